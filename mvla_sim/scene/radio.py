"""Settings of the radio, and of how its rays are traced."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from mvla_sim.scene.antenna import ANTENNAS, Antenna
from mvla_sim.scene.antennas.omni import Omni
from mvla_sim.settings import Settings

__all__ = ["RadioSettings", "RayTracingSettings"]


class RadioSettings(Settings):
    """Carrier, bandwidth, polarisation and antennas of the sensor."""

    carrier_hz: PositiveFloat = Field(36e9, description="centre of the band")
    bandwidth_hz: PositiveFloat = Field(3e9, description="B; the range resolution is c/(2B)")
    polarization: Literal["V", "H"] = "V"
    antenna: Annotated[Antenna, ANTENNAS] = Field(Omni(), description="pattern of both antennas: omni, horn or file")

    @model_validator(mode="after")
    def _check(self) -> RadioSettings:
        if self.bandwidth_hz >= 2 * self.carrier_hz:
            raise ValueError(f"bandwidth_hz = {self.bandwidth_hz:g} reaches below 0 Hz at {self.carrier_hz:g} Hz")
        return self


class RayTracingSettings(Settings):
    """What Sionna RT traces, and with how many rays."""

    specular: bool = Field(True, description="trace reflections")
    diffuse: bool = Field(True, description="trace diffuse scattering")
    diffraction: bool = Field(True, description="trace diffraction at edges")
    max_depth: Annotated[int, Field(ge=1, le=20, description="interactions a path may have")] = 1
    diffuse_rays: Annotated[int, Field(ge=1, le=100_000_000, description="rays a view for diffuse scattering")] = 6000
    specular_rays: Annotated[
        int, Field(ge=1, le=100_000_000, description="rays a view for reflections and diffraction")
    ] = 20_000
    launch: Literal["sector", "sphere"] = Field("sector", description="rays only towards the objects, or all around")
    max_paths: PositiveInt = Field(1_000_000, description="cap on the paths of one view; reaching it is an error")
    seed: Annotated[int, Field(ge=0, lt=2**31, description="of the ray tracer, and of the phases of diffuse paths")] = 1

    @model_validator(mode="after")
    def _check(self) -> RayTracingSettings:
        if not (self.specular or self.diffuse or self.diffraction):
            raise ValueError("specular, diffuse and diffraction are all false; at least one must be true")
        return self
