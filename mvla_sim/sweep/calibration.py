"""Calibrated thresholds: from another experiment's cases, used where the truth is not looked at."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.evaluation.candidates import best_pair, unpack_table
from mvla_sim.files import existing_file
from mvla_sim.imaging.threshold_rules.given import GivenThresholds
from mvla_sim.sweep.axes import dotted_key
from mvla_sim.sweep.experiment import CalibrationSettings
from mvla_sim.sweep.table import MAPS, RECORD, load_maps, load_table

__all__ = ["Calibration", "average_thresholds", "least_mean_thresholds"]

THRESHOLDS = ["top_percent", "min_support_deg"]


def average_thresholds(table: pd.DataFrame, by: Sequence[str], over: Sequence[str]) -> pd.DataFrame:
    """Average optimal thresholds p (per cent) and T_θ (degrees): a row for each combination of the columns ``by``.

    The table has one row a case, with ``top_percent`` and ``min_support_deg``. Of the columns ``over``, all rows of one
    value of the first are averaged first, then these values: so every interval weighs the same, however many offsets it
    has. Columns that the table lacks are passed over.
    """
    first = [name for name in over if name in table.columns][:1]
    if not by:
        parts = table.groupby(first, dropna=False, sort=False)[THRESHOLDS].mean() if first else table[THRESHOLDS]
        return parts.mean().to_frame().T
    inner = table.groupby([*by, *first], dropna=False, sort=False)[THRESHOLDS].mean().reset_index()
    return inner.groupby(list(by), dropna=False, sort=False)[THRESHOLDS].mean().reset_index()


def least_mean_thresholds(
    table: pd.DataFrame, maps: Mapping[str, str], by: Sequence[str], over: Sequence[str]
) -> pd.DataFrame:
    """Find the candidate pairs (p, T_θ) at which the mean CD in dB is least; as :func:`average_thresholds` otherwise.

    An empty reconstruction counts as the grid's diagonal; see :mod:`mvla_sim.evaluation.candidates`. ``maps`` are
    packed tables of CD by the keys of their cases; raises DataError where a case has none, or one that cannot be read.
    """
    first = [name for name in over if name in table.columns][:1]
    rows = []
    groups = table.groupby(list(by), dropna=False, sort=False) if by else [((), table)]
    for place, group in groups:
        parts = [part for _, part in group.groupby(first, dropna=False, sort=False)] if first else [group]
        pair, _ = best_pair(_mean([_mean([_map(key, maps) for key in part["key"]]) for part in parts]))
        rows.append((*place, pair.top_percent, pair.min_support_deg))
    return pd.DataFrame(rows, columns=[*by, *THRESHOLDS])


def _map(key: str, maps: Mapping[str, str]) -> NDArray[np.float64]:
    """The table of a case."""
    if key not in maps:
        raise DataError(
            f"calibration: case {key[:12]} has no map of thresholds; run that experiment again, with "
            f"evaluation.threshold_map = true in its file"
        )
    try:
        return unpack_table(maps[key])
    except DataError as error:
        raise DataError(f"calibration: {MAPS}, case {key[:12]}: {error}; run that experiment afresh") from error


def _mean(tables: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Mean of tables of one shape."""
    if len({table.shape for table in tables}) > 1:
        raise DataError("calibration: methods with and without angular support have no thresholds in common")
    return np.asarray(np.mean(tables, axis=0), np.float64)


@dataclass(frozen=True)
class Calibration:
    """Thresholds by the values of the columns that are kept apart."""

    source: Path  # folder of the experiment they come from
    by: tuple[str, ...]  # the columns
    found: Mapping[tuple[str | None, ...], GivenThresholds]  # the thresholds of each combination of their values

    @classmethod
    def load(cls, settings: CalibrationSettings, folder: Path) -> Calibration:
        """Read the table of the other experiment, which lies beside ``folder``, and choose thresholds by the rule.

        Raises DataError: the table is missing, not complete, or not one of optimal thresholds.
        """
        source = folder.parent / settings.source
        table, axes = load_table(source), _axes(source)
        unfinished = int((table["status"] != "done").sum())
        if unfinished:
            raise DataError(
                f"calibration: {unfinished} of {len(table)} cases of {source} are not done; run that experiment again"
            )
        if set(table.get("protocol", ())) != {"optimal"}:
            raise DataError(f"calibration: the thresholds of {source} were given, not optimised; name another one")
        if settings.scenes is not None:
            there = sorted(set(table["scene"]))
            if missing := sorted(set(settings.scenes) - set(there)):
                raise DataError(
                    f"calibration.scenes: {source} has no scene '{missing[0]}'; allowed: {', '.join(there)}"
                )
            table = table[table["scene"].isin(settings.scenes)]
        table = _chosen(table, settings, axes, source)
        by = tuple(name for name in ("scene", *axes) if name not in settings.over)
        if settings.rule == "least-mean":
            chosen = least_mean_thresholds(table, load_maps(source), by, settings.over)
        else:
            chosen = average_thresholds(table, by, settings.over)
        found = {
            tuple(_normal(record[name]) for name in by): GivenThresholds(
                top_percent=float(record["top_percent"]), min_support_deg=float(record["min_support_deg"])
            )
            for record in chosen.to_dict("records")
        }
        return cls(source, by, found)

    def thresholds(self, columns: Mapping[str, Any]) -> GivenThresholds:
        """Thresholds of a case, by its columns; raises ConfigError where the other experiment has no such case."""
        values = [columns.get(name, columns.get(dotted_key(name) or name)) for name in self.by]
        place = tuple(_normal(value) for value in values)
        if place not in self.found:
            wanted = ", ".join(f"{name} = {value}" for name, value in zip(self.by, values, strict=True))
            raise ConfigError(f"calibration: {self.source} has no case with {wanted}")
        return self.found[place]


def _chosen(table: pd.DataFrame, settings: CalibrationSettings, axes: Sequence[str], source: Path) -> pd.DataFrame:
    """The rows that ``calibration.where`` lets count; raises ConfigError: the other experiment has none such."""
    for name, values in settings.where.items():
        axis = next((axis for axis in axes if dotted_key(axis) == dotted_key(name)), None)
        if axis is None:
            raise ConfigError(f"calibration.where: {source} has no axis '{name}'; allowed: {', '.join(axes)}")
        there = [_normal(value) for value in table[axis].tolist()]
        wanted = {_normal(value): value for value in values}
        if missing := [value for place, value in wanted.items() if place not in there]:
            allowed = ", ".join(map(str, dict.fromkeys(there)))
            raise ConfigError(f"calibration.where: {source} has no case with {name} = {missing[0]}; allowed: {allowed}")
        table = table[[value in wanted for value in there]]
    return table


def _axes(source: Path) -> list[str]:
    """Names of the axes that a finished experiment had."""
    file = existing_file(source / RECORD, "record of an experiment")
    try:
        settings = json.loads(file.read_text(encoding="utf-8"))["settings"]
        axes, others = list(settings["axes"]), settings.get("parts") or settings.get("design")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(f"{file}: not a record of an experiment ({error!r})") from error
    if others:
        raise ConfigError(f"calibration: {source} has parts or a design; calibrate with an experiment of axes alone")
    return axes


def _normal(value: Any) -> str | None:
    """A value as it reads in every table: a number in nine digits, nothing as None."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return None
    return str(value) if isinstance(value, bool | str) else f"{float(value):.9g}"
