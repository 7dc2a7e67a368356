"""Thresholds from the image alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull

from mvla_sim.errors import DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.threshold_rules.automatic import AutomaticThresholds
from mvla_sim.imaging.threshold_rules.given import GivenThresholds
from mvla_sim.imaging.thresholds import joint_threshold

AUTO = AutomaticThresholds()
LAYER = VoxelGrid((0, 0, 0), (60, 60, 1), 0.05)


def outline(side=24):
    """The contour of a square."""
    truth = np.zeros((1, 60, 60), bool)
    low, high = 30 - side // 2, 30 + side // 2
    truth[0, low:high, low:high] = True
    truth[0, low + 1 : high - 1, low + 1 : high - 1] = False
    return truth


def retained(score, support=None, grid=LAYER, resolution_m=None):
    found = AUTO.thresholds(score, support, grid, resolution_m)
    return joint_threshold(score, support, found.top_percent, found.min_support_deg)


@pytest.mark.parametrize("side", [8, 24, 40])
def test_a_contour_is_retained_whole_and_little_else(side):
    """Of targets of every size, over a floor and with noise: every voxel of the outline, and those beside it."""
    truth = outline(side)
    near = gaussian_filter(truth.astype(float), 1.0)
    score = (near + 0.02 * np.random.default_rng(2).random(truth.shape)).astype(np.float32)
    found = retained(score)
    assert found[truth].mean() > 0.9
    assert found.sum() < 1.5 * truth.sum()


def test_a_wider_resolution_cell_retains_a_wider_line():
    truth = outline(30)
    score = gaussian_filter(truth.astype(float), 2.0)
    narrow, wide = retained(score), retained(score, resolution_m=0.15)  # a voxel, and three
    assert wide[truth].all()
    assert wide.sum() == pytest.approx(3 * narrow.sum(), rel=0.15)


def test_the_area_is_the_width_times_the_perimeter_and_no_smaller_one_is():
    score = (gaussian_filter(outline(34).astype(float), 1.0) + np.random.default_rng(5).random((1, 60, 60))) ** 2
    best = np.argsort(-score.ravel(), kind="stable")
    blob = round(np.pi * (3 * AUTO.width) ** 2)

    def enough(count):
        places = np.stack(np.unravel_index(best[:count], (60, 60)), axis=1)
        return count >= round(AUTO.width * ConvexHull(places).area)

    assert retained(score).sum() == next(count for count in range(blob, 3600) if enough(count))


def test_a_bright_spot_is_not_taken_for_the_contour():
    truth = outline(30)
    score = gaussian_filter(truth.astype(float), 1.0)
    score[0, 16:20, 16:20] = 100.0
    assert retained(score)[truth].mean() > 0.9


def test_only_ranks_count():
    """Neither scale nor flashes nor any rising function change the result."""
    score = gaussian_filter(outline().astype(float), 1.5) + 0.05 * np.random.default_rng(3).random((1, 60, 60))
    expected = retained(score)
    np.testing.assert_array_equal(retained(1e-9 * score), expected)
    np.testing.assert_array_equal(retained(np.sqrt(score)), expected)
    np.testing.assert_array_equal(retained(np.log(score) - 10), expected)  # as a product over views is, below 0
    np.testing.assert_array_equal(retained(np.where(score > np.quantile(score, 0.999), 1e6 * score, score)), expected)


def test_support_is_asked_for_and_counts_among_what_has_it():
    """Bright voxels without support are not retained, and do not take the place of others."""
    truth, ghosts = outline(20), np.zeros((1, 60, 60), bool)
    ghosts[0, :10] = True
    score = (truth + 2.0 * ghosts).astype(np.float32)
    support = np.where(truth, 60.0, 5.0).astype(np.float32)
    np.testing.assert_array_equal(retained(score, support), truth)
    assert AUTO.thresholds(score, support, LAYER).min_support_deg == AUTO.least_support_deg
    assert AUTO.thresholds(score, support / 6, LAYER).min_support_deg == pytest.approx(5.0)  # half of the largest
    assert AUTO.thresholds(score, 0 * support, LAYER).min_support_deg == 0


def test_few_voxels_are_all_that_is_retained():
    score = np.zeros((1, 60, 60), np.float32)
    score[0, 30, 30] = 1.0
    assert retained(score).sum() == 1
    score[0, 30, 10:50] = 1.0
    assert retained(score).sum() == 40


def test_a_line_has_two_sides():
    """Of a bright row, and fainter ones beside it that end before it does: 1.2 times to the end and back."""
    score = np.zeros((1, 60, 60), np.float32)
    score[0, 28:33, 5:55] = 0.1
    score[0, 30, 5:55] = 1.0
    found = retained(score)
    assert found[0, 30, 5:55].all()
    assert found.sum() == pytest.approx(AUTO.width * 2 * 50, rel=0.06)


def test_an_interval_has_two_ends():
    """On a grid of one row: no more than a few voxels, however long it is."""
    grid = VoxelGrid((0, 0, 0), (200, 1, 1), 0.05)
    score = np.full((1, 1, 200), 0.1, np.float32) + np.linspace(0, 0.01, 200, dtype=np.float32)
    score[0, 0, 100:103] = 1.0
    assert retained(score, grid=grid).sum() == round(3 * AUTO.width)


BOX = VoxelGrid((0, 0, 0), (40, 40, 40), 0.05)


def shell(radius):
    z, y, x = np.mgrid[:40, :40, :40] - 19.5
    away = np.abs(np.sqrt(x**2 + y**2 + z**2) - radius)
    return np.exp(-(away**2)), away < 0.5


@pytest.mark.parametrize("spot", [0, 2, 3])
def test_a_surface_is_retained_in_three_dimensions(spot):
    """Over noise, and beside a bright ball of some voxels."""
    score, truth = shell(14)
    score += 0.01 * np.random.default_rng(1).random(score.shape)
    z, y, x = np.mgrid[:40, :40, :40]
    score[(z - 20) ** 2 + (y - 20) ** 2 + (x - 20) ** 2 <= spot**2] += 5.0 * bool(spot)
    found = retained(score, grid=BOX)
    assert found[truth].mean() > 0.9
    assert found.sum() == pytest.approx(AUTO.width * 4 * np.pi * 14**2, rel=0.15)


def test_a_plate_in_three_dimensions_has_two_sides():
    """Its voxels lie in a plane, whose hull has no volume."""
    score = 1e-3 * np.random.default_rng(1).random((40, 40, 40))
    score[20, 10:30, 5:35] = 1.0
    score[19:22, 10:30, 5:35] += 0.5
    found = retained(score, grid=BOX)
    assert found[20, 10:30, 5:35].all()
    assert found.sum() > 1.2 * 600


@pytest.mark.parametrize("score", [np.ones((1, 60, 60)), np.zeros((1, 60, 60)), -np.ones((1, 60, 60))])
def test_an_even_image_is_refused(score):
    with pytest.raises(DataError, match="threshold = 'auto': the image is the same everywhere"):
        AUTO.thresholds(score, None, LAYER)


def test_values_that_are_not_finite_are_refused():
    score = outline().astype(np.float32)
    with pytest.raises(DataError, match="the angular support is not finite"):
        AUTO.thresholds(score, np.full(score.shape, np.nan), LAYER)
    score[0, 0, 0] = np.nan
    with pytest.raises(DataError, match="the score is not finite"):
        AUTO.thresholds(score, None, LAYER)


def test_given_thresholds_stay():
    score = outline().astype(np.float32)
    assert GivenThresholds(top_percent=3.0).thresholds(score, None, LAYER, None) == (3.0, 0.0)


def test_a_rule_may_be_named_alone_or_with_its_settings():
    alone, table = (imaging_settings(threshold=rule).threshold for rule in ("auto", {"rule": "auto", "width": 2.4}))
    assert (alone, table) == (AUTO, AutomaticThresholds(width=2.4))
    score = gaussian_filter(outline().astype(float), 1.0)
    wide, narrow = (rule.thresholds(score, None, LAYER).top_percent for rule in (table, alone))
    assert wide > 1.5 * narrow
