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
    """From paths to a power delay profile (``eq:PDP``).

    The paper says neither how paths become samples nor how those in one add up. One sample per 1/B, as tapped delay
    lines have it, is ``oversampling = 1``: with ``kernel = "nearest"`` each path is in the tap nearest to it, with
    ``window = "rectangular"`` all taps have their share of it, sinc(B(τ_l − τ_i)).
    """

    kernel: Literal["band-limited", "nearest"] = Field(
        "band-limited",
        description="a path's echo: the window's pulse, or one sample, the nearest, with no window at all",
    )
    sum: Literal["amplitudes", "powers"] = Field(
        "amplitudes", description="what of overlapping echoes is added: complex amplitudes, or powers, without phases"
    )
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
        h_m(τ_l), ``[n_view, n_range]`` complex128, or None where powers were added: those of paths, or of noise.
    start_m, step_m
        First one-way range and spacing of the axis, metres.
    resolution_m
        ΔR = c/(2B), metres.
    broadening
        Width of the window's main lobe relative to that of no window (its equivalent noise bandwidth); 1 of
        ``kernel = "nearest"``, whose cell is 1/B however many samples are in it.
    window, oversampling
        What noise of the same band looks like: as in the settings, but rectangular of ``kernel = "nearest"``. At one
        sample per 1/B that is noise independent in each.
    kernel
        As in the settings: whether an echo is a pulse of the window, or a single sample.
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
    kernel: Literal["band-limited", "nearest"] = "band-limited"
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
        Kernel, sum, window and oversampling.
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
        The same for a gate that was set, or a gate that does not fit into memory; or a kernel or sum that frequency
        responses, which have no paths, do not have.

    Notes
    -----
    Frequency responses are windowed over their band and transformed as they are, with zeros up to the oversampled axis:
    h(τ) = Σ_k W_k H_k exp(j2πf_kτ) / Σ_k W_k. The gate is cut out afterwards, so nothing leaks in by the cut.

    The channel of paths is sampled at K = B·T frequencies over the band, with T the gate's length plus a margin:
    H(f_k) = W(f_k) Σ_i g_i exp(−j2πf_k τ_i), an exact non-uniform DFT; see :func:`~mvla_sim.dsp.path_spectrum`.
    The inverse FFT is zero-padded to the oversampled axis and divided by Σ W. Paths outside gate and margin are left
    out, as range gating before the transform would.

    Of ``sum = "powers"`` it is P(τ_l) = Σ_i |g_i|²·|p(τ_l − τ_i)|², p the window's pulse. The spectrum of |p|² is the
    autocorrelation of the weights, so that is one more exact non-uniform DFT, of real gains |g_i|²; what is below 0 by
    rounding is set to 0. Of ``kernel = "nearest"`` path i is in the sample l nearest to τ_i alone, the later one where
    two are as near: h_l = Σ g_i or P_l = Σ |g_i|². An isolated path peaks at |g_i|² in all of them, band-limited ones
    up to the distance to the nearest sample.
    """
    check_argument("channel", channel, Cir | FrequencyResponse, "for a file: load_channel")
    check_argument("settings", settings, PdpSettings, "make one")
    numbers = np.arange(channel.n_view) if only is None else only
    nearest = settings.kernel == "nearest"
    window = Window() if nearest else Window(settings.window, settings.kaiser_beta)
    resolution = range_resolution(channel.bandwidth_hz)
    step = resolution / settings.oversampling
    first = max(0, int(np.floor(gate_m[0] / step)) - 1)  # a spare sample at both ends: the gate's own ends lie inside
    count = int(np.ceil(gate_m[1] / step)) + 1 - first + 1
    check_memory(
        _BYTES_PER_SAMPLE * numbers.size * float(count),
        f"pdp.gate_m = [{gate_m[0]:g}, {gate_m[1]:g}]: profiles of {numbers.size} views at steps of {step:.2g} m",
        "narrow the gate {factor:.2g} times",
    )
    amplitude: NDArray[np.complex128] | None = None
    if isinstance(channel, FrequencyResponse):
        _check_pathless(settings)
        _check_unambiguous(channel, settings, gate_m)
        weights = window.weights(channel.response.shape[1])
        length = weights.size * settings.oversampling
        amplitude = range_profiles(channel.response[numbers], weights, length, np.arange(first, first + count))
    else:
        axis = _Axis(step, settings.oversampling, first, count)
        if nearest:
            found = _nearest(channel, numbers, axis, gate_m, powers=settings.sum == "powers")
        else:
            found = _band_limited(channel, numbers, axis, gate_m, window, powers=settings.sum == "powers")
        amplitude = None if settings.sum == "powers" else found
    power = np.maximum(found.real, 0) if amplitude is None else amplitude.real**2 + amplitude.imag**2
    return Pdp(
        power, amplitude, first * step, step, resolution, window.broadening, window, settings.oversampling,
        channel.carrier_hz, settings.kernel,
    )  # fmt: skip


@dataclass(frozen=True)
class _Axis:
    """Samples of a range axis: spacing in metres, samples per resolution cell, number of the first, and how many."""

    step_m: float
    oversampling: int
    first: int
    count: int

    @property
    def margin(self) -> int:
        """Samples on both sides of it that the DFT's wrap-around may touch."""
        return _MARGIN_CELLS * self.oversampling


def _inside(cir: Cir, low: float, high: float, gate_m: tuple[float, float]) -> NDArray[np.bool_]:
    """Which paths are between two ranges, ``[n_path]``; refuses a gate with none."""
    ranges = cir.range_m
    inside = (ranges >= low) & (ranges <= high)
    if not inside.any():
        where = "there are none at all"
        if ranges.size:
            away = np.maximum(gate_m[0] - ranges, ranges - gate_m[1]).min()
            where = f"they lie from {ranges.min():.2f} to {ranges.max():.2f} m, the nearest {away:.2f} m outside"
        raise DataError(f"no path lies inside the range gate of {gate_m[0]:.2f} to {gate_m[1]:.2f} m; {where}")
    return inside


def _band_limited(
    cir: Cir, numbers: NDArray[np.intp], axis: _Axis, gate_m: tuple[float, float], window: Window, *, powers: bool
) -> NDArray[np.complex128]:
    """Impulse responses of some views in the window's band, or sums of the powers of pulses, ``[n, count]``."""
    margin = axis.margin
    frequencies = frequency_count(axis.count, axis.oversampling)
    weights = window.weights(frequencies)
    spacing_hz = cir.bandwidth_hz / frequencies
    lowest_hz = -(frequencies - 1) / 2 * spacing_hz
    axis_start_s = float(range_to_delay((axis.first - margin) * axis.step_m))
    length = frequencies * axis.oversampling
    low, high = (axis.first - margin / 2) * axis.step_m, (axis.first + axis.count + margin / 2) * axis.step_m
    inside = _inside(cir, low, high, gate_m)
    places = np.arange(margin, margin + axis.count)
    spectra = np.empty((numbers.size, frequencies), np.complex128)
    for row, view in enumerate(numbers):
        rows = cir.rows(view)
        kept = inside[rows]
        delay = cir.delay_s[rows][kept] - axis_start_s
        gain = cir.gain[rows][kept]
        if powers:  # |p|² is real, so half of its spectrum will do: from 0 Hz to the band's width
            spectra[row] = path_spectrum(_power(gain).astype(np.complex128), delay, 0.0, spacing_hz, frequencies)
        else:
            spectra[row] = path_spectrum(gain, delay, lowest_hz, spacing_hz, frequencies)
    if not powers:
        return range_profiles(spectra, weights, length, places)
    overlap = np.correlate(weights, weights, "full")[frequencies - 1 :]
    overlap[1:] *= 2
    return range_profiles(spectra, overlap, length, places, lowest=0.0)


def _nearest(
    cir: Cir, numbers: NDArray[np.intp], axis: _Axis, gate_m: tuple[float, float], *, powers: bool
) -> NDArray[np.complex128]:
    """Sums of the gains of the paths that are nearest to each sample, or of their powers, ``[n, count]``."""
    half = axis.step_m / 2
    low, high = axis.first * axis.step_m - half, (axis.first + axis.count) * axis.step_m - half
    _inside(cir, low, high, gate_m)
    chosen = cir.elements(numbers)
    row = np.repeat(np.arange(numbers.size), cir.row_size[numbers])
    sample = np.floor(cir.range_m[chosen] / axis.step_m + 0.5).astype(np.int64) - axis.first
    kept = (sample >= 0) & (sample < axis.count)
    place = row[kept] * axis.count + sample[kept]
    gain = cir.gain[chosen[kept]]
    parts = (_power(gain), np.zeros(gain.size)) if powers else (gain.real, gain.imag)
    real, imag = (np.bincount(place, part, numbers.size * axis.count) for part in parts)
    return np.asarray(real + 1j * imag, np.complex128).reshape(numbers.size, axis.count)


def _power(gain: NDArray[np.complexfloating]) -> NDArray[np.float64]:
    return gain.real.astype(np.float64) ** 2 + gain.imag.astype(np.float64) ** 2


def _check_pathless(settings: PdpSettings) -> None:
    """Refuse what needs paths."""
    for name, value in (("kernel", settings.kernel), ("sum", settings.sum)):
        if value != (default := PdpSettings.model_fields[name].default):
            raise ConfigError(
                f"pdp.{name} = '{value}': needs traced paths, and this file holds measured frequency responses; "
                f"allowed for them: '{default}'"
            )


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
