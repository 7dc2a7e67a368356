"""Pictures of a dataset's samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mvla_sim.dataset.access import Sample
from mvla_sim.errors import DataError
from mvla_sim.plot.drawing import draw_outline, label_plane
from mvla_sim.plot.style import COLORS, DOUBLE_COLUMN_IN, figure_style, new_figure

__all__ = ["plot_samples"]

COLUMNS: Final = 5
TARGET: Final = "#DDDDDD"


def plot_samples(samples: Sequence[Sample]) -> Figure:
    """Draw samples from above in a grid of panels: outline, sensor positions, number and family.

    All panels have the scale of the one that shows most.

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
    with figure_style():
        width = DOUBLE_COLUMN_IN * max(columns, 2) / COLUMNS
        figure = new_figure(width, width / columns * rows * 1.12 + 0.45)
        panels = figure.subplots(rows, columns, squeeze=False)
        for panel in panels.flat[len(samples) :]:
            panel.set_axis_off()
        for number, (sample, places, middle) in enumerate(zip(samples, positions, middles, strict=True)):
            axes = panels.flat[number]
            label_plane(axes)
            draw_outline(axes, sample.outline, fill=TARGET)
            axes.plot(places[:, 0], places[:, 1], ".", color=COLORS["blue"], markersize=2, markeredgewidth=0)
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
            Patch(facecolor=TARGET, edgecolor="black", linewidth=0.5, label="target"),
            Line2D([], [], linestyle="", marker=".", markersize=3, color=COLORS["blue"], label="sensor"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure
