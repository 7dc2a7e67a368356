"""One case of a sweep: its complete settings, what identifies it, and the columns it has in a table."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from pydantic import BaseModel

from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.method import METHODS
from mvla_sim.scene.world import SceneSettings
from mvla_sim.sweep.axes import AxisValue

__all__ = ["MAP", "ROW_SCHEMA", "Case", "Once", "Row", "as_text", "case_key", "flatten", "setting_columns"]

Made = TypeVar("Made")

ROW_SCHEMA: Final = 3
"""Version of what a stored row holds and of how its numbers are made; rows of another version are not used."""

MAP: Final = "threshold_map"
"""Name among the metrics of the packed Chamfer distances at every candidate pair of thresholds."""

LONGEST_LIST: Final = 3
"""Longer lists (vertices, positions) are no columns."""


@dataclass(frozen=True)
class Case:
    """One point of a sweep, with its complete, validated settings."""

    number: int  # place in the plan, from 0
    scene: SceneSettings | None  # None where the channel is that of a file
    imaging: ImagingSettings
    evaluation: EvaluationSettings
    channel: str  # key of the channel's `Source`; cases of one channel share it
    key: str  # what identifies the case wherever and whenever it is planned; see `case_key`
    values: Mapping[str, AxisValue] = field(default_factory=dict)  # scene name and the axis values of this case


@dataclass(frozen=True)
class Row:
    """What came of a case."""

    key: str  # of the case
    status: Literal["done", "failed"]
    error: str = ""  # why it failed, in one line; empty where it did not
    seconds: float = 0.0  # time it took, with what it had to prepare for itself and the cases after it, seconds
    metrics: Mapping[str, Any] = field(default_factory=dict)  # number of views, thresholds and scores by column


PLAIN: Final = (BaseModel, str, type(None))
"""What is a block of its own, or is in JSON what it is here."""


class Once:
    """What functions make of objects, of each object once: cases by the thousand share their blocks of settings.

    An object is known by itself and not by being equal, for 1, 1.0 and true are equal and read differently.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[Any, ...], tuple[Any, Any]] = {}

    def __call__(self, function: Callable[..., Made], thing: Any, *arguments: str) -> Made:
        """The function's value of an object and texts."""
        place = (function, id(thing), *arguments)
        if place not in self._kept:
            self._kept[place] = (thing, function(thing, *arguments))  # kept alive, so that its id stays its own
        made: Made = self._kept[place][1]
        return made


def as_text(thing: Any) -> str:
    """Settings, or plain data, as JSON in one form."""
    data = thing.model_dump(mode="json") if isinstance(thing, BaseModel) else thing
    return json.dumps(data, sort_keys=True, separators=(",", ":"))


def case_key(channel: str, imaging: ImagingSettings, evaluation: EvaluationSettings, once: Once | None = None) -> str:
    """SHA-256, in hexadecimal, over everything that decides a case's numbers, as JSON in one form.

    ``channel`` covers the scene and the versions of the packages that trace it.
    """
    once = once or Once()
    texts = {name: once(as_text, value) for name, value in _blocks(imaging).items()}
    data = {
        "schema": as_text(ROW_SCHEMA),
        "channel": as_text(channel),
        "imaging": _joined(texts),
        "evaluation": once(as_text, evaluation),
    }
    method = METHODS.find(imaging.method)
    if method not in METHODS.own():  # somebody's method: their code decides as well
        data["method"] = as_text(method.digest())
    return hashlib.sha256(_joined(data).encode()).hexdigest()


def _joined(texts: Mapping[str, str]) -> str:
    """A JSON object of the texts of its values, in the form of :func:`as_text`."""
    return "{" + ",".join([f"{_quoted(name)}:{texts[name]}" for name in sorted(texts)]) + "}"


_quoted = functools.cache(json.dumps)


def _blocks(imaging: ImagingSettings) -> dict[str, Any]:
    """Fields of imaging settings, then the tables of methods; plain data where they are no settings."""
    blocks = imaging.__dict__ | (imaging.__pydantic_extra__ or {})
    plain = [name for name, value in blocks.items() if not isinstance(value, PLAIN)]
    return blocks | (imaging.model_dump(mode="json", include=set(plain)) if plain else {})


def setting_columns(case: Case, once: Once | None = None) -> dict[str, Any]:
    """Scene name, axis values, and every setting under its dotted key; nothing where a setting is absent."""
    once = once or Once()
    columns = dict(case.values)
    for name, value in _blocks(case.imaging).items():
        columns |= once(_flat, value, f"imaging.{name}")
    columns |= once(_flat, case.evaluation, "evaluation")
    return columns if case.scene is None else columns | once(_flat_scene, case.scene)


def _flat(block: Any, path: str) -> dict[str, Any]:
    return dict(flatten(block.model_dump(mode="json") if isinstance(block, BaseModel) else block, path))


def _flat_scene(scene: SceneSettings) -> dict[str, Any]:
    return dict(flatten(scene.model_dump(mode="json", exclude={"name", "description"}), "scene"))


def flatten(data: Any, path: str = "", longest: int = LONGEST_LIST) -> Iterator[tuple[str, Any]]:
    """Single values of nested data by dotted key; a file by its name alone, lists longer than ``longest`` left out."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from flatten(value, f"{path}.{key}" if path else str(key), longest)
    elif isinstance(data, list):
        if len(data) <= longest or any(isinstance(item, dict) for item in data):
            for index, item in enumerate(data):
                yield from flatten(item, f"{path}.{index}", longest)
    else:
        yield path, Path(data).name if path.endswith(".file") and isinstance(data, str) else data
