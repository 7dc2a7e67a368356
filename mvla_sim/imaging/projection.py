"""The one projector behind every method: ``image_n = Σ_m q_m(|p_n − T_m|)``, with Θ_n in the same pass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import Beam
from mvla_sim.memory import USABLE, check_memory
from mvla_sim.scene.antenna import STEP_DEG
from mvla_sim.scene.views import Views

__all__ = ["Projection", "RangeProfiles", "check_grid", "project"]

_BYTES_PER_VOXEL = 32  # score and Θ as float32, their copies while an image is made, ranked and written
_BLOCK = 1 << 18  # voxels a kernel call: enough to fill the cores, few enough to stay in cache and memory
_SAME_DEG = 1e-9  # angles this near to each other are one: coordinates of one direction are rounded to 1e-13 degrees
_PER_LANE = 4  # rows a thread: they read neighbouring nodes, so more of them need less of the memory


@dataclass(frozen=True, eq=False, repr=False)
class RangeProfiles:
    """Range profiles q_m of M views on one uniform range axis, linear between its nodes.

    Attributes
    ----------
    values
        q_m(r_l), ``[n_view, n_range]`` float32. Voxels whose range is off the axis receive nothing from the view.
    start_m, step_m
        First range and spacing of the axis, metres.
    nearest_m
        Range R of the view's peak that is nearest to the middle between r_l and r_(l+1), ``[n_view, n_range]`` float32,
        metres, or None for methods without peaks.
    radius_m
        R_T: a view supports a voxel at range r where ``|r − R| ≤ radius_m``; unused without ``nearest_m``.
    gated
        Whether a view adds only to voxels that it supports, where ``nearest_m`` is given.
    """

    values: NDArray[np.float32]
    start_m: float
    step_m: float
    nearest_m: NDArray[np.float32] | None = None
    radius_m: float = float("inf")
    gated: bool = True

    def __post_init__(self) -> None:
        """Check shapes."""
        if self.values.ndim != 2 or self.values.shape[1] < 2:
            raise ConfigError(f"profiles: values has shape {self.values.shape}, must be [n_view, n_range ≥ 2]")
        if self.nearest_m is not None and self.nearest_m.shape != self.values.shape:
            raise ConfigError(f"profiles: nearest has shape {self.nearest_m.shape}, values {self.values.shape}")

    def __repr__(self) -> str:
        return f"RangeProfiles({self.values.shape[0]} views, {self.values.shape[1]} nodes of {self.step_m:.3g} m)"

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return len(self.values)

    def select(self, indices: NDArray[np.intp]) -> RangeProfiles:
        """Return the given views, in the given order."""
        nearest = None if self.nearest_m is None else self.nearest_m[indices]
        return replace(self, values=self.values[indices], nearest_m=nearest)


@dataclass(frozen=True, eq=False, repr=False)
class Projection:
    """Result of :func:`project`.

    Attributes
    ----------
    total
        Σ_m q_m per voxel, ``[nz, ny, nx]`` float32.
    support_deg
        Θ_n, ``[nz, ny, nx]`` float32, degrees (``eq:angular_support_range``); None without the peaks' ranges.
    coverage
        Number of views whose beam covers the voxel, ``[nz, ny, nx]`` float32; None without a beam.
    """

    total: NDArray[np.float32]
    support_deg: NDArray[np.float32] | None
    coverage: NDArray[np.float32] | None = None

    def __repr__(self) -> str:
        return f"Projection({' × '.join(map(str, self.total.shape[::-1]))} voxels)"


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


def project(
    grid: VoxelGrid, views: Views, profiles: RangeProfiles, *, beam: Beam | None = None, block: int = _BLOCK
) -> Projection:
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
    beam
        The sector that each view's antennas cover; a view adds nothing outside it. None: everywhere.
    block
        Voxels handled at a time; bounds the memory beyond the result, and changes nothing else.

    Returns
    -------
    Projection
        Sums, and Θ where the profiles have the peaks' ranges.

    Notes
    -----
    Θ_n is the width, last angle minus first, of the longest run of consecutive supporting views. If all views of a
    closed trajectory support a voxel, the run can be cut anywhere, and the cut at the smallest gap is the widest:
    Θ = 360° − min gap. Views of one angle, as of sensors at several heights, are one direction, which supports a voxel
    if any of them does. A direction from which no beam covers the voxel neither breaks nor extends a run. Of a pair, a
    voxel is covered where both antennas cover it. Cost: O(M·N), whatever the number of peaks.

    Raises
    ------
    ConfigError
        Profiles and views differ in number, no beam meets the grid, or the grid does not fit into memory.
    """
    if profiles.n_view != len(views):
        raise ConfigError(f"projection: {profiles.n_view} profiles for {len(views)} views")
    check_grid(grid)
    from mvla_sim.imaging import kernels  # noqa: PLC0415 - compiles: only where something is projected

    t = kernels.BACKEND.arrays
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    order, angles = _by_angle(views)
    tables = _upload_tables(kernels, views.select(order), angles, profiles.select(order), beam)
    gaps = np.diff(angles)
    nx, ny, nz = grid.counts
    with_support = tables.nearest is not None
    per_lane = min(_PER_LANE, ny * nz) if nx * _PER_LANE <= block else 1
    groups = -(-ny * nz // per_lane)
    lanes = min(groups * nx, block // (nx * per_lane) * nx if per_lane > 1 else block)
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
    total = np.empty(grid.size, np.float32)
    support = np.empty(grid.size, np.float32) if with_support else None
    coverage = np.empty(grid.size, np.float32) if beam is not None else None
    for start in range(0, grid.size, lanes * per_lane):
        first = dr.opaque(t.UInt32, start // per_lane)
        outputs = kernels.project_block(tables, (*integers, *floats), axis, radius, first, lanes, per_lane, t)
        dr.eval(outputs)
        stop = min(start + lanes * per_lane, grid.size)
        found = {name: _join(arrays, nx, stop - start) for name, arrays in outputs.items() if arrays}
        total[start:stop] = found["total"]
        if support is not None:
            support[start:stop] = _support(found, gaps, wrap)
        if coverage is not None:
            coverage[start:stop] = found["coverage"]
    if beam is not None and coverage is not None and not coverage.any():
        raise ConfigError(
            f"beam.edge_db = {beam.edge_db:g}: no view's beam meets the grid; turn the antennas (pointing), lower the "
            "edge or move the grid"
        )
    return Projection(
        total.reshape(grid.shape),
        None if support is None else support.reshape(grid.shape),
        None if coverage is None else coverage.reshape(grid.shape),
    )


def _support(
    found: dict[str, NDArray[np.float32]], gaps: NDArray[np.float64], wrap: float | None
) -> NDArray[np.float32]:
    """Θ of every voxel from its runs: those at both ends of a closed trajectory are one."""
    longest = found["longest"]
    if wrap is None:
        return longest
    across: NDArray[np.float32] | np.float32 = np.float32(wrap)
    least: NDArray[np.float32] | np.float32 = np.float32(gaps.min(initial=360.0))
    every = found["unbroken"].astype(bool)
    if "known" in found:
        across = found["head"] + found["tail"] + across
        least, every = found["least"], every & found["known"].astype(bool)
    joined = np.where((found["run"] >= 0) & (found["first"] >= 0), found["run"] + found["first"] + across, 0)
    return np.where(every, 360 - np.minimum(least, across), np.maximum(longest, joined)).astype(np.float32)


def _upload_tables(
    kernels: Any, views: Views, angles: NDArray[np.float64], profiles: RangeProfiles, beam: Beam | None
) -> Any:
    """Bring views, in the order of their angles ``[n_view]``, and their profiles to the device."""
    t = kernels.BACKEND.arrays
    gaps = np.diff(angles, prepend=angles[:1])
    apart = np.append(gaps[1:] > _SAME_DEG, True)
    return kernels.DeviceTables(
        view=_four(t, views.positions_m, gaps),
        values=_upload(t, profiles.values),
        gated=profiles.gated,
        nearest=None if profiles.nearest_m is None else _upload(t, profiles.nearest_m),
        receiver=None if views.receivers_m is None else _four(t, views.receivers_m, 0 * gaps),
        beam=None if beam is None else _upload_beam(kernels, views, beam),
        ends=None if beam is None and apart.all() else t.Float32(apart.astype(np.float32)),
    )


def _upload_beam(kernels: Any, views: Views, beam: Beam) -> Any:
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    t = kernels.BACKEND.arrays
    ahead = views.directions
    flat = np.hypot(ahead[:, 0], ahead[:, 1])
    upright = flat == 0
    azimuth = np.where(upright, 0.0, np.arctan2(ahead[:, 1], ahead[:, 0]))
    frame = np.stack([np.cos(azimuth), np.sin(azimuth), flat], axis=1)
    cuts = [np.append(cut, cut[-1]) for cut in (beam.antenna.azimuth_db, beam.antenna.elevation_db)]
    return kernels.BeamTables(
        ahead=_four(t, ahead, 0 * flat),
        frame=_four(t, frame, 0 * flat),
        azimuth=t.Float32(cuts[0].astype(np.float32)),
        elevation=t.Float32(cuts[1].astype(np.float32)),
        per_degree=dr.opaque(t.Float32, 1 / STEP_DEG),
        edge_db=dr.opaque(t.Float32, beam.edge_db if beam.edge_db > beam.antenna.floor_db else -1e6),
    )


def _four(t: Any, triples: NDArray[np.float64], fourth: NDArray[np.float64]) -> Any:
    """Flatten ``[n, 3]`` and ``[n]`` to four numbers a row on the device."""
    return t.Float32(np.column_stack([triples, fourth]).astype(np.float32).ravel())


def _by_angle(views: Views) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Order of the views by angle, and their angles, rising; an open trajectory starts behind its widest gap."""
    around = np.where(views.angles_deg >= 360 - _SAME_DEG, views.angles_deg - 360, views.angles_deg)
    order = np.argsort(around, kind="stable")
    angles = around[order]
    if views.closed:
        return order, angles
    first = int(np.argmax(np.diff(angles, prepend=angles[-1] - 360)))
    turns = np.where(np.arange(angles.size) < first, 360, 0)
    return np.roll(order, -first), np.roll(angles + turns, -first)


def _upload(t: object, profiles: NDArray[np.float32]) -> object:
    """Flatten to the device."""
    return t.Float32(np.ascontiguousarray(profiles, np.float32).ravel())  # type: ignore[attr-defined]


def _join(parts: list[Any], nx: int, count: int) -> NDArray[np.float32]:
    """Put the rows of a block, one in each part by turns, together to its first ``count`` voxels."""
    if len(parts) == 1:
        return np.asarray(parts[0].numpy(), np.float32)[:count]
    return np.stack([part.numpy().reshape(-1, nx) for part in parts], axis=1).ravel()[:count]
