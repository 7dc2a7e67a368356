"""Figures of the paper's experiments: parameter maps, CD against the interval per SNR, examples, sensitivity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.imaging.image import Image
from mvla_sim.report.drawing import draw_binary, panel_grid
from mvla_sim.report.style import COLORS, DOUBLE_COLUMN_IN, figure_style, new_figure

__all__ = ["plot_cd_panels", "plot_examples", "plot_parameter_maps", "plot_verdicts"]

METHODS = {"mvla-gr": ("MVLA-GR", "blue", "o"), "bp": ("BP", "vermilion", "s")}
PAPER_POINT = (0.5, 0.04)
VERDICTS = {"holds": "✓", "does not hold": "✗", "not tested": "–"}


def plot_parameter_maps(table: pd.DataFrame) -> Figure:
    """Draw the smallest CD over κ and η: averaged over the scenes, then each scene, on one colour scale.

    Parameters
    ----------
    table
        Columns ``scene``, ``kappa``, ``eta``, ``cd_db`` (dB(m²)), which is averaged over anything else.

    Notes
    -----
    A circle marks the smallest value of each map, a cross the paper's (0.5, 0.04).
    """
    by_scene = table.groupby(["scene", "kappa", "eta"], sort=False)["cd_db"].mean()
    maps = {"average": by_scene.groupby(["kappa", "eta"]).mean()}
    maps |= {str(scene): part.droplevel("scene") for scene, part in by_scene.groupby(level="scene", sort=False)}
    low, high = (float(f(values)) for f, values in ((np.min, by_scene), (np.max, by_scene)))
    with figure_style():
        figure = new_figure(DOUBLE_COLUMN_IN, 2.5)
        panels = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        for axes, (name, values) in zip(panels, maps.items(), strict=True):
            grid = values.unstack("eta").sort_index()
            mesh = axes.imshow(grid.to_numpy(), origin="lower", aspect="auto", cmap="viridis_r", vmin=low, vmax=high)
            axes.set_xticks(range(grid.shape[1]), [f"{eta:g}" for eta in grid.columns], rotation=90)
            axes.set_yticks(range(grid.shape[0]), [f"{kappa:g}" for kappa in grid.index])
            best = np.unravel_index(np.nanargmin(grid.to_numpy()), grid.shape)
            _mark(axes, int(best[1]), int(best[0]), "o")
            if PAPER_POINT[0] in grid.index and PAPER_POINT[1] in grid.columns:
                _mark(
                    axes,
                    int((grid.columns == PAPER_POINT[1]).argmax()),
                    int((grid.index == PAPER_POINT[0]).argmax()),
                    "x",
                )
            axes.set_title(f"{name}: {np.nanmin(grid.to_numpy()):.1f} dB at best")
            axes.set_xlabel("η")
        panels[0].set_ylabel("κ")
        figure.colorbar(mesh, ax=list(panels), label="Chamfer distance (dB(m²))", pad=0.01)
        keys = [_key("o", "smallest CD"), _key("x", "paper: κ = 0.5, η = 0.04")]
        figure.legend(handles=keys, loc="outside lower center", ncols=2)
    return figure


def plot_cd_panels(table: pd.DataFrame, title: str = "") -> Figure:
    """Draw CD against the angular interval, a panel an SNR, for both methods.

    Lines are means over offsets and seeds, bands the range from the 10th to the 90th percentile of them.

    Parameters
    ----------
    table
        Columns ``snr_db``, ``interval_deg``, ``method``, ``cd_db`` (dB(m²)); values that are not finite are left out.
    title
        Title of the figure.
    """
    finite = table[np.isfinite(table["cd_db"].astype(float))]
    levels = sorted(finite["snr_db"].unique())
    with figure_style():
        figure = new_figure(DOUBLE_COLUMN_IN, 2.1)
        panels = figure.subplots(1, len(levels), sharex=True, sharey=True, squeeze=False)[0]
        for axes, snr in zip(panels, levels, strict=True):
            for method, (label, color, marker) in METHODS.items():
                part = finite[(finite["snr_db"] == snr) & (finite["method"] == method)]
                groups = part.groupby("interval_deg")["cd_db"]
                mean, low, high = groups.mean(), groups.quantile(0.1), groups.quantile(0.9)
                axes.fill_between(mean.index, low, high, color=COLORS[color], alpha=0.2, linewidth=0)
                axes.plot(mean.index, mean, color=COLORS[color], marker=marker, markersize=2.2, label=label)
            axes.set_title(f"SNR {snr:g} dB")
            axes.set_xlabel("Δθ (°)")
            axes.grid(visible=True)
        panels[0].set_ylabel("Chamfer distance (dB(m²))")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
        if title:
            figure.suptitle(title)
    return figure


def plot_examples(
    images: Sequence[Image], truths: Sequence[NDArray[np.bool_]], occupied: Sequence[NDArray[np.bool_]],
    labels: Sequence[str], columns: int = 4,
) -> Figure:  # fmt: skip
    """Draw binary reconstructions over the ground truth, ``columns`` a row.

    Raises
    ------
    DataError
        There is no image, or the lists are not equally long.
    """
    if not images or len({len(images), len(truths), len(occupied), len(labels)}) > 1:
        raise DataError("examples: images, truths, binary images and labels must be equally many, at least 1")
    rows = -(-len(images) // columns)
    with figure_style():
        figure, panels = panel_grid(
            DOUBLE_COLUMN_IN, [images[0].grid] * rows, columns, edges_in=(0.42, 0.12, 0.6, 0.25), gap_in=(0.2, 0.5)
        )
        handles: dict[str, Any] = {}
        flat = [axes for row in panels for axes in row]
        for axes in flat[len(images) :]:
            axes.set_axis_off()
        for axes, image, truth, mask, label in zip(flat, images, truths, occupied, labels, strict=False):
            drawn = draw_binary(axes, image, truth, mask, image.grid.shape[0] // 2)
            handles |= {str(handle.get_label()): handle for handle in drawn}
            axes.set_title(label)
        figure.legend(handles=list(handles.values()), loc="lower center", ncols=4)
    return figure


def plot_verdicts(verdicts: pd.DataFrame) -> Figure:
    """Draw a matrix of verdicts: a row a variant, a column a claim.

    Parameters
    ----------
    verdicts
        Index: variants; columns: claims; values ``holds``, ``does not hold`` or ``not tested``.
    """
    order = list(VERDICTS)
    codes = verdicts.map(order.index).to_numpy()
    colors = ListedColormap([COLORS["sky"], COLORS["orange"], "#EEEEEE"])
    with figure_style():
        figure = new_figure(DOUBLE_COLUMN_IN * 0.75, 0.6 + 0.16 * len(verdicts))
        axes = figure.subplots()
        axes.imshow(codes, aspect="auto", cmap=colors, vmin=0, vmax=2)
        for (row, column), code in np.ndenumerate(codes):
            axes.text(column, row, VERDICTS[order[code]], ha="center", va="center")
        axes.set_xticks(range(verdicts.shape[1]), list(verdicts.columns))
        axes.set_yticks(range(verdicts.shape[0]), list(verdicts.index))
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
    return figure


def _mark(axes: Axes, x: int, y: int, marker: str) -> None:
    axes.plot(
        [x], [y], marker=marker, markersize=6, markerfacecolor="none", markeredgecolor="white", markeredgewidth=2.2
    )
    axes.plot(
        [x], [y], marker=marker, markersize=6, markerfacecolor="none", markeredgecolor="black", markeredgewidth=0.9
    )


def _key(marker: str, label: str) -> Line2D:
    return Line2D([], [], linestyle="none", marker=marker, markerfacecolor="none", markeredgecolor="black", label=label)
