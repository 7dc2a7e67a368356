"""Scores against double loops, closed forms and their symmetries."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.errors import DataError
from mvla_sim.evaluation.metrics import Scores, chamfer_db, score
from mvla_sim.grid import VoxelGrid

ROUNDING_DB = 1e-9  # far above float64 rounding of a mean of tens of squares, far below any dB shown


def double_loop(truth, reconstruction):
    """``eq:chamfer_ch4`` word for word."""
    forth = sum(min(sum((a - b) ** 2 for a, b in zip(x, y, strict=True)) for y in reconstruction) for x in truth)
    back = sum(min(sum((a - b) ** 2 for a, b in zip(x, y, strict=True)) for x in truth) for y in reconstruction)
    return 10 * math.log10(forth / len(truth) + back / len(reconstruction))


@st.composite
def point_sets(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return tuple(rng.uniform(-5, 5, (draw(st.integers(1, 20)), 3)) for _ in range(2))


@st.composite
def masks(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    counts = (draw(st.integers(2, 15)), draw(st.integers(1, 15)), draw(st.integers(1, 3)))
    grid = VoxelGrid((1.0, -2.0, 0.5), counts, 0.05)
    pair = [rng.random(grid.shape) < rng.choice([0.05, 0.5]) for _ in range(2)]
    for mask in pair:
        mask.flat[rng.integers(grid.size)] = True
    return grid, *pair


@given(sets=point_sets())
@settings(max_examples=50, deadline=None)
def test_chamfer_is_the_papers_equation(sets):
    assert chamfer_db(*sets) == pytest.approx(double_loop(*sets), abs=ROUNDING_DB)


@given(sets=point_sets(), scale=st.floats(0.01, 100))
@settings(max_examples=50, deadline=None)
def test_chamfer_is_symmetric_and_scales_with_twenty_log(sets, scale):
    truth, reconstruction = sets
    value = chamfer_db(truth, reconstruction)
    assert chamfer_db(reconstruction, truth) == pytest.approx(value, abs=ROUNDING_DB)
    scaled = chamfer_db(scale * truth, scale * reconstruction)
    assert scaled == pytest.approx(value + 20 * math.log10(scale), abs=ROUNDING_DB)


def test_half_the_distance_is_six_decibels_less():
    truth = np.array([[0.0, 0, 0], [1, 0, 0]])
    reconstruction = truth + np.array([0, 0.2, 0])
    drop = chamfer_db(truth, reconstruction) - chamfer_db(truth / 2, reconstruction / 2)
    assert drop == pytest.approx(20 * math.log10(2), abs=ROUNDING_DB)


@given(sets=point_sets(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_chamfer_does_not_see_order_or_rigid_motion(sets, seed):
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    moved = [rng.permutation(points) @ rotation + [3, -1, 2] for points in sets]
    assert chamfer_db(*moved) == pytest.approx(chamfer_db(*sets), abs=ROUNDING_DB)


@given(sets=point_sets())
@settings(max_examples=20, deadline=None)
def test_identical_sets_are_minus_infinity(sets):
    assert chamfer_db(sets[0], sets[0][::-1]) == -math.inf


def test_an_empty_reconstruction_is_nan_and_an_empty_truth_an_error():
    points, empty = np.zeros((2, 3)), np.zeros((0, 3))
    assert math.isnan(chamfer_db(points, empty))
    for truth, reconstruction in ((empty, points), (points[:, :2], points), (points, points * np.nan)):
        with pytest.raises(DataError, match="point"):
            chamfer_db(truth, reconstruction)


def line(grid, row):
    mask = np.zeros(grid.shape, bool)
    mask[0, row, :] = True
    return mask


@pytest.mark.parametrize("spacing", [0.05, 0.1, 0.07])
@pytest.mark.parametrize("shift", [1, 2, 5])
def test_a_shifted_line_has_its_shift_as_every_distance(spacing, shift):
    grid = VoxelGrid((0, 0, 0), (30, 20, 1), spacing)
    metres = shift * spacing
    result = score(line(grid, 8), line(grid, 8 + shift), grid, (metres, metres - spacing / 2))
    assert result.accuracy_m == pytest.approx(metres)
    assert result.completeness_m == pytest.approx(metres)
    assert result.hausdorff95_m == pytest.approx(metres)
    assert result.cd_db == pytest.approx(10 * math.log10(2 * metres**2))
    # a distance equal to the shift counts, whatever 0.05·k rounds to; half a voxel less does not
    assert result.precision == result.recall == result.f1 == (1.0, 0.0)
    assert result.area_m2 == pytest.approx(30 * spacing**2)


def test_rounding_does_not_decide_whether_a_voxel_is_within_a_distance():
    """0.15/0.05 is below 3 in float64; a voxel three further on is within 0.15 m all the same."""
    grid = VoxelGrid((0, 0, 0), (30, 20, 1), 0.05)
    assert 0.15 / grid.spacing_m < 3
    assert score(line(grid, 8), line(grid, 11), grid, (0.15,)).f1 == (1.0,)


def test_half_a_line_is_accurate_but_not_complete():
    grid = VoxelGrid((0, 0, 0), (40, 3, 1), 0.05)
    truth = line(grid, 1)
    half = truth.copy()
    half[..., 20:] = False
    result = score(truth, half, grid, (0.05,))
    assert result.accuracy_m == 0
    assert result.precision == (1.0,)
    assert result.recall == (21 / 40,)
    assert result.completeness_m == pytest.approx(0.05 * sum(range(1, 21)) / 40)
    assert result.f1[0] == pytest.approx(2 * (21 / 40) / (1 + 21 / 40))
    swapped = score(half, truth, grid, (0.05,))
    assert (swapped.precision, swapped.recall) == (result.recall, result.precision)
    assert (swapped.accuracy_m, swapped.completeness_m) == (result.completeness_m, result.accuracy_m)


def test_hausdorff95_forgives_one_voxel_in_a_hundred():
    grid = VoxelGrid((0, 0, 0), (100, 30, 1), 0.05)
    truth = line(grid, 0)
    stray = truth.copy()
    stray[0, 29, 50] = True
    result = score(truth, stray, grid)
    assert result.hausdorff95_m == 0
    assert result.accuracy_m == pytest.approx(29 * 0.05 / 101)


@given(case=masks())
@settings(max_examples=50, deadline=None)
def test_scores_agree_with_the_points_they_stand_for(case):
    grid, truth, reconstruction = case
    result = score(truth, reconstruction, grid, (0.05, 0.12))
    x, y = (grid.centers(np.flatnonzero(mask)) for mask in (truth, reconstruction))
    table = np.linalg.norm(x[:, None] - y[None], axis=-1)
    cd = chamfer_db(x, y)
    assert result.cd_db == cd == -math.inf if np.array_equal(x, y) else result.cd_db == pytest.approx(cd, abs=1e-9)
    assert result.accuracy_m == pytest.approx(table.min(axis=0).mean(), abs=1e-12)
    assert result.completeness_m == pytest.approx(table.min(axis=1).mean(), abs=1e-12)
    # half a per cent more than the distance: rounding aside, no voxel distance lies in between
    assert result.recall[0] == np.mean(table.min(axis=1) <= 0.05 * 1.005)
    assert result.precision[1] == np.mean(table.min(axis=0) <= 0.12)
    assert (result.n_truth, result.n_reconstruction) == (len(x), len(y))


@given(case=masks())
@settings(max_examples=50, deadline=None)
def test_exchanging_the_sets_exchanges_the_directions(case):
    grid, truth, reconstruction = case
    one, other = score(truth, reconstruction, grid), score(reconstruction, truth, grid)
    assert (one.cd_db, one.hausdorff95_m, one.f1) == (other.cd_db, other.hausdorff95_m, other.f1)
    assert (one.accuracy_m, one.precision) == (other.completeness_m, other.recall)


@given(case=masks())
@settings(max_examples=50, deadline=None)
def test_shares_rise_with_the_distance_and_lie_between_0_and_1(case):
    grid, truth, reconstruction = case
    result = score(truth, reconstruction, grid, (0.01, 0.05, 0.1, 0.2, 100.0))
    for shares in (result.precision, result.recall, result.f1):
        assert list(shares) == sorted(shares)
        assert shares[0] >= 0
        assert shares[-1] == 1
    overlap = np.count_nonzero(truth & reconstruction)
    assert result.recall[0] == overlap / np.count_nonzero(truth)


@given(case=masks(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_more_reconstruction_never_lowers_completeness(case, seed):
    grid, truth, reconstruction = case
    more = reconstruction | (np.random.default_rng(seed).random(grid.shape) < 0.3)
    before, after = score(truth, reconstruction, grid), score(truth, more, grid)
    assert after.completeness_m <= before.completeness_m
    assert all(a >= b for a, b in zip(after.recall, before.recall, strict=True))


def test_an_empty_reconstruction_is_nan_with_the_reason():
    grid = VoxelGrid((0, 0, 0), (5, 5, 1), 0.05)
    result = score(line(grid, 2), np.zeros(grid.shape, bool), grid)
    assert "empty" in result.reason
    assert all(math.isnan(v) for v in (result.cd_db, result.accuracy_m, result.hausdorff95_m, *result.f1))
    assert (result.n_reconstruction, result.area_m2) == (0, 0)
    assert score(line(grid, 2), line(grid, 2), grid).reason == ""


def test_the_flat_row_names_distances_in_centimetres():
    grid = VoxelGrid((0, 0, 0), (5, 5, 1), 0.05)
    result = score(line(grid, 2), line(grid, 3), grid, (0.05, 0.1, 0.025))
    row = result.as_dict()
    assert (row["f1_5cm"], row["f1_10cm"], row["f1_2.5cm"]) == result.f1
    assert (row["recall_5cm"], row["precision_10cm"]) == (result.recall[0], result.precision[1])
    plain = {field.name for field in dataclasses.fields(Scores)} - {"distances_m", "precision", "recall", "f1"}
    assert plain <= row.keys()
    assert all(np.isscalar(value) for value in row.values())


def test_bad_masks_and_distances_are_refused():
    grid = VoxelGrid((0, 0, 0), (5, 5, 1), 0.05)
    mask = line(grid, 2)
    with pytest.raises(DataError, match="reconstruction: shape"):
        score(mask, mask[0], grid)
    with pytest.raises(DataError, match="holds no voxel"):
        score(~mask & mask, mask, grid)
    for distance in (0.0, -0.05, math.nan, math.inf):
        with pytest.raises(DataError, match="distances_m"):
            score(mask, mask, grid, (distance,))
