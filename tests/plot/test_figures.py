"""Pictures show the data they are given, in its place, readable, for the smallest inputs too."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_rgba
from matplotlib.image import imread
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.text import Text
from plot_data import (
    SQUARE,
    check_texts,
    circle,
    curve_table,
    make_grid,
    make_image,
    make_masks,
    make_profiles,
    square_scene,
)

from mvla_sim.errors import DataError
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.plot.curves import plot_curves
from mvla_sim.plot.drawing import FALSE, HIT, MISS, angle_axis, angle_cells
from mvla_sim.plot.image_figures import plot_comparison, plot_image, score_caption
from mvla_sim.plot.scene_figures import plot_scene
from mvla_sim.plot.style import PNG_DPI, save_figure
from mvla_sim.plot.waterfall import plot_waterfall
from mvla_sim.scene.views import Views


def comparison(title="Comparison"):
    grid = make_grid()
    images = [make_image(grid), make_image(grid, support=False, method="bp", scale=30)]
    truth, occupied = make_masks(grid)
    return plot_comparison(
        images,
        [truth, None],
        [occupied, occupied],
        ["MVLA-GR", "BP"],
        title=title,
        captions=[score_caption(-20.31, "optimal"), score_caption(np.nan, "auto")],
    )


FIGURES = {
    "scene": lambda: plot_scene(square_scene(), make_masks(make_grid())[0], make_grid()),
    "scene without grid": lambda: plot_scene(square_scene("trajectory.interval_deg=30")),
    "waterfall": lambda: plot_waterfall(make_profiles(36)[0], circle(np.arange(0, 360, 10)), make_profiles(36)[1], "A"),
    "waterfall alone": lambda: plot_waterfall(make_profiles(5)[0], circle(np.array([0, 3, 50, 51, 52]))),
    "waterfall of one view": lambda: plot_waterfall(make_profiles(1)[0], circle(np.array([90])), make_profiles(1)[1]),
    "image": lambda: plot_image(make_image(make_grid()), *make_masks(make_grid())),
    "image with a long title": lambda: plot_image(
        make_image(make_grid(), support=False),
        None,
        make_masks(make_grid())[0],
        "View-normalised backprojection, 360 views\nCD = −20.3 dB(m²), best thresholds, found with the truth",
    ),
    "image without support": lambda: plot_image(
        make_image(make_grid(), support=False), None, make_masks(make_grid())[0]
    ),
    "image of a wide grid": lambda: plot_image(make_image(make_grid(30, 6)), *make_masks(make_grid(30, 6))),
    "image with layers": lambda: plot_image(make_image(make_grid(nz=3)), *make_masks(make_grid(nz=3)), layer=2),
    "score alone": lambda: plot_image(make_image(make_grid(), support=False, method="bp")),
    "comparison": comparison,
    "comparison without title": lambda: comparison(""),
    "curves": lambda: plot_curves(
        curve_table(),
        "x",
        "y",
        "snr",
        style="method",
        by_format="SNR {} dB",
        x_label="angular interval (°)",
        log_x=True,
    ),
    "one curve": lambda: plot_curves(curve_table()[:4], "x", "y", title="A curve"),
}


@pytest.mark.parametrize("name", FIGURES)
def test_every_text_is_inside_the_figure_and_clear_of_the_others(name):
    check_texts(FIGURES[name]())


@pytest.mark.parametrize("name", FIGURES)
def test_files_repeat_byte_for_byte(tmp_path, name):
    for file in ("one.png", "other.png"):
        save_figure(FIGURES[name](), tmp_path / file)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "other.png").read_bytes()
    pixels = imread(tmp_path / "one.png")
    expected = FIGURES[name]().get_size_inches() * PNG_DPI
    assert np.abs(np.array(pixels.shape[1::-1]) - expected).max() <= 1  # rounded to whole pixels
    assert np.ptp(pixels[..., :3]) > 0.5


@pytest.mark.parametrize("name", ["scene", "waterfall", "image", "curves"])
@pytest.mark.parametrize(("suffix", "header"), [(".pdf", b"%PDF-"), (".svg", b"<?xml")])
def test_vector_files(tmp_path, name, suffix, header):
    save_figure(FIGURES[name](), tmp_path / f"figure{suffix}")
    assert (tmp_path / f"figure{suffix}").read_bytes().startswith(header)


# --- scene ---


@pytest.mark.parametrize("interval", [1, 30, 360])
def test_scene_has_a_dot_for_each_view_and_the_grids_frame(interval):
    scene, grid = square_scene(f"trajectory.interval_deg={interval}"), make_grid(6, 4)
    axes = plot_scene(scene, grid=grid).axes[0]
    np.testing.assert_array_equal(np.transpose(axes.lines[0].get_data()), scene.views.positions_m[:, :2])
    np.testing.assert_array_equal(np.transpose(axes.lines[1].get_data()), scene.views.positions_m[:1, :2])
    frame = next(patch for patch in axes.patches if isinstance(patch, Rectangle))
    assert frame.get_bbox().bounds == (-1.5, -1.0, 3.0, 2.0)
    low_x, high_x = axes.get_xlim()
    assert low_x < scene.views.positions_m[:, 0].min()
    assert high_x > scene.views.positions_m[:, 0].max()


@pytest.mark.parametrize(
    ("overrides", "sense"),
    [(["trajectory.interval_deg=5"], 1), (["trajectory={kind='turntable', sensor_m=[9,0,0], interval_deg=5}"], -1)],
)
def test_arrow_points_the_way_the_views_go(overrides, sense):
    axes = plot_scene(square_scene(*overrides)).axes[0]
    (arrow,) = [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]
    path = axes.transData.inverted().transform_path(arrow.get_transform().transform_path(arrow.get_path()))
    (x0, y0), (x1, y1) = path.vertices[0], path.vertices[len(path.vertices) // 3]
    assert sense * (x0 * y1 - y0 * x1) > 0


def test_one_view_has_no_direction():
    axes = plot_scene(square_scene("trajectory.interval_deg=360")).axes[0]
    assert not [patch for patch in axes.patches if isinstance(patch, FancyArrowPatch)]


# --- waterfall ---


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(0, 3599), min_size=1, max_size=40, unique=True))
def test_each_view_has_its_own_cell_about_its_angle(tenths):
    views = circle(np.array(tenths) / 10)
    order, place, _ = angle_axis(views)
    edges, shown = angle_cells(place)
    assert sorted(order) == list(range(len(tenths)))
    np.testing.assert_allclose(np.mod(place, 360), views.angles_deg[order], atol=1e-9)  # degrees, of rounding
    assert (np.diff(place) > 0).all()
    assert (np.diff(edges) > 0).all()
    assert list(shown[shown >= 0]) == list(range(len(tenths)))
    full = shown >= 0
    assert (edges[:-1][full] <= place + 1e-9).all()
    assert (place <= edges[1:][full] + 1e-9).all()


@settings(deadline=None, max_examples=5)
@given(st.permutations(range(6)))
def test_the_order_in_the_file_does_not_matter(order):
    angles = np.array([0.0, 10.0, 25.0, 30.0, 200.0, 205.0])
    pdp, peaks = make_profiles(6)
    order = np.array(order)
    pictures = []
    for index in (np.arange(6), order):
        figure = plot_waterfall(pdp.select(index), circle(angles).select(index), peaks.select(index))
        figure.canvas.draw()
        pictures.append(np.asarray(figure.canvas.buffer_rgba()).copy())
    np.testing.assert_array_equal(*pictures)


def test_an_arc_across_zero_stays_in_one_piece():
    _, place, label = angle_axis(circle(np.arange(-40, 41, 10)))
    np.testing.assert_allclose(place, np.arange(-40, 41, 10), atol=1e-9)  # degrees, of rounding
    assert label == "view angle (°)"


def test_views_at_one_angle_are_counted():
    positions = np.array([[4.0, 0, 0], [5.0, 0, 0], [0, 5.0, 0]])
    _, place, label = angle_axis(Views(positions, np.array([0.0, 0.0, 90.0]), (0.0, 0.0)))
    np.testing.assert_array_equal(place, [0, 1, 2])
    assert "order" in label


def test_wide_gaps_stay_blank_and_peaks_lie_on_their_profiles():
    pdp, peaks = make_profiles(6)
    views = circle(np.array([155.0, 30.0, 25.0, 20.0, 150.0, 160.0]))
    figure = plot_waterfall(pdp, views, peaks)
    mesh = figure.axes[0].collections[0]
    shown = np.ma.filled(mesh.get_array(), np.nan)  # [n_range, n_cell] dB
    assert shown.shape == (20, 7)
    assert np.isnan(shown[:, 3]).all()
    assert np.isfinite(np.delete(shown, 3, axis=1)).all()
    expected = 10 * np.log10(np.array([4, 3, 2, np.nan, 5, 1, 6]) / 6)
    np.testing.assert_allclose(shown[7], expected, atol=1e-9)  # dB, of rounding
    dots = np.transpose(figure.axes[1].lines[0].get_data())
    np.testing.assert_allclose(dots, np.stack([views.angles_deg, peaks.range_m], axis=1), atol=1e-9)


def test_waterfall_refuses_what_does_not_fit():
    pdp, peaks = make_profiles(4)
    views = circle(np.arange(0.0, 40, 10))
    with pytest.raises(DataError, match="4 profiles, 3 views"):
        plot_waterfall(pdp, views.select(np.arange(3)))
    with pytest.raises(DataError, match="peaks of 2 views"):
        plot_waterfall(pdp, views, peaks.select(np.arange(2)))
    with pytest.raises(DataError, match="must be above 0"):
        plot_waterfall(Pdp(-(pdp.power[:, :3] ** 2), None, 2.0, 0.1, 0.2, 1.5), views)
    with pytest.raises(DataError, match="below 0"):
        plot_waterfall(pdp, views, floor_db=0)


# --- images ---


def color_at(figure, axes, x, y):
    pixels = np.asarray(figure.canvas.buffer_rgba())
    column, row = axes.transData.transform((x, y))
    return tuple(pixels[pixels.shape[0] - 1 - int(row), int(column)].tolist())


def rgba8(color):
    return tuple(round(255 * part) for part in to_rgba(color))


def test_voxels_are_drawn_where_they_are_in_the_colour_of_their_class():
    grid = make_grid(5, 3)
    truth, occupied = make_masks(grid)
    assert {(True, True), (True, False), (False, True), (False, False)} == set(zip(truth.flat, occupied.flat))  # noqa: B905
    figure = plot_image(make_image(grid, outline=None), truth, occupied)
    figure.canvas.draw()
    colors = {(True, True): HIT, (True, False): MISS, (False, True): FALSE, (False, False): "white"}
    for n, (x, y, _) in enumerate(grid.centers()):
        assert color_at(figure, figure.axes[2], x, y) == rgba8(colors[truth.flat[n], occupied.flat[n]])


def test_score_map_is_not_flipped():
    grid = make_grid(6, 4)
    score = np.zeros(grid.shape, np.float32)
    score[0, 3, 1] = 1.0  # y = 0.75 m, x = −0.75 m
    figure = plot_image(Image(score, None, grid, "bp", 4))
    figure.canvas.draw()
    colors = np.array([sum(color_at(figure, figure.axes[0], x, y)[:3]) for x, y, _ in grid.centers()])
    assert colors.argmax() == 3 * 6 + 1


@pytest.mark.parametrize("support", [True, False])
@pytest.mark.parametrize("binary", [True, False])
def test_a_panel_for_each_thing_there_is(support, binary):
    grid = make_grid()
    figure = plot_image(make_image(grid, support), occupied=make_masks(grid)[0] if binary else None)
    expected = ["Score", *["Angular support"] * support, *["Binary image"] * binary]
    assert [axes.get_title() for axes in figure.axes] == expected


def test_the_binary_image_inside_an_image_is_the_default():
    grid = make_grid()
    _, occupied = make_masks(grid)
    inside = Image(np.ones(grid.shape, np.float32), None, grid, "bp", 1, occupied=occupied)
    drawn = plot_image(inside).axes[-1].images[0].get_array()
    np.testing.assert_array_equal(drawn[..., 3] > 0, occupied[0])


def test_layers():
    grid = make_grid(nz=3)
    image = make_image(grid)
    for layer, index in ((None, 1), (0, 0), (2, 2)):
        shown = plot_image(image, layer=layer).axes[0].images[0].get_array()
        np.testing.assert_array_equal(shown, image.score[index])
    with pytest.raises(DataError, match=r"layer = 3; allowed: 0 to 2"):
        plot_image(image, layer=3)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_one_voxel(tmp_path, value):
    grid = make_grid(1, 1)
    full = np.full(grid.shape, value, np.float32)
    mask = np.full(grid.shape, value > 0)
    save_figure(plot_image(Image(full, full, grid, "mvla-gr", 1), mask, mask), tmp_path / "figure.png")
    assert imread(tmp_path / "figure.png").size


def test_outlines_keep_their_holes_and_parts():
    ring = SQUARE.difference(shapely.box(-0.5, -0.5, 0.5, 0.5)).union(shapely.box(1.4, 1.4, 1.6, 1.6))
    grid = make_grid()
    axes = plot_image(make_image(grid, outline=ring), occupied=make_masks(grid)[0]).axes[-1]
    path = axes.patches[0].get_path()
    assert (path.codes == path.MOVETO).sum() == 3


def test_dollars_in_names_are_no_formulas(tmp_path):
    save_figure(plot_image(make_image(make_grid()), title="cost $x^{ in $"), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").exists()


def test_masks_of_another_shape_are_refused():
    grid, other = make_grid(), np.zeros((1, 2, 2), bool)
    image = make_image(grid)
    for call in (
        lambda: plot_image(image, truth=other),
        lambda: plot_image(image, occupied=other),
        lambda: plot_comparison([image], [other], [make_masks(grid)[0]], ["a"]),
        lambda: plot_scene(square_scene("trajectory.interval_deg=90"), other, grid),
    ):
        with pytest.raises(DataError, match=r"has shape \(1, 2, 2\), the grid \(1, 8, 8\)"):
            call()
    with pytest.raises(DataError, match="without its grid"):
        plot_scene(square_scene("trajectory.interval_deg=90"), other)


# --- comparison ---


def test_comparison_writes_the_distances_and_says_what_is_missing():
    grid = make_grid()
    images = [make_image(grid), make_image(grid, support=False, method="bp"), make_image(grid)]
    masks = [make_masks(grid)[0]] * 3
    figure = plot_comparison(
        images, masks, masks, ["a", "b", "c"], captions=[*map(score_caption, (-20.34, np.nan, -np.inf))]
    )
    texts = {text.get_text() for text in figure.findobj(Text)}
    assert {"a", "b", "c", "CD = −20.3 dB(m²)", "CD undefined", "CD = −∞ dB(m²)", "no angular support"} <= texts
    without = plot_comparison(images[1:2], masks[:1], masks[:1], ["b"])
    assert len(without.axes) == 2  # score and binary image


def test_comparison_refuses_lists_of_different_lengths():
    image, (truth, occupied) = make_image(make_grid()), make_masks(make_grid())
    with pytest.raises(DataError, match="1 images, 2 truths"):
        plot_comparison([image], [truth, truth], [occupied], ["a"])
    with pytest.raises(DataError, match="0 captions"):
        plot_comparison([image], [truth], [occupied], ["a"], captions=[])
    with pytest.raises(DataError, match="at least 1"):
        plot_comparison([], [], [], [])


# --- curves ---


def test_a_line_for_each_group_sorted_along_x():
    axes = plot_curves(curve_table(), "x", "y", "snr", style="method").axes[0]
    assert len(axes.lines) == 6
    for line in axes.lines:
        np.testing.assert_array_equal(line.get_xdata(), [1, 5, 10, 30])
        np.testing.assert_allclose(np.diff(line.get_ydata()), [4, 5, 20], atol=1e-9)  # dB, of rounding
    assert len({to_rgba(line.get_color()) for line in axes.lines}) == 3
    assert len({line.get_linestyle() for line in axes.lines}) == 2


def test_numbers_get_lighter_colours_as_they_rise():
    figure = plot_curves(curve_table()[:12], "x", "y", "snr", by_format="SNR {} dB")
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["SNR 0 dB", "SNR 10 dB", "SNR 20 dB"]
    light = [
        to_rgba(line.get_color())[:3] @ np.array([0.2126, 0.7152, 0.0722]) for line in figure.legends[0].get_lines()
    ]
    assert (np.diff(light) > 0.05).all()  # visibly different in grey


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_without_a_place_leave_a_gap(bad):
    data = curve_table()[:4].assign(y=[1.0, 2.0, bad, 4.0], lo=[0.0, 1.0, bad, 3.0], hi=[2.0, 3.0, bad, 5.0])
    axes = plot_curves(data, "x", "y", low="lo", high="hi").axes[0]  # x = 30, 1, 5, 10: the third is at 5
    np.testing.assert_array_equal(np.isnan(axes.lines[0].get_ydata()), [False, True, False, False])
    inside = [path.contains_point((5.0, 2.5)) for path in axes.collections[0].get_paths()]
    assert not any(inside)
    low, high = axes.get_ylim()
    assert np.isfinite([low, high]).all()


def test_missing_group_values_are_a_group_of_their_own():
    data = curve_table()[:12].assign(snr=lambda frame: frame.snr.replace(0, np.nan))
    figure = plot_curves(data, "x", "y", "snr", by_format="{} dB")
    assert len(figure.axes[0].lines) == 3
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["10 dB", "20 dB", "none"]


def test_curves_refuse_what_does_not_fit():
    data = curve_table()
    with pytest.raises(DataError, match=r"no column 'q'; it has method"):
        plot_curves(data, "x", "q")
    with pytest.raises(DataError, match=r"several rows have x = \d+, method"):
        plot_curves(data, "x", "y", "method")
    with pytest.raises(DataError, match="no rows"):
        plot_curves(data[:0], "x", "y")
    with pytest.raises(DataError, match="needs both"):
        plot_curves(data[:4], "x", "y", low="lo")
    with pytest.raises(DataError, match="logarithmic"):
        plot_curves(data[:4].assign(x=[0, 1, 2, 3]), "x", "y", log_x=True)
