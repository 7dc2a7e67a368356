"""Objects of a scene in their places, and refusals of those that are where no sensor can be meant to look."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import trimesh

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.cross_sections import distance_inside
from mvla_sim.scene.shape import SHAPES, Shape
from mvla_sim.scene.shapes.mesh_file import MeshFile
from mvla_sim.scene.views import Views

__all__ = ["SceneObject", "called", "check_outside", "check_reach", "name_of", "place_objects", "span_m", "wholes"]

ON_SURFACE_M: Final = 1e-6
"""A sensor this near to a surface is on it; single precision, in which rays are traced, tells no more apart."""
FARTHEST_M: Final = 10_000.0
"""Single precision tells points apart to 1 mm at this distance from the origin, and to 0.5 m in map coordinates."""
OUT_OF_SIGHT_M: Final = 1000.0
"""A target this far from every sensor is one in other coordinates."""


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


def place_objects(entries: Sequence[Shape], source: str) -> tuple[SceneObject, ...]:
    """Objects in their places, a car as its parts.

    Raises
    ------
    ConfigError
        Two objects, or parts, have one name.
    DataError
        A mesh is unusable, or in coordinates of a map.
    """
    names = [name_of(entry, index) for index, entry in enumerate(entries)]
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
            if abs(mesh.bounds).max() > FARTHEST_M:
                raise DataError(_elsewhere(found[name], source, f"beyond {FARTHEST_M / 1000:g} km from the origin"))
    return tuple(found.values())


def name_of(entry: Shape, index: int) -> str:
    """An object's name: its own, or that of its shape, numbered."""
    return entry.name or f"{SHAPES.name_of(type(entry))}-{index}"


def wholes(objects: Sequence[SceneObject]) -> dict[int, list[SceneObject]]:
    """Parts of each object, by its index."""
    return {index: list(parts) for index, parts in itertools.groupby(objects, key=lambda item: item.index)}


def span_m(parts: Sequence[SceneObject]) -> tuple[float, float]:
    """Height of the lowest and of the highest point, metres."""
    return min(item.mesh.bounds[0, 2] for item in parts), max(item.mesh.bounds[1, 2] for item in parts)


def called(item: SceneObject) -> str:
    """Name of an object for a message, with its file where it has one."""
    file = getattr(item.settings, "file", None)
    return item.name if file is None else f"{item.name} ({file})"


def check_reach(objects: Sequence[SceneObject], views: Views, source: str) -> None:
    """Refuse an object that is a kilometre or more from every sensor: it is in other coordinates than they are.

    Raises
    ------
    DataError
        Where it is, and how to move it.
    """
    places = views.midpoints_m
    for item in objects:
        low, high = item.mesh.bounds
        nearest = float(np.linalg.norm(places - np.clip(places, low, high), axis=1).min())
        if nearest > OUT_OF_SIGHT_M:
            raise DataError(_elsewhere(item, source, f"{nearest / 1000:.4g} km from the nearest sensor"))


def check_outside(item: SceneObject, views: Views, source: str) -> None:
    """Refuse a sensor inside an object or on its surface.

    Raises
    ------
    ConfigError
        Which view that is, and, of a mesh that is large, in which unit it may be.
    """
    low, high = item.mesh.bounds
    pairs = {"view": views.positions_m} if views.receivers_m is None else {
        "transmitter of view": views.positions_m, "receiver of view": views.receivers_m
    }  # fmt: skip
    for role, positions in pairs.items():
        within = ((positions >= low - ON_SURFACE_M) & (positions <= high + ON_SURFACE_M)).all(axis=1)
        for height in np.unique(positions[within, 2]):
            level = np.flatnonzero(within & (positions[:, 2] == height))
            hit = level[distance_inside(item.mesh, float(height), positions[level, :2]) <= ON_SURFACE_M]
            if len(hit):
                x, y, z = positions[hit[0]]
                raise ConfigError(
                    f"{source}: trajectory: {role} {hit[0]} at ({x:.4g}, {y:.4g}, {z:.4g}) m is inside '{item.name}' "
                    f"or on its surface; move the sensor or the object{unit_hint(item)}"
                )


def unit_hint(item: SceneObject) -> str:
    """In which unit the file of a large mesh may be, to stand behind a message; empty where there is nothing to say."""
    if not isinstance(item.settings, MeshFile):
        return ""
    hint = item.settings.likely_units(float(item.mesh.extents.max()))
    return f"; it is {item.mesh.extents.max():.4g} m long: {hint}" if hint else ""


def _elsewhere(item: SceneObject, source: str, where: str) -> str:
    middle = item.mesh.bounds.mean(axis=0)
    moved = ", ".join(f"{float(value):.10g}" for value in np.round(item.settings.position_m - middle, 3) + 0.0)
    place = ", ".join(f"{float(value):.10g}" for value in np.round(middle, 3))
    return (
        f"{source}: {called(item)}: its middle is at ({place}) m, {where}: coordinates of a map? "
        f"objects[{item.index}].position_m = [{moved}] moves its middle to the origin"
    )
