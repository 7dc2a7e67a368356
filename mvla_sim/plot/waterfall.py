"""Power delay profiles over the view angle, and the peaks found in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mvla_sim.errors import DataError, check_argument
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.plot.drawing import Panel, angle_axis, angle_cells
from mvla_sim.plot.style import COLORS, DOUBLE_COLUMN_IN, MAPS, SINGLE_COLUMN_IN, figure_style, new_figure
from mvla_sim.scene.views import Views

__all__ = ["plot_waterfall"]


def plot_waterfall(
    pdp: Pdp,
    views: Views,
    peaks: Peaks | None = None,
    title: str = "",
    floor_db: float | None = None,
    *,
    ax: Panel | None = None,
) -> Figure | Panel:
    """Draw power delay profiles over view angle and range, and beside them the peaks found in them.

    Parameters
    ----------
    pdp
        Profiles ``power[n_view, n_range]``, clean or noisy; values of no power are drawn at the lower end of the colour
        scale.
    views
        Where they were measured, one a profile; drawn in order of angle. A step of more than three times the usual one
        stays blank. Where views share an angle, the axis counts the views in order of angle instead.
    peaks
        Detected components, ranges in metres; drawn as dots over a pale copy of the profiles, in a panel of its own.
    title
        Title of the figure.
    floor_db
        Lower end of the colour scale relative to the largest value, dB; by default the median of the profiles in whole
        tens of dB, from −60 to −20.
    ax
        Where to draw the profiles, with the peaks over them; by default in a new figure. It is returned.

    Raises
    ------
    DataError
        Profiles, views and peaks are not equally many, no profile holds any power, or the floor is not below 0 dB.
    """
    check_argument("pdp", pdp, Pdp, "see compute_pdp")
    check_argument("views", views, Views, "a channel has them")
    if not len(pdp.power) == len(views) == (len(views) if peaks is None else peaks.n_view):
        raise DataError(f"waterfall: {len(pdp.power)} profiles, {len(views)} views"
                        f"{'' if peaks is None else f', peaks of {peaks.n_view} views'}; these must agree")  # fmt: skip
    largest = float(pdp.power.max())
    if not largest > 0:
        raise DataError(f"waterfall: the largest power is {largest:g}; it must be above 0")
    level_db = 10 * np.log10(np.maximum(pdp.power / largest, 1e-30))
    if floor_db is None:
        floor_db = float(np.clip(10 * np.floor(np.median(level_db) / 10), -60, -20))
    if not floor_db < 0:
        raise DataError(f"waterfall: floor_db = {floor_db:g}; it must be below 0")
    order, place, label = angle_axis(views)
    edges, shown = angle_cells(place)
    shown_db = np.where(shown[:, None] < 0, np.nan, level_db[order[shown]])  # [n_cell, n_range]
    cells = (edges, pdp.start_m + pdp.step_m * (np.arange(pdp.power.shape[1] + 1) - 0.5), shown_db.T)
    look: dict[str, Any] = {"vmin": floor_db, "vmax": 0, "rasterized": True, "linewidth": 0}
    pale = LinearSegmentedColormap.from_list("pale", ["#FFFFFF", "#8C8C8C"])
    maps: list[Any] = [MAPS["power"]] if peaks is None or ax is not None else [MAPS["power"], pale]
    with figure_style():
        panels: Sequence[Axes] = [] if ax is None else [ax]
        if ax is None:
            figure = new_figure(SINGLE_COLUMN_IN if peaks is None else DOUBLE_COLUMN_IN, 2.7)
            panels = figure.subplots(1, len(maps), sharex=True, sharey=True, squeeze=False)[0]
            if title:
                figure.suptitle(title)
        for axes, colors in zip(panels, maps, strict=True):
            mesh = axes.pcolormesh(*cells, cmap=colors, **look)
            if axes is panels[0]:
                bar = axes.figure.colorbar(mesh, ax=axes, extend="min", pad=0.02, aspect=25)
                bar.set_label("power relative to the maximum (dB)")
            axes.set_xlabel(label)
            if label.endswith("(°)"):
                axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 3, 4.5, 6, 9, 10]))
        panels[0].set_ylabel("range (m)")
        panels[0].set_title("Power delay profiles")
        if peaks is not None:
            where = np.empty(len(views))
            where[order] = place
            size = 1.8 if len(views) > 120 else 3
            color = COLORS["vermilion" if ax is None else "sky"]  # the map of powers has no blue
            panels[-1].plot(where[peaks.view], peaks.range_m, ".", color=color, markersize=size, markeredgewidth=0)
            panels[-1].set_title(f"Detected peaks: {peaks.range_m.size}")
        if ax is not None:
            ax.set_title(title or ax.get_title())
            return ax
    return figure
