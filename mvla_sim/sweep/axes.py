"""What may be swept: the names that settings go by, and the lists of values that an experiment gives them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BeforeValidator, Field

from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import SHORT_NAMES, ImagingSettings
from mvla_sim.scene.world import SceneSettings
from mvla_sim.settings import Settings

__all__ = ["ALL", "BLOCKS", "OFFSET", "Axes", "AxisValue", "Name", "PartSettings", "check_keys", "dotted_key", "shared"]

AxisValue = bool | int | float | str | None
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]*$")]

ALL: Final = "all"
"""The value of the axis ``offset`` that stands for every offset of a case's interval."""

BLOCKS: Final[Mapping[str, type[Settings]]] = {
    "imaging": ImagingSettings,
    "evaluation": EvaluationSettings,
    "scene": SceneSettings,
}
"""Whose settings may be swept, by the first part of a dotted key."""

OFFSET: Final = f"imaging.{SHORT_NAMES['offset']}"
"""The full dotted key of ``offset``."""


def dotted_key(axis: str) -> str | None:
    """Full dotted key of the setting that an axis names; None where it has the form of none.

    ``kappa``, ``mvla.kappa`` and ``imaging.mvla.kappa`` are one.
    """
    if axis in SHORT_NAMES:
        return f"imaging.{SHORT_NAMES[axis]}"
    block, _, rest = axis.partition(".")
    if block in BLOCKS:
        return axis if rest else None
    if axis in ("plane_height_m", "outline"):
        return f"scene.{axis}"
    return next((f"{owner}.{axis}" for owner, model in BLOCKS.items() if rest and block in model.model_fields), None)


def shared(keys: Iterable[str], others: Iterable[str]) -> str | None:
    """A name of ``keys`` whose setting one of ``others`` names too, or is inside of or around; None for none."""
    taken = [dotted_key(other) or other for other in others]
    for name in keys:
        key = dotted_key(name) or name
        if any(key == other or key.startswith(f"{other}.") or other.startswith(f"{key}.") for other in taken):
            return name
    return None


def check_keys(names: Iterable[str]) -> None:
    """Refuse names that have the form of no setting, and two for the same one."""
    known: dict[str, str] = {}
    for name in names:
        key = dotted_key(name)
        if key is None:
            raise ValueError(
                f"'{name}' names no setting; allowed: {', '.join(sorted(SHORT_NAMES))}, or a dotted key that "
                f"begins with imaging., evaluation. or scene."
            )
        if key in known:
            raise ValueError(f"'{name}' and '{known[key]}' name the same setting")
        known[key] = name


def _listed(axes: Any) -> Any:
    """Lists of values as tuples, ``offset = "all"`` as the one of its own that it is."""
    if not isinstance(axes, dict):
        return axes
    listed = {name: tuple(value) if isinstance(value, list) else value for name, value in axes.items()}
    return {name: (ALL,) if value == ALL and dotted_key(name) == OFFSET else value for name, value in listed.items()}


def _checked(axes: dict[str, tuple[AxisValue, ...]]) -> dict[str, tuple[AxisValue, ...]]:
    check_keys(axes)
    for axis, values in axes.items():
        if not values:
            raise ValueError(f"'{axis}' is empty; give at least one value")
        seen: set[tuple[bool, AxisValue]] = set()
        for value in values:
            if (isinstance(value, bool), value) in seen:  # 1 and 1.0 are one value, 1 and true are not
                raise ValueError(f"'{axis}' has {value!r} twice")
            seen.add((isinstance(value, bool), value))
        if dotted_key(axis) == OFFSET and ALL in values and len(values) > 1:
            raise ValueError(f"'{axis}' has '{ALL}' and other values; give one or the other")
    return axes


Axes = Annotated[dict[str, tuple[AxisValue, ...]], BeforeValidator(_listed), AfterValidator(_checked)]
"""Lists of values by dotted key or short name."""


class PartSettings(Settings):
    """One part of an experiment: scenes and axes of its own. The experiment's cases are those of all parts."""

    name: Name | None = Field(None, description="in the table's column part; by default its number, from 1")
    scenes: Annotated[tuple[str, ...], Field(min_length=1)] | None = Field(
        None, description="scene files; by default the experiment's scenes and channels"
    )
    axes: Axes = Field(default_factory=dict, description="beside those of the experiment, which every part has")
