"""Figure and table of the ablation."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output
from mvla_sim.imaging.method import title_of
from mvla_sim.paper.averages import finite
from mvla_sim.plot.style import COLORS, DOUBLE_COLUMN_IN, Given, figure_legend, figure_style, new_figure, save_figure
from mvla_sim.sweep.plan import Plan

__all__ = ["BESIDE", "LADDER", "ablation_table", "draw_ablation", "markdown", "plot_ablation"]

LADDER: Final = ("hard-vote", "soft-kernel", "power-weights", "mvla-gr")
BESIDE: Final = ("bp", "bp-peaks", "bp-normalised", "bp-gated")


def ablation_table(table: pd.DataFrame) -> pd.DataFrame:
    """Mean CD of each method and scene, dB(m²): over intervals, SNRs and seeds alike.

    The table is that of the experiment ``ablation``, with ``scene``, ``method`` and ``cd_db``. Returned are a row a
    method, in the order of the ladder, a column a scene, and ``mean``. Raises DataError without a finished case.
    """
    done = _finished(table)
    means = done.pivot_table(index="method", columns="scene", values="cd_db", aggfunc="mean", sort=False)
    order = [name for name in (*LADDER, *BESIDE) if name in means.index]
    means = means.loc[[*order, *(name for name in means.index if name not in order)]]
    return means.assign(mean=means.mean(axis=1))


def plot_ablation(table: pd.DataFrame, *, figure: Given | None = None) -> Figure | Given:
    """Draw CD against the angular interval, a panel a scene, a line a method; means over SNRs and seeds.

    Parameters and errors as :func:`ablation_table`; the table has ``interval_deg`` too.
    """
    done = _finished(table, ("scene", "method", "interval_deg", "cd_db"))
    scenes = list(dict.fromkeys(done["scene"]))
    names = [name for name in (*LADDER, *BESIDE) if name in set(done["method"])]
    colors = [COLORS[key] for key in ("grey", "sky", "green", "blue", "vermilion", "orange", "purple", "black")]
    with figure_style():
        canvas = figure or new_figure(DOUBLE_COLUMN_IN, 0.42 * DOUBLE_COLUMN_IN)
        axes = np.atleast_1d(canvas.subplots(1, len(scenes), sharey=True))
        for axis, scene in zip(axes, scenes, strict=True):
            part = done[done["scene"] == scene].groupby(["method", "interval_deg"])["cd_db"].mean()
            for name in (one for one in names if one in part.index.get_level_values("method")):
                place = (*LADDER, *BESIDE).index(name)
                line = part[name]
                style = "-" if name in LADDER else "--"
                look = {"marker": "o", "ms": 3, "color": colors[place], "label": title_of(name)}
                axis.plot(line.index, line.to_numpy(), style, **look)
            axis.set_title(scene)
            axis.set_xlabel("Δθ (°)")
        axes[0].set_ylabel("CD (dB m²)")
        figure_legend(canvas, axes[0].get_legend_handles_labels()[0], columns=4)
    return canvas


def markdown(table: pd.DataFrame, digits: int = 1) -> str:
    """A table as Markdown; methods by their titles."""
    head = ["method", *map(str, table.columns)]
    lines = ["| " + " | ".join(head) + " |", "|---|" + "--:|" * len(table.columns)]
    for name, row in table.iterrows():
        cells = [f"{v:.{digits}f}" if isinstance(v, float | np.floating) else str(v) for v in row]
        lines.append(f"| {title_of(str(name))} | " + " | ".join(cells).replace("-", "\N{MINUS SIGN}") + " |")
    return "\n".join(lines) + "\n"


def draw_ablation(plan: Plan, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw the ladder and write its table, where an experiment is of its rungs and of nothing that is not drawn."""
    methods = set(plan.experiment.axes.get("method", ()))
    if not set(LADDER) <= methods <= {*LADDER, *BESIDE} or "interval_deg" not in plan.experiment.axes:
        return []
    with contextlib.suppress(DataError):  # no case is finished
        files = [folder / "ablation.md", folder / "ablation.png", folder / "ablation.pdf"]
        with atomic_output(files[0]) as temporary:
            temporary.write_text(markdown(ablation_table(table)), encoding="utf-8")
        for file in files[1:]:
            save_figure(plot_ablation(table), file)
        return files
    return []


def _finished(table: pd.DataFrame, needed: Sequence[str] = ("scene", "method", "cd_db")) -> pd.DataFrame:
    missing = [name for name in needed if name not in table.columns]
    if missing:
        raise DataError(f"ablation: the table lacks the column {missing[0]}")
    done = finite(table[table["status"] == "done"])
    if done.empty:
        raise DataError("ablation: no case is finished")
    return done
