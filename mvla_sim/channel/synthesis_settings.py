"""Settings of a synthetic measurement: what a network analyser in a chamber adds to a traced channel."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat

from mvla_sim.settings import Settings

__all__ = ["EchoSettings", "SynthesisSettings"]


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
    seed: NonNegativeInt = 0
