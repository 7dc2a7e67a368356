"""The scene: objects, views and the target's outline, checked against each other."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field
from shapely.geometry.base import BaseGeometry

from mvla_sim.errors import ConfigError, MvlaWarning
from mvla_sim.scene.outlines import target_areas
from mvla_sim.scene.placing import SceneObject, check_outside, check_reach, place_objects
from mvla_sim.scene.radio import RadioSettings, RayTracingSettings
from mvla_sim.scene.shape import SHAPES, Shape
from mvla_sim.scene.trajectories.circle import Circle
from mvla_sim.scene.trajectory import TRAJECTORIES, Trajectory
from mvla_sim.scene.views import SAME_HEIGHT_M, Views
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside
from mvla_sim.shipped import find

__all__ = ["Scene", "SceneSettings", "load_scene"]


class SceneSettings(Settings):
    """One scene file: everything that decides a channel impulse response."""

    name: Annotated[str, Field(min_length=1, description="of the scene, in files and figures")]
    description: str = Field("", description="for readers of the file")
    objects: Annotated[
        tuple[Annotated[Shape, SHAPES], ...], Field(min_length=1, description="what the target consists of")
    ]
    trajectory: Annotated[Trajectory, TRAJECTORIES] = Circle()
    radio: RadioSettings = RadioSettings()
    ray_tracing: RayTracingSettings = RayTracingSettings()
    plane_height_m: float = Field(0.0, description="height of the imaging plane: where the ground truth is cut")
    outline: Literal["section", "footprint"] = Field(
        "section", description="the ground truth: cut at the imaging plane, or all that is seen from above"
    )


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Scene:
    """Everything that is in the world, and where it is looked at from.

    Parameters
    ----------
    settings
        A scene's settings, as an object or as plain data like those of a scene file.
    source
        Where they come from, for messages.
    fields
        Or the fields of :class:`SceneSettings` by name, each as an object or as plain data; the scene's ``name`` is
        "scene" by default.

    Attributes
    ----------
    name
        The scene's name.
    settings
        The settings it was built from.
    objects
        The objects, at least one; each part of a car is one of its own.
    views
        Sensor positions T_m.
    outline
        The target's true shape, coordinates (x, y) in metres: the union of the cross-sections at the imaging plane, or
        of all that is seen from above where the settings ask for the footprint; without obstacles.
    extent_m
        D of the paper, metres: the largest of the extents of the objects in the outline. It is nominal for circle,
        square and triangle, else the largest distance between two points of the object's share of the outline.
    bounds
        Lower and upper corner of the box around all objects, ``[2, 3]`` metres.

    Raises
    ------
    ConfigError
        A setting is not allowed, two objects have one name, a sensor is inside an object or on its surface, or an
        object that is no obstacle does not reach the imaging plane, or only with its feet.
    DataError
        A mesh or positions file is unusable, the object does not reach the imaging plane, one is open there, or one is
        far from every sensor.

    Warns
    -----
    MvlaWarning
        Every sensor is at another height than the imaging plane, or that cuts nothing of a footprint.

    Examples
    --------
    >>> import mvla_sim as mv
    >>> mv.Scene(objects=[mv.Star(radius_m=4)], trajectory=mv.Circle(radius_m=10))
    Scene('scene': 1 object, 360 views, extent 7.61 m)
    """

    name: str
    settings: SceneSettings
    objects: tuple[SceneObject, ...]
    views: Views
    outline: BaseGeometry
    extent_m: float
    bounds: NDArray[np.float64]

    def __init__(
        self, settings: SceneSettings | Mapping[str, Any] | None = None, /, *, source: str = "scene", **fields: Any
    ) -> None:
        if not isinstance(settings, SceneSettings | Mapping | None):
            raise ConfigError(
                f"{source}: {type(settings).__name__} is no scene; give a table or objects=[…]; for a file: Scene.load"
            )
        if isinstance(fields.get("objects"), Shape):  # it has items, but they are its fields
            fields["objects"] = [fields["objects"]]
        if isinstance(settings, SceneSettings) and not fields:
            chosen = settings
        else:
            chosen = parse(SceneSettings, {"name": "scene", **dict(settings or {}), **fields}, source)
        objects = place_objects(chosen.objects, source)
        areas = target_areas(objects, chosen, source)
        outline = shapely.union_all(list(areas.values()))
        x_low, y_low, x_high, y_high = outline.bounds
        center = ((x_low + x_high) / 2, (y_low + y_high) / 2)
        views = chosen.trajectory.build_views(center, f"{source}: trajectory")
        check_reach(objects, views, source)
        for item in objects:
            check_outside(item, views, source)
        _say_height(views, chosen, source)
        boxes = np.stack([item.mesh.bounds for item in objects])  # [n_object, 2, 3]
        bounds = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        bounds.setflags(write=False)
        extent = max(chosen.objects[index].nominal_extent_m or _widest_m(area) for index, area in areas.items())
        built = {
            "name": chosen.name, "settings": chosen, "objects": objects, "views": views, "outline": outline,
            "extent_m": extent, "bounds": bounds,
        }  # fmt: skip
        for field, value in built.items():
            object.__setattr__(self, field, value)

    @classmethod
    def load(cls, path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
        """Read a scene file, or one that comes with the package, with overrides, and build what it describes.

        Parameters
        ----------
        path, overrides
            As of :func:`load_scene`.

        Raises
        ------
        ConfigError, DataError
            One line that names the file, the key or object, its value and what is allowed.
        """
        return cls(load_scene(path, overrides), source=str(path))

    def __repr__(self) -> str:
        count = len(self.settings.objects)
        objects = f"{count} object{'s' * (count > 1)}"
        return f"Scene('{self.name}': {objects}, {len(self.views)} views, extent {self.extent_m:.2f} m)"

    def select(self, indices: NDArray[np.intp]) -> Scene:
        """The same scene, looked at from some of its views, by their numbers."""
        part = copy.copy(self)
        object.__setattr__(part, "views", self.views.select(indices))
        return part

    def fingerprint(self) -> str:
        """SHA-256, in hexadecimal, over everything that decides a channel.

        It covers radio and ray tracing, the surfaces, vertices and faces of all objects, outline and extent, views and
        antenna pattern (all to 1 nm, or 1e-9 dB) rather than the settings that they are made from: code or a file that
        makes them otherwise changes it; a file that is moved or renamed does not, nor does a new name or description of
        the scene or of an object.
        """
        settings, views, pattern = self.settings, self.views, self.settings.radio.antenna.pattern()
        surface = {"material", "thickness_m", "scattering_coefficient", "scattering_pattern", "xpd_coefficient"}
        data = {
            "radio": settings.radio.model_dump(mode="json", exclude={"antenna"}),
            "gain_dbi": None if pattern is None else [pattern.gain_dbi, pattern.floor_db],
            "ray_tracing": settings.ray_tracing.model_dump(mode="json"),
            "plane_height_m": settings.plane_height_m,
            "extent_m": self.extent_m,
            "center_m": views.center_m,
            "surfaces": [item.settings.model_dump(mode="json", include=surface) for item in self.objects],
        }
        digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode())
        arrays = [views.positions_m, views.angles_deg, views.receivers_m, views.boresights]
        arrays += [None, None] if pattern is None else [pattern.azimuth_db, pattern.elevation_db]
        arrays += [shapely.get_coordinates(self.outline)]
        arrays += [np.asarray(array) for item in self.objects for array in (item.mesh.vertices, item.mesh.faces)]
        for array in arrays:
            if array is None:
                digest.update(b"none")
                continue
            digest.update(f"{array.shape}".encode())
            if array.dtype.kind == "f":
                digest.update((np.round(array, 9) + 0.0).astype("<f8").tobytes())  # + 0.0 turns -0 into 0
            else:
                digest.update(array.astype("<i8").tobytes())
        return digest.hexdigest()


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> SceneSettings:
    """Read a scene file; file names inside it are relative to it.

    Parameters
    ----------
    path
        A TOML file, or the bare name of one that comes with the package, as ``star``.
    overrides
        ``dotted.key=value`` texts; the key may begin with ``scene.``, as in the axes of an experiment.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    file = find("scenes", path)
    data = apply_overrides(read_toml(file, "scene file"), overrides, lambda key: key.removeprefix("scene."))
    objects, radio = data.get("objects"), data.get("radio")
    nodes: list[Any] = [*(objects if isinstance(objects, list) else ()), data.get("trajectory")]
    nodes += [radio.get("antenna")] if isinstance(radio, dict) else []
    for node in nodes:
        if isinstance(node, dict) and isinstance(node.get("file"), str):
            node["file"] = resolve_beside(node["file"], file.parent)
    return parse(SceneSettings, data, str(file))


def _widest_m(area: BaseGeometry) -> float:
    """Largest distance between two points of an area, metres; both are corners of its convex hull."""
    corners = shapely.get_coordinates(area.convex_hull)
    return max(float(np.hypot(*(corners - corner).T).max()) for corner in corners)


def _say_height(views: Views, settings: SceneSettings, source: str) -> None:
    """Tell that every sensor is at another height than the imaging plane."""
    heights, plane = views.midpoints_m[:, 2], settings.plane_height_m
    away = heights[np.argmin(abs(heights - plane))]
    if abs(away - plane) > SAME_HEIGHT_M:
        warnings.warn(
            f"{source}: the sensor is at z = {away:.4g} m and the imaging plane at {plane:g} m: upright faces mirror "
            "its waves at its own height; set the trajectory's height, or plane_height_m",
            MvlaWarning,
            stacklevel=3,
        )
