"""Length, width and orientation of what an image shows: the smallest rectangle around it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import label
from shapely.geometry.base import BaseGeometry

from mvla_sim.errors import ConfigError, DataError, check_argument
from mvla_sim.grid import VoxelGrid

__all__ = ["Box", "bounding_box", "box_of_outline", "largest_parts"]

Floats = NDArray[np.float64]

SAME = 1e-9  # relative; lengths and areas nearer than this are equal but for rounding


@dataclass(frozen=True)
class Box:
    """A rectangle in the x–y plane.

    Attributes
    ----------
    center_m
        Centre (x, y), metres.
    length_m, width_m
        Long and short side, metres.
    orientation_deg
        Direction of the long side, counter-clockwise from the x axis, in (−90, 90] degrees. Of a square, that of the
        side nearest to the x axis.
    """

    center_m: tuple[float, float]
    length_m: float
    width_m: float
    orientation_deg: float

    @property
    def aspect(self) -> float:
        """Length over width."""
        return self.length_m / self.width_m

    @property
    def corners_m(self) -> Floats:
        """Corners, counter-clockwise, ``[4, 2]`` metres."""
        angle = math.radians(self.orientation_deg)
        along = np.array([math.cos(angle), math.sin(angle)]) * self.length_m / 2
        across = np.array([-math.sin(angle), math.cos(angle)]) * self.width_m / 2
        return np.asarray(self.center_m) + np.stack([along + across, across - along, -along - across, along - across])


def bounding_box(occupied: NDArray[np.bool_], grid: VoxelGrid, keep_area: float = 1.0) -> Box:
    """Smallest rectangle, in any direction, around the full squares of the occupied voxels.

    Parameters
    ----------
    occupied
        Binary image ``[nz, ny, nx]`` bool; several layers are seen from above.
    grid
        The voxel grid.
    keep_area
        Share of the occupied area that counts, in (0, 1]. The largest connected parts (voxels that share a side or a
        corner) are taken until they hold this share, and with the last one all of its size; with less than 1 a lone
        voxel need not decide the box.

    Returns
    -------
    Box
        Never smaller than a voxel; of rectangles of the same area the one nearest to the x axis.

    Raises
    ------
    DataError
        No voxel is occupied, or the mask has another shape than the grid.
    ConfigError
        ``keep_area`` is not in (0, 1].
    """
    check_argument("occupied", occupied, np.ndarray, "an image has one")
    check_argument("grid", grid, VoxelGrid, "an image has one")
    if occupied.shape != grid.shape:
        raise DataError(f"bounding box: occupied has shape {occupied.shape}, the grid {grid.shape}")
    if not 0 < keep_area <= 1:
        raise ConfigError(f"bounding box: keep_area = {keep_area:g}; must be above 0 and at most 1")
    plane = np.asarray(np.any(occupied, axis=0), bool)
    if not plane.any():
        raise DataError("bounding box: no voxel is occupied; at least one is needed")
    if keep_area < 1:
        parts, sizes = _parts(plane)
        falling = np.sort(sizes[1:])[::-1]
        enough = int(np.argmax(np.cumsum(falling) >= keep_area * falling.sum() * (1 - SAME)))
        plane = plane & (sizes[parts] >= falling[enough])
    # The first and the last voxel of each row decide the hull. In voxels, corners are whole numbers.
    rows = np.flatnonzero(plane.any(axis=1))
    first = plane[rows].argmax(axis=1)
    last = plane.shape[1] - plane[rows, ::-1].argmax(axis=1)  # its right edge
    corners = np.concatenate([np.stack([x, y], axis=-1) for x in (first, last) for y in (rows, rows + 1)])
    box = _smallest(shapely.convex_hull(shapely.multipoints(corners)))
    x, y, _ = grid.bounds_m()[0]
    step = grid.spacing_m
    center_m = (float(x + step * box.center_m[0]), float(y + step * box.center_m[1]))
    return Box(center_m, box.length_m * step, box.width_m * step, box.orientation_deg)


def box_of_outline(outline: BaseGeometry) -> Box:
    """Smallest rectangle, in any direction, around an outline in the x–y plane, metres.

    Raises
    ------
    DataError
        The outline is empty or encloses no area.

    Examples
    --------
    >>> box_of_outline(shapely.box(0.0, -1.0, 4.0, 1.0))
    Box(center_m=(2.0, 0.0), length_m=4.0, width_m=2.0, orientation_deg=0.0)
    """
    hull = shapely.convex_hull(outline)
    if hull.geom_type != "Polygon" or hull.is_empty:
        raise DataError(f"bounding box: the outline is a {outline.geom_type} without an area; a polygon is needed")
    return _smallest(hull)


def largest_parts(occupied: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Drop the connected parts that hold less than a share of all occupied voxels.

    Parameters
    ----------
    occupied
        Binary image ``[nz, ny, nx]`` bool. Voxels that share a face, an edge or a corner are connected: in one layer,
        each with its eight neighbours.
    share
        The least share of a part that stays, in [0, 1]; 0 keeps everything.

    Returns
    -------
    ndarray of bool
        The mask of what stays, of the same shape; nothing if every part is below the share.

    Raises
    ------
    ConfigError
        ``share`` is not in [0, 1].
    """
    if not 0 <= share <= 1:
        raise ConfigError(f"largest parts: share = {share:g}; allowed: 0 to 1")
    mask = np.asarray(occupied, bool)
    parts, sizes = _parts(mask)
    return np.asarray(mask & (sizes[parts] >= share * sizes[1:].sum() * (1 - SAME)), bool)


def _parts(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Label the connected parts from 1, the rest 0, and count the voxels of each label."""
    parts, _ = label(mask, np.ones((3,) * mask.ndim))
    return parts, np.bincount(parts.ravel())


def _smallest(hull: BaseGeometry) -> Box:
    """Smallest rectangle around a convex polygon; one of its sides lies along a side of the polygon.

    That leaves as many candidates as the polygon has sides. Equal ones must not be told apart by rounding.
    """
    points = shapely.get_coordinates(hull)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2  # far from the origin, products would lose digits
    points = points - middle
    sides = np.diff(points, axis=0)
    along = sides / np.hypot(*sides.T)[:, None]
    frame = np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=-1)], axis=1)  # [n_side, 2, 2]
    places = frame @ points.T  # [n_side, 2, n_point]
    low, high = places.min(axis=-1), places.max(axis=-1)
    extent = high - low  # [n_side, 2]
    center = np.einsum("skd,sk->sd", frame, (low + high) / 2) + middle
    square = np.isclose(extent[:, 0], extent[:, 1], rtol=SAME, atol=0)
    direction = np.rad2deg(np.arctan2(along[:, 1], along[:, 0])) + np.where(extent[:, 1] > extent[:, 0], 90.0, 0.0)
    direction = np.where(square, 45 - (45 - direction) % 90, 90 - (90 - direction) % 180)
    area = extent.prod(axis=1)
    equal = np.flatnonzero(area <= area.min() * (1 + SAME))
    best = equal[np.argmin(np.abs(direction[equal]))]
    return Box(
        center_m=(float(center[best, 0]), float(center[best, 1])),
        length_m=float(extent[best].max()),
        width_m=float(extent[best].min()),
        orientation_deg=float(direction[best]),
    )
