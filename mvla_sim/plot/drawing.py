"""What the figures are put together from: maps, masks, outlines, trajectories, angle axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Patch, PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mvla_sim.errors import DataError, MvlaError, check_argument
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.method import METHODS, Method, title_of
from mvla_sim.plot.style import COLORS, MAPS, Given, new_figure
from mvla_sim.scene.views import Views

__all__ = [
    "Bits", "angle_axis", "angle_cells", "check_image", "check_mask", "color_bar", "draw_binary", "draw_classes",
    "draw_direction", "draw_outline", "draw_score", "draw_support", "label_plane", "panel_grid", "rings_of",
    "score_label", "view_count",
]  # fmt: skip

Bits = NDArray[np.bool_]
Handles = list[Patch | Line2D]
Panel = TypeVar("Panel", bound=Axes)
Panels = TypeVar("Panels", bound=Sequence[Axes])
"""The axes that a function was given, and returns; without any it returns a new figure."""
Edges = tuple[float, float, float, float]

TARGET = "#DDDDDD"
HIT, FALSE, MISS = COLORS["blue"], COLORS["vermilion"], "#B0B0B0"
OVER_MAP = COLORS["sky"]
"""Colour of a line over a map of the score, which has no blue from its darkest to its brightest."""
SCORE_PERCENTILE = 99.8  # brighter voxels are cut off: a few crossings of arcs would leave the rest of a map dark
WIDE_GAP = 3.0  # steps in angle above this many times the usual one stay blank


def view_count(count: int) -> str:
    """Say how many views: "1 view", "72 views"."""
    return f"{count} view{'' if count == 1 else 's'}"


def check_mask(mask: Bits, grid: VoxelGrid | None, name: str) -> None:
    """Raise DataError for a mask without a grid or of another shape than its grid."""
    check_argument(name, mask, np.ndarray, "an array [nz, ny, nx] of bool")
    if grid is None:
        raise DataError(f"picture: {name} of shape {mask.shape} comes without its grid")
    if mask.shape != grid.shape:
        raise DataError(f"picture: {name} has shape {mask.shape}, the grid {grid.shape}")


def check_image(image: Image, truth: Bits | None, occupied: Bits | None, layer: int | None) -> None:
    """Raise DataError for masks that do not fit an image's grid, and a layer it does not have."""
    check_argument("image", image, Image, "see reconstruct")
    for name, mask in (("truth", truth), ("occupied", occupied)):
        if mask is not None:
            check_mask(mask, image.grid, name)
    if layer is not None and not 0 <= layer < image.grid.shape[0]:
        raise DataError(f"picture: layer = {layer}; allowed: 0 to {image.grid.shape[0] - 1}")


def label_plane(axes: Axes) -> None:
    """Give both axes the same scale and few ticks."""
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))


def panel_grid(
    width_in: float,
    grids: Sequence[VoxelGrid],
    columns: int,
    *,
    edges_in: Edges,
    gap_in: tuple[float, float],
    figure: Given | None = None,
) -> tuple[Figure | Given, list[list[Axes]]]:
    """Make a figure of panels that keep a grid's proportions: a row for each grid, columns of equal width.

    Its height follows from the grids. ``edges_in`` is the space left, right, below and above all panels, ``gap_in``
    that between columns and between rows, inches. Panels go in these proportions into a figure that is given.
    """
    left, right, below, above = edges_in
    width = (width_in - left - right - (columns - 1) * gap_in[0]) / columns
    heights = [width * float(np.clip(grid.counts[1] / grid.counts[0], 0.3, 2.0)) for grid in grids]
    total = below + above + sum(heights) + (len(grids) - 1) * gap_in[1]
    canvas = figure or new_figure(width_in, total, constrained=False)
    rows: list[list[Axes]] = []
    top = total - above
    for height in heights:
        row: list[Axes] = []
        for column in range(columns):
            place = (left + column * (width + gap_in[0])) / width_in, (top - height) / total
            axes = canvas.add_axes((*place, width / width_in, height / total))
            label_plane(axes)
            axes.tick_params(labelleft=column == 0)
            axes.set_xlabel("x (m)")
            row.append(axes)
        row[0].set_ylabel("y (m)")
        rows.append(row)
        top -= height + gap_in[1]
    return canvas, rows


def color_bar(axes: Axes, mappable: AxesImage, label: str, *, below: bool, cut_off: bool, inset: bool = True) -> None:
    """Put a colour bar as long as the panel under it or at its right; ``cut_off`` marks values beyond its end.

    ``inset``: the panel keeps its place and size, for the figure has room; else matplotlib makes room for the bar.
    """
    place: dict[str, Any] = {"ax": axes}
    if inset:
        box, whole = axes.get_position(), axes.figure.bbox
        width, height = box.width * whole.width / axes.figure.dpi, box.height * whole.height / axes.figure.dpi
        bounds = (0.0, -0.52 / height, 1.0, 0.1 / height) if below else (1 + 0.06 / width, 0.0, 0.1 / width, 1.0)
        place = {"cax": axes.inset_axes(bounds), "extendfrac": 0.03}
    bar = axes.figure.colorbar(
        mappable,
        orientation="horizontal" if below else "vertical",
        extend="max" if cut_off else "neither",
        ticks=MaxNLocator(4, steps=[1, 2, 2.5, 3, 5, 10]),
        **place,
    )
    bar.set_label(label)


def score_label(image: Image) -> str:
    """What a score's axis is called: in the method's own words, and by its title where it has none."""
    try:
        label = METHODS.find(image.method).score_label
    except MvlaError:  # of a method that is not to be found here
        label = Method.score_label
    return f"score of {title_of(image.method)}" if label == Method.score_label else label


def draw_score(axes: Axes, image: Image, layer: int, *, bar_below: bool, inset: bool = True) -> None:
    """Draw one layer of the score from 0 to just below its maximum, with a colour bar."""
    top = float(np.percentile(image.score[layer], SCORE_PERCENTILE))
    drawn = _draw_map(axes, image, image.score[layer], "score", top)
    color_bar(axes, drawn, score_label(image), below=bar_below, cut_off=True, inset=inset)


def draw_support(axes: Axes, image: Image, layer: int, *, bar_below: bool, inset: bool = True) -> None:
    """Draw one layer of the angular support, with a colour bar. Raises DataError: the image has none."""
    if image.support_deg is None:
        raise DataError(f"picture: an image of method {image.method} has no angular support")
    values = image.support_deg[layer]
    drawn = _draw_map(axes, image, values, "support", float(values.max()))
    color_bar(axes, drawn, "angular support Θ (°)", below=bar_below, cut_off=False, inset=inset)


def draw_classes(
    axes: Axes, classes: Sequence[tuple[Bits, str]], grid: VoxelGrid, layer: int, zorder: float = 0
) -> None:
    """Fill the voxels of one layer of each mask ``[nz, ny, nx]`` with its colour; the rest stays clear."""
    picture = np.ones((*grid.shape[1:], 4))
    picture[..., 3] = 0
    for mask, color in classes:
        picture[mask[layer]] = to_rgba(color)
    axes.imshow(picture, origin="lower", extent=_extent(grid), interpolation_stage="rgba", zorder=zorder)


def draw_outline(axes: Axes, outline: BaseGeometry | None, fill: str = "none", width_pt: float = 0.5) -> None:
    """Draw every ring of an outline, holes too, as a thin line."""
    if outline is not None and (rings := rings_of(outline)):
        path = Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))
        axes.add_patch(PathPatch(path, facecolor=fill, edgecolor="black", linewidth=width_pt))


def rings_of(area: BaseGeometry) -> list[NDArray[np.float64]]:
    """Every ring of an area, ``[n, 2]`` each."""
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon" and not part.is_empty]
    return [shapely.get_coordinates(ring) for part in parts for ring in (part.exterior, *part.interiors)]


def draw_binary(axes: Axes, image: Image, truth: Bits | None, occupied: Bits, layer: int) -> Handles:
    """Draw the retained voxels of one layer, told apart by the truth if given, and the outline; return handles."""
    if truth is None:
        classes = [(occupied, HIT, "retained")]
    else:
        classes = [
            (truth & ~occupied, MISS, "missed"),
            (occupied & ~truth, FALSE, "false"),
            (occupied & truth, HIT, "hit"),
        ]
    draw_classes(axes, [(mask, color) for mask, color, _ in classes], image.grid, layer)
    handles: Handles = [Patch(color=color, label=name) for _, color, name in reversed(classes)]
    if image.outline is not None:
        draw_outline(axes, image.outline, width_pt=min(0.5, 24 / max(image.grid.counts[:2])))  # thinner than a voxel
        handles.append(Line2D([], [], color="black", linewidth=0.5, label="outline"))
    left, right, bottom, top = _extent(image.grid)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    return handles


def draw_direction(axes: Axes, views: Views, color: str) -> None:
    """Draw an arrow outside the first tenth of the trajectory, in the order of the views."""
    last = max(1, round(0.1 * (len(views) - 1)))
    center = np.asarray(views.center_m)
    points = center + 1.09 * (views.positions_m[: last + 1, :2] - center)
    if len(points) > 1 and np.ptp(points, axis=0).max() > 0:
        axes.add_patch(
            FancyArrowPatch(path=Path(points), arrowstyle="-|>", mutation_scale=8, color=color, linewidth=1, zorder=4)
        )
        axes.update_datalim(points)


def angle_axis(views: Views) -> tuple[NDArray[np.intp], NDArray[np.float64], str]:
    """Order of the views by angle, their places along an axis in that order ``[n_view]``, and the axis's label.

    An arc across 0° begins at negative angles, so that it stays in one piece. Where two views share an angle, the
    places count the views.
    """
    order = np.argsort(views.angles_deg, kind="stable")
    place = views.angles_deg[order]
    gaps = np.diff(place, append=place[0] + 360)
    if not gaps.min() > 0:
        return order, np.arange(len(place), dtype=np.float64), "view, in order of angle"
    widest = int(np.argmax(gaps))
    if not views.closed and widest < len(place) - 1:
        order = np.roll(order, -widest - 1)
        place = np.concatenate([place[widest + 1 :] - 360, place[: widest + 1]])
    return order, place, "view angle (°)"


def angle_cells(place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Edges ``[n + 1]`` of cells about rising places, and the index of the place in each ``[n]``: −1 in a wide gap."""
    steps = np.diff(place)
    usual = float(np.median(steps)) if steps.size else 1.0
    edges, shown = [place[0] - usual / 2], [0]
    for index, step in enumerate(steps, start=1):
        if step > WIDE_GAP * usual:
            edges += [place[index - 1] + usual / 2, place[index] - usual / 2]
            shown += [-1, index]
        else:
            edges.append(place[index] - step / 2)
            shown.append(index)
    return np.array([*edges, place[-1] + usual / 2], np.float64), np.array(shown, np.intp)


def _draw_map(axes: Axes, image: Image, values: NDArray[np.float32], kind: str, top: float) -> AxesImage:
    extent = _extent(image.grid)
    return axes.imshow(values, origin="lower", extent=extent, cmap=MAPS[kind], vmin=0, vmax=top if top > 0 else 1)


def _extent(grid: VoxelGrid) -> tuple[float, float, float, float]:
    low, high = grid.bounds_m()
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])
