"""Coherent backprojection: amplitudes are added with the carrier's phase. It shows what phase-free methods give up.

``image_n = |Σ_m h_m(τ_mn) e^{+j2πf_c τ_mn}|²`` with τ_mn = 2 r_mn/c, the delay to voxel n and back.

h_m is the baseband amplitude of :class:`~mvla_sim.imaging.pdp.Pdp`: the gain of a path at delay τ has the carrier's
phase e^{−j2πf_cτ}, which is a constant of that path, and h varies with the range no faster than the band allows.
So h can be interpolated between its samples; the carrier's phase is put in afterwards, at each voxel's own delay. The
phase depends on the voxel, hence real and imaginary part are no range profiles, and the projector cannot add them.

Source: backprojection for synthetic apertures, textbook matter. A focus is about λ/4 wide, so positions, delays and the
spacing of views must be right to a fraction of λ; with a phase of its own in every view the focus is gone.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mvla_sim.constants import SPEED_OF_LIGHT
from mvla_sim.errors import ConfigError
from mvla_sim.imaging.method import Method
from mvla_sim.imaging.noise import NOISES
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.projection import check_grid

__all__ = ["CoherentBackprojection"]

_NODES_PER_CELL = 32
"""Nodes per ΔR between which h is taken as linear; it turns by at most π/32 there, which errs by 0.1 %."""
_BLOCK = 1 << 14  # voxels at a time: their arrays stay in the cache


class CoherentBackprojection(Method):
    """``image_n = |Σ_m h_m(τ_mn) e^{+j2πf_c τ_mn}|²``, scaled by the largest |h|²."""

    name: ClassVar[str] = "bp-coherent"
    title: ClassVar[str] = "Coherent backprojection"
    uses_peaks: ClassVar[bool] = False
    uses_pdp: ClassVar[bool] = True
    uses_amplitude: ClassVar[bool] = True

    def image(self, seen: Observation) -> Estimate:
        """Add amplitudes up, ``[nz, ny, nx]``; in blocks of voxels, views in the order of their positions.

        Raises
        ------
        ConfigError
            Noise was added to the power, so that there is no phase any more; or echoes are single samples.
        """
        if seen.pdp.amplitude is None:
            kind = NOISES.name_of(type(seen.settings.noise))
            raise ConfigError(
                f"noise.kind = '{kind}': noise on the power leaves no phase, which bp-coherent "
                "needs; use noise.kind = 'complex' or noise.snr_db = 'none'"
            )
        if seen.pdp.kernel == "nearest":
            raise ConfigError(
                "pdp.kernel = 'nearest': echoes that are single samples tell no phase between them, which bp-coherent "
                "needs; use pdp.kernel = 'band-limited'"
            )
        check_grid(seen.grid)
        table, start, step = _fine(seen)
        per_metre = 2 * seen.pdp.carrier_hz / SPEED_OF_LIGHT
        total = np.empty(seen.grid.size, np.float32)
        for first in range(0, seen.grid.size, _BLOCK):
            indices = np.arange(first, min(first + _BLOCK, seen.grid.size))
            image = _focused(seen, seen.grid.centers(indices), (table, start, step), per_metre)
            total[indices] = image.real**2 + image.imag**2
        return Estimate(total.reshape(seen.grid.shape))


def _fine(seen: Observation) -> tuple[NDArray[np.complex64], float, float]:
    """h_m on a finer axis, ``[n_view, n_range]``, by cubic splines; with its first range and spacing, metres."""
    pdp = seen.pdp
    assert pdp.amplitude is not None
    times = max(1, -(-_NODES_PER_CELL // pdp.oversampling))
    samples = pdp.amplitude.shape[1]
    nodes = np.arange((samples - 1) * times + 1) / times
    largest = np.abs(pdp.amplitude).max()
    table = np.empty((len(pdp.amplitude), nodes.size), np.complex64)
    for view, amplitude in enumerate(pdp.amplitude):
        table[view] = CubicSpline(np.arange(samples), amplitude / (largest or 1.0))(nodes)
    return table, pdp.start_m, pdp.step_m / times


def _focused(
    seen: Observation,
    points_m: NDArray[np.float64],
    profiles: tuple[NDArray[np.complex64], float, float],
    turns_per_m: float,
) -> NDArray[np.complex128]:
    """Σ_m h_m e^{+j2π·(turns_per_m)·r_mn} at points ``[n, 3]`` metres."""
    table, start, step = profiles
    views = seen.views
    total = np.zeros(len(points_m), np.complex128)
    x, y, z = np.ascontiguousarray(points_m.T)
    for view in np.lexsort(views.positions_m.T):
        ends = [views.positions_m[view]]
        if views.receivers_m is not None:
            ends.append(views.receivers_m[view])
        distances = [np.sqrt((x - end[0]) ** 2 + (y - end[1]) ** 2 + (z - end[2]) ** 2) for end in ends]
        distance = sum(distances) / len(distances)
        cell = (distance - start) / step
        inside = (cell >= 0) & (cell < table.shape[1] - 1)
        if seen.beam is not None:
            for end in ends:
                inside &= seen.beam.covers(points_m - end, views.directions[view])
        node = np.where(inside, cell, 0).astype(np.intp)
        low = table[view, node]
        value = low + (cell - node).astype(np.float32) * (table[view, node + 1] - low)
        turns = turns_per_m * distance
        phase = (2 * np.pi * (turns - np.rint(turns))).astype(np.float32)
        total += np.where(inside, value, 0) * (np.cos(phase) + 1j * np.sin(phase))
    return total
