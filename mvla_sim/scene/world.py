"""The scene: objects, views and the target's outline, checked against each other."""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from pydantic import Field
from shapely.geometry.base import BaseGeometry

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.cross_sections import cross_section, footprint, section_and_gap
from mvla_sim.scene.radio import RadioSettings, RayTracingSettings
from mvla_sim.scene.shape import SHAPES, Shape
from mvla_sim.scene.trajectories.circle import Circle
from mvla_sim.scene.trajectory import TRAJECTORIES, Trajectory
from mvla_sim.scene.views import Views
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside
from mvla_sim.shipped import find

__all__ = ["Scene", "SceneObject", "SceneSettings", "load_scene"]

ON_SURFACE_M: Final = 1e-6
"""A sensor this near to a surface is on it; single precision, in which rays are traced, tells no more apart."""


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


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object in its place, or a part of one that has several materials.

    Attributes
    ----------
    name
        Unique in its scene; a part's is that of the object with its own behind it, as in ``car-0-cabin``.
    settings
        Its settings: shape, place and radio material; a part's are those of the object with the part's own material.
    mesh
        Its surface in the world, metres.
    index
        Which of the settings' objects it is or belongs to.
    """

    name: str
    settings: Shape
    mesh: trimesh.Trimesh
    index: int

    def __repr__(self) -> str:
        return f"SceneObject('{self.name}': {self.settings!r}, {len(self.mesh.faces)} faces)"


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
        of all that is seen from above where the settings ask for the footprint.
    extent_m
        D of the paper, metres: the largest of the extents of the objects in the outline. It is nominal for circle,
        square and triangle, else the largest distance between two points of the object's share of the outline.
    bounds
        Lower and upper corner of the box around all objects, ``[2, 3]`` metres.

    Raises
    ------
    ConfigError
        A setting is not allowed, two objects have one name, several objects or a car do not reach the imaging plane, or
        a sensor is inside an object or on its surface.
    DataError
        A mesh or positions file is unusable, the object does not reach the imaging plane, or one is open there.

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
        objects = _objects(chosen.objects, source)
        areas = _footprints(objects, source) if chosen.outline == "footprint" else _sections(objects, chosen, source)
        outline = shapely.union_all(list(areas.values()))
        x_low, y_low, x_high, y_high = outline.bounds
        center = ((x_low + x_high) / 2, (y_low + y_high) / 2)
        views = chosen.trajectory.build_views(center, f"{source}: trajectory")
        for item in objects:
            _check_outside(item, views, source)
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


def _objects(entries: Sequence[Shape], source: str) -> tuple[SceneObject, ...]:
    """Objects in their places, a car as its parts; all names are unique."""
    names = [_name(entry, index) for index, entry in enumerate(entries)]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ConfigError(
                f"{source}: objects[{index}].name = '{name}' is also the name of objects[{names.index(name)}]; "
                "names must be unique"
            )
    found: dict[str, SceneObject] = {}
    for index, (whole, entry) in enumerate(zip(names, entries, strict=True)):
        for part, mesh in entry.parts(f"{source}: objects[{index}]").items():
            name = f"{whole}-{part}" if part else whole
            if name in found:
                raise ConfigError(
                    f"{source}: objects[{index}].name = '{whole}': '{name}' is also a name in "
                    f"objects[{found[name].index}]; names must be unique, those of a car's parts too"
                )
            found[name] = SceneObject(name, entry.part(part), mesh, index)
    return tuple(found.values())


def _name(entry: Shape, index: int) -> str:
    return entry.name or f"{SHAPES.name_of(type(entry))}-{index}"


def _footprints(objects: Sequence[SceneObject], source: str) -> dict[int, BaseGeometry]:
    """Area (x, y) in metres of each whole object as seen from above, by its index."""
    areas = {
        index: footprint(trimesh.util.concatenate([item.mesh for item in parts]))
        for index, parts in _whole(objects).items()
    }
    areas = {index: area for index, area in areas.items() if not area.is_empty}
    if not areas:
        raise DataError(f"{source}: outline = 'footprint': no object has a face that is seen from above")
    return areas


def _sections(objects: Sequence[SceneObject], settings: SceneSettings, source: str) -> dict[int, BaseGeometry]:
    """Cross-section (x, y) in metres of each whole object that the imaging plane cuts, by its index."""
    height = settings.plane_height_m
    found = [section_and_gap(item.mesh, height) for item in objects]
    reached = [item for item, (area, gap) in zip(objects, found, strict=True) if gap is not None or not area.is_empty]
    # One object: its own message says where it is. Several: those above and below the plane are only obstacles.
    if not reached and len(objects) > 1:
        spans = ", ".join(_span(index, parts) for index, parts in _whole(objects).items())
        raise ConfigError(f"{source}: plane_height_m = {height:g} cuts none of the objects ({spans})")
    return {
        index: shapely.union_all([cross_section(item.mesh, height, f"{source}: {_called(item)}") for item in parts])
        for index, parts in _whole(reached or objects).items()
    }


def _whole(objects: Sequence[SceneObject]) -> dict[int, list[SceneObject]]:
    """Parts of each object, by its index."""
    return {index: list(parts) for index, parts in itertools.groupby(objects, key=lambda item: item.index)}


def _span(index: int, parts: Sequence[SceneObject]) -> str:
    """Name of a whole object, and its lowest and highest point."""
    low, high = min(item.mesh.bounds[0, 2] for item in parts), max(item.mesh.bounds[1, 2] for item in parts)
    first = parts[0]
    name = first.name if len(parts) == 1 else _name(first.settings, index)
    return f"{name} {low:.4g} to {high:.4g} m"


def _called(item: SceneObject) -> str:
    """Name of an object for a message, with its file where it has one."""
    file = getattr(item.settings, "file", None)
    return item.name if file is None else f"{item.name} ({file})"


def _widest_m(area: BaseGeometry) -> float:
    """Largest distance between two points of an area, metres; both are corners of its convex hull."""
    corners = shapely.get_coordinates(area.convex_hull)
    return max(float(np.hypot(*(corners - corner).T).max()) for corner in corners)


def _check_outside(item: SceneObject, views: Views, source: str) -> None:
    low, high = item.mesh.bounds
    pairs = {"view": views.positions_m} if views.receivers_m is None else {
        "transmitter of view": views.positions_m, "receiver of view": views.receivers_m
    }  # fmt: skip
    for called, positions in pairs.items():
        within = ((positions >= low - ON_SURFACE_M) & (positions <= high + ON_SURFACE_M)).all(axis=1)
        for height in np.unique(positions[within, 2]):
            area, _ = section_and_gap(item.mesh, float(height))
            level = np.flatnonzero(within & (positions[:, 2] == height))
            hit = level[shapely.distance(area, shapely.points(positions[level, :2])) <= ON_SURFACE_M]
            if len(hit):
                x, y, z = positions[hit[0]]
                raise ConfigError(
                    f"{source}: trajectory: {called} {hit[0]} at ({x:.4g}, {y:.4g}, {z:.4g}) m is inside '{item.name}' "
                    "or on its surface; move the sensor or the object"
                )
