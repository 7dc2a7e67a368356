"""Every setting with its default and meaning, read from the classes themselves: ``mvla settings``."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from mvla_sim.channel.importing import ImportSettings
from mvla_sim.channel.synthesis import SynthesisSettings
from mvla_sim.dataset.campaign import CampaignSettings
from mvla_sim.distributions import Drawn
from mvla_sim.errors import ConfigError, check_argument
from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.method import METHODS
from mvla_sim.imaging.methods.functions import names_a_file
from mvla_sim.imaging.reading import BLOCKS, load_reading
from mvla_sim.kinds import Kinds
from mvla_sim.measured.process import ProcessSettings
from mvla_sim.scene.world import SceneSettings
from mvla_sim.settings import parse
from mvla_sim.sweep.experiment import ExperimentSettings

__all__ = ["Setting", "list_settings"]

GROUPS: Final[dict[str, type[BaseModel]]] = {
    "scene": SceneSettings,
    "imaging": ImagingSettings,
    "evaluation": EvaluationSettings,
    "import": ImportSettings,
    "synthesis": SynthesisSettings,
    "experiment": ExperimentSettings,
    "process": ProcessSettings,
    "campaign": CampaignSettings,
}
"""What files, and ``--set``, can set: a scene, what makes an image of a channel, and so on."""


class Setting(NamedTuple):
    """One setting.

    Attributes
    ----------
    group
        What it is a setting of: ``scene``, ``imaging``, …
    key
        Dotted key as for ``--set``; ``0`` stands for any element of a list.
    default
        As in TOML; empty where there is none, so that it must be given.
    meaning
        In words; of what not all kinds have, which have it.
    """

    group: str
    key: str
    default: str
    meaning: str


def list_settings(*words: str, reading: str | None = None) -> list[Setting]:
    """Return settings: all, or those that every word selects.

    Parameters
    ----------
    *words
        Each a group (``scene``), a part of a key, as ``peaks`` or ``snr``, or a method of a file, ``file.py:function``.
    reading
        Show the values of this reading of the paper in place of the defaults, and only what a reading may set.

    Raises
    ------
    ConfigError
        There is no such setting, or method; or the reading has one that is not allowed.
    DataError
        There is no such reading.
    """
    found = [Setting(group, *row) for group, model in GROUPS.items() for row in _rows(model, "", (model,))]
    if reading is not None:
        found = _under(reading, found)
    for word in words:
        check_argument("words", word, str, "a group or a part of a key")
        if names_a_file(word):
            method = METHODS.find(word)
            found = [Setting("imaging", *row) for row in _rows(method, f"{method.block_name()}.", (method,))]
            continue
        found = [entry for entry in found if (entry.group == word if word in GROUPS else word in entry.key)]
        if not found:
            raise ConfigError(f"no setting has {' and '.join(map(repr, words))}; {_hint(word)}")
    return found


def _under(reading: str, settings: list[Setting]) -> list[Setting]:
    """The settings that a reading may set, with its values; where it changes one, the default is in the meaning."""
    tables = load_reading(reading)
    for group in BLOCKS:
        parse(GROUPS[group], tables.get(group, {}), f"reading '{reading}': {group}")
    given = {(group, key): value for group, table in tables.items() for key, value in _values(table, "")}
    shown = []
    for entry in settings:
        if entry.group in BLOCKS:
            value = given.get((entry.group, entry.key))
            default = _toml(value) if value is not None else entry.default
            changed = default != entry.default
            note = f"{entry.meaning}; default {entry.default}" if changed else entry.meaning
            shown.append(entry._replace(default=default, meaning=note))
    return shown


def _values(table: dict[str, Any], path: str) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _values(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value


def _hint(word: str) -> str:
    known = sorted({*GROUPS, *(part for entry in list_settings() for part in entry.key.split(".") if part != "0")})
    close = difflib.get_close_matches(word, known, n=1)
    return f"did you mean '{close[0]}'?" if close else f"groups are {', '.join(GROUPS)}"


Row = tuple[str, str, str]
"""Key, default and meaning."""


def _rows(model: type[BaseModel], path: str, above: tuple[type[BaseModel], ...]) -> Iterator[Row]:
    """Settings of a class, and of all inside it; those of another group are named, not repeated."""
    for name, field in model.model_fields.items():
        key = f"{path}{field.alias or name}"
        shape = _shape(field.annotation, tuple(field.metadata))
        group = next((group for group, root in GROUPS.items() if root in shape.models), None)
        meaning = "; ".join(part for part in (field.description, *shape.notes) if part)
        if group is not None:
            yield key, _text(field), f"settings of {group}" + (f": {meaning}" if meaning else "")
            continue
        inner = [item for item in shape.models if item not in above]
        if shape.values or field.is_required() or field.default is None or not inner:
            yield key, _text(field), meaning
        inside = f"{key}.0." if shape.listed else f"{key}."
        if len(inner) == 1 and shape.tag is None:
            yield from _rows(inner[0], inside, (*above, inner[0]))
        elif inner:
            yield from _kinds(inner, shape.tag, field, inside, above)
    for name, block in getattr(model, "extra_models", dict)().items():
        yield from _rows(block, f"{path}{name}.", (*above, block))


def _kinds(
    models: list[type[BaseModel]], tag: str | None, field: FieldInfo, path: str, above: tuple[type[BaseModel], ...]
) -> Iterator[Row]:
    """Settings of all kinds that a field may be of; where not all have one, its meaning begins with those that do."""
    tag = tag or next((name for name in models[0].model_fields if all(_name(m, name) for m in models)), None)
    names = {model: _name(model, tag) or model.__name__ for model in models}
    if tag is not None:
        default = f'"{_name(type(field.default), tag)}"' if isinstance(field.default, BaseModel) else ""
        yield f"{path}{tag}", default, " | ".join(names.values())
    having: dict[Row, list[str]] = {}
    for model in models:
        for row in _rows(model, path, (*above, model)):
            if row[0] != f"{path}{tag}":
                having.setdefault(row, []).append(names[model])
    for (key, default, meaning), owners in having.items():
        whose = "" if len(owners) == len(models) else ", ".join(owners)
        yield key, default, ": ".join(part for part in (whose, meaning) if part)


class _Shape(NamedTuple):
    """What an annotation allows: settings of these classes, plain values, a list of them, and what to say of it."""

    models: tuple[type[BaseModel], ...] = ()
    tag: str | None = None
    values: bool = False
    listed: bool = False
    notes: tuple[str, ...] = ()


def _shape(annotation: Any, metadata: tuple[Any, ...] = ()) -> _Shape:
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    kinds = next((item for item in metadata if isinstance(item, Kinds)), None)
    if kinds is not None:
        found = _Shape(kinds.installed(), kinds.key, values=kinds.short)
    elif any(isinstance(item, Drawn) for item in metadata):
        found = _Shape(values=True, notes=(*_shape(annotation).notes, "or a distribution"))
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        found = _Shape((annotation,))
    elif origin is typing.Annotated:
        found = _shape(inner[0], inner[1:])
    elif origin is typing.Literal:
        found = _Shape(values=True, notes=(" | ".join(map(str, inner)),))
    elif origin is tuple and inner[-1:] == (Ellipsis,):
        found = _shape(inner[0])._replace(listed=True)
    elif origin is typing.Union or origin is types.UnionType:
        parts = [_shape(part) for part in inner if part is not type(None)]
        found = _Shape(
            tuple(model for part in parts for model in part.models),
            next((part.tag for part in parts if part.tag), None),
            any(part.values for part in parts),
            any(part.listed for part in parts),
            tuple(note for part in parts for note in part.notes),
        )
    else:
        found = _Shape(values=True)
    return found


def _name(model: type[BaseModel], tag: str | None) -> str:
    """The one value that a field of this name may have; empty where it may have others, or there is none."""
    field = model.model_fields.get(tag or "")
    choices = typing.get_args(field.annotation) if field is not None else ()
    literal = field is not None and typing.get_origin(field.annotation) is typing.Literal
    return str(choices[0]) if literal and len(choices) == 1 else ""


def _text(field: FieldInfo) -> str:
    """A default as TOML has it; empty where there is none."""
    default = field.get_default(call_default_factory=True)
    return "" if default is PydanticUndefined else _toml(default)


def _toml(value: Any) -> str:
    if value is None:
        return '"none"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, BaseModel):
        shown = value.model_dump(exclude_defaults=True)
        tags = {name: tag for name in type(value).model_fields if (tag := _name(type(value), name))}
        return _toml(tags | shown)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else str(value)
