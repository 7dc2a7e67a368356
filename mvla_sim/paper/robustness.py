"""Figures of robustness: CD and F1 against the strength of each impairment, a line a method."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.imaging.method import title_of
from mvla_sim.paper.averages import finite
from mvla_sim.plot.curves import DASHES, LINE_COLORS, MARKERS
from mvla_sim.plot.style import DOUBLE_COLUMN_IN, Given, figure_legend, figure_style, new_figure, save_figure
from mvla_sim.sweep.plan import Plan

__all__ = ["SWEPT", "draw_robustness", "plot_robustness", "robustness_curves"]

BLOCK: Final = "imaging.impairments."
COLUMNS: Final = 4
"""Panels beside each other at most."""


@dataclass(frozen=True)
class _Kind:
    """How an impairment is drawn: its axis' label, what its strength is multiplied by, and whether that is log."""

    label: str
    scale: float = 1.0
    log: bool = False


SWEPT: Final = {
    "position_error_m": _Kind("position error (mm)", 1e3, log=True),
    "timing_offset_s": _Kind("timing offset (ns)", 1e9),
    "timing_jitter_s": _Kind("timing jitter (ns)", 1e9),
    "random_phase": _Kind("random phase a view"),
    "missing_share": _Kind("missing views (%)", 100.0),
    "blocked_sector_deg": _Kind("blocked sector (°)"),
    "clutter_paths": _Kind("false echoes a view"),
}
"""Impairments by name, in the order of their panels."""


def plot_robustness(
    table: pd.DataFrame,
    *,
    scene: str | None = None,
    f1: str = "f1_10cm",
    f1_label: str = "F1 at 10 cm",
    title: str = "",
    figure: Given | None = None,
) -> Figure | Given:
    """Draw CD above F1 for each impairment of a table, a column of two panels each, a line a method.

    Lines are means, bands the range over the seeds. Dotted lines in a panel with a logarithmic axis are the means
    without any impairment, which have no place on it.

    Parameters and errors as :func:`robustness_curves`; ``f1_label`` is the name of the column of F1 in the figure.
    """
    curves = robustness_curves(table, scene=scene, f1=f1)
    names = [name for name in SWEPT if name in set(curves["impairment"])]
    methods = list(dict.fromkeys(curves["method"]))
    blocks = -(-len(names) // COLUMNS)
    columns = -(-len(names) // blocks)
    measures = {"cd_db": "CD (dB(m²))", "f1": f1_label}
    limits = {measure: _limits(curves, measure) for measure in measures}
    with figure_style():
        canvas = figure or new_figure(DOUBLE_COLUMN_IN * max(2, columns) / COLUMNS, 0.5 + 2.7 * blocks)
        panels = canvas.subplots(2 * blocks, columns, squeeze=False)
        for place, name in enumerate(names):
            block, column = divmod(place, columns)
            part = curves[curves["impairment"] == name]
            for row, (measure, label) in enumerate(measures.items()):
                axes = panels[2 * block + row, column]
                _draw(axes, part, name, measure, methods)
                axes.set_ylim(*limits[measure])
                axes.tick_params(labelbottom=row == 1, labelleft=column == 0)
                if column == 0:
                    axes.set_ylabel(label)
            panels[2 * block + 1, column].set_xlabel(SWEPT[name].label)
        for place in range(len(names), blocks * columns):
            for row in (0, 1):
                panels[2 * (place // columns) + row, place % columns].set_axis_off()
        keys = [Line2D([], [], label=title_of(method), **_look(number)) for number, method in enumerate(methods)]
        figure_legend(canvas, keys)
        canvas.align_ylabels(panels[:, 0])
        if title:
            canvas.suptitle(title)
    return canvas


def draw_robustness(plan: Plan, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw CD and F1 against each impairment, a figure a scene, where impairments are swept."""
    swept = [*plan.swept, *(key for variant in plan.experiment.variants for key in variant.set)]
    if not any(key.startswith(BLOCK) for key in swept):
        return []
    centimetres = f"{100 * max(plan.experiment.evaluation.distances_m):g}"
    pictures: list[Path] = []
    for scene in plan.names:
        with contextlib.suppress(DataError):  # no case of it is finished
            figure = plot_robustness(
                table, scene=scene, f1=f"f1_{centimetres}cm", f1_label=f"F1 at {centimetres} cm", title=scene
            )
            for suffix in (".png", ".pdf"):
                pictures.append(folder / f"{scene}-robustness{suffix}")
                save_figure(figure, pictures[-1])
    return pictures


def robustness_curves(table: pd.DataFrame, *, scene: str | None = None, f1: str = "f1_10cm") -> pd.DataFrame:
    """Mean and range of CD and F1 for each impairment, method and strength, where nothing else is impaired.

    Parameters
    ----------
    table
        Columns ``method`` or ``imaging.method``, ``cd_db`` (dB(m²)), that of F1, which ``f1`` names, and the settings
        ``imaging.impairments.…``; an absent or empty one is at its default. Cases that are not done, or have no finite
        CD, are left out. Averaged over anything else, as over seeds.
    scene
        Which scene; needed where the table has several.

    Returns
    -------
    DataFrame
        ``impairment``, ``method``, ``strength`` (in the setting's unit; a sector's width in degrees; 0 or 1 for the
        phase), ``cd_db``, ``cd_db_low``, ``cd_db_high``, ``f1``, ``f1_low``, ``f1_high``. The strength 0 is of
        cases without any impairment.

    Raises
    ------
    DataError
        A column is missing, the scene is not in the table or not given, or no impairment has a finished case.
    """
    method = "method" if "method" in table else "imaging.method"
    for column in (method, "cd_db", f1):
        if column not in table:
            raise DataError(f"robustness: the table has no column '{column}'")
    if "scene" in table:
        known = list(table["scene"].unique())
        if scene is None and len(known) > 1:
            raise DataError(f"robustness: the table has several scenes; give one of {', '.join(known)}")
        if scene is not None and scene not in known:
            raise DataError(f"robustness: no scene '{scene}'; there are {', '.join(known)}")
        table = table[table["scene"] == (known[0] if scene is None else scene)]
    done = finite(table if "status" not in table else table[table["status"] == "done"]).reset_index(drop=True)
    strengths = pd.DataFrame({name: _strength(done, name) for name in SWEPT})
    impaired = (strengths != 0).sum(axis=1)
    rows = []
    for name in SWEPT:
        if not (strengths[name][impaired == 1] != 0).any():
            continue
        alone = (impaired == 0) | ((impaired == 1) & (strengths[name] != 0))
        values = pd.DataFrame(
            {"method": done[method], "strength": strengths[name], "cd_db": done["cd_db"], "f1": done[f1]}
        )
        for (label, strength), group in values[alone].groupby(["method", "strength"], sort=False):
            row = {"impairment": name, "method": label, "strength": strength}
            for measure in ("cd_db", "f1"):
                numbers = group[measure].astype(float)
                row |= {measure: numbers.mean(), f"{measure}_low": numbers.min(), f"{measure}_high": numbers.max()}
            rows.append(row)
    if not rows:
        raise DataError("robustness: no finished case is impaired in one way alone; sweep imaging.impairments")
    found = pd.DataFrame(rows)
    places = {"impairment": list(SWEPT).index, "method": list(dict.fromkeys(done[method])).index}
    return found.sort_values(
        ["impairment", "method", "strength"], key=lambda column: column.map(places.get(str(column.name), float))
    ).reset_index(drop=True)


def _strength(table: pd.DataFrame, name: str) -> NDArray[np.float64]:
    """Strength of an impairment in every row, ``[n_row]``; 0 where it is absent."""
    if name == "blocked_sector_deg":
        first, last = (_numbers(table, f"{BLOCK}{name}.{end}") for end in (0, 1))
        return np.where(last >= first, last - first, last - first + 360)
    return _numbers(table, BLOCK + name)


def _numbers(table: pd.DataFrame, column: str) -> NDArray[np.float64]:
    if column not in table:
        return np.zeros(len(table))
    texts = table[column].astype(str).replace({"True": "1", "False": "0"})
    return np.asarray(pd.to_numeric(texts, errors="coerce").fillna(0.0), np.float64)


def _draw(axes: Axes, part: pd.DataFrame, name: str, measure: str, methods: list[str]) -> None:
    """Draw the lines of one panel."""
    kind = SWEPT[name]
    for number, method in enumerate(methods):
        rows = part[part["method"] == method]
        look = _look(number)
        if kind.log:
            for level in rows[measure][rows["strength"] == 0]:
                axes.axhline(level, color=look["color"], ls=":", lw=0.8)
            rows = rows[rows["strength"] > 0]
        x = kind.scale * rows["strength"].to_numpy(np.float64)
        axes.fill_between(x, rows[f"{measure}_low"], rows[f"{measure}_high"], color=look["color"], alpha=0.18, lw=0)
        axes.plot(x, rows[measure], markersize=2.6, **look)
    axes.set_axisbelow(True)
    axes.grid(visible=True)
    if kind.log:
        axes.set_xscale("log")
        low, high = (float(f(part["strength"][part["strength"] > 0])) * kind.scale for f in (np.min, np.max))
        decades = 10.0 ** np.arange(np.ceil(np.log10(low) - 1e-9), np.floor(np.log10(high) + 1e-9) + 1)
        ticks = decades if decades.size > 1 else np.unique([low, high])
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    if name == "random_phase":
        axes.set_xticks([0, 1], ["off", "on"])
        axes.set_xlim(-0.3, 1.3)


def _limits(curves: pd.DataFrame, measure: str) -> tuple[float, float]:
    """Limits that all panels of a measure share."""
    low, high = float(curves[f"{measure}_low"].min()), float(curves[f"{measure}_high"].max())
    margin = 0.05 * (high - low) or 0.5
    return low - margin, high + margin


def _look(number: int) -> dict[str, Any]:
    """Line of a method; those beyond the colours are dashed, beyond twice as many dotted."""
    dash = DASHES[number // len(LINE_COLORS) % len(DASHES)]
    return {"color": LINE_COLORS[number % len(LINE_COLORS)], "ls": dash, "marker": MARKERS[number % len(MARKERS)]}
