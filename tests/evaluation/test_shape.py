"""The smallest rectangle around an image: what was drawn comes back, whatever its place and direction."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.evaluation.boxes import Box, bounding_box, box_of_outline, largest_parts
from mvla_sim.grid import VoxelGrid

SPACING = 0.05
GRID = VoxelGrid((0.3, -0.2, 0.5), (160, 160, 1), SPACING)
DIAGONAL = math.sqrt(2) * SPACING


def rectangle(length, width, angle_deg, center=(0.0, 0.0)):
    shape = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    return shapely.affinity.translate(shapely.affinity.rotate(shape, angle_deg, origin=(0, 0)), *center)


def fill(shape, grid=GRID):
    """Voxels whose centre the shape covers."""
    x, y, _ = grid.centers().T
    return shapely.contains_xy(shape, x, y).reshape(grid.shape)


def turn(a_deg, b_deg):
    """Angle between two directions without an arrow, degrees, in [0, 90]."""
    return abs((a_deg - b_deg + 90) % 180 - 90)


def lone(*places, grid=GRID):
    mask = np.zeros(grid.shape, bool)
    for y, x in places:
        mask[0, y, x] = True
    return mask


sizes = st.tuples(st.floats(0.5, 5.0), st.floats(0.5, 5.0))
angles = st.floats(-180, 180)
centers = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


@given(sides=sizes, angle=angles, center=centers)
def test_a_turned_rectangle_is_recovered_from_its_outline(sides, angle, center):
    length, width = max(sides), min(sides)
    assume(length > 1.001 * width)  # else there is no long side
    box = box_of_outline(rectangle(length, width, angle, center))
    assert box.length_m == pytest.approx(length, abs=1e-9)  # metres, of rounding
    assert box.width_m == pytest.approx(width, abs=1e-9)
    assert box.aspect == pytest.approx(length / width, abs=1e-6)
    assert box.center_m == pytest.approx(center, abs=1e-9)
    assert turn(box.orientation_deg, angle) < 1e-4  # degrees, of rounding
    assert -90 < box.orientation_deg <= 90


@given(sides=sizes, angle=angles, center=centers)
def test_a_turned_rectangle_is_recovered_from_its_voxels(sides, angle, center):
    length, width = max(sides), min(sides)
    assume(length > 1.2 * width + 2 * DIAGONAL)  # else rounding may exchange the sides
    box = bounding_box(fill(rectangle(length, width, angle, center)), GRID)
    # A square whose centre is inside reaches at most half a diagonal beyond a side, and every point half a diagonal
    # inside lies in such a square. So the box holds a rectangle smaller by a diagonal, turned by some angle, and is no
    # larger than one larger by a diagonal; a box turned by δ needs (l² + w²)·sin(2δ)/2 more than l·w.
    (low_l, low_w), (high_l, high_w) = ((length + d, width + d) for d in (-DIAGONAL, DIAGONAL))
    assert low_l * low_w <= box.length_m * box.width_m <= high_l * high_w + 1e-9
    sine = 2 * (high_l * high_w - low_l * low_w) / (low_l**2 + low_w**2)
    assert turn(box.orientation_deg, angle) <= math.degrees(math.asin(min(1, sine))) / 2 + 1e-6
    # a diagonal of rounding, and as much again for the turn that it leaves open
    assert box.length_m == pytest.approx(length, abs=2 * DIAGONAL)
    assert box.width_m == pytest.approx(width, abs=2 * DIAGONAL)
    assert box.center_m == pytest.approx(center, abs=DIAGONAL)
    assert -90 < box.orientation_deg <= 90


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.001, 0.5))
def test_every_square_lies_inside_and_no_direction_needs_less(seed, share):
    rng = np.random.default_rng(seed)
    grid = VoxelGrid((1.0, 2.0, 0.0), (int(rng.integers(1, 12)), int(rng.integers(1, 12)), 1), 0.5)
    mask = rng.random(grid.shape) < share
    mask.flat[rng.integers(grid.size)] = True
    box = bounding_box(mask, grid)
    half = grid.spacing_m / 2
    x, y, _ = grid.centers(np.flatnonzero(mask)).T
    corners = np.concatenate([np.stack([x + a, y + b], axis=-1) for a in (-half, half) for b in (-half, half)])
    edge = box.corners_m - np.asarray(box.center_m)
    for axis, extent in ((edge[0] + edge[3], box.length_m), (edge[0] + edge[1], box.width_m)):
        along = (corners - box.center_m) @ axis / np.linalg.norm(axis)
        assert np.abs(along).max() == pytest.approx(extent / 2, abs=1e-9)  # metres, of rounding
    swept = np.deg2rad(np.arange(0, 90, 0.5))
    spans = [np.ptp(corners @ [np.cos(swept + turned), np.sin(swept + turned)], axis=0) for turned in (0, np.pi / 2)]
    assert box.length_m * box.width_m <= (spans[0] * spans[1]).min() + 1e-9
    shape = shapely.minimum_rotated_rectangle(shapely.multipoints(corners))
    assert box.length_m * box.width_m == pytest.approx(shape.area, abs=1e-6)


def test_an_upright_block_is_exact():
    grid = VoxelGrid((0.0, 0.0, 0.0), (20, 20, 1), 0.25)
    mask = np.zeros(grid.shape, bool)
    mask[0, 3:9, 2:6] = True
    assert bounding_box(mask, grid) == Box((-1.5, -1.0), 1.5, 1.0, 90.0)
    assert bounding_box(np.swapaxes(mask, 1, 2), grid) == Box((-1.0, -1.5), 1.5, 1.0, 0.0)


def test_one_voxel_is_a_square():
    grid = VoxelGrid((1.0, 2.0, 0.0), (1, 1, 1), 0.25)
    box = bounding_box(np.ones(grid.shape, bool), grid)
    assert box == Box((1.0, 2.0), 0.25, 0.25, 0.0)
    assert box.aspect == 1.0


@pytest.mark.parametrize(("angle", "expected"), [(0, 0), (30, 30), (45, 45), (60, -30), (-45, 45), (90, 0)])
def test_a_square_points_along_the_side_nearest_to_the_x_axis(angle, expected):
    assert box_of_outline(rectangle(2, 2, angle)).orientation_deg == pytest.approx(expected, abs=1e-6)


def test_corners_go_round_the_box():
    box = box_of_outline(rectangle(4, 2, 30, (1, -1)))
    shape = shapely.Polygon(box.corners_m)
    assert shape.exterior.is_ccw
    assert shape.symmetric_difference(rectangle(4, 2, 30, (1, -1))).area < 1e-9  # m², of rounding


def test_layers_are_seen_from_above():
    grid = VoxelGrid((0.0, 0.0, 1.0), (10, 10, 3), 0.5)
    mask = np.zeros(grid.shape, bool)
    mask[0, 4, 1:5] = True
    mask[2, 4, 5:9] = True
    box = bounding_box(mask, grid)
    assert (box.length_m, box.width_m) == pytest.approx((4.0, 0.5))


def test_outlines_of_several_parts_have_one_box():
    parts = shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(3, 0, 4, 1)])
    assert box_of_outline(parts) == Box((2.0, 0.5), 4.0, 1.0, 0.0)


def test_a_lone_voxel_decides_the_box_only_if_it_may():
    mask = fill(rectangle(2.0, 1.0, 0.0))
    stray = mask | lone((150, 150))
    alone = bounding_box(mask, GRID)
    assert bounding_box(stray, GRID).length_m > 2 * alone.length_m
    assert bounding_box(stray, GRID, keep_area=0.99) == alone
    assert bounding_box(largest_parts(stray, 0.01), GRID) == alone


def test_the_parts_that_count_hold_the_share_and_equal_ones_stay_together():
    mask = np.zeros(GRID.shape, bool)
    mask[0, 10, 10:16] = True  # 6 of 10 voxels
    mask[0, 10, 20:22] = True  # 2
    mask[0, 10, 30:32] = True  # 2
    lengths = [bounding_box(mask, GRID, share).length_m / SPACING for share in (0.1, 0.6, 0.61, 0.8, 1.0)]
    assert lengths == pytest.approx([6, 6, 22, 22, 22])


def test_corners_connect_parts_and_small_ones_are_dropped():
    mask = lone((3, 3), (4, 4), (5, 3), (20, 20))
    assert largest_parts(mask, 0.5).sum() == 3
    np.testing.assert_array_equal(largest_parts(mask, 0.5), lone((3, 3), (4, 4), (5, 3)))
    for share in (0.0, 0.25):  # a part of exactly the share stays
        np.testing.assert_array_equal(largest_parts(mask, share), mask)
    assert not largest_parts(mask, 0.8).any()
    assert not largest_parts(np.zeros(GRID.shape, bool), 0.1).any()


def test_layers_connect_parts():
    mask = np.zeros((3, 4, 4), bool)
    mask[0, 0, 0] = mask[1, 1, 1] = mask[2, 2, 2] = mask[0, 3, 3] = True
    kept = largest_parts(mask, 0.5)
    assert kept.sum() == 3
    assert not kept[0, 3, 3]


def test_what_has_no_box_is_refused():
    nothing = np.zeros(GRID.shape, bool)
    with pytest.raises(DataError, match="no voxel is occupied"):
        bounding_box(nothing, GRID)
    with pytest.raises(DataError, match=r"occupied has shape \(2, 2\), the grid \(1, 160, 160\)"):
        bounding_box(np.ones((2, 2), bool), GRID)
    for keep in (0.0, -1.0, 1.1, math.nan):
        with pytest.raises(ConfigError, match=r"keep_area = .*above 0 and at most 1"):
            bounding_box(~nothing, GRID, keep)
    for share in (-0.1, 1.1, math.nan):
        with pytest.raises(ConfigError, match=r"share = .*allowed: 0 to 1"):
            largest_parts(nothing, share)
    for outline in (shapely.Polygon(), shapely.LineString([(0, 0), (1, 1)]), shapely.Point(0, 0)):
        with pytest.raises(DataError, match="without an area"):
            box_of_outline(outline)
