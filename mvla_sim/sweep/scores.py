"""Scores of a design's samples: what tells which is better.

A score is a function that takes the table of one sample in one round, a row a case with every setting and metric a
column, and returns named figures. That named ``score`` decides, the lowest is the best; NaN is worse than any number.
It is named

* by a metric of the table: the mean over the sample's finished cases, as far as it is finite;
* by an entry point of the group ``mvla_sim.scores`` of a package that is installed;
* ``file.py:function``, or ``file.py`` where the function is called ``score``.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from numbers import Real
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from mvla_sim.errors import ConfigError, DataError, reason
from mvla_sim.evaluation.evaluate import EvaluationSettings, evaluate
from mvla_sim.grid import GridSettings, VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.kinds import module_of_file
from mvla_sim.scene.shapes.square import Square

__all__ = ["SCORE", "Score", "find_score", "metric_names"]

SCORE: Final = "score"
"""The figure that decides."""
GROUP: Final = "mvla_sim.scores"


@dataclass(frozen=True)
class Score:
    """A score by its name."""

    name: str
    function: Callable[[pd.DataFrame], Mapping[str, Any]]
    of_metric: bool = False
    """Whether metrics are all that it looks at."""

    def figures(self, table: pd.DataFrame, sample: str) -> dict[str, float]:
        """Figures of a sample, ``score`` first.

        Raises
        ------
        DataError
            The function fails, or returns no such figures; one line.
        """
        where = f"design.score = '{self.name}': sample {sample}"
        try:
            found = self.function(table)
        except Exception as error:
            raise DataError(f"{where}: {reason(error)}") from error
        if not isinstance(found, Mapping) or SCORE not in found:
            raise DataError(f"{where}: must return a mapping with '{SCORE}'; it is {type(found).__name__}")
        for name, value in found.items():
            if not isinstance(value, Real | np.number):
                raise DataError(f"{where}: {name} = {value!r} is no number")
        return {SCORE: float(found[SCORE]), **{str(key): float(value) for key, value in found.items() if key != SCORE}}


def find_score(name: str, metrics: Sequence[str]) -> Score:
    """The score of a name, where the table has these metrics.

    Raises
    ------
    ConfigError
        There is none, or its file or package cannot be imported; one line.
    """
    file, _, function = name.rpartition(":")
    if name.endswith(".py") or file.endswith(".py"):
        path = Path(file if file.endswith(".py") else name).expanduser()
        module, _ = module_of_file(path, f"design.score = '{name}'")
        return Score(name, _callable(name, getattr(module, function if file.endswith(".py") else SCORE, None)))
    points = {point.name: point for point in entry_points(group=GROUP)}
    if name in points:
        try:
            return Score(name, _callable(name, points[name].load()))
        except (ImportError, AttributeError) as error:
            raise ConfigError(
                f"design.score = '{name}': {points[name].value} cannot be imported ({reason(error)})"
            ) from error
    if name in metrics:
        return Score(name, lambda table: {SCORE: mean_of(table, name)}, of_metric=True)
    allowed = [*points, *metrics]
    close = difflib.get_close_matches(name, allowed, n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    raise ConfigError(
        f"design.score = '{name}': no metric or score{hint}; allowed: {', '.join(allowed)}, or file.py:function"
    )


def mean_of(table: pd.DataFrame, metric: str) -> float:
    """Mean of a metric over the finished cases of a table, as far as it is finite; NaN where it is nowhere."""
    if metric not in table:
        return float("nan")
    values = table.loc[table["status"] == "done", metric].to_numpy(float)
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else float("nan")


def metric_names(settings: EvaluationSettings) -> tuple[str, ...]:
    """Names of the numbers that a finished case has under such settings, found out with an image of nothing much."""
    grid = VoxelGrid.from_settings(GridSettings(size_m=(2.0, 2.0, 0.0), spacing_m=0.1))
    ramp = np.linspace(0.1, 1.0, grid.size, dtype=np.float32).reshape(grid.shape)
    image = Image(ramp, 360 * ramp, grid, "mvla-gr", 36, outline=Square(side_m=1.0).outline(), resolution_m=0.05)
    row = evaluate(image, settings, with_optimum=settings.threshold is None).as_dict()
    return ("seconds", "views", *(name for name, value in row.items() if isinstance(value, Real | np.number)))


def _callable(name: str, value: Any) -> Callable[[pd.DataFrame], Mapping[str, Any]]:
    if not callable(value):
        raise ConfigError(f"design.score = '{name}': there is no such function")
    function: Callable[[pd.DataFrame], Mapping[str, Any]] = value
    return function
