"""Settings of a campaign file: families of scenes with distributions, from which the samples of a dataset are drawn."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    field_validator,
    model_validator,
)

from mvla_sim.dataset.families import FamilySettings, Name
from mvla_sim.distributions import Listed, Real, bounded, draw, values_of
from mvla_sim.grid import GridSettings
from mvla_sim.scene.radio import RadioSettings, RayTracingSettings
from mvla_sim.scene.trajectories.arc import Arc
from mvla_sim.scene.trajectories.circle import Circle
from mvla_sim.scene.trajectories.turntable import Turntable
from mvla_sim.scene.trajectory import Trajectory, whole_turn
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml
from mvla_sim.shipped import find

__all__ = ["SPLITS", "CampaignSettings", "SplitSettings", "load_campaign"]

SPLITS = ("train", "validation", "test")
MOST_VOXELS = 16_000_000
"""Of a sample's occupancy."""
Point3 = tuple[float, float, float]


class RandomTrajectory(Settings):
    """What all trajectories have; distances are from the middle of the grid, heights from its layer."""

    interval_deg: Annotated[Listed, bounded(least=0.01, most=360)] = Field(1.0, description="between views")
    height_m: Real = Field(0.0, description="of the sensor, above the grid's layer")
    pair_separation_m: Annotated[Real, bounded(least=0)] = Field(
        0.0, description="distance between transmitter and receiver, side by side"
    )
    radius_m: Annotated[Real, bounded(above=0)] = Field(10.0, description="of a turntable: from the axis to the sensor")

    def drawn(self, center_m: Point3, random: np.random.Generator) -> Trajectory:
        """Draw a trajectory about a point, metres."""
        interval, height, separation, radius = (
            draw(value, random) for value in (self.interval_deg, self.height_m, self.pair_separation_m, self.radius_m)
        )
        x, y, z = center_m
        common = {"interval_deg": interval, "pair_separation_m": separation}
        return self.placed((x, y, z + height), radius, random, common)

    def placed(
        self, center_m: Point3, radius_m: float, random: np.random.Generator, common: dict[str, float]
    ) -> Trajectory:
        """Put a trajectory about a point, and draw what only this kind has."""
        raise NotImplementedError


class FullTurn(RandomTrajectory):
    """All the way round; the interval must divide 360°."""

    @field_validator("interval_deg")
    @classmethod
    def _check_interval(cls, value: Any) -> Any:
        for interval in values_of(value):
            whole_turn(interval)
        return value


class RandomCircle(FullTurn):
    """A sensor that goes round the target."""

    kind: Literal["circle"] = "circle"
    start_deg: Real = Field(0.0, description="azimuth of the first view")

    def placed(
        self, center_m: Point3, radius_m: float, random: np.random.Generator, common: dict[str, float]
    ) -> Circle:
        """A circle about the point."""
        start = draw(self.start_deg, random)
        return Circle(radius_m=radius_m, start_deg=start, center_m=center_m[:2], height_m=center_m[2], **common)


class RandomTurntable(FullTurn):
    """A target that turns counter-clockwise before a fixed sensor."""

    kind: Literal["turntable"]

    def placed(
        self, center_m: Point3, radius_m: float, random: np.random.Generator, common: dict[str, float]
    ) -> Turntable:
        """A turntable whose axis is at the point, and the sensor on its +x side."""
        del random
        x, y, z = center_m
        return Turntable(sensor_m=(x + radius_m, y, z), axis_m=(x, y), **common)


class RandomArc(RandomTrajectory):
    """Part of a circle."""

    kind: Literal["arc"]
    start_deg: Real = Field(0.0, description="azimuth of the first view")
    span_deg: Annotated[Real, bounded(above=0, below=360)] = Field(description="from the first view to the last")

    @model_validator(mode="after")
    def _check(self) -> RandomArc:
        narrow, wide = min(values_of(self.span_deg)), max(values_of(self.interval_deg))
        if narrow < wide:
            raise ValueError(f"span_deg may be {narrow:g}, which is below interval_deg = {wide:g}")
        return self

    def placed(self, center_m: Point3, radius_m: float, random: np.random.Generator, common: dict[str, float]) -> Arc:
        """An arc about the point."""
        start = draw(self.start_deg, random)
        stop = start + draw(self.span_deg, random)
        x, y, z = center_m
        return Arc(radius_m=radius_m, start_deg=start, stop_deg=stop, center_m=(x, y), height_m=z, **common)


CampaignTrajectory = Annotated[RandomCircle | RandomTurntable | RandomArc, Field(discriminator="kind")]


class SplitSettings(Settings):
    """Shares of the samples; a sample is a scene, so no scene is in two splits."""

    train: Annotated[float, Field(ge=0, le=1, description="share of the samples")] = 0.7
    validation: Annotated[float, Field(ge=0, le=1, description="share of the samples")] = 0.1
    test: Annotated[float, Field(ge=0, le=1, description="share of the samples")] = 0.2

    @model_validator(mode="after")
    def _check(self) -> SplitSettings:
        total = self.train + self.validation + self.test
        if abs(total - 1) > 1e-9:
            raise ValueError(f"train + validation + test = {total:g}; the shares must add up to 1")
        return self


def _centred(grid: GridSettings) -> GridSettings:
    """A grid of its own place: it is where objects are put, and the imaging plane."""
    return grid.model_copy(update={"center_m": grid.middle_m()})


class CampaignSettings(Settings):
    """One campaign file: everything that decides a dataset.

    Wherever a distribution is allowed, a number (or text) is a fixed value, ``{ min = 1, max = 3 }`` a uniform one and
    ``{ choices = [1, 2], weights = [3, 1] }`` a list; numbers of things are whole in all three.
    """

    name: Name = Field(description="of the dataset")
    description: str = Field("", description="in the dataset's card")
    licence: Annotated[str, Field(min_length=1, pattern=r"^[\w.+() -]+$", description="SPDX expression")] = "CC-BY-4.0"
    seed: NonNegativeInt = Field(0, description="decides every sample")
    samples: Annotated[int, Field(ge=1, le=10_000_000, description="number of samples")]
    samples_per_shard: Annotated[int, Field(ge=1, le=10_000, description="samples of one file")] = 20
    split: SplitSettings = SplitSettings()
    families: Annotated[tuple[FamilySettings, ...], Field(min_length=1, description="kinds of targets that are drawn")]
    trajectory: CampaignTrajectory = RandomCircle()
    radio: RadioSettings = RadioSettings()
    ray_tracing: RayTracingSettings = RayTracingSettings()
    grid: Annotated[GridSettings, AfterValidator(_centred)] = Field(
        GridSettings(center_m=(0.0, 0.0, 0.0)), description="of the occupancy; objects lie wholly inside it"
    )
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
        if "file" in type(self.radio.antenna).model_fields:
            raise ValueError("radio.antenna.kind = 'file': a campaign is one file; allowed: omni, horn")
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
        """Every setting that decides the data, as plain data: all but the texts about it.

        A grid without an alignment is told as before there was one, so that older datasets stay readable.
        """
        unset = {"grid": {"align"}} if self.grid.align is None else {}
        return self.model_dump(mode="json", exclude={"description": True, "licence": True, **unset})

    def digest(self) -> str:
        """SHA-256, in hexadecimal, over :meth:`identity`."""
        return hashlib.sha256(json.dumps(self.identity(), sort_keys=True).encode()).hexdigest()


def load_campaign(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> CampaignSettings:
    """Read a campaign file.

    Parameters
    ----------
    path
        A TOML file, or the bare name of one that comes with the package, as ``benchmark-small``.
    overrides
        ``dotted.key=value`` texts, as with ``--set``.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    file = find("experiments", path)
    data = apply_overrides(read_toml(file, "campaign file"), overrides)
    if isinstance(data.get("trajectory"), dict):
        data["trajectory"].setdefault("kind", "circle")
    return parse(CampaignSettings, data, str(file))
