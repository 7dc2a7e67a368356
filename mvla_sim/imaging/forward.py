"""What every view would see of an image: the projector's transpose, and both with their tables on the device."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import Beam
from mvla_sim.imaging.projection import _PER_LANE, RangeProfiles, _upload_tables, check_grid
from mvla_sim.scene.views import Views

__all__ = ["RangeOperator", "forward"]

_LANES = 256  # threads of the forward kernel: enough for the cores, few enough for the cache; not the machine's number,
# which would change the order of sums
_TOGETHER = 2  # views a thread: they share the voxel; measured best on two AVX2 cores


class RangeOperator:
    """The pair S, Sᵀ of an image ``[N]`` and range profiles ``[M, n_range]``; views and beams stay on the device.

    ``(S x)_ml = Σ_n h(r_mn/δ − l) x_n`` with the triangle h(u) = max(0, 1 − |u|) of linear interpolation, δ the axis's
    step, r_mn the range of voxel n from view m, of a pair half the way there and back; over the voxels that the view's
    beam covers. Sᵀ is the projector (:func:`~mvla_sim.imaging.projection.project`).

    Parameters
    ----------
    grid
        Voxel centres p_n.
    views
        Positions T_m.
    start_m, step_m, count
        First range, spacing (metres) and number of nodes of the range axis. A voxel whose range is off the axis is not
        seen by the view.
    beam
        The sector that each view's antennas cover; None: everywhere.

    Raises
    ------
    ConfigError
        The axis has fewer than two nodes, or the grid does not fit into memory.
    """

    def __init__(
        self, grid: VoxelGrid, views: Views, start_m: float, step_m: float, count: int, *, beam: Beam | None = None
    ) -> None:
        check_grid(grid)
        from mvla_sim.imaging import kernels  # noqa: PLC0415 - compiles: only where something is projected

        t: Any = kernels.BACKEND.arrays
        import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

        self.grid = grid
        self.n_view = len(views)
        self.n_range = count
        self.arrays = t
        no_profiles = RangeProfiles(np.zeros((self.n_view, min(count, 2)), np.float32), start_m, step_m)
        tables = _upload_tables(kernels, views, views.angles_deg, no_profiles, beam)
        self._tables = replace(tables, ends=None)
        nx, ny, _ = grid.counts
        self.node_count = dr.opaque(t.UInt32, count)
        self._counts = [dr.opaque(t.UInt32, n) for n in (nx, ny)]
        self._place = [dr.opaque(t.Float32, v) for v in (*grid.origin_m, grid.spacing_m)]
        self._axis = [dr.opaque(t.Float32, v) for v in (start_m, 1 / step_m)]
        self._together = _TOGETHER if self.n_view >= _TOGETHER else 1
        self._parts = min(grid.size, -(-_LANES * self._together // self.n_view))

    def forward(self, image: Any, weight: Any | None = None) -> Any:
        """S x of an image ``[N]`` on the device, flat ``[M·n_range]`` float32, not yet evaluated.

        ``weight`` ``[n_range]`` on the device scales every node of all views.
        """
        import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

        from mvla_sim.imaging import forward_kernel  # noqa: PLC0415 - as above

        size = dr.opaque(self.arrays.UInt32, self.grid.size)
        grid = (*self._counts, size, *self._place)
        cut = {"parts": self._parts, "together": self._together, "n_view": self.n_view, "nodes": self.n_range}
        rows = forward_kernel.spread(self._tables, image, grid, (self.node_count, *self._axis), **cut)
        dr.eval(rows)
        return forward_kernel.fold(rows, weight, self.node_count, **cut)

    def project(self, profiles: Any) -> Any:
        """Sᵀ q of profiles ``[M·n_range]`` on the device; flat ``[N]`` float32, evaluated."""
        import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

        from mvla_sim.imaging import kernels  # noqa: PLC0415 - compiles: only where something is projected

        t = self.arrays
        nx, ny, nz = self.grid.counts
        per_lane = min(_PER_LANE, ny * nz)
        lanes = -(-ny * nz // per_lane) * nx
        axis = (dr.opaque(t.UInt32, self.n_view), self.node_count, *self._axis)
        found = kernels.project_block(
            replace(self._tables, values=profiles),
            (*self._counts, *self._place),
            axis,
            dr.opaque(t.Float32, np.inf),
            dr.opaque(t.UInt32, 0),
            lanes,
            per_lane,
            t,
        )["total"]
        image = dr.empty(t.Float32, self.grid.size)
        lane, width = dr.arange(t.UInt32, lanes), self._counts[0]
        size = dr.opaque(t.UInt32, self.grid.size)
        for u, total in enumerate(found):
            index = (lane // width * per_lane + u) * width + lane % width
            dr.scatter(image, total, index, index < size, mode=dr.ReduceMode.Permute)
        dr.eval(image)
        return image


def forward(
    grid: VoxelGrid,
    views: Views,
    image: NDArray[np.floating],
    *,
    start_m: float,
    step_m: float,
    count: int,
    beam: Beam | None = None,
) -> NDArray[np.float32]:
    """Range profiles of an image, as :class:`RangeOperator` defines them: the transpose of the projector.

    Parameters
    ----------
    image
        x_n, ``[nz, ny, nx]``, any unit.
    grid, views, start_m, step_m, count, beam
        As for :class:`RangeOperator`.

    Returns
    -------
    NDArray[np.float32]
        ``[n_view, n_range]``, in the image's unit.

    Raises
    ------
    ConfigError
        The image is not of the grid's shape, or as for :class:`RangeOperator`.
    """
    if image.shape != grid.shape:
        raise ConfigError(f"forward: the image has shape {image.shape}, the grid {grid.shape}")
    operator = RangeOperator(grid, views, start_m, step_m, count, beam=beam)
    profiles = operator.forward(operator.arrays.Float32(np.ascontiguousarray(image, np.float32).ravel()))
    return np.asarray(profiles.numpy(), np.float32).reshape(len(views), count)
