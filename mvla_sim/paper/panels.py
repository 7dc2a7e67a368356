"""Figures of the paper's experiments: parameter maps, CD against the interval per SNR, examples, effects.

``title``, ``figure`` and ``ax`` are as in :mod:`mvla_sim.plot`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.imaging.image import Image
from mvla_sim.paper.averages import finite
from mvla_sim.paper.claims import PAPER_ETA, PAPER_KAPPA
from mvla_sim.plot import drawing, style
from mvla_sim.plot.drawing import Panel
from mvla_sim.plot.style import Given

__all__ = ["parameter_maps", "plot_cd_panels", "plot_effects", "plot_examples", "plot_parameter_maps"]

METHODS = {"mvla-gr": ("MVLA-GR", "blue", "o"), "bp": ("BP", "vermilion", "s")}


def plot_parameter_maps(table: pd.DataFrame, only: str | None = None, *, figure: Given | None = None) -> Figure | Given:
    """Draw the smallest CD over κ and η: averaged over the scenes, then each scene, on one colour scale.

    Parameters
    ----------
    table
        Columns ``scene``, ``kappa``, ``eta``, ``cd_db`` (dB(m²)), which is averaged over anything else. Values that are
        not finite are left out; a cell that lacks a scene has no average and stays blank.
    only
        Name of a scene, or "average": that map alone, on the colours of all, with its values written into it.

    Raises
    ------
    DataError
        There is no such map, or no finite value.

    Notes
    -----
    A circle marks the smallest value of each map, a cross the paper's (0.5, 0.04).
    """
    maps = parameter_maps(table)
    if only is not None and only not in maps:
        raise DataError(f"parameter maps: no map '{only}'; there are {', '.join(maps)}")
    values = np.concatenate([grid.to_numpy(np.float64).ravel() for grid in maps.values()])
    if not np.isfinite(values).any():
        raise DataError("parameter maps: no finite CD to draw")
    shown = maps if only is None else {only: maps[only]}
    with style.figure_style():
        canvas = figure or style.new_figure(
            *((style.DOUBLE_COLUMN_IN, 2.5) if only is None else (style.SINGLE_COLUMN_IN, 3.2))
        )
        panels = canvas.subplots(1, len(shown), sharey=True, squeeze=False)[0]
        for axes, (name, grid) in zip(panels, shown.items(), strict=True):
            mesh = _draw_parameter_map(
                axes, grid, (float(np.nanmin(values)), float(np.nanmax(values))), write=only is not None
            )
            best = f": {np.nanmin(grid):.1f} dB at best" if np.isfinite(grid).any(axis=None) else ": no value"
            axes.set_title(name + best)
        panels[0].set_ylabel("κ")
        canvas.colorbar(mesh, ax=list(panels), label="Chamfer distance (dB(m²))", pad=0.01)
        keys = [_key("o", "smallest CD"), _key("x", f"paper: κ = {PAPER_KAPPA:g}, η = {PAPER_ETA:g}")]
        style.figure_legend(canvas, keys, columns=2)
    return canvas


def parameter_maps(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Mean CD by scene, dB(m²), rows κ and columns η; first "average", their mean where every scene has a value."""
    cleared = table.assign(cd_db=table["cd_db"].where(np.isfinite(table["cd_db"].astype(float))))
    by_scene = cleared.groupby(["scene", "kappa", "eta"], sort=False)["cd_db"].mean().unstack("scene")
    by_scene = by_scene[list(table["scene"].unique())]
    columns = {"average": by_scene.mean(axis=1, skipna=False)} | {str(name): by_scene[name] for name in by_scene}
    return {name: pd.DataFrame(column.unstack("eta").sort_index()) for name, column in columns.items()}


def plot_cd_panels(
    table: pd.DataFrame, title: str = "", only: float | None = None, *, figure: Given | None = None
) -> Figure | Given:
    """Draw CD against the angular interval, a panel an SNR, for both methods.

    Lines are means over offsets and seeds, bands the range from the 10th to the 90th percentile of them.

    Parameters
    ----------
    table
        Columns ``snr_db``, ``interval_deg``, ``method``, ``cd_db`` (dB(m²)); values that are not finite are left out.
    only
        Draw the panel of this SNR in dB alone, wider, on the axes of all.

    Raises
    ------
    DataError
        There is no finite CD, or none at this SNR.
    """
    shown = finite(table)
    groups = shown.groupby(["snr_db", "method", "interval_deg"])["cd_db"]
    curves = pd.DataFrame({"mean": groups.mean(), "low": groups.quantile(0.1), "high": groups.quantile(0.9)})
    levels = sorted(shown["snr_db"].unique())
    if not levels or (only is not None and only not in levels):
        raise DataError(f"CD panels: no finite CD{'' if only is None else f' at {only:g} dB'} to draw")
    drawn = levels if only is None else [only]
    with style.figure_style():
        canvas = figure or style.new_figure(
            *((style.DOUBLE_COLUMN_IN, 2.1) if only is None else (style.SINGLE_COLUMN_IN, 2.3))
        )
        panels = canvas.subplots(1, len(drawn), sharex=True, sharey=True, squeeze=False)[0]
        for axes, snr in zip(panels, drawn, strict=True):
            for method, (label, color, marker) in METHODS.items():
                part = curves[[place[:2] == (snr, method) for place in curves.index]]
                x = part.index.get_level_values("interval_deg").to_numpy()
                axes.fill_between(x, part["low"], part["high"], color=style.COLORS[color], alpha=0.2, linewidth=0)
                axes.plot(x, part["mean"], color=style.COLORS[color], marker=marker, markersize=2.2, label=label)
            axes.set_title(f"SNR {snr:g} dB")
            axes.set_xlabel("Δθ (°)")
            axes.grid(visible=True)
        margin = 0.04 * float(curves["high"].max() - curves["low"].min()) or 1.0
        panels[0].set_ylim(float(curves["low"].min()) - margin, float(curves["high"].max()) + margin)
        panels[0].set_ylabel("Chamfer distance (dB(m²))")
        style.figure_legend(canvas, panels[0].get_legend_handles_labels()[0], columns=2)
        if title:
            canvas.suptitle(title)
    return canvas


def plot_examples(
    images: Sequence[Image], truths: Sequence[NDArray[np.bool_]], occupied: Sequence[NDArray[np.bool_]],
    labels: Sequence[str], *, columns: int = 4, figure: Given | None = None,
) -> Figure | Given:  # fmt: skip
    """Draw binary reconstructions over the ground truth, ``columns`` a row.

    Raises DataError: there is no image, or the lists are not equally long.
    """
    if not images or len({len(images), len(truths), len(occupied), len(labels)}) > 1:
        raise DataError("examples: images, truths, binary images and labels must be equally many, at least 1")
    rows = -(-len(images) // columns)
    with style.figure_style():
        canvas, panels = drawing.panel_grid(
            style.DOUBLE_COLUMN_IN,
            [images[0].grid] * rows,
            columns,
            edges_in=(0.42, 0.12, 0.6, 0.25),
            gap_in=(0.2, 0.5),
            figure=figure,
        )
        handles: dict[str, Any] = {}
        flat = [axes for row in panels for axes in row]
        for axes in flat[len(images) :]:
            axes.set_axis_off()
        for axes, image, truth, mask, label in zip(flat, images, truths, occupied, labels, strict=False):
            drawn = drawing.draw_binary(axes, image, truth, mask, image.grid.shape[0] // 2)
            handles |= {str(handle.get_label()): handle for handle in drawn}
            axes.set_title(label)
        style.figure_legend(canvas, list(handles.values()), columns=4)
    return canvas


def plot_effects(table: pd.DataFrame, labels: Mapping[str, str], *, ax: Panel | None = None) -> Figure | Panel:
    """Draw shares of variance: a row a setting, a column a figure, the settings of the largest shares on top.

    Parameters
    ----------
    table
        Columns ``figure``, ``setting`` and ``share``, as of :func:`~mvla_sim.paper.effects.effects` without pairs.
    labels
        What each figure is called, in the order of the columns.
    """
    shares = 100 * table.pivot(index="setting", columns="figure", values="share")
    shares = shares.reindex(columns=[name for name in labels if name in shares]).fillna(0)
    shares = shares.loc[shares.sum(axis=1).sort_values(ascending=False, kind="stable").index]
    with style.figure_style():
        figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.9 + 0.19 * len(shares))
        axes = figure.subplots() if ax is None else ax
        axes.imshow(shares.to_numpy(), aspect="auto", cmap="Blues", vmin=0, vmax=max(30.0, shares.to_numpy().max()))
        for (row, column), share in np.ndenumerate(shares.to_numpy()):
            if share >= 1:
                axes.text(
                    column, row, f"{share:.0f}", ha="center", va="center", color="white" if share > 25 else "black"
                )
        axes.set_xticks(range(shares.shape[1]), [labels[str(name)] for name in shares], rotation=45, ha="left")
        axes.set_yticks(range(shares.shape[0]), list(shares.index))
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
    return figure if ax is None else ax


def _draw_parameter_map(axes: Axes, grid: pd.DataFrame, limits: tuple[float, float], *, write: bool) -> AxesImage:
    """Draw one map with equal cells, whatever the steps of κ and η, and its marks."""
    values = grid.to_numpy(np.float64)
    mesh = axes.imshow(values, origin="lower", aspect="auto", cmap="viridis_r", vmin=limits[0], vmax=limits[1])
    axes.set_xticks(range(grid.shape[1]), [f"{eta:g}" for eta in grid.columns], rotation=90)
    axes.set_yticks(range(grid.shape[0]), [f"{kappa:g}" for kappa in grid.index])
    axes.set_xlabel("η")
    if np.isfinite(values).any():
        row, column = divmod(int(np.nanargmin(values)), values.shape[1])
        _mark(axes, column, row, "o", 14 if write else 6)
    if PAPER_KAPPA in grid.index and PAPER_ETA in grid.columns:
        row, column = (list(axis).index(at) for axis, at in ((grid.index, PAPER_KAPPA), (grid.columns, PAPER_ETA)))
        _mark(axes, column, row - 0.33 * write, "x", 4 if write else 6)  # under the number, not across it
    if write:
        for (row, column), value in np.ndenumerate(values):
            if np.isfinite(value):
                text = f"{value:.1f}".replace("-", "\N{MINUS SIGN}")
                red, green, blue, _ = mesh.to_rgba(np.array([value]))[0]
                bright = 0.299 * red + 0.587 * green + 0.114 * blue  # as the eye weighs them (Rec. 601)
                color = "black" if bright > 0.45 else "white"
                axes.text(column, row, text, ha="center", va="center", fontsize=4.8, color=color)
    return mesh


def _mark(axes: Axes, x: float, y: float, marker: str, size: float) -> None:
    for color, width in (("white", 2.2), ("black", 0.9)):
        (line,) = axes.plot([x], [y], marker=marker, markersize=size, markerfacecolor="none")
        line.set(markeredgecolor=color, markeredgewidth=width)


def _key(marker: str, label: str) -> Line2D:
    return Line2D([], [], linestyle="none", marker=marker, markerfacecolor="none", markeredgecolor="black", label=label)
