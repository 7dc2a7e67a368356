"""Thresholds from the image alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull

from mvla_sim.config.imaging import ThresholdSettings
from mvla_sim.errors import DataError
from mvla_sim.imaging.automatic import LEAST_SUPPORT_DEG, WIDTH, automatic_thresholds, thresholds_of
from mvla_sim.imaging.threshold import joint_threshold
from mvla_sim.scene.grid import VoxelGrid

LAYER = VoxelGrid((0, 0, 0), (60, 60, 1), 0.05)


def outline(side=24):
    """The contour of a square."""
    truth = np.zeros((1, 60, 60), bool)
    low, high = 30 - side // 2, 30 + side // 2
    truth[0, low:high, low:high] = True
    truth[0, low + 1 : high - 1, low + 1 : high - 1] = False
    return truth


def retained(score, support=None, grid=LAYER, resolution_m=None):
    found = automatic_thresholds(score, support, grid, resolution_m)
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
    blob = round(np.pi * (3 * WIDTH) ** 2)

    def enough(count):
        places = np.stack(np.unravel_index(best[:count], (60, 60)), axis=1)
        return count >= round(WIDTH * ConvexHull(places).area)

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
    np.testing.assert_array_equal(retained(np.where(score > np.quantile(score, 0.999), 1e6 * score, score)), expected)


def test_support_is_asked_for_and_counts_among_what_has_it():
    """Bright voxels without support are not retained, and do not take the place of others."""
    truth, ghosts = outline(20), np.zeros((1, 60, 60), bool)
    ghosts[0, :10] = True
    score = (truth + 2.0 * ghosts).astype(np.float32)
    support = np.where(truth, 60.0, 5.0).astype(np.float32)
    np.testing.assert_array_equal(retained(score, support), truth)
    assert automatic_thresholds(score, support, LAYER).min_support_deg == LEAST_SUPPORT_DEG
    assert automatic_thresholds(score, support / 6, LAYER).min_support_deg == pytest.approx(5.0)  # half of the largest
    assert automatic_thresholds(score, 0 * support, LAYER).min_support_deg == 0


def test_few_voxels_and_lines_have_a_length_too():
    score = np.zeros((1, 60, 60), np.float32)
    score[0, 30, 30] = 1.0
    assert retained(score).sum() == 1
    score[0, 30, 10:50] = 1.0
    assert retained(score).sum() == 40
    score[0, 31, 10] = 0.5
    assert 38 <= retained(score).sum() <= 41


def test_a_surface_is_retained_in_three_dimensions():
    grid = VoxelGrid((0, 0, 0), (30, 30, 30), 0.05)
    z, y, x = np.mgrid[:30, :30, :30] - 14.5
    radius = np.sqrt(x**2 + y**2 + z**2)
    score = np.exp(-((radius - 10) ** 2)).astype(np.float32)
    found = retained(score, grid=grid)
    assert found.sum() == pytest.approx(WIDTH * 4 * np.pi * 10**2, rel=0.15)
    assert np.abs(radius[found] - 10).max() < 1.5


@pytest.mark.parametrize("score", [np.ones((1, 60, 60)), np.zeros((1, 60, 60)), -np.arange(3600.0).reshape(1, 60, 60)])
def test_an_even_image_is_refused(score):
    with pytest.raises(DataError, match="threshold = 'auto': the image is the same everywhere or nowhere above 0"):
        automatic_thresholds(score, None, LAYER)


def test_given_thresholds_stay():
    given = ThresholdSettings(top_percent=3.0)
    score = outline().astype(np.float32)
    assert thresholds_of(given, score, None, LAYER) is given
    assert thresholds_of("auto", score, None, LAYER).top_percent < 100
