"""Settings of a scene file: what is in the world, where it is looked at from, and how it is traced."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from mvla_sim.scene.antenna_settings import AntennaSettings, Omni
from mvla_sim.scene.trajectory_settings import CircleTrajectory, TrajectorySettings
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside

__all__ = ["ObjectSettings", "RadioSettings", "RayTracingSettings", "SceneSettings", "load_scene"]

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


RUBBER = CustomMaterial(relative_permittivity=4.0, conductivity_s_per_m=0.8)
"""Round figures, not measured ones: rubber filled with carbon black, with a loss tangent of 0.1 at 36 GHz."""


class Car(ObjectBase):
    """A car that stands on its position, front towards +x; ``material`` is that of its sheet metal."""

    shape: Literal["car"]
    length_m: Annotated[float, Field(ge=3, le=6)] = 4.22
    width_m: Annotated[float, Field(ge=1.4, le=2.4, description="without the mirrors")] = 1.76
    height_m: Annotated[float, Field(ge=1.2, le=2.4)] = 1.60
    glass: ItuMaterial | CustomMaterial = "glass"
    glass_thickness_m: Annotated[float, Field(gt=0, le=0.1)] = 0.005
    tyres: ItuMaterial | CustomMaterial = RUBBER


ObjectSettings = Annotated[
    Circle | Square | Rectangle | Triangle | Star | Polygon | MeshFile | Car, Field(discriminator="shape")
]


class RadioSettings(Settings):
    """Carrier, bandwidth, polarisation and antennas of the sensor."""

    carrier_hz: PositiveFloat = 36e9
    bandwidth_hz: PositiveFloat = 3e9
    polarization: Literal["V", "H"] = "V"
    antenna: AntennaSettings = Field(Omni(), description="pattern of both antennas: omni, horn or file")

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
    outline: Literal["section", "footprint"] = Field(
        "section", description="the ground truth: cut at the imaging plane, or all that is seen from above"
    )


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
    if isinstance(data.get("radio"), dict):
        nodes.append(data["radio"].get("antenna"))
    if isinstance(data.get("objects"), list):
        nodes += data["objects"]
    for node in nodes:
        if isinstance(node, dict) and isinstance(node.get("file"), str):
            node["file"] = resolve_beside(node["file"], folder)
    if isinstance(data.get("trajectory"), dict):
        data["trajectory"].setdefault("kind", "circle")
    return parse(SceneSettings, data, str(path))
