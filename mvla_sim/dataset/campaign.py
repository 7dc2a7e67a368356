"""Settings of a campaign file: families of scenes with distributions, from which the samples of a dataset are drawn."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, field_validator, model_validator

from mvla_sim.distributions import Drawn, Listed, Real, TextChoice, Weight, Whole, bounded, values_of
from mvla_sim.grid import GridSettings
from mvla_sim.scene.antenna_settings import PatternFile
from mvla_sim.scene.scene_settings import ItuMaterial, RadioSettings, RayTracingSettings
from mvla_sim.scene.trajectory_settings import whole_turn
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml

__all__ = [
    "SPLITS", "CampaignSettings", "CampaignTrajectory", "FamilySettings", "SplitSettings", "load_campaign",
]  # fmt: skip

SPLITS = ("train", "validation", "test")
MOST_VOXELS = 16_000_000
"""Of a sample's occupancy."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]*$", max_length=80)]


class MaterialChoice(TextChoice):
    """One of the materials listed."""

    choices: Annotated[tuple[ItuMaterial, ...], Field(min_length=1)]


class FamilyBase(Settings):
    """What every family has: how often it is drawn, and size, place and surface of its objects.

    All objects of a sample are of one family, and each is drawn on its own. ``size_m`` is the paper's extent D where it
    gives one: diameter, side of square or triangle; of a rectangle the length, of the others the diameter of the
    circle about the object's centre that its outermost point lies on.
    """

    name: Name
    weight: Weight = Field(1.0, description="how often the family is drawn, relative to the others")
    objects: Annotated[Whole, bounded(least=1, most=100)] = Field(1, description="objects of a sample")
    size_m: Annotated[Real, bounded(least=0.001)]
    x_m: Real = Field(0.0, description="of an object's centre, from the middle of the grid")
    y_m: Real = 0.0
    rotation_deg: Real = 0.0
    height_m: Annotated[Real, bounded(above=0)] = 2.0
    material: Annotated[ItuMaterial, Drawn(MaterialChoice)] = Field("metal", description="ITU-R P.2040 names")
    scattering_coefficient: Annotated[Real, bounded(least=0, most=1)] = 0.1


class CircleFamily(FamilyBase):
    """Cylinders."""

    shape: Literal["circle"]
    facets: Annotated[int, Field(ge=3, le=10_000)] = 360


class SquareFamily(FamilyBase):
    """Squares."""

    shape: Literal["square"]


class RectangleFamily(FamilyBase):
    """Rectangles."""

    shape: Literal["rectangle"]
    aspect: Annotated[Real, bounded(above=0, most=1)] = Field(description="width over length")


class TriangleFamily(FamilyBase):
    """Equilateral triangles."""

    shape: Literal["triangle"]


class StarFamily(FamilyBase):
    """Star polygons."""

    shape: Literal["star"]
    points: Annotated[Whole, bounded(least=3, most=100)] = 5
    inner_ratio: Annotated[Real, bounded(above=0, below=1)] = Field(description="inner over outer radius")


class PolygonFamily(FamilyBase):
    """Random simple polygons: corners in rising direction about the centre, at random directions and radii."""

    shape: Literal["polygon"]
    corners: Annotated[Whole, bounded(least=3, most=100)] = 6
    roughness: Annotated[Real, bounded(least=0, most=0.95)] = Field(
        0.5, description="radii of the corners are uniform between 1 - roughness and 1 times the largest"
    )


class SmoothFamily(FamilyBase):
    """Random smooth closed outlines: a circle whose radius is modulated by a few random Fourier terms."""

    shape: Literal["smooth"]
    harmonics: Annotated[Whole, bounded(least=2, most=20)] = Field(4, description="highest Fourier term; terms from 2")
    roughness: Annotated[Real, bounded(least=0, most=0.95)] = Field(
        0.5, description="the terms' amplitudes add up to this share of the mean radius"
    )
    facets: Annotated[int, Field(ge=12, le=2000)] = 120


FamilySettings = Annotated[
    CircleFamily | SquareFamily | RectangleFamily | TriangleFamily | StarFamily | PolygonFamily | SmoothFamily,
    Field(discriminator="shape"),
]


class CampaignTrajectoryBase(Settings):
    """What all trajectories have; distances are from the middle of the grid, heights from its layer."""

    interval_deg: Annotated[Listed, bounded(least=0.01, most=360)] = 1.0
    height_m: Real = 0.0
    pair_separation_m: Annotated[Real, bounded(least=0)] = 0.0


class FullTurn(CampaignTrajectoryBase):
    """All the way round; the interval must divide 360°."""

    @field_validator("interval_deg")
    @classmethod
    def _check_interval(cls, value: Any) -> Any:
        for interval in values_of(value):
            whole_turn(interval)
        return value


class CircleCampaign(FullTurn):
    """A sensor that goes round the target."""

    kind: Literal["circle"] = "circle"
    radius_m: Annotated[Real, bounded(above=0)] = 10.0
    start_deg: Real = 0.0


class TurntableCampaign(FullTurn):
    """A target that turns counter-clockwise before a fixed sensor."""

    kind: Literal["turntable"]
    radius_m: Annotated[Real, bounded(above=0)] = Field(10.0, description="from the axis to the sensor")


class ArcCampaign(CampaignTrajectoryBase):
    """Part of a circle."""

    kind: Literal["arc"]
    radius_m: Annotated[Real, bounded(above=0)] = 10.0
    start_deg: Real = 0.0
    span_deg: Annotated[Real, bounded(above=0, below=360)]

    @model_validator(mode="after")
    def _check(self) -> ArcCampaign:
        narrow, wide = min(values_of(self.span_deg)), max(values_of(self.interval_deg))
        if narrow < wide:
            raise ValueError(f"span_deg may be {narrow:g}, which is below interval_deg = {wide:g}")
        return self


CampaignTrajectory = Annotated[CircleCampaign | TurntableCampaign | ArcCampaign, Field(discriminator="kind")]


class SplitSettings(Settings):
    """Shares of the samples; a sample is a scene, so no scene is in two splits."""

    train: Annotated[float, Field(ge=0, le=1)] = 0.7
    validation: Annotated[float, Field(ge=0, le=1)] = 0.1
    test: Annotated[float, Field(ge=0, le=1)] = 0.2

    @model_validator(mode="after")
    def _check(self) -> SplitSettings:
        total = self.train + self.validation + self.test
        if abs(total - 1) > 1e-9:
            raise ValueError(f"train + validation + test = {total:g}; the shares must add up to 1")
        return self


class CampaignSettings(Settings):
    """One campaign file: everything that decides a dataset.

    Wherever a distribution is allowed, a number (or text) is a fixed value, ``{ min = 1, max = 3 }`` a uniform one and
    ``{ choices = [1, 2], weights = [3, 1] }`` a list; numbers of things are whole in all three.
    """

    name: Name
    description: str = ""
    licence: Annotated[str, Field(min_length=1, pattern=r"^[\w.+() -]+$", description="SPDX expression")] = "CC-BY-4.0"
    seed: NonNegativeInt = 0
    samples: Annotated[int, Field(ge=1, le=10_000_000)]
    samples_per_shard: Annotated[int, Field(ge=1, le=10_000)] = 20
    split: SplitSettings = SplitSettings()
    families: Annotated[tuple[FamilySettings, ...], Field(min_length=1)]
    trajectory: CampaignTrajectory = CircleCampaign()
    radio: RadioSettings = RadioSettings()
    ray_tracing: RayTracingSettings = RayTracingSettings()
    grid: GridSettings = Field(GridSettings(), description="of the occupancy; objects lie wholly inside it")
    object_gap_m: NonNegativeFloat = Field(0.2, description="least distance between two objects of a sample")
    sensor_gap_m: PositiveFloat = Field(0.5, description="least horizontal distance from an object to the sensor")

    @model_validator(mode="after")
    def _check(self) -> CampaignSettings:
        names = [family.name for family in self.families]
        for number, name in enumerate(names):
            if name in names[:number]:
                raise ValueError(f"families[{number}].name = '{name}' is used twice; names must be unique")
        if self.grid.size_m[2] != 0:
            raise ValueError(f"grid.size_m = {list(self.grid.size_m)}: the occupancy is one layer; z must be 0")
        voxels = math.prod(size / self.grid.spacing_m for size in self.grid.size_m[:2])
        if voxels > MOST_VOXELS:
            raise ValueError(
                f"grid.spacing_m = {self.grid.spacing_m:g} makes {voxels:.2g} voxels; at most {MOST_VOXELS:g}"
            )
        if isinstance(self.radio.antenna, PatternFile):
            raise ValueError("radio.antenna.kind = 'file': a campaign is one file; allowed: omni, horn")  # noqa: TRY004
        if self.ray_tracing.seed != 1:
            raise ValueError(
                f"ray_tracing.seed = {self.ray_tracing.seed}: every sample draws its own from the campaign's seed"
            )
        diagonal = math.hypot(*self.grid.size_m[:2])
        for number, family in enumerate(self.families):
            if (least := min(values_of(family.size_m))) > diagonal:
                raise ValueError(
                    f"families[{number}].size_m is at least {least:g}; the grid's diagonal is {diagonal:g}"
                )
        return self

    @property
    def shards(self) -> int:
        """Number of shard files."""
        return -(-self.samples // self.samples_per_shard)

    def identity(self) -> dict[str, Any]:
        """Every setting that decides the data, as plain data: all but the texts about it."""
        return self.model_dump(mode="json", exclude={"description", "licence"})

    def digest(self) -> str:
        """SHA-256, in hexadecimal, over :meth:`identity`."""
        return hashlib.sha256(json.dumps(self.identity(), sort_keys=True).encode()).hexdigest()


def load_campaign(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> CampaignSettings:
    """Read a campaign file.

    Parameters
    ----------
    path
        A TOML file as ``experiments/benchmark-small.toml``.
    overrides
        ``dotted.key=value`` texts, as with ``--set``.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    data = apply_overrides(read_toml(path, "campaign file"), overrides)
    if isinstance(data.get("trajectory"), dict):
        data["trajectory"].setdefault("kind", "circle")
    return parse(CampaignSettings, data, str(path))
