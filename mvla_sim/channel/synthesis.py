"""A synthetic measurement: what a network analyser in a chamber would sweep of a traced channel."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.readers.touchstone_files import write_touchstone
from mvla_sim.channel.references import echo_gain
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import range_to_delay
from mvla_sim.dsp import path_spectrum
from mvla_sim.errors import ConfigError, DataError, OutputError, check_argument
from mvla_sim.files import as_path
from mvla_sim.memory import check_memory
from mvla_sim.settings import Settings
from mvla_sim.streams import Stream, stream

__all__ = [
    "BACKGROUND_FILE", "REFERENCE_FILE", "EchoSettings", "SweepSet", "SynthesisSettings", "synthesize", "write_sweeps",
]  # fmt: skip

BACKGROUND_FILE = "background.s2p"
REFERENCE_FILE = "reference.s2p"

_VIEW, _BACKGROUND, _REFERENCE = range(3)
_CHANNEL, _PORTS = range(2)
_PORT_REFLECTION = 0.1
"""S11 and S22, −20 dB: a passable match."""


class EchoSettings(Settings):
    """A static echo of the chamber: the same in every sweep, with and without the target."""

    range_m: PositiveFloat = Field(description="one-way range")
    gain_db: float = Field(description="path gain")


class SynthesisSettings(Settings):
    """A VNA sweep a view: leakage, static echoes, thermal noise, drift, cable delay and gain of the set-up."""

    points: Annotated[int, Field(ge=2, le=100_001, description="frequencies over the scene's band, both ends")] = 1601
    snr_db: float = Field(
        30.0, description="mean power of the target's echoes over that of the noise, a frequency point, mean of views"
    )
    random_phase: bool = Field(True, description="each sweep has a phase of its own, uniform in 0 to 2π")
    leakage: EchoSettings = Field(
        EchoSettings(range_m=0.3, gain_db=-55.0), description="from antenna to antenna, besides the target"
    )
    echoes: tuple[EchoSettings, ...] = Field((), description="static echoes of the chamber and of the turntable")
    cable_delay_s: NonNegativeFloat = Field(0.0, description="delay of cables, in every sweep")
    system_gain_db: float = Field(0.0, description="gain of amplifiers and cables, in every sweep")
    reference_range_m: PositiveFloat | None = Field(None, description="also sweep a metal sphere at this range")
    reference_radius_m: PositiveFloat = Field(0.15, description="radius of that sphere")
    seed: NonNegativeInt = Field(0, description="of noise and phases")


@dataclass(frozen=True, eq=False)
class SweepSet:
    """Sweeps of a target from M views, of the empty chamber, and of a reference target.

    Attributes
    ----------
    sweeps
        The views, leakage, static echoes, noise, phases, cable delay and gain included.
    background
        Sweep without the target, ``[n_frequency]`` complex128.
    reference
        Sweep of the metal sphere in place of the target, ``[n_frequency]`` complex128; None where none was asked for.
    noise_power
        Mean power of the receiver's noise at one frequency, before the gain.
    seed
        Root of the noise and phases.
    """

    sweeps: FrequencyResponse
    background: NDArray[np.complex128]
    reference: NDArray[np.complex128] | None
    noise_power: float
    seed: int


def synthesize(cir: Cir, settings: SynthesisSettings) -> SweepSet:
    """Sweep a traced channel as a network analyser would.

    Parameters
    ----------
    cir
        The channel; its bandwidth B is swept from end to end, ``points`` frequencies f_c − B/2 to f_c + B/2.
    settings
        What the chamber and the instrument add.

    Returns
    -------
    SweepSet
        The same for the same seed, whatever else was computed before.

    Raises
    ------
    ConfigError
        So few points that an echo folds back to another range, or so many that they do not fit in memory.
    DataError
        No view has an echo, so there is no power to set the noise by.

    Notes
    -----
    In the order in which it happens: H_m(f) = Σ_i g_i exp(−j2π(f − f_c)τ_i), where g_i holds the phase at the carrier;
    plus leakage and static echoes, A·exp(−j2πf·2R/c); plus white circular noise of the receiver; times exp(jφ) of each
    sweep; times the gain and exp(−j2πf·τ) of the cables. The sphere stands on the axis of the antennas: it has the echo
    of :func:`~mvla_sim.channel.references.echo_gain` at the carrier times their peak gains.
    """
    check_argument("cir", cir, Cir, "see simulate")
    check_argument("settings", settings, SynthesisSettings, "make one")
    start = cir.carrier_hz - cir.bandwidth_hz / 2
    step = cir.bandwidth_hz / (settings.points - 1)
    _check_folding(cir, settings, step)
    check_memory(
        64.0 * cir.n_view * settings.points,
        f"synthesis.points = {settings.points}: sweeps of {cir.n_view} views",
        "take {factor:.2g} times fewer points",
    )
    frequency = np.asarray(start + step * np.arange(settings.points), np.float64)
    rows = [cir.rows(view) for view in range(cir.n_view)]
    lowest = start - cir.carrier_hz
    target = np.stack([path_spectrum(cir.gain[r], cir.delay_s[r], lowest, step, settings.points) for r in rows])
    power = float(np.mean(target.real**2 + target.imag**2))
    if power == 0:
        raise DataError(
            "synthesis: no view of the channel has an echo of the target; there is no power to set snr_db by"
        )
    noise_power = power / 10 ** (settings.snr_db / 10)

    static = sum((_echo(echo, frequency) for echo in settings.echoes), _echo(settings.leakage, frequency))
    chain = 10 ** (settings.system_gain_db / 20) * np.exp(-2j * np.pi * frequency * settings.cable_delay_s)

    def measure(channel: NDArray[np.complex128], *key: int) -> NDArray[np.complex128]:
        random = stream(settings.seed, Stream.MEASUREMENT, *key, _CHANNEL)
        phase = random.uniform(0, 2 * np.pi)  # drawn in any case: without phases the noise is the same
        turn = np.exp(1j * phase) if settings.random_phase else 1.0
        return np.asarray((channel + static + _noise(random, noise_power, frequency.shape)) * turn * chain)

    reference = None
    if settings.reference_range_m is not None:
        reference = measure(_sphere(cir, settings, frequency), _REFERENCE, 0)
    sweeps = FrequencyResponse(
        response=np.stack([measure(channel, _VIEW, view) for view, channel in enumerate(target)]),
        start_hz=start,
        step_hz=step,
        views=cir.views,
        extent_m=cir.extent_m,
        outline=cir.outline,
        plane_height_m=cir.plane_height_m,
        antenna=cir.antenna,
        config={
            **cir.config,
            "synthesis": settings.model_dump(mode="json", include=set(SynthesisSettings.model_fields)),
        },
        provenance=cir.provenance,
    )
    background = measure(np.zeros(settings.points, np.complex128), _BACKGROUND, 0)
    return SweepSet(sweeps, background, reference, noise_power, settings.seed)


def write_sweeps(
    measured: SweepSet, folder: str | os.PathLike[str], prefix: str, angles_deg: Sequence[float] | NDArray[np.float64]
) -> list[Path]:
    """Write sweeps as Touchstone files of two ports: ``<prefix>_<angle>deg.s2p`` a view, and background, reference.

    S21 = S12 is the channel; S11 and S22 are the reflection of the ports, −20 dB with noise.

    Parameters
    ----------
    measured
        What was measured.
    folder
        Where to; it is made if it is missing. It may hold no other sweeps, which would be read as views.
    prefix
        First part of the views' names.
    angles_deg
        Angle of the turntable or of the sensor at each view, ``[n_view]`` degrees. Names have as many decimals as the
        angles need, at least one and at most six.

    Returns
    -------
    list of Path
        The files: the views in their order, then the background, then the reference if there is one.

    Raises
    ------
    ConfigError
        A prefix that is no part of a file's name.
    DataError
        Two views at one angle, or another number of angles than of views.
    OutputError
        A file cannot be written, or the folder holds other sweeps.
    """
    check_argument("measured", measured, SweepSet, "see synthesize")
    check_argument("prefix", prefix, str, "the first part of a file's name")
    place = as_path(folder)
    if not prefix or Path(prefix).name != prefix or "\\" in prefix or prefix.startswith("."):
        raise ConfigError(f"prefix = '{prefix}': allowed: the first part of a file's name, without '/'")
    names = _names(prefix, np.asarray(angles_deg, np.float64), measured.sweeps.n_view)
    channels = [*measured.sweeps.response, measured.background]
    keys = [(_VIEW, view) for view in range(len(names))] + [(_BACKGROUND, 0)]
    names.append(BACKGROUND_FILE)
    if measured.reference is not None:
        channels.append(measured.reference)
        keys.append((_REFERENCE, 0))
        names.append(REFERENCE_FILE)
    _make_folder(place, set(names))
    frequency = measured.sweeps.frequency_hz
    for name, channel, key in zip(names, channels, keys, strict=True):
        random = stream(measured.seed, Stream.MEASUREMENT, *key, _PORTS)
        s = np.empty((len(channel), 2, 2), np.complex128)
        s[:, 0, 1] = s[:, 1, 0] = channel
        s[:, 0, 0] = _PORT_REFLECTION + _noise(random, measured.noise_power, channel.shape)
        s[:, 1, 1] = _PORT_REFLECTION + _noise(random, measured.noise_power, channel.shape)
        write_touchstone(place / name, frequency, s)
    return [place / name for name in names]


def _echo(echo: EchoSettings, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
    delay = float(range_to_delay(echo.range_m))
    return np.asarray(10 ** (echo.gain_db / 20) * np.exp(-2j * np.pi * frequency_hz * delay), np.complex128)


def _sphere(cir: Cir, settings: SynthesisSettings, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
    assert settings.reference_range_m is not None
    antenna = cir.antenna.pattern()
    gain = echo_gain("sphere", settings.reference_range_m, settings.reference_radius_m, cir.carrier_hz)
    level_db = 20 * np.log10(gain) + (0.0 if antenna is None else 2 * antenna.gain_dbi)
    return _echo(EchoSettings(range_m=settings.reference_range_m, gain_db=level_db), frequency_hz)


def _noise(random: np.random.Generator, power: float, shape: tuple[int, ...]) -> NDArray[np.complex128]:
    """Circular complex normal numbers of mean square ``power``."""
    real, imaginary = random.standard_normal((2, *shape))
    return np.asarray(np.sqrt(power / 2) * (real + 1j * imaginary), np.complex128)


def _check_folding(cir: Cir, settings: SynthesisSettings, step_hz: float) -> None:
    ranges = [settings.leakage.range_m, settings.reference_range_m or 0.0, *(e.range_m for e in settings.echoes)]
    farthest = max(float(range_to_delay(max(ranges))), float(cir.delay_s.max(initial=0.0))) + settings.cable_delay_s
    if farthest * step_hz >= 1:
        least = int(np.ceil(farthest * cir.bandwidth_hz)) + 2
        raise ConfigError(
            f"synthesis.points = {settings.points}: echoes at delays of {farthest:.3g} s fold at 1/Δf = "
            f"{1 / step_hz:.3g} s; allowed: {least} points or more"
        )


def _names(prefix: str, angles_deg: NDArray[np.float64], n_view: int) -> list[str]:
    if angles_deg.shape != (n_view,) or not np.isfinite(angles_deg).all():
        raise DataError(f"angles_deg: shape {angles_deg.shape}; allowed: {n_view} finite angles, one a view")
    decimals = next((d for d in range(1, 6) if (abs(angles_deg - angles_deg.round(d)) < 1e-6).all()), 6)
    told = angles_deg.round(decimals) + 0.0  # no "-0.0"
    seen: dict[float, int] = {}
    for view, angle in enumerate(told):
        other = seen.setdefault(round(float(angle) % 360, 6) % 360, view)
        if other != view:
            raise DataError(
                f"angles_deg: views {other} and {view} are both at {angle:g}° (to {decimals} decimals); each needs a "
                "file of its own"
            )
    return [f"{prefix}_{angle:0{4 + decimals}.{decimals}f}deg.s2p" for angle in told]


def _make_folder(folder: Path, names: set[str]) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = sorted(
            p.name for p in folder.iterdir() if p.suffix.lower() in (".s1p", ".s2p") and p.name not in names
        )
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written ({error.strerror})") from error
    if others:
        raise OutputError(f"{folder}: holds other sweeps, such as {others[0]}; choose an empty folder")
