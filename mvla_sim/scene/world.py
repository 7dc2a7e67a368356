"""The scene: objects, views and the target's outline, checked against each other."""

from __future__ import annotations

import hashlib
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

from mvla_sim.config.scene import MeshFile, ObjectSettings, SceneSettings, load_scene
from mvla_sim.errors import ConfigError
from mvla_sim.scene.meshes import build_mesh, cross_section, section_and_gap
from mvla_sim.scene.shapes import nominal_extent_m
from mvla_sim.scene.trajectory import Views, build_views

__all__ = ["Scene", "SceneObject"]

ON_SURFACE_M: Final = 1e-6
"""A sensor this near to a surface is on it; single precision, in which rays are traced, tells no more apart."""


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object in its place.

    Attributes
    ----------
    name
        Unique in its scene.
    settings
        Its settings: shape, place and radio material.
    mesh
        Its surface in the world, metres.
    """

    name: str
    settings: ObjectSettings
    mesh: trimesh.Trimesh


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
        The objects, at least one.
    views
        Sensor positions T_m.
    outline
        Union of the cross-sections at the imaging plane, coordinates (x, y) in metres: the target's true shape.
    extent_m
        D of the paper, metres: the largest of the extents of the objects that the imaging plane cuts. It is nominal
        for circle, square and triangle, else the largest distance between two points of the cross-section.
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
            Two objects have one name, or a sensor is inside an object or on its surface.
        DataError
            A mesh or positions file is unusable, no object reaches the imaging plane, or one is open there.
        """
        names = _names(settings.objects, source)
        objects = tuple(
            SceneObject(name, entry, build_mesh(entry, f"{source}: objects[{index}]"))
            for index, (name, entry) in enumerate(zip(names, settings.objects, strict=True))
        )
        sections = _sections(objects, settings.plane_height_m, source)
        outline = shapely.union_all([section for _, section in sections])
        extent = max(nominal_extent_m(item.settings) or _widest_m(section) for item, section in sections)
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
        in place of their names: a mesh that is edited changes it; one that is moved or renamed does not, nor does a
        new name or description of the scene or of an object.
        """
        data = self.settings.model_dump(mode="json", exclude={"name", "description", "trajectory"})
        for entry in data["objects"]:
            del entry["name"]
            entry.pop("file", None)
        data["center_m"] = self.views.center_m
        digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode())
        arrays = [self.views.positions_m, self.views.angles_deg]
        for item in self.objects:
            if isinstance(item.settings, MeshFile):
                arrays += [np.asarray(item.mesh.vertices), np.asarray(item.mesh.faces)]
        for array in arrays:
            digest.update(f"{array.shape}".encode())
            if array.dtype.kind == "f":
                digest.update((np.round(array, 9) + 0.0).astype("<f8").tobytes())  # + 0.0 turns -0 into 0
            else:
                digest.update(array.astype("<i8").tobytes())
        return digest.hexdigest()


def _names(objects: Sequence[ObjectSettings], source: str) -> list[str]:
    names = [entry.name or f"{entry.shape}-{index}" for index, entry in enumerate(objects)]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ConfigError(
                f"{source}: objects[{index}].name = '{name}' is also the name of objects[{names.index(name)}]; "
                "names must be unique"
            )
    return names


def _sections(objects: Sequence[SceneObject], height_m: float, source: str) -> list[tuple[SceneObject, BaseGeometry]]:
    """Objects that the imaging plane cuts, each with its cross-section (x, y) in metres."""
    found = [section_and_gap(item.mesh, height_m) for item in objects]
    reached = [item for item, (area, gap) in zip(objects, found, strict=True) if gap is not None or not area.is_empty]
    # One object: its own message says where it is. Several: those above and below the plane are only obstacles.
    if not reached and len(objects) > 1:
        spans = ", ".join(f"{o.name} {o.mesh.bounds[0, 2]:.4g} to {o.mesh.bounds[1, 2]:.4g} m" for o in objects)
        raise ConfigError(f"{source}: plane_height_m = {height_m:g} cuts none of the objects ({spans})")
    return [(item, cross_section(item.mesh, height_m, f"{source}: {_called(item)}")) for item in reached or objects]


def _called(item: SceneObject) -> str:
    """Name of an object for a message, with its file where it has one."""
    return f"{item.name} ({item.settings.file})" if isinstance(item.settings, MeshFile) else item.name


def _widest_m(area: BaseGeometry) -> float:
    """Largest distance between two points of an area, metres; both are corners of its convex hull."""
    corners = shapely.get_coordinates(area.convex_hull)
    return max(float(np.hypot(*(corners - corner).T).max()) for corner in corners)


def _check_outside(item: SceneObject, views: Views, source: str) -> None:
    low, high = item.mesh.bounds
    within = ((views.positions_m >= low - ON_SURFACE_M) & (views.positions_m <= high + ON_SURFACE_M)).all(axis=1)
    for height in np.unique(views.positions_m[within, 2]):
        area, _ = section_and_gap(item.mesh, float(height))
        level = np.flatnonzero(within & (views.positions_m[:, 2] == height))
        hit = level[shapely.distance(area, shapely.points(views.positions_m[level, :2])) <= ON_SURFACE_M]
        if len(hit):
            x, y, z = views.positions_m[hit[0]]
            raise ConfigError(
                f"{source}: trajectory: view {hit[0]} at ({x:.4g}, {y:.4g}, {z:.4g}) m is inside '{item.name}' or on "
                "its surface; move the sensor or the object"
            )
