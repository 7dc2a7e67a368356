"""One case of a sweep: its complete settings, what identifies it, and the columns it has in a table."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.method import METHODS
from mvla_sim.scene.world import SceneSettings
from mvla_sim.sweep.experiment import AxisValue

__all__ = ["MAP", "ROW_SCHEMA", "Case", "Row", "case_key", "flatten", "setting_columns"]

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


def case_key(channel: str, imaging: ImagingSettings, evaluation: EvaluationSettings) -> str:
    """SHA-256, in hexadecimal, over everything that decides a case's numbers, as JSON in one form.

    ``channel`` covers the scene and the versions of the packages that trace it.
    """
    data = {
        "schema": ROW_SCHEMA,
        "channel": channel,
        "imaging": imaging.model_dump(mode="json"),
        "evaluation": evaluation.model_dump(mode="json"),
    }
    method = METHODS.find(imaging.method)
    if method not in METHODS.own():  # somebody's method: their code decides as well
        data["method"] = method.digest()
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def setting_columns(case: Case) -> dict[str, Any]:
    """Scene name, axis values, and every setting under its dotted key; nothing where a setting is absent."""
    blocks = {
        "imaging": case.imaging.model_dump(mode="json"),
        "evaluation": case.evaluation.model_dump(mode="json"),
    }
    if case.scene is not None:
        blocks["scene"] = case.scene.model_dump(mode="json", exclude={"name", "description"})
    return dict(case.values) | dict(flatten(blocks))


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
