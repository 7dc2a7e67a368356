"""Images in three dimensions, from every side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
import trimesh
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, proj3d  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection  # type: ignore[import-untyped]
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.volumes import exposed_faces
from mvla_sim.plot import drawing, style
from mvla_sim.plot.drawing import Bits
from mvla_sim.plot.style import Given

__all__ = ["plot_volume"]

Floats = NDArray[np.float64]

EDGE = "#8A8A8A"
"""Pale, yet seen over dark faces and over bright ones."""
PROJECTIONS = (("Top", 2, 0, 1), ("Side", 1, 0, 2), ("Front", 0, 1, 2))
"""Name, axis that is looked along, axes drawn to the right and upwards: 0 is x, 1 is y, 2 is z."""
AXIS_NAMES = "xyz"
VIEW_DEG = (24.0, -52.0)
"""Elevation and azimuth from which the three-dimensional view is drawn, degrees."""
LIGHT = (0.62, 0.80, 1.0)
"""Brightness of faces that look along x, y and z."""
CORNER = 0.07
"""Share of an axis of the three-dimensional view that carries no tick, at either end."""
SHARP_DEG = 20.0
"""Edges at which a mesh bends by more than this are drawn."""
HIGHEST_PANEL_IN, LOWEST_PANEL_IN, VIEW_IN = 2.3, 0.5, 3.4
"""Heights: most and least of a projection, and of the three-dimensional view, inches."""


def plot_volume(
    image: Image,
    occupied: Bits,
    meshes: Sequence[trimesh.Trimesh] = (),
    title: str = "",
    *,
    figure: Given | None = None,
) -> Figure | Given:
    """Draw a three-dimensional image: the largest score seen from three sides, and the occupied voxels' surface.

    Parameters
    ----------
    image
        The image.
    occupied
        Binary image ``[nz, ny, nx]``. Its faces are coloured by height, and shaded by the way they look.
    meshes
        What is really there, in metres: silhouettes over the projections, edges over the surface.
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
    maps = {name: image.score.max(axis=2 - along) for name, along, _, _ in PROJECTIONS}
    top = float(np.percentile(np.concatenate([values.ravel() for values in maps.values()]), drawing.SCORE_PERCENTILE))
    with style.figure_style():
        canvas, panels, view = _volume_panels(image.grid, title, figure)
        low, high = image.grid.bounds_m()
        for axes, (name, along, right, up) in zip(panels, PROJECTIONS, strict=True):
            drawn: AxesImage = axes.imshow(
                maps[name],
                origin="lower",
                extent=(low[right], high[right], low[up], high[up]),
                cmap=style.MAPS["score"],
                vmin=0,
                vmax=top if top > 0 else 1,
            )
            axes.set_aspect("equal", adjustable="datalim")
            for mesh in meshes:
                rings = drawing.rings_of(_silhouette(mesh, right, up))
                axes.add_collection(LineCollection(rings, colors=drawing.OVER_MAP, linewidths=0.7), autolim=False)
            axes.set_title(f"{name}, along {AXIS_NAMES[along]}")
        drawing.color_bar(panels[-1], drawn, f"largest {drawing.score_label(image)}", below=False, cut_off=True)
        _draw_view(view, image.grid, occupied, meshes)
        if meshes:
            handles = [
                Line2D([], [], color=drawing.OVER_MAP, linewidth=0.8, label="mesh, its silhouette"),
                Line2D([], [], color=EDGE, linewidth=0.6, label="mesh, its edges"),
            ]
            canvas.legend(handles=handles, loc="lower left", ncols=1)
        style.figure_title(canvas, title)
    return canvas


def _volume_panels(grid: VoxelGrid, title: str, figure: Given | None) -> tuple[Figure | Given, list[Axes], Axes3D]:
    """Three panels in a row on one scale, standing on one line, and the three-dimensional view under them."""
    left, end, below, gap, above = 0.5, 0.6, 0.35, 0.52, style.room_above_in(title)
    size = grid.spacing_m * np.array(grid.counts)
    widths = np.array([size[right] for _, _, right, _ in PROJECTIONS])
    heights = np.array([size[up] for _, _, _, up in PROJECTIONS])
    room = style.DOUBLE_COLUMN_IN - left - end - 2 * gap
    scale = min(room / widths.sum(), HIGHEST_PANEL_IN / heights.max())  # inches a metre
    widths, heights = (np.maximum(scale * lengths, LOWEST_PANEL_IN) for lengths in (widths, heights))
    widths *= min(1.0, room / widths.sum())
    left += (room - widths.sum()) / 2  # in the middle
    total = VIEW_IN + below + heights.max() + above
    canvas = figure or style.new_figure(style.DOUBLE_COLUMN_IN, total, constrained=False)
    panels, x = [], left
    for (_, _, horizontal, vertical), width, height in zip(PROJECTIONS, widths, heights, strict=True):
        place = x / style.DOUBLE_COLUMN_IN, (VIEW_IN + below) / total, width / style.DOUBLE_COLUMN_IN, height / total
        axes = canvas.add_axes(place)
        drawing.label_plane(axes)
        for axis, length in ((axes.xaxis, width), (axes.yaxis, height)):
            count = int(np.clip(length / 0.3, 1, 5))
            axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10], min_n_ticks=1))
        axes.set_xlabel(f"{AXIS_NAMES[horizontal]} (m)")
        axes.set_ylabel(f"{AXIS_NAMES[vertical]} (m)")
        panels.append(axes)
        x += width + gap
    view = canvas.add_axes((0, 0, 1, (VIEW_IN - 0.3) / total), projection="3d", computed_zorder=False)
    assert isinstance(view, Axes3D)
    return canvas, panels, view


def _draw_view(axes: Axes3D, grid: VoxelGrid, occupied: Bits, meshes: Sequence[trimesh.Trimesh]) -> None:
    """Draw the faces that can be seen from :data:`VIEW_DEG`, and the meshes' edges over them."""
    elevation, azimuth = np.deg2rad(VIEW_DEG)
    toward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    surface = exposed_faces(occupied, grid)
    seen = surface.normals @ toward > 0
    corners = surface.vertices_m[surface.squares[seen]]
    bounds = np.concatenate([corners.reshape(-1, 3), *(mesh.bounds for mesh in meshes)])
    low, high = (bounds.min(axis=0), bounds.max(axis=0)) if len(bounds) else grid.bounds_m()
    if len(corners):
        height = (corners[..., 2].mean(axis=1) - low[2]) / max(high[2] - low[2], grid.spacing_m)
        colors = colormaps[style.MAPS["ordered"]](0.1 + 0.85 * height)
        colors[:, :3] *= (np.abs(surface.normals[seen]) @ np.array(LIGHT))[:, None]
        faces = Poly3DCollection(corners, facecolors=colors, edgecolors=colors, linewidths=0.15, zorder=2)
        faces.set_rasterized(True)
        axes.add_collection3d(faces, autolim=False)
    for mesh in meshes:
        lines = Line3DCollection(_edges(mesh, toward), colors=EDGE, linewidths=0.6, zorder=3)
        axes.add_collection3d(lines, autolim=False)
    margin = 0.03 * float((high - low).max())
    low, high = low - margin, high + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_proj_type("ortho")
    axes.view_init(*VIEW_DEG)
    drawn = _fill(axes, low, high)
    for k, (axis, name) in enumerate(zip((axes.xaxis, axes.yaxis, axes.zaxis), AXIS_NAMES, strict=True)):
        count = int(np.clip(drawn[k] / 0.2, 1, 5))
        ticks = MaxNLocator(count, steps=[1, 2, 5, 10]).tick_values(low[k], high[k])
        free = CORNER * (high[k] - low[k])  # else the last label of one axis meets the first of the next
        axis.set_ticks(ticks[(ticks > low[k] + free) & (ticks < high[k] - free)])
        axis.set_tick_params(pad=-2)
        axis.labelpad = -4
        axis.set_label_text(f"{name} (m)")
        axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
    axes.set_title("Occupied voxels, coloured by height" if occupied.any() else "No voxel is occupied", pad=2)


def _fill(axes: Axes3D, low: Floats, high: Floats) -> Floats:
    """Magnify the box from ``low`` to ``high`` as far as its labels leave room; its sides as drawn, ``[3]`` inches."""
    axes.set_box_aspect(high - low)
    axes.apply_aspect()
    corners = [(low, high)[k][axis] for axis in range(3) for k in np.arange(8) >> axis & 1]
    x, y, _ = proj3d.proj_transform(*np.reshape(corners, (3, 8)), axes.get_proj())
    places = axes.transData.transform(np.stack([x, y], axis=-1)) / axes.figure.dpi  # [8, 2] inches
    room = np.array([style.DOUBLE_COLUMN_IN - 1.4, VIEW_IN - 0.8])
    zoom = float((room / np.ptp(places, axis=0)).min())
    axes.set_box_aspect(high - low, zoom=zoom)
    return np.asarray(zoom * np.linalg.norm(places[[1, 2, 4]] - places[0], axis=1), np.float64)


def _silhouette(mesh: trimesh.Trimesh, right: int, up: int) -> BaseGeometry:
    """Area that a mesh covers when looked at along the axis that is neither ``right`` nor ``up``, metres."""
    corners = np.asarray(mesh.triangles)[:, :, [right, up]]
    (ax, ay), (bx, by) = (np.moveaxis(corners[:, k] - corners[:, 0], -1, 0) for k in (1, 2))
    twice = ax * by - ay * bx
    size = float(np.ptp(mesh.bounds, axis=0).max())
    # The faces on one side of a closed mesh cover what all do; those seen edge-on cover nothing.
    shown = (twice if mesh.is_watertight else np.abs(twice)) > 1e-9 * size**2
    return shapely.union_all(shapely.polygons(corners[shown]))


def _edges(mesh: trimesh.Trimesh, toward: Floats) -> Floats:
    """Edges that show a mesh's shape: sharp ones, borders, and those where it turns away, ``[n, 2, 3]`` metres."""
    pairs = np.asarray(mesh.face_adjacency)
    facing = np.asarray(mesh.face_normals) @ toward > 0
    shown = np.asarray(mesh.face_adjacency_angles) > np.deg2rad(SHARP_DEG)
    shown |= facing[pairs[:, 0]] != facing[pairs[:, 1]]
    edges, count = np.unique(np.asarray(mesh.edges_sorted), axis=0, return_counts=True)
    chosen = np.concatenate([np.asarray(mesh.face_adjacency_edges)[shown], edges[count == 1]])
    return np.asarray(np.asarray(mesh.vertices)[chosen], np.float64)
