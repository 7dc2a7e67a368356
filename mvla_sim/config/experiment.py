"""Settings of an experiment file: scenes, stage settings, and the axes that are swept."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from mvla_sim.config.base import Settings, apply_overrides, parse, read_toml, resolve_beside
from mvla_sim.config.imaging import EvaluationSettings, ImagingSettings

__all__ = ["AxisValue", "ExperimentSettings", "load_experiment"]

AxisValue = bool | int | float | str


class ExperimentSettings(Settings):
    """One experiment file.

    An axis is a short name (``snr_db``, ``interval_deg``, ``offset``, ``seed``, ``method``, ``kappa``, ``eta``, …) or a
    dotted key that begins with ``imaging.``, ``evaluation.`` or ``scene.``; cases are the product of all axes.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]*$")]
    description: str = ""
    scenes: Annotated[tuple[str, ...], Field(min_length=1)]
    imaging: ImagingSettings = ImagingSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    axes: dict[str, Annotated[tuple[AxisValue, ...], Field(min_length=1)]] = Field(default_factory=dict)
    show: tuple[dict[str, AxisValue], ...] = Field((), description="cases of which pictures are drawn, by axis value")


def load_experiment(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> ExperimentSettings:
    """Read an experiment file; scene files are relative to it.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    data: dict[str, Any] = apply_overrides(read_toml(path, "experiment file"), overrides)
    if isinstance(data.get("scenes"), list):
        folder = Path(path).parent
        data["scenes"] = [resolve_beside(s, folder) if isinstance(s, str) else s for s in data["scenes"]]
    return parse(ExperimentSettings, data, str(path))
