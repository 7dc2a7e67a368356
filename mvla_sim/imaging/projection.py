"""The one projector behind every method: ``image_n = Σ_m q_m(|p_n − T_m|)``, with Θ_n in the same pass."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import psutil
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError
from mvla_sim.runtime.memory import USABLE, check_memory
from mvla_sim.scene.grid import VoxelGrid
from mvla_sim.scene.trajectory import Views

__all__ = ["Projection", "RangeProfiles", "check_grid", "project"]

_BYTES_PER_VOXEL = 32  # score and Θ as float32, their copies while an image is made, ranked and written
_BLOCK = 1 << 18  # voxels a kernel call: enough to fill the cores, few enough to stay in cache and memory
_PER_LANE = {True: 2, False: 4}  # voxels a thread, with and without support: measured best on two AVX-512 cores


@dataclass(frozen=True)
class RangeProfiles:
    """Range profiles q_m of M views on one uniform range axis, linear between its nodes.

    Attributes
    ----------
    values
        q_m(r_l), ``[n_view, n_range]`` float32. Voxels whose range is off the axis receive nothing from the view.
    start_m, step_m
        First range and spacing of the axis, metres.
    distance_m
        Distance from r_l to the nearest peak of the view, ``[n_view, n_range]`` float32, metres, or None for methods
        without peaks.
    radius_m
        R_T: a view supports a voxel, and adds to it, where ``distance ≤ radius_m``; unused without ``distance_m``.
    """

    values: NDArray[np.float32]
    start_m: float
    step_m: float
    distance_m: NDArray[np.float32] | None = None
    radius_m: float = float("inf")

    def __post_init__(self) -> None:
        """Check shapes."""
        if self.values.ndim != 2 or self.values.shape[1] < 2:
            raise ConfigError(f"profiles: values has shape {self.values.shape}, must be [n_view, n_range ≥ 2]")
        if self.distance_m is not None and self.distance_m.shape != self.values.shape:
            raise ConfigError(f"profiles: distance has shape {self.distance_m.shape}, values {self.values.shape}")

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return len(self.values)

    def select(self, indices: NDArray[np.intp]) -> RangeProfiles:
        """Return the given views, in the given order."""
        distance = None if self.distance_m is None else self.distance_m[indices]
        return replace(self, values=self.values[indices], distance_m=distance)


@dataclass(frozen=True)
class Projection:
    """Result of :func:`project`.

    Attributes
    ----------
    total
        Σ_m q_m per voxel, ``[nz, ny, nx]`` float32.
    support_deg
        Θ_n, ``[nz, ny, nx]`` float32, degrees (``eq:angular_support_range``); None without a distance table.
    """

    total: NDArray[np.float32]
    support_deg: NDArray[np.float32] | None


def check_grid(grid: VoxelGrid) -> None:
    """Refuse a grid whose images do not fit into the free memory.

    Raises
    ------
    ConfigError
        The size, what is free, and by how much the grid is too large.
    """
    nx, ny, nz = grid.counts
    dimensions = sum(n > 1 for n in grid.counts) or 1
    free = USABLE * psutil.virtual_memory().available
    fits = grid.spacing_m * (grid.size * _BYTES_PER_VOXEL / free) ** (1 / dimensions)
    check_memory(
        grid.size * _BYTES_PER_VOXEL,
        f"grid.spacing_m = {grid.spacing_m:g}: {nx} × {ny} × {nz} voxels",
        f"a spacing of {fits:.2g} m fits",
    )


def project(grid: VoxelGrid, views: Views, profiles: RangeProfiles, *, block: int = _BLOCK) -> Projection:
    """Project range profiles onto a grid.

    Parameters
    ----------
    grid
        Voxel centres p_n.
    views
        Positions T_m and angles φ_m; runs of supporting views follow the angle, whatever the order of the views, and
        cross 0°/360° where the trajectory is closed.
    profiles
        One profile a view.
    block
        Voxels handled at a time; bounds the memory beyond the result, and changes nothing else.

    Returns
    -------
    Projection
        Sums, and Θ where the profiles have a distance table.

    Notes
    -----
    Θ_n is the width, last angle minus first, of the longest run of consecutive supporting views. If all views of a
    closed trajectory support a voxel, the run can be cut anywhere, and the cut at the smallest gap is the widest:
    Θ = 360° − min gap. Cost: O(M·N), whatever the number of peaks.

    Raises
    ------
    ConfigError
        Profiles and views differ in number, or the grid does not fit into memory.
    """
    if profiles.n_view != len(views):
        raise ConfigError(f"projection: {profiles.n_view} profiles for {len(views)} views")
    check_grid(grid)
    from mvla_sim.imaging import kernels  # noqa: PLC0415 - compiles: only where something is projected

    t = kernels.BACKEND.arrays
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    order, angles = _along(views)
    gaps = np.diff(angles, prepend=angles[:1])
    tables = kernels.Tables(
        view=t.Float32(np.column_stack([views.positions_m[order], gaps]).astype(np.float32).ravel()),
        values=_upload(t, profiles.values[order]),
        distance=None if profiles.distance_m is None else _upload(t, profiles.distance_m[order]),
    )
    nx, ny, _ = grid.counts
    with_support = tables.distance is not None
    per_lane = _PER_LANE[with_support]
    lanes = min(block, -(-grid.size // per_lane) * per_lane) // per_lane or 1
    integers = [dr.opaque(t.UInt32, v) for v in (nx, ny)]
    floats = [dr.opaque(t.Float32, v) for v in (*grid.origin_m, grid.spacing_m)]
    axis = (
        dr.opaque(t.UInt32, profiles.n_view),
        dr.opaque(t.UInt32, profiles.values.shape[1]),
        dr.opaque(t.Float32, profiles.start_m),
        dr.opaque(t.Float32, 1 / profiles.step_m),
    )
    radius = dr.opaque(t.Float32, profiles.radius_m)
    wrap = 360.0 - float(angles[-1] - angles[0]) if views.closed else None
    all_views = 360.0 - float(min(gaps[1:].min(initial=360.0), wrap)) if wrap is not None else None

    total = np.empty(grid.size, np.float32)
    support = np.empty(grid.size, np.float32) if with_support else None
    for start in range(0, grid.size, lanes * per_lane):
        outputs = kernels.project_block(
            tables, (*integers, *floats), axis, radius, dr.opaque(t.UInt32, start), lanes, per_lane, t
        )
        dr.eval(outputs if with_support else outputs[0])
        stop = min(start + lanes * per_lane, grid.size)
        total[start:stop] = _join(outputs[0], stop - start)
        if support is not None:
            longest, run, first, unbroken = (_join(part, stop - start) for part in outputs[1:])
            if wrap is not None and all_views is not None:
                joined = np.where((run >= 0) & (first >= 0), run + first + np.float32(wrap), 0)
                longest = np.where(unbroken, np.float32(all_views), np.maximum(longest, joined))
            support[start:stop] = longest
    return Projection(total.reshape(grid.shape), None if support is None else support.reshape(grid.shape))


def _along(views: Views) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Order of the views by angle, and their angles, rising; an open trajectory starts behind its widest gap."""
    order = np.argsort(views.angles_deg, kind="stable")
    angles = views.angles_deg[order]
    if views.closed:
        return order, angles
    first = int(np.argmax(np.diff(angles, prepend=angles[-1] - 360)))
    turns = np.where(np.arange(angles.size) < first, 360, 0)
    return np.roll(order, -first), np.roll(angles + turns, -first)


def _upload(t: object, profiles: NDArray[np.float32]) -> object:
    """Flatten to the device, with one sample behind the last so that the right neighbour always exists."""
    return t.Float32(np.append(profiles.astype(np.float32, copy=False).ravel(), np.float32(0)))  # type: ignore[attr-defined]


def _join(parts: list[object], count: int) -> NDArray[np.float32]:
    """Concatenate the per-lane parts of a block to its first ``count`` voxels."""
    return np.concatenate([part.numpy() for part in parts])[:count]  # type: ignore[attr-defined]
