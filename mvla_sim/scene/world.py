"""The scene: objects, views and the target's outline, checked against each other."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.antenna import build_antenna
from mvla_sim.scene.antenna_settings import PatternFile
from mvla_sim.scene.meshes import build_parts, cross_section, footprint, section_and_gap
from mvla_sim.scene.scene_settings import Car, MeshFile, ObjectSettings, SceneSettings, load_scene
from mvla_sim.scene.shapes import nominal_extent_m
from mvla_sim.scene.trajectory import build_views
from mvla_sim.scene.vehicle import part_settings
from mvla_sim.scene.views import Views

__all__ = ["Scene", "SceneObject"]

ON_SURFACE_M: Final = 1e-6
"""A sensor this near to a surface is on it; single precision, in which rays are traced, tells no more apart."""


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
    settings: ObjectSettings
    mesh: trimesh.Trimesh
    index: int


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that is in the world, and where it is looked at from.

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
    """

    name: str
    settings: SceneSettings
    objects: tuple[SceneObject, ...]
    views: Views
    outline: BaseGeometry
    extent_m: float
    bounds: NDArray[np.float64]

    @classmethod
    def load(cls, path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
        """Read a scene file, with ``dotted.key=value`` overrides, and build what it describes.

        Raises
        ------
        ConfigError, DataError
            One line that names the file, the key or object, its value and what is allowed.
        """
        return cls.from_settings(load_scene(path, overrides), str(path))

    @classmethod
    def from_settings(cls, settings: SceneSettings, source: str = "scene") -> Scene:
        """Build meshes, views and outline, and check that they fit together.

        Parameters
        ----------
        settings
            A scene's settings.
        source
            Where they come from, for messages.

        Raises
        ------
        ConfigError
            Two objects have one name, several objects or a car do not reach the imaging plane, or a sensor is inside an
            object or on its surface.
        DataError
            A mesh or positions file is unusable, the object does not reach the imaging plane, or one is open there.
        """
        objects = _objects(settings.objects, source)
        areas = (
            _footprints(objects, source) if settings.outline == "footprint" else _sections(objects, settings, source)
        )
        outline = shapely.union_all(list(areas.values()))
        extent = max(nominal_extent_m(settings.objects[index]) or _widest_m(area) for index, area in areas.items())
        x_low, y_low, x_high, y_high = outline.bounds
        center = ((x_low + x_high) / 2, (y_low + y_high) / 2)
        views = build_views(settings.trajectory, center, f"{source}: trajectory")
        for item in objects:
            _check_outside(item, views, source)
        boxes = np.stack([item.mesh.bounds for item in objects])  # [n_object, 2, 3]
        bounds = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        bounds.setflags(write=False)
        return cls(settings.name, settings, objects, views, outline, extent, bounds)

    def fingerprint(self) -> str:
        """SHA-256, in hexadecimal, over everything that decides a channel.

        It covers materials, radio, ray tracing, shapes and views (to 1 nm), and the vertices and faces of mesh files
        and the levels of antenna pattern files in place of their names: a file that is edited changes it; one that is
        moved or renamed does not, nor does a new name or description of the scene or of an object. Vertices and faces
        of a car's parts are covered too, for its settings alone do not decide them.
        """
        data = self.settings.model_dump(mode="json", exclude={"name", "description", "trajectory"})
        for entry in data["objects"]:
            del entry["name"]
            entry.pop("file", None)
        data["radio"]["antenna"].pop("file", None)
        data["center_m"] = self.views.center_m
        digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode())
        arrays = [self.views.positions_m, self.views.angles_deg]
        arrays += [array for array in (self.views.receivers_m, self.views.boresights) if array is not None]
        if isinstance(self.settings.radio.antenna, PatternFile):
            pattern = build_antenna(self.settings.radio.antenna)
            assert pattern is not None
            arrays += [pattern.azimuth_db, pattern.elevation_db]
        for item in self.objects:
            if isinstance(item.settings, MeshFile | Car):
                arrays += [np.asarray(item.mesh.vertices), np.asarray(item.mesh.faces)]
        for array in arrays:
            digest.update(f"{array.shape}".encode())
            if array.dtype.kind == "f":
                digest.update((np.round(array, 9) + 0.0).astype("<f8").tobytes())  # + 0.0 turns -0 into 0
            else:
                digest.update(array.astype("<i8").tobytes())
        return digest.hexdigest()


def _objects(entries: Sequence[ObjectSettings], source: str) -> tuple[SceneObject, ...]:
    """Objects in their places, a car as its parts; all names are unique."""
    names = [entry.name or f"{entry.shape}-{index}" for index, entry in enumerate(entries)]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ConfigError(
                f"{source}: objects[{index}].name = '{name}' is also the name of objects[{names.index(name)}]; "
                "names must be unique"
            )
    found: dict[str, SceneObject] = {}
    for index, (whole, entry) in enumerate(zip(names, entries, strict=True)):
        for part, mesh in build_parts(entry, f"{source}: objects[{index}]").items():
            name = f"{whole}-{part}" if part else whole
            settings = part_settings(entry, part) if isinstance(entry, Car) else entry
            if name in found:
                raise ConfigError(
                    f"{source}: objects[{index}].name = '{whole}': '{name}' is also a name in "
                    f"objects[{found[name].index}]; names must be unique, those of a car's parts too"
                )
            found[name] = SceneObject(name, settings, mesh, index)
    return tuple(found.values())


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
    name = first.name if len(parts) == 1 else first.settings.name or f"{first.settings.shape}-{index}"
    return f"{name} {low:.4g} to {high:.4g} m"


def _called(item: SceneObject) -> str:
    """Name of an object for a message, with its file where it has one."""
    return f"{item.name} ({item.settings.file})" if isinstance(item.settings, MeshFile) else item.name


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
