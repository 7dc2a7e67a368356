"""Settings of the sensor's antennas: pattern, peak gain, and where the beam points."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from mvla_sim.settings import Settings

__all__ = ["AntennaSettings", "Horn", "Omni", "PatternCuts", "PatternFile", "PointingSettings"]

Beamwidth = Annotated[float, Field(ge=1, le=180)]  # patterns have nodes 0.25° apart
PeakGain = Annotated[
    float | None, Field(description="peak gain in dBi; by default the directivity of the pattern itself")
]


class Omni(Settings):
    """An isotropic antenna: 0 dBi in every direction."""

    kind: Literal["omni"] = "omni"


class Horn(Settings):
    """A horn by its half-power beamwidths, the same for transmitter and receiver."""

    kind: Literal["horn"]
    azimuth_beamwidth_deg: Beamwidth = Field(14.39, description="full width at half power, horizontal plane")
    elevation_beamwidth_deg: Beamwidth | None = Field(None, description="vertical plane; by default as in azimuth")
    shape: Literal["gaussian", "cosine"] = Field("gaussian", description="main lobe: Gaussian, or cos^q of the angle")
    floor_db: Annotated[float, Field(lt=0, description="level below the peak of side and back lobes")] = -40.0
    gain_dbi: PeakGain = None


class PatternFile(Settings):
    """A measured pattern: a CSV file with columns ``angle_deg,azimuth_db[,elevation_db]``, one cut a plane."""

    kind: Literal["file"]
    file: str
    gain_dbi: PeakGain = None


class PatternCuts(Settings):
    """The two cuts of a pattern file as channel files carry them, so that they do without it."""

    kind: Literal["cuts"]
    azimuth_db: Annotated[tuple[float, ...], Field(min_length=1441, max_length=1441)]
    elevation_db: Annotated[tuple[float, ...], Field(min_length=721, max_length=721)]
    gain_dbi: float


AntennaSettings = Annotated[Omni | Horn | PatternFile | PatternCuts, Field(discriminator="kind")]


class PointingSettings(Settings):
    """Where the beam points, in the frame in which the trajectory is given: of a turntable and of poses the sensor's.

    By default each view's antennas point horizontally at the trajectory's centre; of poses, at the middle of the
    target's places. ``aim_m`` is a fixed point to look at; ``azimuth_deg`` a fixed compass direction, counter-clockwise
    from +x, as of a side-looking sensor on a straight pass. A positions file with columns
    ``azimuth_deg[,elevation_deg]`` sets it view by view and wins over both.
    """

    aim_m: tuple[float, float, float] | None = None
    azimuth_deg: float | None = None
    elevation_deg: Annotated[float, Field(gt=-90, lt=90, description="tilt above the horizontal")] = 0.0

    @model_validator(mode="after")
    def _check(self) -> PointingSettings:
        if self.aim_m is not None and (self.azimuth_deg is not None or self.elevation_deg):
            raise ValueError("aim_m fixes the direction; leave out azimuth_deg and elevation_deg")
        return self
