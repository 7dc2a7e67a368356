"""From raw sweeps to path gains: background subtraction, and the zero of ranges and the level by a reference target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, NonNegativeFloat, PositiveFloat, model_validator
from scipy.fft import next_fast_len
from scipy.optimize import minimize_scalar

from mvla_sim.constants import SPEED_OF_LIGHT, range_resolution, range_to_delay
from mvla_sim.dsp import Window, range_profiles
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.settings import Settings

__all__ = [
    "BackgroundSettings", "Gate", "ReferenceCalibration", "ReferenceSettings", "Subtraction", "calibrate", "echo_gain",
    "find_peak", "range_profile", "subtract_background",
]  # fmt: skip

OVERSAMPLING: Final = 4
"""Samples of a profile per 1/(K·Δf); Hann's main lobe is four such cells wide, so no peak falls between samples."""
HANN: Final = Window("hann")
STANDS_OUT_DB: Final = 15.0
"""Least level of the reference's echo over the median of all ranges; noise alone reaches it once in millions."""


def _near_and_far(gate: tuple[float, float]) -> tuple[float, float]:
    if gate[0] >= gate[1]:
        raise ValueError("must be [near, far] with near below far")
    return gate


Gate = Annotated[tuple[NonNegativeFloat, PositiveFloat], AfterValidator(_near_and_far)]


class BackgroundSettings(Settings):
    """A sweep without the target, subtracted from every view.

    Oscillators drift between sweeps. ``align_m`` is a range interval that holds only what the target cannot change,
    such as the leakage from antenna to antenna: the background is turned to each view's phase there.
    """

    file: str = Field(description="sweep without the target")
    align_m: Gate | None = Field(
        None, description="measured ranges at which its phase is turned to each view's; by default none"
    )


class ReferenceSettings(Settings):
    """A sweep of a target of known range and echo: it fixes the zero of the range axis and the level.

    Levels become path gains between isotropic antennas: λ/(8πR) of a large flat plate at right angles, λ·a/(8πR(R + a))
    of a sphere of radius a, R to the nearest point of its surface; that is the radar equation where R is much larger.
    """

    file: str = Field(description="sweep of the reference target")
    kind: Literal["sphere", "plate"] = Field(description="of the reference target")
    range_m: PositiveFloat = Field(description="from the middle of the antennas to the nearest point of the target")
    radius_m: PositiveFloat | None = Field(None, description="of the sphere")
    background: str | None = Field(None, description="sweep without the reference; by default background.file")
    gate_m: Gate | None = Field(None, description="measured ranges its echo is looked for in; by default all")

    @model_validator(mode="after")
    def _check(self) -> ReferenceSettings:
        if (self.kind == "sphere") != (self.radius_m is not None):
            raise ValueError(f"radius_m = {self.radius_m}: a sphere needs it, a plate has none")
        return self


@dataclass(frozen=True, eq=False)
class Subtraction:
    """Sweeps without their background, ``[n_view, n_frequency]``.

    ``residual_db`` ``[n_view]`` is the power in the align gate after over before, dB; NaN without a gate.
    """

    response: NDArray[np.complex128]
    residual_db: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReferenceCalibration:
    """Sweeps whose levels are path gains and whose delays start at the antennas, ``[n_view, n_frequency]``.

    What was taken out is the delay of cables and antennas, seconds; what was multiplied on a real factor, an amplitude.
    """

    response: NDArray[np.complex128]
    delay_offset_s: float
    gain_correction: float


def range_profile(
    response: NDArray[np.complex128], start_hz: float, step_hz: float
) -> tuple[NDArray[np.complex128], float]:
    """Delay profile of one sweep: Hann window, zero-padded inverse FFT.

    Parameters
    ----------
    response
        ``[n_frequency]`` complex128.
    start_hz, step_hz
        First frequency f_0 and step Δf, hertz.

    Returns
    -------
    profile, step_m
        h(τ_l), ``[n_range]`` complex128, and the spacing of its one-way ranges, which start at 0; metres.

    Notes
    -----
    As :func:`~mvla_sim.dsp.range_profiles` with absolute frequencies: an echo g·exp(−j2πf·τ₀) peaks at τ₀ with h = g.
    """
    length = int(next_fast_len(OVERSAMPLING * len(response)))
    profile = range_profiles(response, HANN.weights(len(response)), length, np.arange(length), start_hz / step_hz)
    return profile, SPEED_OF_LIGHT / (2 * step_hz * length)


def subtract_background(
    response: NDArray[np.complex128],
    background: NDArray[np.complex128],
    start_hz: float,
    step_hz: float,
    align_m: Gate | None = None,
) -> Subtraction:
    """Subtract a sweep without the target from every view.

    Parameters
    ----------
    response
        ``[n_view, n_frequency]`` complex128.
    background
        ``[n_frequency]`` complex128 at the same frequencies.
    start_hz, step_hz
        First frequency and spacing, hertz.
    align_m
        (near, far) in ranges as measured, cables included, where only what never changes echoes: the background is
        turned to each view's phase there. None: subtracted as it is, which needs coherent sweeps.

    Raises
    ------
    ConfigError
        A gate beyond the unambiguous range.
    DataError
        Another number of frequencies, or nothing in the gate.

    Notes
    -----
    With b(τ) and r_m(τ) the Hann-windowed profiles, φ_m = arg Σ_gate b*(τ)·r_m(τ) is the turn that minimises
    Σ_gate |r_m − e^{jφ} b|². Its error is that of the gate's phase under noise, about 1/√SNR there, and what static
    echoes leave is as large relative to them.
    """
    if background.shape != response.shape[1:]:
        raise DataError(f"background has {background.size} frequencies, the views have {response.shape[1]}")
    if align_m is None:
        return Subtraction(response - background, np.full(len(response), np.nan))
    _check_gate("align_m", align_m, step_hz)
    empty, step_m = range_profile(background, start_hz, step_hz)
    gate = _gate_samples(align_m, step_m, len(empty))
    empty = empty[gate]
    difference = np.empty(response.shape, np.complex128)
    residual_db = np.empty(len(response))
    for view, sweep in enumerate(response):
        before = range_profile(sweep, start_hz, step_hz)[0][gate]
        match = np.vdot(empty, before)
        if match == 0:
            raise DataError(
                f"background.align_m = {list(align_m)}: view {view} and the background have nothing in common there; "
                "choose ranges that hold the leakage or a static echo"
            )
        turn = match / abs(match)
        difference[view] = sweep - turn * background
        left, whole = abs(before - turn * empty) ** 2, abs(before) ** 2
        with np.errstate(divide="ignore"):  # −inf where nothing is left
            residual_db[view] = 10 * np.log10(left.sum() / whole.sum())
    return Subtraction(difference, residual_db)


def calibrate(
    response: NDArray[np.complex128],
    reference: NDArray[np.complex128],
    settings: ReferenceSettings,
    start_hz: float,
    step_hz: float,
) -> ReferenceCalibration:
    """Take out of every view the delay and the gain that a target of known range and echo shows.

    Parameters
    ----------
    response
        ``[n_view, n_frequency]`` complex128.
    reference
        Sweep of the reference target without its background, ``[n_frequency]`` complex128.
    settings
        The target, its range, and where in the sweep its echo is looked for.
    start_hz, step_hz
        First frequency and spacing, hertz.

    Raises
    ------
    ConfigError
        The gate or the target lies beyond the unambiguous range.
    DataError
        No echo stands out in the gate, or the strongest is outside and only reaches in.

    Notes
    -----
    H'_m(f) = a·H_m(f)·exp(+j2πf·δ) with δ = τ_peak − 2R/c and a = g(R)/|h(τ_peak)|, g from :func:`echo_gain` at the
    carrier. No phase is taken from the reference: it would say nothing about the other sweeps.
    """
    if reference.shape != response.shape[1:]:
        raise DataError(f"reference has {reference.size} frequencies, the views have {response.shape[1]}")
    frequency = start_hz + step_hz * np.arange(reference.size)
    if settings.range_m > range_resolution(step_hz):
        raise ConfigError(f"reference.range_m = {settings.range_m:g} m: {_folding(step_hz)}")
    delay, amplitude = find_peak(reference, start_hz, step_hz, settings.gate_m)
    carrier = float(frequency[0] + frequency[-1]) / 2
    offset = delay - float(range_to_delay(settings.range_m))
    gain = echo_gain(settings.kind, settings.range_m, settings.radius_m, carrier) / amplitude
    return ReferenceCalibration(response * (gain * np.exp(2j * np.pi * frequency * offset)), offset, gain)


def echo_gain(kind: str, range_m: float, radius_m: float | None, carrier_hz: float) -> float:
    """Amplitude of a reference target's echo between isotropic antennas at one place.

    Parameters
    ----------
    kind
        ``"plate"``, flat, large and at right angles, or ``"sphere"``, both of metal.
    range_m
        R, to the nearest point of the target, metres.
    radius_m
        a, of the sphere, metres.
    carrier_hz
        Frequency, hertz.

    Notes
    -----
    Geometrical optics. A plate mirrors the antenna to twice the range, λ/(8πR). On a sphere the wave diverges as from
    a point a·R/(a + 2R) behind the surface: λ·a/(8πR(R + a)). Where R ≫ a that is λ·a/(8πR²), the radar equation with
    the cross-section πa²; at R = 5 m and a = 0.15 m the radar equation is 0.26 dB too high.
    """
    mirrored = SPEED_OF_LIGHT / carrier_hz / (8 * np.pi * range_m)
    if kind == "plate":
        return float(mirrored)
    if radius_m is None:
        raise ConfigError("reference.radius_m: a sphere needs it")
    return float(mirrored * radius_m / (range_m + radius_m))


def find_peak(
    response: NDArray[np.complex128], start_hz: float, step_hz: float, gate_m: Gate | None = None
) -> tuple[float, float]:
    """Delay in seconds and amplitude |h| of the strongest echo of a sweep, in a gate of ranges as measured.

    The largest sample of the profile, refined on the exact sum to 1e-5 of a sample.

    Raises
    ------
    ConfigError
        The gate lies beyond the unambiguous range.
    DataError
        No echo stands out, or the strongest has its peak outside the gate.
    """
    _check_gate("reference.gate_m", gate_m, step_hz)
    profile, step_m = range_profile(response, start_hz, step_hz)
    level = abs(profile)
    gate = np.arange(len(level)) if gate_m is None else _gate_samples(gate_m, step_m, len(level))
    top = int(gate[level[gate].argmax()])
    where = "reference.gate_m = " + ("all ranges" if gate_m is None else f"{list(gate_m)}")
    if level[top] <= 10 ** (STANDS_OUT_DB / 20) * np.median(level):
        raise DataError(f"{where}: no echo of the reference stands {STANDS_OUT_DB:g} dB above the median of all ranges")
    if level[top - 1] > level[top] or level[(top + 1) % len(level)] > level[top]:
        raise DataError(f"{where}: no echo of the reference has its peak there; the level rises to beyond the gate")
    weights = HANN.weights(len(response))
    weighted = response * weights
    turn = 2j * np.pi * step_hz * np.arange(len(response))
    spacing = float(range_to_delay(step_m))

    def negative(delay: float) -> float:
        return -float(abs((weighted * np.exp(turn * delay)).sum()))

    bounds = ((top - 1) * spacing, (top + 1) * spacing)
    best = minimize_scalar(negative, bounds=bounds, method="bounded", options={"xatol": 1e-5 * spacing})
    return float(best.x), float(-best.fun / weights.sum())


def _gate_samples(gate_m: Gate, step_m: float, length: int) -> NDArray[np.intp]:
    """Samples of a profile from just before a gate to just behind it."""
    first, last = int(np.floor(gate_m[0] / step_m)), int(np.ceil(gate_m[1] / step_m))
    return np.arange(first, min(last + 1, length))


def _folding(step_hz: float) -> str:
    return (
        f"beyond the unambiguous range c/(2Δf) = {range_resolution(step_hz):.2f} m of sweeps in steps of "
        f"{step_hz / 1e6:g} MHz"
    )


def _check_gate(name: str, gate_m: Gate | None, step_hz: float) -> None:
    if gate_m is not None and gate_m[1] > range_resolution(step_hz):
        raise ConfigError(f"{name} = {list(gate_m)} m: {_folding(step_hz)}")
