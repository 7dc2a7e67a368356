"""Images: score, angular support and binary result, of one method, of several, and of a measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from shapely.geometry.base import BaseGeometry

from mvla_sim.errors import DataError, check_argument
from mvla_sim.evaluation.boxes import Box
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.method import title_of
from mvla_sim.plot import drawing, style
from mvla_sim.plot.drawing import Bits, Panels
from mvla_sim.plot.style import Given

__all__ = ["plot_comparison", "plot_image", "plot_measured", "score_caption"]

WHOSE: Final = {
    "optimal": "best thresholds, found with the truth",
    "given": "given thresholds",
    "auto": "automatic thresholds",
}
"""Ways to come by thresholds; see :class:`mvla_sim.evaluation.evaluate.Evaluation`."""


def plot_image(
    image: Image,
    truth: Bits | None = None,
    occupied: Bits | None = None,
    title: str = "",
    layer: int | None = None,
    *,
    axes: Panels | None = None,
) -> Figure | Panels:
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
    axes
        One for each panel, in this order; by default those of a new figure. They are returned.

    Raises
    ------
    DataError
        ``truth`` or ``occupied`` is not of the grid's shape, the grid has no such layer, or there are more or fewer
        axes than panels.
    """
    drawing.check_image(image, truth, occupied, layer)
    occupied = image.occupied if occupied is None else occupied
    index = image.grid.shape[0] // 2 if layer is None else layer
    shown = {"Score": image.score, "Angular support": image.support_deg, "Binary image": occupied}
    names = [name for name, values in shown.items() if values is not None]
    if axes is not None and len(axes) != len(names):
        raise DataError(f"picture: {len(axes)} axes; {len(names)} are needed: {', '.join(names)}")
    name = title or f"{title_of(image.method)}, {drawing.view_count(image.n_view)}"
    if image.grid.shape[0] > 1:
        name += f", layer at z = {image.grid.axes()[2][index]:.3g} m"
    with style.figure_style():
        panels: Sequence[Axes] = () if axes is None else axes
        if axes is None:
            width = style.SINGLE_COLUMN_IN if len(names) == 1 else style.DOUBLE_COLUMN_IN * len(names) / 3
            edges = (0.42, 0.12, 0.9, 0.45 + 0.14 * name.count("\n"))
            figure, (panels,) = drawing.panel_grid(width, [image.grid], len(names), edges_in=edges, gap_in=(0.15, 0.0))
            figure.suptitle(name, y=1 - 0.06 / figure.get_figheight(), va="top")
        for panel, what in zip(panels, names, strict=True):
            panel.set_title(what if axes is None else f"{name}: {what[0].lower()}{what[1:]}" if title else what)
        drawing.draw_score(panels[0], image, index, bar_below=True, inset=axes is None)
        if image.support_deg is not None:
            drawing.draw_support(panels[1], image, index, bar_below=True, inset=axes is None)
        if occupied is not None:
            handles = drawing.draw_binary(panels[-1], image, truth, occupied, index)
            if axes is None:
                middle = panels[-1].get_position()
                anchor = (middle.x0 + middle.width / 2, 0.3 / figure.get_figheight())
                figure.legend(handles=handles, loc="center", bbox_to_anchor=anchor, ncols=2)
            else:
                panels[-1].legend(handles=handles, frameon=True)
    if axes is None:
        return figure
    for panel in axes:
        drawing.label_plane(panel)
        panel.set(xlabel="x (m)", ylabel="y (m)")
    return axes


def plot_comparison(
    images: Sequence[Image],
    truths: Sequence[Bits | None],
    occupied: Sequence[Bits],
    labels: Sequence[str],
    *,
    captions: Sequence[str] | None = None,
    title: str = "",
    figure: Given | None = None,
) -> Figure | Given:
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
    captions
        A text for each row, written over its binary image; of :func:`score_caption` the distance and the thresholds.
    title
        Title of the figure.
    figure
        Where to draw; by default a new one. It is returned.

    Raises
    ------
    DataError
        There is no row, the lists are not equally long, or an array is not of its grid's shape.
    """
    for name, given in (("images", images), ("truths", truths), ("occupied", occupied), ("labels", labels)):
        check_argument(name, given, list | tuple, "one a row")
    lengths = [len(images), len(truths), len(occupied), len(labels), *([] if captions is None else [len(captions)])]
    if not lengths[0] or len(set(lengths)) > 1:
        raise DataError(
            f"comparison: {lengths[0]} images, {lengths[1]} truths, {lengths[2]} binary images, {lengths[3]} labels"
            f"{'' if captions is None else f', {lengths[4]} captions'}; these must agree and be at least 1"
        )
    for image, truth, mask in zip(images, truths, occupied, strict=True):
        drawing.check_image(image, truth, mask, None)
    columns = 2 + any(image.support_deg is not None for image in images)
    lines = 0.14 * max(text.count("\n") for text in captions or [""])  # inches that captions need beyond one line
    with style.figure_style():
        canvas, panels = drawing.panel_grid(
            style.DOUBLE_COLUMN_IN * columns / 3,
            [image.grid for image in images],
            columns,
            edges_in=(0.42, 0.12, 0.6, lines + style.room_above_in(title)),
            gap_in=(0.65, 0.58 + lines),
            figure=figure,
        )
        handles: dict[str, Patch | Line2D] = {}
        for row, (image, truth, mask, label) in enumerate(zip(images, truths, occupied, labels, strict=True)):
            index = image.grid.shape[0] // 2
            first, *others, last = panels[row]
            drawing.draw_score(first, image, index, bar_below=False)
            for axes in others:
                if image.support_deg is None:
                    axes.set_axis_off()
                    axes.text(0.5, 0.5, "no angular support", ha="center", color="0.4", transform=axes.transAxes)
                else:
                    drawing.draw_support(axes, image, index, bar_below=False)
            drawn = drawing.draw_binary(last, image, truth, mask, index)
            handles |= {str(handle.get_label()): handle for handle in drawn}
            if captions is not None:
                last.set_title(captions[row], loc="right" if lines else "center")
            first.set_title(label, loc="left", fontweight="bold")
        style.figure_legend(canvas, list(handles.values()), columns=4)
        style.figure_title(canvas, title)
    return canvas


def plot_measured(
    image: Image,
    occupied: Bits,
    outline: BaseGeometry | None,
    box: Box | None = None,
    title: str = "",
    *,
    figure: Given | None = None,
) -> Figure | Given:
    """Draw a measured image as two panels: (a) the continuous support map, (b) the binary result.

    Several layers are seen from above: the largest score, and whether any voxel is occupied.

    Parameters
    ----------
    image
        The image. Its own outline is not drawn.
    occupied
        Binary image ``[nz, ny, nx]``.
    outline
        What the target looks like from above, x and y in metres, drawn as a thin line over both panels; None where it
        is not known.
    box
        The binary result's bounding box, drawn dashed, with its length and width in the legend.
    title
        Title of the figure.
    figure
        Where to draw; by default a new one. It is returned.

    Raises
    ------
    DataError
        ``occupied`` is not of the grid's shape.
    """
    drawing.check_image(image, None, occupied, None)
    flat = _from_above(image)
    low, high = flat.grid.bounds_m()
    with style.figure_style():
        canvas, ((left, right),) = drawing.panel_grid(
            style.DOUBLE_COLUMN_IN,
            [flat.grid],
            2,
            edges_in=(0.42, 0.12, 0.62, style.room_above_in(title)),
            gap_in=(0.75, 0.0),
            figure=figure,
        )
        drawing.draw_score(left, flat, 0, bar_below=False)
        left.set_title("(a) Continuous support map (score)")
        drawing.draw_classes(right, [(np.asarray(np.any(occupied, axis=0, keepdims=True)), drawing.HIT)], flat.grid, 0)
        right.set_title("(b) Binary result")
        handles: list[Patch | Line2D] = [Patch(color=drawing.HIT, label="retained")]
        if outline is not None:
            for axes, color in ((left, drawing.OVER_MAP), (right, "black")):
                drawing.draw_outline(axes, outline, width_pt=0.7)
                for patch in axes.patches:
                    patch.set_edgecolor(color)
            handles.append(Line2D([], [], color="black", linewidth=0.7, label="outline, in (a) blue"))
        if box is not None:
            color = style.COLORS["vermilion"]
            right.add_patch(Polygon(box.corners_m, fill=False, edgecolor=color, linestyle="--", linewidth=0.9))
            size = f"bounding box, {box.length_m:.2f} m × {box.width_m:.2f} m"
            handles.append(Line2D([], [], color=color, linestyle="--", linewidth=0.9, label=size))
        for axes in (left, right):
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[1], high[1])
        style.figure_legend(canvas, handles, columns=3)
        style.figure_title(canvas, title)
    return canvas


def score_caption(cd_db: float, protocol: str = "") -> str:
    """Chamfer distance in dB(m²), NaN where it is undefined, and below it whose thresholds it was measured at.

    Parameters
    ----------
    cd_db
        10·log10 of the Chamfer distance over 1 m².
    protocol
        ``optimal``, ``given``, ``auto`` or the name of another rule; nothing is said of thresholds without it.
    """
    text = "CD undefined" if np.isnan(cd_db) else f"CD = {cd_db:.1f} dB(m²)".replace("-", "−").replace("inf", "∞")
    return f"{text}\n{WHOSE.get(protocol, f'thresholds by {protocol}')}" if protocol else text


def _from_above(image: Image) -> Image:
    """One layer with the largest score of each column; the angular support is left out."""
    grid = replace(image.grid, counts=(*image.grid.counts[:2], 1))
    score = image.score.max(axis=0, keepdims=True)
    return replace(image, score=score, grid=grid, support_deg=None, occupied=None)
