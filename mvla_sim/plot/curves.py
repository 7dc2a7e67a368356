"""Curves from a tidy table: one line for each value of a column."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.typing import ColorType
from numpy.typing import NDArray

from mvla_sim.errors import DataError, check_argument
from mvla_sim.imaging.method import title_of
from mvla_sim.plot.drawing import Panel
from mvla_sim.plot.style import COLORS, MAPS, SINGLE_COLUMN_IN, figure_legend, figure_style, new_figure

__all__ = ["plot_curves"]

LINE_COLORS = [COLORS[name] for name in ("blue", "vermilion", "green", "purple", "orange", "sky", "black", "grey")]
DASHES = ("-", "--", ":", "-.")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")


def plot_curves(
    table: pd.DataFrame,
    x: str,
    y: str,
    by: str | None = None,
    *,
    style: str | None = None,
    low: str | None = None,
    high: str | None = None,
    x_label: str | None = None,
    y_label: str | None = None,
    by_format: str = "{}",
    style_format: str = "{}",
    title: str = "",
    log_x: bool = False,
    width_in: float = SINGLE_COLUMN_IN,
    ax: Panel | None = None,
) -> Figure | Panel:
    """Draw one column of a tidy table against another, a line for each value of a third.

    Values that are infinite or NaN leave a gap.

    Parameters
    ----------
    table
        One row a point; each line has each x once.
    x, y
        Numeric columns.
    by
        Column whose values give the lines their colours: along a colour map where they are numbers.
    style
        Column whose values give the lines their dashes and markers.
    low, high
        Columns with the lower and upper edge of a band around each line; both or none.
    x_label, y_label
        Names with units, by default those of the columns.
    by_format, style_format
        How the legend shows a value of ``by`` and of ``style``, for example ``"SNR {} dB"``.
    title
        Title of the figure.
    log_x
        Draw x on a logarithmic axis, with the table's own values as ticks.
    width_in
        Width of the figure, inches.
    ax
        Where to draw; by default in a new figure. It is returned.

    Raises
    ------
    DataError
        The table is empty, lacks a column, or has an x twice in one line or, on a logarithmic axis, one not above 0; or
        only one edge of a band is given.
    """
    check_argument("table", table, pd.DataFrame, "see load_table")
    keys = [key for key in (by, style) if key is not None]
    if (low is None) != (high is None):
        raise DataError(f"curves: low = {low}, high = {high}; a band needs both")
    _check_table(table, [x, *keys], [y, *(name for name in (low, high) if name is not None)])
    if log_x and not (table[x] > 0).all():
        raise DataError(f"curves: '{x}' = {table[x].min():g} has no place on a logarithmic axis; it must be above 0")
    color_of, color_values = _groups(table, by)
    dash_of, dash_values = _groups(table, style)
    colors = _line_colors(color_values)
    with figure_style():
        figure = new_figure(width_in, 2.6)
        axes = figure.add_subplot() if ax is None else ax
        for color, dash in sorted(set(zip(color_of.tolist(), dash_of.tolist(), strict=True))):
            rows = table[(color_of == color) & (dash_of == dash)].sort_values(x)
            place = rows[x].to_numpy(np.float64)
            marker = MARKERS[(color if style is None else dash) % len(MARKERS)]
            axes.plot(place, _gaps(rows[y]), ls=DASHES[dash % len(DASHES)], marker=marker, color=colors[color])
            if low is not None and high is not None:
                axes.fill_between(place, _gaps(rows[low]), _gaps(rows[high]), color=colors[color], alpha=0.18, lw=0)
        axes.set_xlabel(x_label or x)
        axes.set_ylabel(y_label or y)
        axes.set_axisbelow(True)
        axes.grid(visible=True)
        if log_x:
            axes.set_xscale("log")
            ticks = _sparse_ticks(table[x].to_numpy(np.float64))
            axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axes.minorticks_off()
        handles = []
        if by is not None:
            for color, value in enumerate(color_values):
                mark = MARKERS[color % len(MARKERS)] if style is None else ""
                handles.append(Line2D([], [], color=colors[color], marker=mark, label=_group_label(value, by_format)))
        if style is not None:
            for dash, value in enumerate(dash_values):
                line = Line2D([], [], color="0.3", ls=DASHES[dash % len(DASHES)], marker=MARKERS[dash % len(MARKERS)])
                line.set_label(_group_label(value, style_format))
                handles.append(line)
        if title:
            axes.set_title(title)
        if handles and ax is not None:
            ax.legend(handles=handles, frameon=True)
        elif handles:
            figure_legend(figure, handles, "upper")
    return figure if ax is None else ax


def _check_table(table: pd.DataFrame, keys: Sequence[str], values: Sequence[str]) -> None:
    """Raise DataError for a table without rows, without one of the columns, or with two rows of the same keys."""
    for column in [*keys, *values]:
        if column not in table.columns:
            raise DataError(f"curves: the table has no column '{column}'; it has {', '.join(map(str, table.columns))}")
    if table.empty:
        raise DataError(f"curves: the table of '{values[0]}' against '{keys[0]}' has no rows")
    twice = table.loc[table.duplicated(list(keys)), list(keys)]
    if len(twice):
        where = ", ".join(f"{key} = {value}" for key, value in twice.iloc[0].items())
        raise DataError(f"curves: several rows have {where}; a line takes one value of '{values[0]}' at each")


def _groups(table: pd.DataFrame, column: str | None) -> tuple[NDArray[np.intp], list[Any]]:
    """Number of each row's group ``[n_row]``, and the groups' values: numbers in order, the rest as they come."""
    if column is None:
        return np.zeros(len(table), np.intp), [None]
    number, values = pd.factorize(table[column], sort=_is_number(table[column]), use_na_sentinel=False)
    return np.asarray(number, np.intp), list(values)


def _line_colors(values: Sequence[Any]) -> list[ColorType]:
    """Colours of a legend's entries: along a colour map where they are numbers, else as different as can be."""
    if len(values) > 1 and _is_number(pd.Series(values)):
        return list(colormaps[MAPS["ordered"]](np.linspace(0, 0.88, len(values))))
    return [LINE_COLORS[index % len(LINE_COLORS)] for index in range(len(values))]


def _group_label(value: Any, pattern: str) -> str:
    """Text of a legend's entry; methods by their names, missing values as "none"."""
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return "none"
    if isinstance(value, float):
        value = f"{value:g}".replace("-", "\N{MINUS SIGN}")
    return pattern.format(title_of(value) if isinstance(value, str) else value)


def _gaps(values: pd.Series[Any]) -> NDArray[np.float64]:
    """Values with NaN wherever they are not finite, so that lines and bands break there."""
    numbers = values.to_numpy(np.float64)
    return np.where(np.isfinite(numbers), numbers, np.nan)


def _sparse_ticks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Those of the values whose labels fit beside each other on a logarithmic axis; the first and last always."""
    ordered = np.unique(values[values > 0])
    if ordered.size < 3:
        return ordered
    least = 0.06 * np.log(ordered[-1] / ordered[0])
    kept = [ordered[0]]
    for value in ordered[1:-1]:
        if np.log(value / kept[-1]) >= least and np.log(ordered[-1] / value) >= least:
            kept.append(value)
    return np.array([*kept, ordered[-1]])


def _is_number(values: pd.Series[Any]) -> bool:
    return pd.api.types.is_numeric_dtype(values) and not pd.api.types.is_bool_dtype(values)
