"""Ground truth on the voxel grid: which voxels an outline occupies, and their geometry for the scores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label
from shapely.geometry import MultiPolygon, Polygon

from mvla_sim.errors import DataError
from mvla_sim.grid import VoxelGrid

__all__ = ["TruthGeometry", "check_inside", "rasterize", "whole_coordinates"]

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]

TOUCH = 1e-6  # of a voxel: edges nearer than this touch, so that rounding never decides
STENCIL_ENTRIES = 150_000  # truth voxels × neighbours; more costs time at every T_θ, fewer leave more to fill in
MAX_STENCIL_RADIUS = 16  # voxels; each distinct length within it costs a pass


@dataclass(frozen=True, eq=False)
class TruthGeometry:
    """What the scores and the threshold search need of one ground truth on one grid; build it once, use it often.

    All lengths are in voxels, so squared distances between voxel centres are whole numbers.

    Attributes
    ----------
    grid
        The voxel grid.
    voxels
        Flat indices of the truth voxels, ``[U]``.
    points
        Their whole-number coordinates (ix, iy, iz), ``[U, 3]``.
    squared
        Squared distance of every voxel to the truth, ``[N]``, spacing².
    neighbours
        Flat indices of the J nearest voxels of each truth voxel, nearest first, ``[J, U]``; N where outside the grid.
    shells
        First row of ``neighbours`` of each group of equal length, ``[S + 1]``, the last entry being J.
    steps
        Squared length of the next group minus that of this one, ``[S]``, spacing²; the last group's next is ``cap``.
    cap
        Least squared distance that a voxel outside the stencil can have, spacing².
    """

    grid: VoxelGrid
    voxels: Integers
    points: Floats
    squared: Floats
    neighbours: Integers
    shells: Integers
    steps: Floats
    cap: float

    def __repr__(self) -> str:
        """One line: how many voxels of how many."""
        return f"TruthGeometry({self.voxels.size} of {self.grid.size} voxels)"

    @classmethod
    def build(cls, truth: NDArray[np.bool_], grid: VoxelGrid) -> TruthGeometry:
        """Prepare a truth mask ``[nz, ny, nx]``.

        Raises
        ------
        DataError
            The mask has another shape than the grid or holds no voxel.
        """
        mask = np.asarray(truth, bool)
        if mask.shape != grid.shape:
            raise DataError(f"ground truth: shape {mask.shape} is not the grid's {grid.shape}")
        voxels = np.flatnonzero(mask)
        if voxels.size == 0:
            raise DataError("ground truth: holds no voxel; at least one is needed")
        points = whole_coordinates(voxels, grid)
        offsets, radius = _stencil(grid, STENCIL_ENTRIES // voxels.size)
        inside = np.ones((len(offsets), voxels.size), bool)
        neighbours = np.broadcast_to(voxels, inside.shape).copy()
        stride = 1
        for axis, count in enumerate(grid.counts):
            place = offsets[:, axis, None] + points[:, axis].astype(np.intp)
            inside &= (place >= 0) & (place < count)
            neighbours += stride * offsets[:, axis, None]
            stride *= count
        neighbours[~inside] = grid.size
        length = (offsets**2).sum(axis=1)
        starts = np.flatnonzero(np.diff(length, prepend=-1))
        cap = radius**2 + 1
        return cls(
            grid=grid,
            voxels=voxels,
            points=points,
            squared=np.rint(distance_transform_edt(~mask).ravel() ** 2),
            neighbours=neighbours,
            shells=np.append(starts, length.size),
            steps=np.diff(length[starts], append=cap).astype(float),
            cap=float(cap),
        )


def check_inside(outline: Polygon | MultiPolygon, grid: VoxelGrid, thickness_m: float = 0.0) -> None:
    """Refuse an outline that is no area or does not lie wholly inside the grid's footprint.

    Parameters
    ----------
    outline
        Cross-section in the x–y plane, metres.
    grid
        The voxel grid; touching its edge is still inside.
    thickness_m
        Of the outline, half of it on either side, metres.

    Raises
    ------
    DataError
        By how many metres the outline sticks out, and on which sides.
    """
    if not isinstance(outline, Polygon | MultiPolygon):
        raise DataError(f"ground truth: the outline is a {type(outline).__name__}; it must be a polygon")
    if outline.is_empty:
        raise DataError("ground truth: the outline is empty; at least one polygon is needed")
    if not outline.is_valid:
        raise DataError(f"ground truth: the outline is no valid polygon: {shapely.is_valid_reason(outline)}")
    lower, upper = grid.bounds_m()
    half = thickness_m / 2
    x_min, y_min, x_max, y_max = np.add(outline.bounds, (-half, -half, half, half))
    beyond = {"-x": lower[0] - x_min, "+x": x_max - upper[0], "-y": lower[1] - y_min, "+y": y_max - upper[1]}
    out = [f"{by:.3g} m at {side}" for side, by in beyond.items() if by > TOUCH * grid.spacing_m]
    if out:
        raise DataError(
            f"ground truth: {f'with a thickness of {thickness_m:g} m it ' if thickness_m else ''}"
            f"sticks out of the grid by {', '.join(out)}; the grid spans "
            f"x {lower[0]:g} to {upper[0]:g} m, y {lower[1]:g} to {upper[1]:g} m: "
            "enlarge grid.size_m or move grid.center_m"
        )


def rasterize(
    outline: Polygon | MultiPolygon,
    grid: VoxelGrid,
    kind: Literal["contour", "filled"],
    thickness_m: float = 0.0,
) -> NDArray[np.bool_]:
    """Return the voxels that an outline occupies, ``[nz, ny, nx]`` bool.

    Parameters
    ----------
    outline
        Cross-section in the x–y plane, metres, possibly with holes.
    grid
        The voxel grid, one layer.
    kind
        ``contour``: voxels whose closed square the boundary (exterior and holes) meets. Touching counts, within
        10⁻⁶ of a voxel: a boundary on the edge between two voxels marks both. ``filled``: these, and the voxels
        whose centre the outline covers.
    thickness_m
        Of the contour, metres: voxels whose centre lies within half of it from the boundary are marked as well.

    Raises
    ------
    DataError
        The grid has several layers, ``kind`` is neither, a thickness is below 0 or not the contour's, or
        :func:`check_inside` refuses the outline.
    """
    if kind not in ("contour", "filled"):
        raise DataError(f"ground truth: kind = {kind!r}; allowed: contour, filled")
    if grid.counts[2] != 1:
        raise DataError(
            f"ground truth: the grid has {grid.counts[2]} layers; an outline needs exactly 1 (size_m z = 0)"
        )
    if not (np.isfinite(thickness_m) and thickness_m >= 0) or (thickness_m and kind != "contour"):
        raise DataError(f"ground truth: thickness_m = {thickness_m:g}; must be at least 0, and 0 unless of a contour")
    check_inside(outline, grid, thickness_m)
    nx, ny, _ = grid.counts
    x0, y0, _ = grid.origin_m
    # In units of voxels from the centre of voxel 0, voxel (ix, iy) is the square ix ± 1/2, iy ± 1/2.
    scaled = shapely.transform(outline, lambda xy: (xy - [x0, y0]) / grid.spacing_m)
    contour = _contour(shapely.boundary(scaled), nx, ny)
    if thickness_m:
        contour |= _near(shapely.boundary(scaled), thickness_m / 2 / grid.spacing_m, nx, ny)
    mask = contour if kind == "contour" else contour | _covered(scaled, contour)
    return mask[None]


def _contour(boundary: shapely.Geometry, nx: int, ny: int) -> NDArray[np.bool_]:
    """Voxels ``[ny, nx]`` whose square meets the boundary: candidates near its points, then the exact test."""
    nearest = np.unique(np.rint(shapely.get_coordinates(shapely.segmentize(boundary, 0.5))).astype(np.intp), axis=0)
    # A piece is at most half a voxel long, so each voxel it meets is a neighbour of an end point's voxel.
    step = np.arange(-1, 2)
    ix = (nearest[:, 0, None, None] + step[:, None] + 0 * step).ravel()
    iy = (nearest[:, 1, None, None] + step + 0 * step[:, None]).ravel()
    inside = (ix >= 0) & (ix < nx) & (iy >= 0) & (iy < ny)
    candidates = np.unique(iy[inside] * nx + ix[inside])
    ix, iy = candidates % nx, candidates // nx
    half = 0.5 + TOUCH
    shapely.prepare(boundary)
    met = shapely.intersects(boundary, shapely.box(ix - half, iy - half, ix + half, iy + half))
    mask = np.zeros(nx * ny, bool)
    mask[candidates[met]] = True
    return mask.reshape(ny, nx)


def _near(boundary: shapely.Geometry, distance: float, nx: int, ny: int) -> NDArray[np.bool_]:
    """Voxels ``[ny, nx]`` whose centre lies within a distance, in voxels, of the boundary."""
    shapely.prepare(boundary)
    iy, ix = np.indices((ny, nx))
    return np.asarray(shapely.dwithin(boundary, shapely.points(ix, iy), distance + TOUCH), bool)


def _covered(outline: Polygon | MultiPolygon, contour: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels ``[ny, nx]`` off the contour whose centre is covered.

    The boundary meets none of them, so side neighbours lie on the same side of it: one test a connected part.
    """
    parts, count = label(~contour)
    _, first = np.unique(parts, return_index=True)
    first = first[-count:] if count else first[:0]
    inside = np.zeros(count + 1, bool)
    inside[1:] = shapely.intersects_xy(outline, first % contour.shape[1], first // contour.shape[1])
    return np.asarray(inside[parts], bool)


def whole_coordinates(voxels: Integers, grid: VoxelGrid) -> Floats:
    """Whole-number coordinates (ix, iy, iz) of flat voxel indices, ``[n, 3]``, in voxels."""
    return np.stack(np.unravel_index(voxels, grid.shape)[::-1], axis=-1).astype(float)


def _stencil(grid: VoxelGrid, budget: int) -> tuple[Integers, int]:
    """Offsets (ix, iy, iz) within a radius, nearest first, ``[J, 3]`` with J about ``budget``; and the radius."""
    dimensions = max(1, sum(count > 1 for count in grid.counts))
    volume = (2.0, np.pi, 4 / 3 * np.pi)[dimensions - 1]
    radius = int(np.clip((budget / volume) ** (1 / dimensions), 1, MAX_STENCIL_RADIUS))
    spans = [np.arange(-min(radius, count - 1), min(radius, count - 1) + 1) for count in grid.counts]
    offsets = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 3)
    length = (offsets**2).sum(axis=1)
    order = np.argsort(length, kind="stable")
    return offsets[order[: np.count_nonzero(length <= radius**2)]], radius
