"""Scenes and samples of a dataset, seen from above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from mvla_sim.dataset.access import Sample
from mvla_sim.errors import DataError, check_argument
from mvla_sim.grid import VoxelGrid
from mvla_sim.plot import drawing, style
from mvla_sim.plot.drawing import Bits, Panel
from mvla_sim.plot.style import Given
from mvla_sim.scene.world import Scene

__all__ = ["plot_samples", "plot_scene"]

COLUMNS: Final = 5
"""Samples beside each other at most."""


def plot_scene(
    scene: Scene, truth: Bits | None = None, grid: VoxelGrid | None = None, *, ax: Panel | None = None
) -> Figure | Panel:
    """Draw the target from above, where it is looked at from, and the grid it is imaged on.

    Every view is a dot; the first is marked, and an arrow shows the order of the others.

    Parameters
    ----------
    scene
        Outline and views.
    truth
        Ground-truth voxels ``[nz, ny, nx]``; needs ``grid``. Of several layers the middle one is drawn.
    grid
        The imaging grid; its frame is drawn.
    ax
        Where to draw, in metres; by default in a new figure. It is returned.

    Raises
    ------
    DataError
        ``truth`` is not of the grid's shape, or comes without a grid.
    """
    check_argument("scene", scene, Scene, "for a file: Scene.load")
    if truth is not None:
        drawing.check_mask(truth, grid, "truth")
    x, y, _ = scene.views.positions_m.T
    with style.figure_style():
        figure = style.new_figure(style.SINGLE_COLUMN_IN, 3.75)
        axes = figure.add_subplot() if ax is None else ax
        drawing.label_plane(axes)
        drawing.draw_outline(axes, scene.outline, fill=drawing.TARGET)
        handles: list[Patch | Line2D] = [
            Patch(facecolor=drawing.TARGET, edgecolor="black", linewidth=0.5, label="target")
        ]
        if grid is not None and truth is not None:
            drawing.draw_classes(axes, [(truth, style.COLORS["orange"])], grid, grid.shape[0] // 2, zorder=1.5)
            handles.append(Patch(color=style.COLORS["orange"], label="ground truth"))
        if grid is not None:
            low, high = grid.bounds_m()
            frame = Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1])
            frame.set(fill=False, linestyle="--", linewidth=0.8, edgecolor="0.4")
            axes.add_patch(frame)
            handles.append(Line2D([], [], linestyle="--", linewidth=0.8, color="0.4", label="imaging grid"))
        size = 3 if len(x) > 120 else 5
        axes.plot(x, y, ".", color=style.COLORS["blue"], markersize=size, markeredgewidth=0)
        axes.plot(x[:1], y[:1], "D", color=style.COLORS["vermilion"], markersize=5, zorder=4)
        for marker, color, label in ((".", "blue", drawing.view_count(len(x))), ("D", "vermilion", "first view")):
            handles.append(Line2D([], [], linestyle="", marker=marker, color=style.COLORS[color], label=label))
        drawing.draw_direction(axes, scene.views, style.COLORS["vermilion"])
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.05)
        axes.autoscale()
        axes.set_xlabel("x (m)")
        axes.set_ylabel("y (m)")
        axes.set_title(f"Scene {scene.name}, from above")
        if ax is not None:
            ax.legend(handles=handles, frameon=True)
            return ax
        style.figure_legend(figure, handles, columns=3)
    return figure


def plot_samples(samples: Sequence[Sample], *, figure: Given | None = None) -> Figure | Given:
    """Draw samples from above in a grid of panels: outline, sensor positions, number and family.

    All panels have the scale of the one that shows most.

    Parameters
    ----------
    samples
        Of :func:`mvla_sim.open_dataset`.
    figure
        Where to draw; by default a new one. It is returned.

    Raises
    ------
    DataError
        There is no sample.
    """
    if not samples:
        raise DataError("picture: there is no sample to draw")
    columns = min(COLUMNS, len(samples))
    rows = math.ceil(len(samples) / columns)
    positions = [sample.cir.views.positions_m for sample in samples]
    middles = [(places[:, :2].min(axis=0) + places[:, :2].max(axis=0)) / 2 for places in positions]
    half = 1.06 * max(
        float(abs(places[:, :2] - middle).max()) for places, middle in zip(positions, middles, strict=True)
    )
    with style.figure_style():
        width = style.DOUBLE_COLUMN_IN * max(columns, 2) / COLUMNS
        canvas = figure or style.new_figure(width, width / columns * rows * 1.12 + 0.45)
        panels = canvas.subplots(rows, columns, squeeze=False)
        for panel in panels.flat[len(samples) :]:
            panel.set_axis_off()
        for number, (sample, places, middle) in enumerate(zip(samples, positions, middles, strict=True)):
            axes = panels.flat[number]
            drawing.label_plane(axes)
            drawing.draw_outline(axes, sample.outline, fill=drawing.TARGET)
            axes.plot(places[:, 0], places[:, 1], ".", color=style.COLORS["blue"], markersize=2, markeredgewidth=0)
            axes.set_xlim(middle[0] - half, middle[0] + half)
            axes.set_ylim(middle[1] - half, middle[1] + half)
            axes.set_title(f"{sample.metadata['sample']}: {sample.metadata['family']}")
            last_of_column = number + columns >= len(samples)
            axes.tick_params(labelbottom=last_of_column, labelleft=number % columns == 0)
            if last_of_column:
                axes.set_xlabel("x (m)")
            if number % columns == 0:
                axes.set_ylabel("y (m)")
        handles: list[Patch | Line2D] = [
            Patch(facecolor=drawing.TARGET, edgecolor="black", linewidth=0.5, label="target"),
            Line2D([], [], linestyle="", marker=".", markersize=3, color=style.COLORS["blue"], label="sensor"),
        ]
        style.figure_legend(canvas, handles, columns=2)
    return canvas
