"""From paths to power delay profiles: band-limited, windowed, oversampled, gated (``eq:CIR``, ``eq:PDP``)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import range_resolution, range_to_delay
from mvla_sim.dsp import Window, path_spectrum, range_profiles
from mvla_sim.errors import ConfigError, DataError, check_argument
from mvla_sim.grid import VoxelGrid
from mvla_sim.memory import check_memory
from mvla_sim.scene.views import Views
from mvla_sim.settings import Settings

__all__ = ["Pdp", "PdpSettings", "compute_pdp", "frequency_count", "gate_for"]

_MARGIN_CELLS = 16  # resolution cells kept on both sides of the gate, so that the DFT's wrap-around stays outside it
_BYTES_PER_SAMPLE = 96  # amplitude and power, noise, and copies of them while they are made


class PdpSettings(Settings):
    """From paths to a band-limited power delay profile (``eq:PDP``)."""

    window: Literal["hann", "hamming", "blackman", "kaiser", "rectangular"] = Field("hann", description="over the band")
    kaiser_beta: Annotated[float, Field(ge=0, le=40, description="β of the Kaiser window")] = 6.0
    oversampling: Annotated[int, Field(ge=1, le=64, description="samples per 1/B of delay")] = 4
    gate_m: tuple[NonNegativeFloat, PositiveFloat] | None = Field(
        None, description="one-way range interval kept; by default the ranges at which the grid is seen"
    )

    @model_validator(mode="after")
    def _check(self) -> PdpSettings:
        if self.gate_m is not None and self.gate_m[0] >= self.gate_m[1]:
            raise ValueError(f"gate_m = {list(self.gate_m)} must be [near, far] with near below far")
        return self


@dataclass(frozen=True, eq=False, repr=False)
class Pdp:
    """Power delay profiles of M views on one range axis.

    Attributes
    ----------
    power
        P_m(τ_l) = |h_m(τ_l)|², ``[n_view, n_range]`` float64, path gain; an isolated path of gain g peaks at |g|².
        After PDP-domain noise of zero mean, values may be negative.
    amplitude
        h_m(τ_l), ``[n_view, n_range]`` complex128, or None once noise was added to the power.
    start_m, step_m
        First one-way range and spacing of the axis, metres.
    resolution_m
        ΔR = c/(2B), metres.
    broadening
        Width of the window's main lobe relative to that of no window (its equivalent noise bandwidth).
    window, oversampling
        As in the settings: what noise of the same band looks like.
    carrier_hz
        Carrier frequency, which phase-free methods never look at.
    noise_mean, noise_sigma
        True mean and standard deviation of the noise that was added to each view, where there is no signal and before
        negative powers are clipped, ``[n_view]``, path gain; None where none was added or the data have their own.
    """

    power: NDArray[np.float64]
    amplitude: NDArray[np.complex128] | None
    start_m: float
    step_m: float
    resolution_m: float
    broadening: float
    window: Window = field(default_factory=Window)
    oversampling: int = 1
    carrier_hz: float = float("nan")
    noise_mean: NDArray[np.float64] | None = None
    noise_sigma: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        near, far = self.range_m[[0, -1]]
        return f"Pdp({len(self.power)} views, {self.power.shape[1]} samples from {near:.2f} to {far:.2f} m)"

    @property
    def range_m(self) -> NDArray[np.float64]:
        """Range axis, ``[n_range]`` metres."""
        return np.asarray(self.start_m + self.step_m * np.arange(self.power.shape[1]), np.float64)

    def select(self, indices: NDArray[np.intp]) -> Pdp:
        """Return the given views, in the given order."""
        return replace(
            self,
            power=self.power[indices],
            amplitude=None if self.amplitude is None else self.amplitude[indices],
            noise_mean=None if self.noise_mean is None else self.noise_mean[indices],
            noise_sigma=None if self.noise_sigma is None else self.noise_sigma[indices],
        )


def gate_for(grid: VoxelGrid, views: Views, settings: PdpSettings) -> tuple[float, float]:
    """Range gate (near, far) in metres: the setting, or all ranges at which the grid's voxels are seen."""
    if settings.gate_m is not None:
        return settings.gate_m
    return grid.range_span_m(views.positions_m, views.receivers_m)


def compute_pdp(
    channel: Cir | FrequencyResponse,
    settings: PdpSettings,
    gate_m: tuple[float, float],
    only: NDArray[np.intp] | None = None,
) -> Pdp:
    """Compute the power delay profiles of every view inside a range gate, without any noise but the data's own.

    Parameters
    ----------
    channel
        Paths, or measured frequency responses.
    settings
        Window and oversampling.
    gate_m
        (near, far), one-way metres.
    only
        Views whose profiles are wanted, ``[n]``; by default all.

    Raises
    ------
    DataError
        The gate holds no path of any view of the channel; the message says where the paths are. Or it reaches beyond
        the unambiguous range of frequency responses.
    ConfigError
        The same for a gate that was set, or a gate that does not fit into memory.

    Notes
    -----
    Frequency responses are windowed over their band and transformed as they are, with zeros up to the oversampled axis:
    h(τ) = Σ_k W_k H_k exp(j2πf_kτ) / Σ_k W_k. The gate is cut out afterwards, so nothing leaks in by the cut.

    The channel of paths is sampled at K = B·T frequencies over the band, with T the gate's length plus a margin:
    H(f_k) = W(f_k) Σ_i g_i exp(−j2πf_k τ_i), an exact non-uniform DFT; see :func:`~mvla_sim.dsp.path_spectrum`.
    The inverse FFT is zero-padded to the oversampled axis and divided by Σ W. Paths outside gate and margin are left
    out, as range gating before the transform would.
    """
    check_argument("channel", channel, Cir | FrequencyResponse, "for a file: load_channel")
    check_argument("settings", settings, PdpSettings, "make one")
    numbers = np.arange(channel.n_view) if only is None else only
    window = Window(settings.window, settings.kaiser_beta)
    resolution = range_resolution(channel.bandwidth_hz)
    step = resolution / settings.oversampling
    first = max(0, int(np.floor(gate_m[0] / step)) - 1)  # a spare sample at both ends: the gate's own ends lie inside
    count = int(np.ceil(gate_m[1] / step)) + 1 - first + 1
    check_memory(
        _BYTES_PER_SAMPLE * numbers.size * float(count),
        f"pdp.gate_m = [{gate_m[0]:g}, {gate_m[1]:g}]: profiles of {numbers.size} views at steps of {step:.2g} m",
        "narrow the gate {factor:.2g} times",
    )
    if isinstance(channel, FrequencyResponse):
        _check_unambiguous(channel, settings, gate_m)
        weights = window.weights(channel.response.shape[1])
        length = weights.size * settings.oversampling
        amplitude = range_profiles(channel.response[numbers], weights, length, np.arange(first, first + count))
    else:
        amplitude = _of_paths(channel, numbers, window, (settings.oversampling, first, count), gate_m)
    power = amplitude.real**2 + amplitude.imag**2
    return Pdp(
        power, amplitude, first * step, step, resolution, window.broadening, window, settings.oversampling,
        channel.carrier_hz,
    )  # fmt: skip


def _of_paths(
    cir: Cir, numbers: NDArray[np.intp], window: Window, axis: tuple[int, int, int], gate_m: tuple[float, float]
) -> NDArray[np.complex128]:
    """Band-limited impulse responses of some views, ``[n, count]``; ``axis``: oversampling, first sample, count."""
    oversampling, first, count = axis
    step = range_resolution(cir.bandwidth_hz) / oversampling
    margin = _MARGIN_CELLS * oversampling
    frequencies = frequency_count(count, oversampling)
    weights = window.weights(frequencies)
    spacing_hz = cir.bandwidth_hz / frequencies
    lowest_hz = -(frequencies - 1) / 2 * spacing_hz
    axis_start_s = float(range_to_delay((first - margin) * step))
    length = frequencies * oversampling
    low, high = (first - margin / 2) * step, (first + count + margin / 2) * step
    ranges = cir.range_m
    inside = (ranges >= low) & (ranges <= high)
    if not inside.any():
        where = "there are none at all"
        if ranges.size:
            away = np.maximum(gate_m[0] - ranges, ranges - gate_m[1]).min()
            where = f"they lie from {ranges.min():.2f} to {ranges.max():.2f} m, the nearest {away:.2f} m outside"
        raise DataError(f"no path lies inside the range gate of {gate_m[0]:.2f} to {gate_m[1]:.2f} m; {where}")
    spectra = np.empty((numbers.size, frequencies), np.complex128)
    for row, view in enumerate(numbers):
        rows = cir.rows(view)
        kept = inside[rows]
        delay = cir.delay_s[rows][kept] - axis_start_s
        spectra[row] = path_spectrum(cir.gain[rows][kept], delay, lowest_hz, spacing_hz, frequencies)
    return range_profiles(spectra, weights, length, np.arange(margin, margin + count))


def _check_unambiguous(channel: FrequencyResponse, settings: PdpSettings, gate_m: tuple[float, float]) -> None:
    """Refuse a gate beyond which echoes have folded back."""
    limit = channel.unambiguous_range_m
    if gate_m[1] <= limit:
        return
    count = channel.response.shape[1]
    why = (
        f"{count} frequencies {channel.step_hz / 1e6:.4g} MHz apart give an unambiguous range of {limit:.2f} m; for "
        f"{gate_m[1]:.2f} m sweep at least {int(np.ceil(count * gate_m[1] / limit))} points over the same band"
    )
    if settings.gate_m is not None:
        raise ConfigError(f"pdp.gate_m = [{gate_m[0]:g}, {gate_m[1]:g}]: {why}")
    raise DataError(f"the grid is seen at ranges of {gate_m[0]:.2f} to {gate_m[1]:.2f} m; {why}")


def frequency_count(samples: int, oversampling: int) -> int:
    """Number of frequencies K over the band for an axis of ``samples`` and the margins on both sides of it."""
    return -(-(samples + 2 * _MARGIN_CELLS * oversampling) // oversampling)
