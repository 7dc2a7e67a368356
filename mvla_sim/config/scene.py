"""Settings of a scene file: what is in the world, where it is looked at from, and how it is traced."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from mvla_sim.config.base import Settings, apply_overrides, parse, read_toml, resolve_beside

__all__ = ["ObjectSettings", "RadioSettings", "RayTracingSettings", "SceneSettings", "TrajectorySettings", "load_scene"]

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]

ItuMaterial = Literal[
    "concrete", "brick", "plasterboard", "wood", "glass", "ceiling_board", "chipboard", "plywood", "marble",
    "floorboard", "metal", "very_dry_ground", "medium_dry_ground", "wet_ground",
]  # fmt: skip


class CustomMaterial(Settings):
    """A homogeneous material by its constants; independent of frequency."""

    relative_permittivity: Annotated[float, Field(ge=1)]
    conductivity_s_per_m: NonNegativeFloat = 0.0


class ScatteringPattern(Settings):
    """Angular pattern of diffuse reflection (Degli-Esposti et al., IEEE TAP 55(1), 2007)."""

    kind: Literal["lambertian", "directive", "backscattering"] = "lambertian"
    alpha_r: Annotated[int, Field(ge=1, description="width of the lobe around the specular direction")] = 4
    alpha_i: Annotated[int, Field(ge=1, description="width of the lobe back to the source (backscattering)")] = 4
    lobe_ratio: Annotated[float, Field(ge=0, le=1, description="share of power in the specular lobe")] = 0.5


class ObjectBase(Settings):
    """What every object of a scene has: place, material and surface."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][\w-]*$")] | None = None
    position_m: Point3 = (0.0, 0.0, 0.0)
    rotation_deg: float = Field(0.0, description="about the vertical axis, counter-clockwise")
    material: ItuMaterial | CustomMaterial = "metal"
    thickness_m: PositiveFloat = 0.1
    scattering_coefficient: Annotated[float, Field(ge=0, le=1)] = 0.1
    scattering_pattern: ScatteringPattern = ScatteringPattern()
    xpd_coefficient: Annotated[float, Field(ge=0, le=1)] = 0.0


class PrismBase(ObjectBase):
    """A vertical prism over an outline, centred on its position."""

    height_m: PositiveFloat = 2.0


class Circle(PrismBase):
    """A cylinder. A facet's centre points to the +x axis, so views at whole multiples of 360°/facets see a flash."""

    shape: Literal["circle"]
    radius_m: PositiveFloat = 4.0
    facets: Annotated[int, Field(ge=3, le=100_000)] = 360


class Square(PrismBase):
    """A square with sides along x and y."""

    shape: Literal["square"]
    side_m: PositiveFloat = 8.0


class Rectangle(PrismBase):
    """A rectangle, length along x and width along y."""

    shape: Literal["rectangle"]
    length_m: PositiveFloat
    width_m: PositiveFloat


class Triangle(PrismBase):
    """An equilateral triangle by its altitude, centroid at its position, one tip towards +y."""

    shape: Literal["triangle"]
    altitude_m: PositiveFloat = 6.0


class Star(PrismBase):
    """A star polygon, one tip towards +y; the inner radius defaults to that of {n/2}, for n = 5 r·sin18°/sin54°."""

    shape: Literal["star"]
    points: Annotated[int, Field(ge=3, le=1000)] = 5
    radius_m: PositiveFloat = 4.0
    inner_radius_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _check(self) -> Star:
        if self.inner_radius_m is None and self.points < 5:
            raise ValueError(f"points = {self.points} has no {{n/2}} star polygon; give inner_radius_m")
        if self.inner_radius_m is not None and self.inner_radius_m >= self.radius_m:
            raise ValueError(f"inner_radius_m = {self.inner_radius_m} must be below radius_m = {self.radius_m}")
        return self


class Polygon(PrismBase):
    """Any simple polygon by its vertices, in order."""

    shape: Literal["polygon"]
    vertices_m: Annotated[tuple[Point2, ...], Field(min_length=3)]


class MeshFile(ObjectBase):
    """A mesh read from a file (PLY, OBJ, STL, GLB, …), scaled, turned and placed; metres after scaling."""

    shape: Literal["mesh"]
    file: str
    scale: PositiveFloat = 1.0
    up: Literal["z", "y"] = Field("z", description="which axis of the file points up")


ObjectSettings = Annotated[
    Circle | Square | Rectangle | Triangle | Star | Polygon | MeshFile, Field(discriminator="shape")
]

Interval = Annotated[float, Field(gt=0, le=360)]


class CircleTrajectory(Settings):
    """A full circle; the interval must divide 360°."""

    kind: Literal["circle"] = "circle"
    radius_m: PositiveFloat = 10.0
    interval_deg: Interval = 1.0
    start_deg: float = 0.0
    center_m: Point2 = (0.0, 0.0)
    height_m: float = 0.0

    @model_validator(mode="after")
    def _check(self) -> CircleTrajectory:
        whole_turn(self.interval_deg)
        return self


class ArcTrajectory(Settings):
    """Part of a circle, from ``start_deg`` to ``stop_deg`` inclusive."""

    kind: Literal["arc"]
    radius_m: PositiveFloat = 10.0
    start_deg: float
    stop_deg: float
    interval_deg: Interval = 1.0
    center_m: Point2 = (0.0, 0.0)
    height_m: float = 0.0

    @model_validator(mode="after")
    def _check(self) -> ArcTrajectory:
        span = self.stop_deg - self.start_deg
        if not 0 < span < 360:
            raise ValueError(f"stop_deg - start_deg = {span:g} must be above 0 and below 360; use kind = 'circle'")
        if span < self.interval_deg:
            raise ValueError(f"interval_deg = {self.interval_deg:g} is wider than the arc of {span:g}")
        return self


class LineTrajectory(Settings):
    """Evenly spaced positions on a straight line, both ends included."""

    kind: Literal["line"]
    start_m: Point3
    stop_m: Point3
    views: Annotated[int, Field(ge=2)]

    @model_validator(mode="after")
    def _check(self) -> LineTrajectory:
        if self.start_m == self.stop_m:
            raise ValueError(f"start_m and stop_m are the same point {list(self.start_m)}")
        return self


class PositionsTrajectory(Settings):
    """Any positions, from a CSV file with a header ``x_m,y_m[,z_m]`` or listed here."""

    kind: Literal["positions"]
    file: str | None = None
    positions_m: tuple[Point3, ...] | None = None

    @model_validator(mode="after")
    def _check(self) -> PositionsTrajectory:
        if (self.file is None) == (self.positions_m is None):
            raise ValueError("give either file or positions_m")
        if self.positions_m is not None and not self.positions_m:
            raise ValueError("positions_m is empty; give at least one position")
        return self


class TurntableTrajectory(Settings):
    """A fixed sensor and a target that turns counter-clockwise: the same views, seen from the target's frame."""

    kind: Literal["turntable"]
    sensor_m: Point3 = (10.0, 0.0, 0.0)
    interval_deg: Interval = 1.0
    axis_m: Point2 = (0.0, 0.0)

    @model_validator(mode="after")
    def _check(self) -> TurntableTrajectory:
        whole_turn(self.interval_deg)
        return self


def whole_turn(interval_deg: float) -> int:
    """Number of views of a full turn; raises ValueError where the interval does not divide 360°."""
    count = round(360 / interval_deg)
    if abs(count * interval_deg - 360) > 1e-6:
        raise ValueError(f"interval_deg = {interval_deg:g} does not divide 360; allowed: 360 / n for a whole n")
    return count


TrajectorySettings = Annotated[
    CircleTrajectory | ArcTrajectory | LineTrajectory | PositionsTrajectory | TurntableTrajectory,
    Field(discriminator="kind"),
]


class RadioSettings(Settings):
    """Carrier, bandwidth and polarisation of the sensor."""

    carrier_hz: PositiveFloat = 36e9
    bandwidth_hz: PositiveFloat = 3e9
    polarization: Literal["V", "H"] = "V"

    @model_validator(mode="after")
    def _check(self) -> RadioSettings:
        if self.bandwidth_hz >= 2 * self.carrier_hz:
            raise ValueError(f"bandwidth_hz = {self.bandwidth_hz:g} reaches below 0 Hz at {self.carrier_hz:g} Hz")
        return self


class RayTracingSettings(Settings):
    """What Sionna RT traces, and with how many rays."""

    specular: bool = True
    diffuse: bool = True
    diffraction: bool = True
    max_depth: Annotated[int, Field(ge=1, le=20, description="interactions a path may have")] = 1
    diffuse_rays: Annotated[int, Field(ge=1, le=100_000_000)] = 6000
    specular_rays: Annotated[int, Field(ge=1, le=100_000_000)] = 20_000
    launch: Literal["sector", "sphere"] = Field("sector", description="rays only towards the objects, or all around")
    max_paths: PositiveInt = Field(1_000_000, description="cap on the paths of one view; reaching it is an error")
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1

    @model_validator(mode="after")
    def _check(self) -> RayTracingSettings:
        if not (self.specular or self.diffuse or self.diffraction):
            raise ValueError("specular, diffuse and diffraction are all false; at least one must be true")
        return self


class SceneSettings(Settings):
    """One scene file: everything that decides a channel impulse response."""

    name: Annotated[str, Field(min_length=1)]
    description: str = ""
    objects: Annotated[tuple[ObjectSettings, ...], Field(min_length=1)]
    trajectory: TrajectorySettings = CircleTrajectory()
    radio: RadioSettings = RadioSettings()
    ray_tracing: RayTracingSettings = RayTracingSettings()
    plane_height_m: float = Field(0.0, description="height of the imaging plane: where the ground truth is cut")


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> SceneSettings:
    """Read a scene file; file names inside it are relative to it.

    Parameters
    ----------
    path
        A TOML file as in ``scenes/``.
    overrides
        ``dotted.key=value`` texts, as with ``--set``.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    data = apply_overrides(read_toml(path, "scene file"), overrides)
    folder = Path(path).parent
    nodes: list[Any] = [data.get("trajectory")]
    if isinstance(data.get("objects"), list):
        nodes += data["objects"]
    for node in nodes:
        if isinstance(node, dict) and isinstance(node.get("file"), str):
            node["file"] = resolve_beside(node["file"], folder)
    if isinstance(data.get("trajectory"), dict):
        data["trajectory"].setdefault("kind", "circle")
    return parse(SceneSettings, data, str(path))
