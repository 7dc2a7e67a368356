"""Rasterised ground truth: against the obvious test of every voxel, and its symmetries."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import LineString, MultiPolygon, Point, Polygon, box

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.evaluation.evaluate import EvaluationSettings, ground_truth
from mvla_sim.evaluation.ground_truth import TruthGeometry, check_inside, rasterize
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image

KINDS = ("contour", "filled")


def layer(nx, ny=None, spacing=0.5, center=(0.0, 0.0, 0.0)):
    return VoxelGrid(center, (nx, ny or nx, 1), spacing)


def every_voxel(outline, grid, kind):
    """The definition, tested on every voxel; outlines on voxel edges are left to other tests."""
    half = grid.spacing_m / 2
    x, y = grid.centers()[:, :2].T
    squares = shapely.box(x - half, y - half, x + half, y + half)
    mask = shapely.intersects(squares, shapely.boundary(outline))
    if kind == "filled":
        mask |= shapely.intersects_xy(outline, x, y)
    return mask.reshape(grid.shape)


@st.composite
def outlines(draw):
    """A star-like polygon with irrational-looking corners, sometimes with a hole or a second part."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 12)))
    radius = rng.uniform(0.6, 2.4, angle.size)
    polygon = Polygon(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)).buffer(0)
    if rng.random() < 0.5:
        polygon = polygon.difference(Point(rng.uniform(-0.3, 0.3, 2)).buffer(rng.uniform(0.1, 0.5)))
    if rng.random() < 0.5:
        polygon = polygon.union(Point(2.9, 2.9).buffer(0.07))
    return polygon


@pytest.mark.parametrize("kind", KINDS)
@given(outline=outlines(), counts=st.tuples(st.integers(13, 40), st.integers(13, 40)))
@settings(max_examples=40, deadline=None)
def test_it_is_the_definition_applied_to_every_voxel(kind, outline, counts):
    grid = VoxelGrid((0.013, -0.027, 0.4), (*counts, 1), 6.5 / min(counts))
    np.testing.assert_array_equal(rasterize(outline, grid, kind), every_voxel(outline, grid, kind))


@given(outline=outlines(), count=st.integers(13, 40), turns=st.integers(1, 3))
@settings(max_examples=40, deadline=None)
def test_a_quarter_turn_commutes_with_rasterising(outline, count, turns):
    grid = layer(count, spacing=6.5 / count)
    turned = affinity.rotate(outline, 90 * turns, origin=(0, 0))
    for kind in KINDS:
        # y is the rows' axis and rises with the index, so a counter-clockwise turn is rot90 from y to x
        expected = np.rot90(rasterize(outline, grid, kind)[0], -turns)
        np.testing.assert_array_equal(rasterize(turned, grid, kind)[0], expected)


@given(outline=outlines(), count=st.integers(13, 60))
@settings(max_examples=40, deadline=None)
def test_filled_holds_the_contour_and_its_size_is_the_area(outline, count):
    grid = layer(count, spacing=6.5 / count)
    contour, filled = (rasterize(outline, grid, kind) for kind in KINDS)
    assert not np.any(contour & ~filled)
    area, cell = outline.area, grid.spacing_m**2
    # voxels off the contour lie wholly inside or outside, so the two counts bracket the area
    assert np.count_nonzero(filled & ~contour) * cell <= area * (1 + 1e-9)
    assert np.count_nonzero(filled) * cell >= area * (1 - 1e-9)


def test_a_square_through_voxel_centres_is_one_voxel_thick():
    mask = rasterize(box(-2, -2, 2, 2), layer(11), "contour")[0]
    expected = np.zeros((11, 11), bool)
    expected[1:-1, 1:-1] = True
    expected[2:-2, 2:-2] = False
    np.testing.assert_array_equal(mask, expected)


@pytest.mark.parametrize("spacing", [0.5, 0.05, 0.1, 1 / 3, 0.07])
def test_a_square_on_voxel_edges_touches_both_sides_everywhere(spacing):
    """Rounding must not decide: 0.05 has no exact binary form, and edge coordinates carry its error."""
    side = 6 * spacing
    mask = rasterize(box(-side, -side, side, side), layer(20, spacing=spacing), "contour")[0]
    expected = np.zeros((20, 20), bool)
    expected[3:17, 3:17] = True
    expected[5:15, 5:15] = False
    np.testing.assert_array_equal(mask, expected)


def test_a_square_on_the_edge_of_the_grid_is_inside_it():
    grid = layer(8)
    square = box(-2, -2, 2, 2)
    check_inside(square, grid)
    mask = rasterize(square, grid, "contour")[0]
    assert mask[0].all()
    assert mask[:, -1].all()
    assert not mask[1:-1, 1:-1].any()
    assert rasterize(square, grid, "filled").all()


def test_a_hole_and_two_parts_are_left_as_they_are():
    ring = box(-2, -2, 2, 2).difference(box(-1.1, -1.1, 1.1, 1.1))
    far = box(3.05, 3.05, 3.95, 3.95)
    grid = layer(41, spacing=0.2)
    both = rasterize(MultiPolygon([ring, far]), grid, "filled")
    np.testing.assert_array_equal(both, rasterize(ring, grid, "filled") | rasterize(far, grid, "filled"))
    assert not both[0, 20, 20]
    assert both[0, 20, 20 + 8]


def test_an_outline_smaller_than_a_voxel_is_that_voxel():
    mask = rasterize(Point(0.02, -0.03).buffer(0.01), layer(5), "contour")
    assert np.flatnonzero(mask).tolist() == [12]


def test_the_direction_and_start_of_the_ring_do_not_matter():
    corners = [(-2.1, -1.3), (1.9, -1.7), (2.2, 1.1), (-0.4, 2.3)]
    expected = rasterize(Polygon(corners), layer(21, spacing=0.3), "filled")
    for shifted in (corners[2:] + corners[:2], corners[::-1]):
        np.testing.assert_array_equal(rasterize(Polygon(shifted), layer(21, spacing=0.3), "filled"), expected)


@pytest.mark.parametrize(
    ("shift", "words"),
    [((1.5, 0), ["0.5 m at +x"]), ((-3.25, 0), ["2.25 m at -x"]), ((0, 9), ["8 m at +y"]), ((1.2, -1.1), ["+x", "-y"])],
)
def test_a_truth_outside_the_grid_is_refused_with_metres_and_side(shift, words):
    square = affinity.translate(box(-4, -4, 4, 4), *shift)
    with pytest.raises(DataError) as error:
        check_inside(square, layer(20))
    assert all(word in str(error.value) for word in [*words, "size_m"])
    with pytest.raises(DataError, match="sticks out"):
        rasterize(square, layer(20), "contour")


@pytest.mark.parametrize(
    ("outline", "words"),
    [
        (Polygon(), "empty"),
        (LineString([(0, 0), (1, 1)]), "LineString"),
        (Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "Self-intersection"),
    ],
)
def test_an_outline_that_is_no_area_is_refused(outline, words):
    with pytest.raises(DataError, match=words):
        rasterize(outline, layer(10), "contour")


def test_layers_and_kinds_are_refused():
    with pytest.raises(DataError, match="3 layers"):
        rasterize(box(-1, -1, 1, 1), VoxelGrid((0, 0, 0), (10, 10, 3), 0.5), "contour")
    with pytest.raises(DataError, match="solid"):
        rasterize(box(-1, -1, 1, 1), layer(10), "solid")


@given(seed=st.integers(0, 2**32 - 1), counts=st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 3)))
@settings(max_examples=40, deadline=None)
def test_truth_geometry_holds_the_distances_it_says(seed, counts):
    grid = VoxelGrid((0, 0, 0), counts, 0.5)
    truth = np.random.default_rng(seed).random(grid.shape) < 0.2
    truth.flat[seed % grid.size] = True
    geometry = TruthGeometry.build(truth, grid)
    centers = grid.centers() / grid.spacing_m
    table = ((centers[:, None] - centers[geometry.voxels][None]) ** 2).sum(axis=-1)  # [N, U]
    np.testing.assert_allclose(geometry.squared, table.min(axis=1), atol=1e-9)  # rounding of the voxel centres
    for u in range(geometry.voxels.size):
        inside = geometry.neighbours[:, u] < grid.size
        near = geometry.neighbours[inside, u]
        assert np.unique(near).size == near.size
        assert np.all(np.diff(table[near, u]) >= -1e-9)
        assert near.size == np.count_nonzero(table[:, u] < geometry.cap - 0.5)


def test_truth_geometry_refuses_other_shapes_and_empty_truths():
    grid = layer(4)
    with pytest.raises(DataError, match=r"\(4, 4\)"):
        TruthGeometry.build(np.ones((4, 4), bool), grid)
    with pytest.raises(DataError, match="no voxel"):
        TruthGeometry.build(np.zeros(grid.shape, bool), grid)


@given(outline=outlines(), count=st.integers(13, 40), thickness=st.floats(0.01, 1.0))
@settings(max_examples=40, deadline=None)
def test_a_thick_contour_is_the_definition_applied_to_every_voxel(outline, count, thickness):
    grid = layer(count, spacing=7.5 / count)
    x, y = grid.centers()[:, :2].T
    near = shapely.distance(shapely.boundary(outline), shapely.points(x, y)).reshape(grid.shape)
    expected = every_voxel(outline, grid, "contour") | (near <= thickness / 2)
    mask = rasterize(outline, grid, "contour", thickness)
    sure = np.abs(near - thickness / 2) > 1e-5 * grid.spacing_m  # a centre on the rim is left to the next test
    np.testing.assert_array_equal(mask[sure], expected[sure])
    assert not np.any(rasterize(outline, grid, "contour") & ~mask)


@pytest.mark.parametrize(("thickness", "rows"), [(0.0, 1), (0.05, 1), (0.1, 3), (0.19, 3), (0.2, 5), (0.3, 7)])
def test_a_straight_side_is_as_thick_as_it_is_told(thickness, rows):
    """The side runs through voxel centres, 5 cm apart: centres at multiples of 5 cm from it, those on the rim too."""
    grid = layer(61, spacing=0.05)
    mask = rasterize(box(-1, -1, 1, 1), grid, "contour", thickness)[0]
    assert np.count_nonzero(mask[:30, 30]) == rows


def test_a_contour_no_thicker_than_nothing_is_the_contour():
    outline, grid = Point(0.1, 0.2).buffer(1.7), layer(40, spacing=0.1)
    np.testing.assert_array_equal(rasterize(outline, grid, "contour", 0.0), rasterize(outline, grid, "contour"))


@pytest.mark.parametrize(("kind", "thickness"), [("filled", 0.1), ("contour", -0.1), ("contour", np.nan)])
def test_thicknesses_that_are_none_are_refused(kind, thickness):
    with pytest.raises(DataError, match="thickness_m = ") as error:
        rasterize(box(-1, -1, 1, 1), layer(20), kind, thickness)
    assert "\n" not in str(error.value)


def test_a_contour_whose_thickness_leaves_the_grid_is_refused():
    """The square's side is 0.1 m from the grid's edge: 0.2 m of thickness fit, 0.3 m do not."""
    grid = layer(42, spacing=0.1)
    rasterize(box(-2, -2, 2, 2), grid, "contour", 0.2)
    with pytest.raises(DataError, match=r"with a thickness of 0\.3 m it sticks out of the grid by 0\.05 m at -x"):
        rasterize(box(-2, -2, 2, 2), grid, "contour", 0.3)


def test_an_evaluation_is_against_the_thick_contour_and_a_filled_one_has_none():
    grid = layer(61, spacing=0.05)
    image = Image(np.ones(grid.shape, np.float32), None, grid, "bp", 3, outline=box(-1, -1, 1, 1))
    thick = ground_truth(image, EvaluationSettings(thickness_m=0.2))
    np.testing.assert_array_equal(thick, rasterize(box(-1, -1, 1, 1), grid, "contour", 0.2))
    for settings_, words in (
        ({"truth": "filled", "thickness_m": 0.1}, "thickness_m = 0.1: is of a contour; with truth = 'filled' give 0"),
        ({"thickness_m": -0.1}, "thickness_m = -0.1: should be greater than or equal to 0"),
    ):
        with pytest.raises(ConfigError) as error:
            EvaluationSettings(**settings_)
        assert words in str(error.value)
        assert "\n" not in str(error.value)
