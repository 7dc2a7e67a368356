"""The target's true shape: where the imaging plane cuts it, or all that is seen from above."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import shapely
import trimesh
from shapely.geometry.base import BaseGeometry

from mvla_sim.errors import ConfigError, DataError, MvlaWarning
from mvla_sim.scene.cross_sections import NUDGE, cross_section, footprint, section_and_gap
from mvla_sim.scene.placing import SceneObject, called, name_of, span_m, unit_hint, wholes
from mvla_sim.scene.shape import Prism

if TYPE_CHECKING:
    from mvla_sim.scene.world import SceneSettings

__all__ = ["target_areas"]

LEAST_SHARE: Final = 0.25
"""A section below this share of the widest one is a foot, or a tip, and no outline of the object."""
TRIED: Final = 7
"""Heights at which the widest section is looked for."""
TOUCH: Final = 8 * NUDGE
"""How far, as a share of a mesh's size, a plane may be from its end to touch it: a section is moved by no more."""


def target_areas(objects: Sequence[SceneObject], settings: SceneSettings, source: str) -> dict[int, BaseGeometry]:
    """Area (x, y) in metres of each object of the target, by its index among the settings' objects.

    Raises
    ------
    ConfigError
        There is no target; or an object of it does not reach the imaging plane, or the plane cuts no more than its feet
        where it was not chosen for that.
    DataError
        A mesh is open at the plane, does not reach it, or has no face that is seen from above.
    """
    targets = {index: parts for index, parts in wholes(objects).items() if not parts[0].settings.obstacle}
    if not targets:
        raise ConfigError(f"{source}: objects: each is an obstacle; at least one must be the target (obstacle = false)")
    if settings.outline == "footprint":
        return _footprints(targets, settings.plane_height_m, source)
    return _sections(targets, settings, source)


def _footprints(targets: dict[int, list[SceneObject]], height: float, source: str) -> dict[int, BaseGeometry]:
    areas = {
        index: footprint(trimesh.util.concatenate([item.mesh for item in parts])) for index, parts in targets.items()
    }
    areas = {index: area for index, area in areas.items() if not area.is_empty}
    if not areas:
        raise DataError(f"{source}: outline = 'footprint': no object has a face that is seen from above")
    if all(_touches(parts, height) or not _reaches(parts, height) for parts in targets.values()):
        warnings.warn(
            f"{source}: the imaging plane z = {height:g} m cuts none of the objects ({_spans(targets)}); their "
            "footprint is compared with an image at that height; set plane_height_m",
            MvlaWarning,
            stacklevel=5,
        )
    return areas


def _sections(targets: dict[int, list[SceneObject]], settings: SceneSettings, source: str) -> dict[int, BaseGeometry]:
    height = settings.plane_height_m
    reached: dict[int, list[SceneObject]] = {}
    for index, parts in targets.items():
        found = [(item, *section_and_gap(item.mesh, height)) for item in parts]
        reached[index] = [item for item, area, gap in found if gap is not None or not area.is_empty]
    missed = {index: parts for index, parts in targets.items() if not reached[index]}
    if len(missed) == len(targets) == 1:
        (parts,) = targets.values()
        if len(parts) == 1:  # its own message says where it is
            cross_section(parts[0].mesh, height, f"{source}: {called(parts[0])}", unit_hint(parts[0]))
    if len(missed) == len(targets):
        raise ConfigError(f"{source}: plane_height_m = {height:g} cuts none of the objects ({_spans(targets)})")
    if missed:
        raise ConfigError(
            f"{source}: plane_height_m = {height:g} does not cut {_spans(missed)}, which would be traced and be no "
            f"part of the ground truth; {_common(targets)}move it with position_m, set outline = 'footprint', or "
            f"objects[{next(iter(missed))}].obstacle = true for what is no target"
        )
    areas = {}
    for index, parts in reached.items():
        sections = [cross_section(item.mesh, height, f"{source}: {called(item)}", unit_hint(item)) for item in parts]
        areas[index] = shapely.union_all(sections)
        if not isinstance(parts[0].settings, Prism):
            _check_share(targets[index], areas[index], settings, source)
    return areas


def _check_share(parts: list[SceneObject], area: BaseGeometry, settings: SceneSettings, source: str) -> None:
    """Refuse feet as an outline, where the plane was not set or only touches the object."""
    height, chosen = settings.plane_height_m, "plane_height_m" in settings.model_fields_set
    if chosen and not _touches(parts, height):
        return
    heights = np.linspace(*span_m(parts), TRIED + 2)[1:-1]
    areas = [shapely.union_all([section_and_gap(item.mesh, z)[0] for item in parts]).area for z in heights.tolist()]
    widest = int(np.argmax(areas))
    if area.area < LEAST_SHARE * areas[widest]:
        raise ConfigError(
            f"{source}: plane_height_m = {height:g}{'' if chosen else ' (the default)'} cuts {area.area:.3g} m² of "
            f"{_span(parts)}, whose section at {heights[widest]:.3g} m has {areas[widest]:.3g} m²; set "
            f"plane_height_m = {heights[widest]:.3g} and the sensor at that height, or "
            f"outline = 'footprint'{unit_hint(parts[0])}"
        )


def _touches(parts: list[SceneObject], height: float) -> bool:
    size = float(np.linalg.norm(np.ptp([corner for item in parts for corner in item.mesh.bounds], axis=0)))
    return min(abs(height - end) for end in span_m(parts)) <= TOUCH * size


def _reaches(parts: list[SceneObject], height: float) -> bool:
    low, high = span_m(parts)
    return low <= height <= high


def _span(parts: list[SceneObject]) -> str:
    """Name of a whole object, and its lowest and highest point."""
    first, (low, high) = parts[0], span_m(parts)
    name = first.name if len(parts) == 1 else name_of(first.settings, first.index)
    return f"{name} ({low:.4g} to {high:.4g} m)"


def _spans(targets: dict[int, list[SceneObject]]) -> str:
    return ", ".join(_span(parts) for parts in targets.values())


def _common(targets: dict[int, list[SceneObject]]) -> str:
    """A plane that cuts every object, as an advice; empty where none does."""
    low = max(span_m(parts)[0] for parts in targets.values())
    high = min(span_m(parts)[1] for parts in targets.values())
    return f"set plane_height_m = {(low + high) / 2:.3g}, which cuts all, " if low < high else ""
