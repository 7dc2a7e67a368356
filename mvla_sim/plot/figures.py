"""Pictures of scenes, profiles, images and tables: one function a figure, each of data that is ready.

Every function returns a :class:`matplotlib.figure.Figure`; :func:`~mvla_sim.plot.style.save_figure` writes it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from mvla_sim.errors import DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.methods.registry import title_of
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.plot.curves import plot_curves
from mvla_sim.plot.drawing import (
    Bits,
    angle_axis,
    angle_cells,
    check_image,
    check_mask,
    draw_binary,
    draw_classes,
    draw_direction,
    draw_outline,
    draw_score,
    draw_support,
    label_plane,
    panel_grid,
    view_count,
)
from mvla_sim.plot.style import COLORS, DOUBLE_COLUMN_IN, MAPS, SINGLE_COLUMN_IN, figure_style, new_figure
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import Scene

__all__ = ["plot_comparison", "plot_curves", "plot_image", "plot_scene", "plot_waterfall"]

TARGET = "#DDDDDD"


def plot_scene(scene: Scene, truth: Bits | None = None, grid: VoxelGrid | None = None) -> Figure:
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

    Raises
    ------
    DataError
        ``truth`` is not of the grid's shape, or comes without a grid.
    """
    if truth is not None:
        check_mask(truth, grid, "truth")
    x, y, _ = scene.views.positions_m.T
    with figure_style():
        figure = new_figure(SINGLE_COLUMN_IN, 3.75)
        axes = figure.add_subplot()
        label_plane(axes)
        draw_outline(axes, scene.outline, fill=TARGET)
        handles: list[Patch | Line2D] = [Patch(facecolor=TARGET, edgecolor="black", linewidth=0.5, label="target")]
        if grid is not None and truth is not None:
            draw_classes(axes, [(truth, COLORS["orange"])], grid, grid.shape[0] // 2, zorder=1.5)
            handles.append(Patch(color=COLORS["orange"], label="ground truth"))
        if grid is not None:
            low, high = grid.bounds_m()
            frame = Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1])
            frame.set(fill=False, linestyle="--", linewidth=0.8, edgecolor="0.4")
            axes.add_patch(frame)
            handles.append(Line2D([], [], linestyle="--", linewidth=0.8, color="0.4", label="imaging grid"))
        size = 3 if len(x) > 120 else 5
        axes.plot(x, y, ".", color=COLORS["blue"], markersize=size, markeredgewidth=0)
        axes.plot(x[:1], y[:1], "D", color=COLORS["vermilion"], markersize=5, zorder=4)
        for marker, color, label in ((".", "blue", view_count(len(x))), ("D", "vermilion", "first view")):
            handles.append(Line2D([], [], linestyle="", marker=marker, color=COLORS[color], label=label))
        draw_direction(axes, scene.views, COLORS["vermilion"])
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.05)
        axes.autoscale()
        axes.set_xlabel("x (m)")
        axes.set_ylabel("y (m)")
        axes.set_title(f"Scene {scene.name}, from above")
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def plot_waterfall(
    pdp: Pdp, views: Views, peaks: Peaks | None = None, title: str = "", floor_db: float | None = None
) -> Figure:
    """Draw power delay profiles over view angle and range, and beside them the peaks found in them.

    Parameters
    ----------
    pdp
        Profiles, clean or noisy; values of no power are drawn at the lower end of the colour scale.
    views
        Where they were measured, one a profile; drawn in order of angle. A step of more than three times the usual one
        stays blank. Where views share an angle, the axis counts the views in order of angle instead.
    peaks
        Detected components; drawn as dots over a pale copy of the profiles, in a panel of its own.
    title
        Title of the figure.
    floor_db
        Lower end of the colour scale relative to the largest value, dB; by default the median of the profiles in whole
        tens of dB, from −60 to −20.

    Raises
    ------
    DataError
        Profiles, views and peaks are not equally many, no profile holds any power, or the floor is not below 0 dB.
    """
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
    cells = np.where(shown[:, None] < 0, np.nan, level_db[order[shown]])  # [n_cell, n_range]
    range_edges = pdp.start_m + pdp.step_m * (np.arange(pdp.power.shape[1] + 1) - 0.5)
    with figure_style():
        count = 1 if peaks is None else 2
        pale = LinearSegmentedColormap.from_list("pale", ["#FFFFFF", "#8C8C8C"])
        figure = new_figure(SINGLE_COLUMN_IN if peaks is None else DOUBLE_COLUMN_IN, 2.7)
        panels = figure.subplots(1, count, sharex=True, sharey=True, squeeze=False)[0]
        for axes, colors in zip(panels, (colormaps[MAPS["power"]], pale), strict=False):
            mesh = axes.pcolormesh(
                edges, range_edges, cells.T, cmap=colors, vmin=floor_db, vmax=0, rasterized=True, linewidth=0
            )
            if axes is panels[0]:
                bar = figure.colorbar(mesh, ax=axes, extend="min", pad=0.02, aspect=25)
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
            panels[1].plot(
                where[peaks.view], peaks.range_m, ".", color=COLORS["vermilion"], markersize=size, markeredgewidth=0
            )
            panels[1].set_title(f"Detected peaks: {peaks.range_m.size}")
        if title:
            figure.suptitle(title)
    return figure


def plot_image(
    image: Image, truth: Bits | None = None, occupied: Bits | None = None, title: str = "", layer: int | None = None
) -> Figure:
    """Draw an image as panels in one row: score, angular support where there is one, binary image over the truth.

    Parameters
    ----------
    image
        The image; its outline is drawn over the binary image.
    truth
        Ground-truth voxels ``[nz, ny, nx]``.
    occupied
        Binary image ``[nz, ny, nx]``; by default the one inside ``image``. Without one that panel is left out.
    title
        Title of the figure; by default the method and the number of views.
    layer
        Index of the layer of a three-dimensional grid; by default the middle one.

    Raises
    ------
    DataError
        ``truth`` or ``occupied`` is not of the grid's shape, or the grid has no such layer.
    """
    occupied = image.occupied if occupied is None else occupied
    check_image(image, truth, occupied, layer)
    index = image.grid.shape[0] // 2 if layer is None else layer
    count = 1 + (image.support_deg is not None) + (occupied is not None)
    with figure_style():
        width = SINGLE_COLUMN_IN if count == 1 else DOUBLE_COLUMN_IN * count / 3
        figure, (panels,) = panel_grid(width, [image.grid], count, edges_in=(0.42, 0.12, 0.9, 0.45), gap_in=(0.15, 0.0))
        axes = panels.pop(0)
        draw_score(axes, image, index, bar_below=True)
        axes.set_title("Score")
        if image.support_deg is not None:
            axes = panels.pop(0)
            draw_support(axes, image, index, bar_below=True)
            axes.set_title("Angular support")
        if occupied is not None:
            axes = panels.pop(0)
            handles = draw_binary(axes, image, truth, occupied, index)
            middle = axes.get_position()
            anchor = (middle.x0 + middle.width / 2, 0.3 / figure.get_figheight())
            figure.legend(handles=handles, loc="center", bbox_to_anchor=anchor, ncols=2)
            axes.set_title("Binary image")
        name = title or f"{title_of(image.method)}, {view_count(image.n_view)}"
        if image.grid.shape[0] > 1:
            name += f", layer at z = {image.grid.axes()[2][index]:.3g} m"
        figure.suptitle(name, y=1 - 0.06 / figure.get_figheight(), va="top")
    return figure


def plot_comparison(
    images: Sequence[Image],
    truths: Sequence[Bits | None],
    occupied: Sequence[Bits],
    labels: Sequence[str],
    *,
    cd_db: Sequence[float] | None = None,
    title: str = "",
) -> Figure:
    """Draw methods beneath each other: a row each, of score, angular support and the binary image over the truth.

    Of grids with several layers the middle one is drawn.

    Parameters
    ----------
    images
        One image a row.
    truths
        Ground-truth voxels ``[nz, ny, nx]`` of each row, or None.
    occupied
        Binary images ``[nz, ny, nx]`` of each row.
    labels
        Names of the rows.
    cd_db
        Chamfer distance of each row, dB(m²), written over its binary image; NaN where it is undefined.
    title
        Title of the figure.

    Raises
    ------
    DataError
        There is no row, the lists are not equally long, or an array is not of its grid's shape.
    """
    lengths = [len(images), len(truths), len(occupied), len(labels), *([] if cd_db is None else [len(cd_db)])]
    if not lengths[0] or len(set(lengths)) > 1:
        raise DataError(
            f"comparison: {lengths[0]} images, {lengths[1]} truths, {lengths[2]} binary images, {lengths[3]} labels"
            f"{'' if cd_db is None else f', {lengths[4]} distances'}; these must agree and be at least 1"
        )
    for image, truth, mask in zip(images, truths, occupied, strict=True):
        check_image(image, truth, mask, None)
    columns = 2 + any(image.support_deg is not None for image in images)
    with figure_style():
        figure, panels = panel_grid(
            DOUBLE_COLUMN_IN * columns / 3,
            [image.grid for image in images],
            columns,
            edges_in=(0.42, 0.12, 0.6, 0.45 if title else 0.25),
            gap_in=(0.65, 0.58),
        )
        handles: dict[str, Patch | Line2D] = {}
        for row, (image, truth, mask, label) in enumerate(zip(images, truths, occupied, labels, strict=True)):
            index = image.grid.shape[0] // 2
            first, *others, last = panels[row]
            draw_score(first, image, index, bar_below=False)
            for axes in others:
                if image.support_deg is None:
                    axes.set_axis_off()
                    axes.text(0.5, 0.5, "no angular support", ha="center", color="0.4", transform=axes.transAxes)
                else:
                    draw_support(axes, image, index, bar_below=False)
            drawn = draw_binary(last, image, truth, mask, index)
            handles |= {str(handle.get_label()): handle for handle in drawn}
            if cd_db is not None:
                last.set_title(_distance(cd_db[row]))
            first.set_title(label, loc="left", fontweight="bold")
        figure.legend(handles=list(handles.values()), loc="lower center", ncols=4)
        if title:
            figure.suptitle(title, y=1 - 0.06 / figure.get_figheight(), va="top")
    return figure


def _distance(cd_db: float) -> str:
    if np.isnan(cd_db):
        return "CD undefined"
    return f"CD = {cd_db:.1f} dB(m²)".replace("-", "−").replace("inf", "∞")
