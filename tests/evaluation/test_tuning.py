"""The threshold search against trying every threshold, in exact fractions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threshold_problems import decibels, every_threshold, problems, thresholded

from mvla_sim.errors import DataError
from mvla_sim.evaluation import ground_truth
from mvla_sim.evaluation.metrics import score as score_masks
from mvla_sim.evaluation.tuning import TruthGeometry, chamfer_for_prefixes, optimal_thresholds
from mvla_sim.grid import VoxelGrid


class TestAgainstEveryThreshold:
    @pytest.mark.usefixtures("sizes")
    def test_the_optimum_is_the_best_of_all(self):
        @given(problem=problems())
        @settings(max_examples=50, deadline=None)
        def check(problem):
            grid, truth, score, theta = problem
            value, level, n = min(every_threshold(score, theta, truth))
            best = optimal_thresholds(score, theta, TruthGeometry.build(truth, grid))
            assert (best.min_support_deg, best.n_top) == (level, n)
            assert best.cd_db == pytest.approx(decibels(value, grid), abs=1e-9)  # rounding of one logarithm
            assert best.n_retained == np.count_nonzero(thresholded(score, theta, n, level))

        check()

    @pytest.mark.usefixtures("sizes")
    def test_the_curve_is_every_prefix(self):
        @given(problem=problems(), data=st.data())
        @settings(max_examples=30, deadline=None)
        def check(problem, data):
            grid, truth, score, theta = problem
            table = list(every_threshold(score, theta, truth))
            level = data.draw(st.sampled_from(sorted({entry[1] for entry in table})))
            curve = chamfer_for_prefixes(score, theta, TruthGeometry.build(truth, grid), level)
            expected = np.full(grid.size, np.nan)
            for value, at, n in table:
                if at == level:
                    expected[n - 1 :] = decibels(value, grid)  # stays until the next retained voxel
            np.testing.assert_allclose(curve, expected, atol=1e-9)  # rounding of one logarithm

        check()


@pytest.mark.parametrize(
    ("counts", "truth", "score", "theta"),
    [
        # T_θ = 85° reaches the optimum first, and T_θ = 50°, whose bound equals it, must still be looked at
        ((6, 1, 1), [2, 3], [3, 7, 4, 3, 8, 5], [80, 10, 50, 85, 10, 0]),
        # the first block's bound must not be taken from another block
        (
            (3, 6, 1),
            [7, 8, 10],
            [0, 3, 1, 1, 3, 1, 0, 2, 1, 1, 3, 1, 1, 3, 1, 1, 3, 0],
            [5, 5, 0, 0, 0, 0, 10, 5, 0, 5, 10, 5, 5, 5, 5, 5, 10, 10],
        ),
    ],
    ids=["equal bound at a lower support", "bound of the first block"],
)
def test_rare_orders_of_search(monkeypatch, counts, truth, score, theta):
    """Problems on which a search with one slip goes wrong; random ones meet them once in thousands."""
    monkeypatch.setattr(ground_truth, "STENCIL_ENTRIES", 0)
    grid = VoxelGrid((0, 0, 0), counts, 0.05)
    mask = np.isin(np.arange(grid.size), truth).reshape(grid.shape)
    image, support = (np.array(values, np.float32).reshape(grid.shape) for values in (score, theta))
    _, level, n = min(every_threshold(image, support, mask))
    best = optimal_thresholds(image, support, TruthGeometry.build(mask, grid))
    assert (best.min_support_deg, best.n_top) == (level, n)


def test_the_fallback_is_taken_and_exact_where_the_best_scores_are_far_away():
    """The stencil reaches 16 voxels here; the truth is 80 voxels from the best score."""
    grid = VoxelGrid((0, 0, 0), (100, 3, 1), 0.05)
    truth = np.zeros(grid.shape, bool)
    truth[0, 1, 5] = True
    score = np.linspace(0, 1, 300, dtype=np.float32).reshape(3, 100, 1).transpose(2, 0, 1).copy()
    theta = np.zeros(grid.shape, np.float32)
    theta[..., 90:] = 10
    geometry = TruthGeometry.build(truth, grid)
    assert geometry.cap < 80**2
    for support in (theta, None):
        value, level, n = min(every_threshold(score, support, truth))
        best = optimal_thresholds(score, support, geometry)
        assert (best.min_support_deg, best.n_top) == (level, n)
        assert best.cd_db == pytest.approx(decibels(value, grid), abs=1e-9)
    # only voxels 85 columns away pass the test, so the distance is known in closed form
    far = chamfer_for_prefixes(score, theta, geometry, 10.0)
    assert np.nanmin(far) >= 10 * math.log10(2 * (85 * 0.05) ** 2)


@given(problem=problems())
@settings(max_examples=50, deadline=None)
def test_the_thresholds_reported_give_the_distance_reported(problem):
    grid, truth, score, theta = problem
    geometry = TruthGeometry.build(truth, grid)
    best = optimal_thresholds(score, theta, geometry)
    count = round(best.top_percent / 100 * grid.size)
    assert count == best.n_top
    mask = thresholded(score, theta, count, best.min_support_deg)
    scores = score_masks(truth, mask, grid)
    assert scores.cd_db == best.cd_db  # both are the same quotient of whole numbers
    assert scores.area_m2 == best.area_m2
    assert thresholded(score, theta, count - 1, best.min_support_deg).sum() == mask.sum() - 1


@given(problem=problems())
@settings(max_examples=50, deadline=None)
def test_the_optimum_is_the_lowest_point_of_its_curve(problem):
    grid, truth, score, theta = problem
    geometry = TruthGeometry.build(truth, grid)
    best = optimal_thresholds(score, theta, geometry)
    curve = chamfer_for_prefixes(score, theta, geometry, best.min_support_deg)
    assert int(np.nanargmin(curve)) == best.n_top - 1
    assert curve[best.n_top - 1] == best.cd_db


@given(problem=problems())
@settings(max_examples=50, deadline=None)
def test_an_angular_test_can_only_help_the_oracle(problem):
    grid, truth, score, theta = problem
    geometry = TruthGeometry.build(truth, grid)
    with_test, without = (optimal_thresholds(score, support, geometry) for support in (theta, None))
    assert with_test.cd_db <= without.cd_db
    assert without.min_support_deg == 0


@given(problem=problems(flat=True))
@settings(max_examples=50, deadline=None)
def test_only_the_order_of_scores_and_supports_matters(problem):
    grid, truth, score, theta = problem
    geometry = TruthGeometry.build(truth, grid)
    best = optimal_thresholds(score, theta, geometry)
    ranks = np.unique(score, return_inverse=True)[1].reshape(grid.shape)
    stretched = None if theta is None else theta.astype(float) ** 2
    other = optimal_thresholds(7.0 * ranks - 3, stretched, geometry)  # also another type: float64
    assert (other.cd_db, other.n_top, other.n_retained) == (best.cd_db, best.n_top, best.n_retained)
    assert other.min_support_deg == pytest.approx(best.min_support_deg**2)


@given(problem=problems(flat=True), factor=st.floats(0.1, 10))
@settings(max_examples=30, deadline=None)
def test_the_unit_of_length_moves_the_distance_and_nothing_else(problem, factor):
    grid, truth, score, theta = problem
    scaled = VoxelGrid((3, 4, 5), grid.counts, factor * grid.spacing_m)
    best, other = (optimal_thresholds(score, theta, TruthGeometry.build(truth, g)) for g in (grid, scaled))
    assert (other.n_top, other.min_support_deg) == (best.n_top, best.min_support_deg)
    assert other.cd_db == pytest.approx(best.cd_db + 20 * math.log10(factor), abs=1e-9)


def test_a_perfect_image_is_minus_infinity_at_the_truths_size():
    grid = VoxelGrid((0, 0, 0), (30, 30, 1), 0.05)
    truth = np.zeros(grid.shape, bool)
    truth[0, 10:20, 12] = True
    best = optimal_thresholds(truth.astype(np.float32), None, TruthGeometry.build(truth, grid))
    assert best.cd_db == -math.inf
    assert (best.n_top, best.n_retained) == (10, 10)
    assert best.top_percent == pytest.approx(100 * 10 / 900)
    assert best.area_m2 == pytest.approx(10 * 0.05**2)


def test_the_support_alone_can_find_the_truth():
    """A constant score orders nothing; the truth is exactly where Θ is at least 40°."""
    grid = VoxelGrid((0, 0, 0), (12, 9, 1), 0.05)
    truth = np.zeros(grid.shape, bool)
    truth[0, 3:6, 4:8] = True
    theta = np.where(truth, 40.0, 35.0).astype(np.float32)
    theta[0, 4, 5] = 90
    best = optimal_thresholds(np.ones(grid.shape, np.float32), theta, TruthGeometry.build(truth, grid))
    assert (best.cd_db, best.min_support_deg, best.n_retained) == (-math.inf, 40.0, 12)
    assert best.n_top == np.flatnonzero(truth)[-1] + 1


@given(problem=problems())
@settings(max_examples=20, deadline=None)
def test_flattened_images_and_one_geometry_for_many(problem):
    grid, truth, score, theta = problem
    geometry = TruthGeometry.build(truth, grid)
    first = optimal_thresholds(score, theta, geometry)
    optimal_thresholds(-score, theta, geometry)
    again = optimal_thresholds(score.ravel(), None if theta is None else theta.ravel(), geometry)
    assert again == first


def test_a_support_no_voxel_has_leaves_nothing():
    grid = VoxelGrid((0, 0, 0), (4, 4, 1), 0.05)
    truth = np.ones(grid.shape, bool)
    theta = np.full(grid.shape, 20, np.float32)
    curve = chamfer_for_prefixes(theta, theta, TruthGeometry.build(truth, grid), 20.1)
    assert np.isnan(curve).all()


def test_the_curve_compares_in_the_type_of_the_support():
    """0.7 in float32 is below 0.7 in float64; a voxel with Θ = 0.7 passes T_θ = 0.7 all the same."""
    grid = VoxelGrid((0, 0, 0), (4, 4, 1), 0.05)
    theta = np.full(grid.shape, 0.7, np.float32)
    assert float(theta[0, 0, 0]) < 0.7
    curve = chamfer_for_prefixes(theta, theta, TruthGeometry.build(np.ones(grid.shape, bool), grid), 0.7)
    assert np.isfinite(curve[:-1]).all()


def test_bad_images_are_refused():
    grid = VoxelGrid((0, 0, 0), (4, 3, 1), 0.05)
    geometry = TruthGeometry.build(np.ones(grid.shape, bool), grid)
    good = np.ones(grid.shape, np.float32)
    bad = good.copy()
    bad[0, 1, 2] = np.nan
    with pytest.raises(DataError, match=r"score: shape \(3, 4\)"):
        optimal_thresholds(good[0], good, geometry)
    with pytest.raises(DataError, match="score: 1 of 12"):
        optimal_thresholds(bad, good, geometry)
    with pytest.raises(DataError, match="theta_deg: 1 of 12"):
        optimal_thresholds(good, bad, geometry)
    with pytest.raises(DataError, match="theta_deg: smallest value -1"):
        optimal_thresholds(good, -good, geometry)
    for theta, level in ((good, -1.0), (good, math.nan), (None, 5.0)):
        with pytest.raises(DataError, match="min_support_deg"):
            chamfer_for_prefixes(good, theta, geometry, level)
