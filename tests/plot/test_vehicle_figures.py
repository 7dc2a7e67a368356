"""Pictures of a measured vehicle show what they are given, in its place, from every side, readable."""

from __future__ import annotations

import time

import numpy as np
import pytest
import shapely
import trimesh
from matplotlib.colors import to_rgba
from matplotlib.image import imread
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from plot_data import check_texts

from mvla_sim.errors import DataError
from mvla_sim.evaluation.boxes import Box, bounding_box
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.volumes import exposed_faces
from mvla_sim.plot.image_figures import plot_measured
from mvla_sim.plot.style import DOUBLE_COLUMN_IN, save_figure
from mvla_sim.plot.volume_figure import VIEW_DEG, plot_volume

CAR = shapely.box(-2.1, -0.9, 2.1, 0.9)
PLANE = VoxelGrid((0.0, 0.0, 0.9), (30, 20, 1), 0.25)
VOLUME = VoxelGrid((0.25, 0.0, 1.0), (24, 14, 10), 0.25)


def make_image(grid, method="mvla-gr", **changes):
    score = np.random.default_rng(1).random(grid.shape).astype(np.float32)
    return Image(**{"score": score, "support_deg": None, "grid": grid, "method": method, "n_view": 36} | changes)


def blocks(grid):
    """A body and a cabin on it, as of a car."""
    x, y, z = grid.centers().T
    body = (np.abs(x) < 2.1) & (np.abs(y) < 0.9) & (np.abs(z - 0.6) < 0.4)
    cabin = (np.abs(x + 0.4) < 1.1) & (np.abs(y) < 0.8) & (np.abs(z - 1.3) < 0.4)
    return (body | cabin).reshape(grid.shape)


def ring(grid):
    x, y, _ = grid.centers().T
    return (shapely.distance(CAR.exterior, shapely.points(x, y)) < 0.2).reshape(grid.shape)


def make_mesh():
    mesh = trimesh.creation.box((4.2, 1.8, 1.5))
    mesh.apply_translation((0, 0, 1.0))
    return mesh


def measured(**changes):
    given = {"outline": CAR, "box": bounding_box(ring(PLANE), PLANE), "title": "A car, 36 views"} | changes
    return plot_measured(make_image(PLANE), ring(PLANE), **given)


FLAT = VoxelGrid((0.0, 0.0, 1.0), (30, 20, 1), 0.25)
TALL = VoxelGrid((0.0, 0.0, 1.0), (5, 5, 30), 0.25)
ONE = VoxelGrid((0.0, 0.0, 1.0), (1, 1, 1), 0.05)
FIGURES = {
    "measured": measured,
    "measured alone": lambda: measured(outline=None, box=None, title=""),
    "measured with an outline": lambda: measured(box=None),
    "measured by backprojection": lambda: plot_measured(make_image(PLANE, "bp"), ring(PLANE), CAR),
    "measured in layers": lambda: plot_measured(make_image(VOLUME), blocks(VOLUME), CAR),
    "volume": lambda: plot_volume(make_image(VOLUME), blocks(VOLUME), [make_mesh()], "A car, 36 views"),
    "volume without mesh": lambda: plot_volume(make_image(VOLUME), blocks(VOLUME)),
    "volume by backprojection": lambda: plot_volume(make_image(VOLUME, "bp"), blocks(VOLUME)),
    "volume of one layer": lambda: plot_volume(make_image(FLAT), ring(FLAT), [make_mesh()]),
    "tall volume": lambda: plot_volume(make_image(TALL), blocks(TALL), title="Tall"),
    "one voxel": lambda: plot_volume(make_image(ONE), np.ones(ONE.shape, bool)),
    "empty volume": lambda: plot_volume(make_image(VOLUME), np.zeros(VOLUME.shape, bool)),
}


@pytest.mark.parametrize("name", FIGURES)
def test_every_text_is_inside_the_figure_and_clear_of_the_others(name):
    figure = FIGURES[name]()
    assert figure.get_figwidth() <= DOUBLE_COLUMN_IN
    check_texts(figure)


@pytest.mark.parametrize("name", ["measured", "volume", "one voxel"])
def test_files_repeat_byte_for_byte(tmp_path, name):
    for file in ("one.png", "other.png", "one.pdf", "other.pdf"):
        save_figure(FIGURES[name](), tmp_path / file)
    for suffix in (".png", ".pdf"):
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"other{suffix}").read_bytes()
    assert np.ptp(imread(tmp_path / "one.png")[..., :3]) > 0.5


# --- measured image ---


def test_both_panels_show_the_data_on_the_grid():
    figure = measured()
    left, right = figure.axes
    assert [left.get_title(), right.get_title()] == ["(a) Continuous support map (score)", "(b) Binary result"]
    assert figure.get_suptitle() == "A car, 36 views"
    np.testing.assert_array_equal(left.images[0].get_array(), make_image(PLANE).score[0])
    np.testing.assert_array_equal(right.images[0].get_array()[..., 3] > 0, ring(PLANE)[0])
    for axes in (left, right):
        assert axes.images[0].get_extent() == [-3.75, 3.75, -2.5, 2.5]
        assert axes.get_xlim() == (-3.75, 3.75)
        assert axes.get_ylim() == (-2.5, 2.5)


def test_voxels_are_drawn_where_they_are():
    mask = np.zeros(PLANE.shape, bool)
    mask[0, 17, 2] = True
    figure = plot_measured(make_image(PLANE), mask, None)
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())
    column, row = np.stack(figure.axes[1].transData.transform(PLANE.centers()[:, :2])).astype(int).T
    dark = pixels[pixels.shape[0] - 1 - row, column, :3].sum(axis=1) < 3 * 255
    np.testing.assert_array_equal(dark.reshape(PLANE.shape), mask)


def test_the_outline_is_over_both_panels_and_the_box_dashed_over_the_result():
    box = Box((0.5, -0.25), 4.0, 1.5, 30.0)
    figure = measured(box=box)
    left, right = figure.axes
    (outline,) = left.patches
    same, dashed = right.patches
    for patch in (outline, same):
        np.testing.assert_array_equal(patch.get_path().vertices, shapely.get_coordinates(CAR))
    assert to_rgba(outline.get_edgecolor()) != to_rgba(same.get_edgecolor())  # the one is on a dark ground
    np.testing.assert_allclose(dashed.get_path().vertices[:4], box.corners_m)
    assert dashed.get_linestyle() == "--"
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["retained", "outline, in (a) blue", "bounding box, 4.00 m × 1.50 m"]


def test_nothing_is_drawn_that_is_not_given():
    image = make_image(PLANE, outline=CAR)
    figure = plot_measured(image, ring(PLANE), None)
    assert not any(axes.patches for axes in figure.axes)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["retained"]


def test_an_outline_beyond_the_grid_does_not_move_the_panels():
    for axes in measured(outline=shapely.box(-50, -50, 50, 50)).axes:
        assert axes.get_xlim() == (-3.75, 3.75)
        assert axes.get_ylim() == (-2.5, 2.5)


def test_layers_are_seen_from_above():
    image, mask = make_image(VOLUME), blocks(VOLUME)
    left, right = plot_measured(image, mask, CAR).axes
    np.testing.assert_array_equal(left.images[0].get_array(), image.score.max(axis=0))
    np.testing.assert_array_equal(right.images[0].get_array()[..., 3] > 0, mask.any(axis=0))


def test_a_fine_grid_is_quick(tmp_path):
    grid = VoxelGrid((0.0, 0.0, 0.9), (1200, 1200, 1), 0.005)
    image, mask = make_image(grid), ring(grid)
    start = time.process_time()
    save_figure(plot_measured(image, mask, CAR, bounding_box(mask, grid)), tmp_path / "fine.png")
    assert time.process_time() - start < 10  # 0.6 s on an idle core


# --- volume ---


def test_projections_are_maxima_on_one_colour_scale():
    image = make_image(VOLUME)
    figure = plot_volume(image, blocks(VOLUME))
    top, side, front, view = figure.axes
    assert isinstance(view, Axes3D)
    x, y, z = (-2.75, 3.25), (-1.75, 1.75), (-0.25, 2.25)
    for axes, (name, labels, axis, extent) in zip(
        (top, side, front),
        [
            ("Top, along z", ("x (m)", "y (m)"), 0, x + y),
            ("Side, along y", ("x (m)", "z (m)"), 1, x + z),
            ("Front, along x", ("y (m)", "z (m)"), 2, y + z),
        ],
        strict=True,
    ):
        assert axes.get_title() == name
        assert (axes.get_xlabel(), axes.get_ylabel()) == labels
        np.testing.assert_array_equal(axes.images[0].get_array(), image.score.max(axis=axis))
        assert axes.images[0].get_extent() == pytest.approx(extent)
        assert axes.images[0].get_clim() == top.images[0].get_clim()
        assert axes.images[0].origin == "lower"
    figure.canvas.draw()
    scales = [axes.transData.get_matrix()[k, k] for axes in (top, side, front) for k in (0, 1)]
    assert np.ptp(scales) < 1e-6 * scales[0]  # a metre is as long in every panel


def test_the_view_shows_the_faces_that_look_at_it():
    mask = blocks(VOLUME)
    view = plot_volume(make_image(VOLUME), mask, [make_mesh()]).axes[-1]
    elevation, azimuth = np.deg2rad(VIEW_DEG)
    toward = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    surface = exposed_faces(mask, VOLUME)
    expected = surface.vertices_m[surface.squares[surface.normals @ toward > 0]]
    (faces,) = [item for item in view.collections if isinstance(item, Poly3DCollection)]
    np.testing.assert_array_equal(np.ma.getdata(faces._faces), expected)
    assert (view.elev, view.azim) == VIEW_DEG
    bounds = np.concatenate([expected.reshape(-1, 3), make_mesh().bounds])
    for (low, high), values in zip((view.get_xlim(), view.get_ylim(), view.get_zlim()), bounds.T, strict=True):
        assert low < values.min()
        assert values.max() < high


def test_higher_faces_are_brighter_and_sides_darker_than_tops():
    grid = VoxelGrid((0.0, 0.0, 1.0), (1, 1, 4), 0.5)
    view = plot_volume(make_image(grid), np.ones(grid.shape, bool)).axes[-1]
    (faces,) = view.collections
    colors = faces._facecolor3d[:, :3] @ [0.299, 0.587, 0.114]
    corners = np.ma.getdata(faces._faces)
    flat = np.ptp(corners, axis=1)
    top, by_x, by_y = (np.flatnonzero(flat[:, axis] < 1e-9) for axis in (2, 0, 1))
    assert (len(top), len(by_x), len(by_y)) == (1, 4, 4)
    for side in (by_x, by_y):
        rising = side[np.argsort(corners[side, :, 2].mean(axis=1))]
        assert (np.diff(colors[rising]) > 0).all()
        assert colors[rising[-1]] < colors[top[0]]
    assert (colors[by_x] < colors[by_y]).all()


def silhouettes(axes):
    return [segment for item in axes.collections for segment in item.get_segments()]


def test_silhouettes_of_meshes_lie_over_the_projections():
    panels = plot_volume(make_image(VOLUME), blocks(VOLUME), [make_mesh(), make_mesh()]).axes[:3]
    for axes, (right, up) in zip(panels, ((0, 1), (0, 2), (1, 2)), strict=True):
        rings = silhouettes(axes)
        assert len(rings) == 2
        low, high = make_mesh().bounds[:, [right, up]]
        for points in rings:
            assert shapely.Polygon(points).symmetric_difference(shapely.box(*low, *high)).area < 1e-9  # m²
    without = plot_volume(make_image(VOLUME), blocks(VOLUME))
    assert not any(silhouettes(axes) for axes in without.axes[:3])
    assert not without.legends


def test_silhouettes_keep_holes_and_open_meshes():
    ring_mesh = trimesh.creation.annulus(0.5, 1.0, 0.5)
    ring_mesh.apply_translation((0, 0, 1))
    sheet = trimesh.Trimesh([[0, 0, 1], [1, 0, 1], [1, 1, 1]], [[0, 2, 1]])  # looks down
    panels = plot_volume(make_image(VOLUME), blocks(VOLUME), [ring_mesh, sheet]).axes[:3]
    outer, inner, triangle = sorted((shapely.Polygon(points).area for points in silhouettes(panels[0])), reverse=True)
    assert outer == pytest.approx(np.pi, rel=0.01)  # of 32 facets
    assert inner == pytest.approx(np.pi / 4, rel=0.01)
    assert triangle == pytest.approx(0.5)
    assert len(silhouettes(panels[1])) == 1  # seen edge-on the sheet covers nothing


def drawn_edges(mesh):
    view = plot_volume(make_image(VOLUME), blocks(VOLUME), [mesh]).axes[-1]
    (lines,) = [item for item in view.collections if isinstance(item, Line3DCollection)]
    return np.array(lines._segments3d)


def test_edges_show_the_shape_not_the_triangles():
    edges = drawn_edges(make_mesh())
    assert len(edges) == 12  # and none of the six diagonals
    assert (np.count_nonzero(np.ptp(edges, axis=1) > 1e-9, axis=1) == 1).all()
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    circle = drawn_edges(ball)
    elevation, azimuth = np.deg2rad(VIEW_DEG)
    toward = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    assert 40 < len(circle) < 0.1 * len(ball.edges_unique)
    assert np.abs(circle @ toward).max() < 0.1  # about the longest edge of a ball of 1 m
    sheet = trimesh.Trimesh([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], [[0, 1, 2], [0, 2, 3]])
    assert len(drawn_edges(sheet)) == 4


def test_an_empty_volume_says_so():
    view = FIGURES["empty volume"]().axes[-1]
    assert view.get_title() == "No voxel is occupied"
    assert not view.collections


@pytest.mark.parametrize("method", ["mvla-gr", "bp"])
def test_a_score_of_zeros_is_drawn(tmp_path, method):
    image = make_image(VOLUME, method, score=np.zeros(VOLUME.shape, np.float32))
    save_figure(plot_volume(image, blocks(VOLUME)), tmp_path / "zeros.png")
    assert imread(tmp_path / "zeros.png").size


def test_masks_of_another_shape_are_refused():
    other = np.zeros((1, 2, 2), bool)
    with pytest.raises(DataError, match=r"occupied has shape \(1, 2, 2\), the grid \(1, 20, 30\)"):
        plot_measured(make_image(PLANE), other, CAR)
    with pytest.raises(DataError, match=r"occupied has shape \(1, 2, 2\), the grid \(10, 14, 24\)"):
        plot_volume(make_image(VOLUME), other)
