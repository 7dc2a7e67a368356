"""Methods under several ways to choose their thresholds: a table, a figure, and what not knowing the truth costs."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mvla_sim.errors import DataError
from mvla_sim.imaging.method import title_of
from mvla_sim.paper.averages import finite
from mvla_sim.plot.curves import LINE_COLORS, MARKERS
from mvla_sim.plot.style import DOUBLE_COLUMN_IN, Given, figure_legend, figure_style, new_figure

__all__ = ["EXPLAINED", "WAYS", "automatic_cost", "fair_table", "plot_fair"]

WAYS: Final = {
    "oracle": "fair-thresholds",
    "calibrated": "fair-calibrated",
    "held out: averages": "fair-heldout",
    "held out: least mean": "fair-leastmean",
    "automatic": "fair-auto",
}
"""Experiments by the way in which they choose thresholds."""
EXPLAINED: Final = {
    "oracle": "Oracle: each case's own best thresholds.",
    "calibrated": "Calibrated: averages of the target's own optimal ones, per SNR, as in the paper.",
    "held out: averages": "Held out: from other targets alone, as averages of their optimal ones.",
    "held out: least mean": "Held out, least mean: the one pair with the least mean CD over other targets.",
    "automatic": "Automatic: from each image, without a truth.",
}
"""What each of these ways is."""
AXES: Final = ("interval_deg", "snr_db", "offset", "seed")
NEEDED: Final = ("status", "scene", "method", "interval_deg", "cd_db")


def fair_table(
    tables: Mapping[str, pd.DataFrame], scene: str = "star", least_interval_deg: float = 0.0
) -> pd.DataFrame:
    """Methods under several ways to choose thresholds.

    Parameters
    ----------
    tables
        Rows by the way's name, as in :data:`WAYS`; every one has the columns :data:`NEEDED`. A column ``ap_…cm`` of the
        first is taken as well. Only intervals, SNRs, offsets and seeds that are in all of them count.
    scene, least_interval_deg
        Only this scene, and intervals of at least this, count.

    Returns
    -------
    DataFrame
        A row a method, by the first way's mean CD; a column of mean CD a way, with the method's rank there beside it,
        and the mean area under precision and recall with its rank. A case without a voxel above its thresholds, or
        that is not done, has no CD and is left out of the mean: ``lacking`` counts those of all ways.

    Raises
    ------
    DataError
        No table, one without a column that is needed, or no finished case of the scene that all of them have.
    """
    if not tables:
        raise DataError("fair thresholds: no table")
    for name, table in tables.items():
        if missing := [column for column in NEEDED if column not in table]:
            raise DataError(f"fair thresholds: the table of {name} lacks the column {missing[0]}")
    axes = [axis for axis in AXES if all(axis in table for table in tables.values())]
    asked = {
        name: table[(table["scene"] == scene) & (table["interval_deg"] >= least_interval_deg)].set_index(axes)
        for name, table in tables.items()
    }
    common = functools.reduce(pd.Index.intersection, (table.index.unique() for table in asked.values()))
    columns: dict[str, pd.Series[float]] = {}
    lacking: pd.Series[int] | None = None
    for name, table in asked.items():
        wanted = table[table.index.isin(common)]
        done = finite(wanted[wanted["status"] == "done"])
        if done.empty:
            raise DataError(f"fair thresholds: no finished case of {scene} in {name}")
        columns[name] = done.groupby("method", sort=False)["cd_db"].mean()
        lost = wanted.groupby("method").size().sub(done.groupby("method").size(), fill_value=0)
        lacking = lost if lacking is None else lacking.add(lost, fill_value=0)
        if name == next(iter(tables)):
            for area in [column for column in done.columns if column.startswith("ap_")][:1]:
                columns[area] = done.groupby("method", sort=False)[area].mean()
    found = pd.DataFrame(columns)
    result = pd.DataFrame(index=found.index)
    for column in map(str, found.columns):
        result[column] = found[column]
        ranks = found[column].rank(method="min", ascending=not column.startswith("ap_"))
        result[f"{column} rank"] = ranks.astype("Int64")
    assert lacking is not None
    result["lacking"] = lacking.reindex(result.index).astype("Int64")
    ordered: pd.DataFrame = result.sort_values(next(iter(tables)))
    return ordered


def automatic_cost(optimal: pd.DataFrame, automatic: pd.DataFrame) -> pd.DataFrame:
    """Mean CD under automatic thresholds minus that under optimal ones, dB, by method and scene.

    Both tables have ``scene``, ``method``, ``cd_db`` and what they have of :data:`AXES`; cases that lack a CD in one of
    them are left out. Returned are a row a method, by its mean; a column a scene, and ``mean``, NaN where a scene is
    missing.
    Raises DataError: a column is missing, cases cannot be told apart, or the tables have no finished case in common.
    """
    axes = [name for name in AXES if name in optimal and name in automatic]
    keys = ["scene", "method", *axes]
    sides = []
    for table in (optimal, automatic):
        if lacking := [name for name in (*keys, "cd_db") if name not in table]:
            raise DataError(f"automatic thresholds: a table lacks the column {lacking[0]}")
        done = finite(table[table["status"] == "done"])
        if done.duplicated(keys).any():
            raise DataError(f"automatic thresholds: a table has several cases of one {', '.join(keys)}")
        sides.append(done.set_index(keys)["cd_db"].astype(float))
    cost = (sides[1] - sides[0]).dropna()
    if cost.empty:
        raise DataError("automatic thresholds: the tables have no finished case in common")
    means = cost.groupby(["method", "scene"], sort=False).mean().unstack("scene")
    return means.assign(mean=means.mean(axis=1, skipna=False)).sort_values("mean")


def plot_fair(table: pd.DataFrame, *, figure: Given | None = None) -> Figure | Given:
    """Draw :func:`fair_table`: a line a method, a marker a way at its mean CD; beside it the area without any."""
    ways = [name for name in WAYS if name in table]
    areas = [name for name in map(str, table) if name.startswith("ap_") and not name.endswith("rank")]
    place = np.arange(len(table))[::-1]
    with figure_style():
        canvas = figure or new_figure(DOUBLE_COLUMN_IN, 1.0 + 0.22 * len(table))
        panels = canvas.subplots(1, 1 + len(areas), sharey=True, squeeze=False, width_ratios=[3] + [1] * len(areas))[0]
        ends = table[ways].astype(float).agg(["min", "max"], axis=1)
        panels[0].hlines(place, ends["min"], ends["max"], color="0.8", lw=1.2, zorder=1)
        for number, way in enumerate(ways):
            panels[0].plot(
                table[way].astype(float), place, ls="", marker=MARKERS[number], color=LINE_COLORS[number], ms=4.5,
                label=way, zorder=2,
            )  # fmt: skip
        panels[0].set_yticks(place, [title_of(str(name)) for name in table.index])
        panels[0].set_xlabel("mean CD (dB(m²)); better to the left")
        for panel, area in zip(panels[1:], areas, strict=True):
            panel.barh(place, table[area].astype(float), color="0.6", height=0.6)
            panel.set_xlabel(f"area under precision\nand recall at {area.removeprefix('ap_').replace('cm', ' cm')}")
        for panel in panels:
            panel.set_axisbelow(True)
            panel.grid(visible=True, axis="x")
        keys = panels[0].get_legend_handles_labels()[0]
        figure_legend(canvas, keys, "upper")
    return canvas
