"""Thresholds from the image alone."""

from __future__ import annotations

import numpy as np
import pytest

from mvla_sim.config.imaging import ThresholdSettings
from mvla_sim.errors import DataError
from mvla_sim.imaging.automatic import automatic_thresholds, otsu, thresholds_of


def test_otsu_parts_two_classes():
    random = np.random.default_rng(0)
    values = np.concatenate([random.normal(1, 0.2, 5000), random.normal(4, 0.3, 1000)])
    assert 1.6 < otsu(values) < 3.1  # anywhere between the two


def test_otsu_is_the_largest_variance_between_classes():
    values = np.random.default_rng(1).gamma(2, size=400)
    edges = np.histogram(values, 256)[1][1:-1]

    def between(edge):
        low, high = values[values <= edge], values[values > edge]
        return low.size * high.size * (low.mean() - high.mean()) ** 2

    assert between(otsu(values)) >= 0.98 * max(between(edge) for edge in edges)  # of bins, not of values


def test_a_contour_is_found_without_its_truth():
    truth = np.zeros((1, 60, 60), bool)
    truth[0, 20:40, 20:40] = True
    truth[0, 21:39, 21:39] = False
    random = np.random.default_rng(2)
    score = (truth + 0.1 * random.random(truth.shape)).astype(np.float32) ** 2
    support = np.where(truth, 80.0, 5.0).astype(np.float32)
    found = automatic_thresholds(score, support)
    assert found.top_percent == pytest.approx(100 * truth.mean(), rel=0.05)
    assert found.min_support_deg <= 80
    assert automatic_thresholds(score, None).min_support_deg == 0


def test_scale_changes_nothing_and_a_flash_little():
    random = np.random.default_rng(3)
    score = np.where(random.random(4000) < 0.05, 5.0, 1.0) * random.uniform(0.8, 1.2, 4000)
    before = automatic_thresholds(score, None).top_percent
    assert automatic_thresholds(1e-9 * score, None).top_percent == pytest.approx(before)
    score[:10] = 1e6
    assert automatic_thresholds(score, None).top_percent == pytest.approx(before, rel=0.1)


def test_an_even_image_is_refused():
    with pytest.raises(DataError, match="threshold = 'auto': the image is the same nearly everywhere"):
        automatic_thresholds(np.ones(100), None)


def test_given_thresholds_stay():
    given = ThresholdSettings(top_percent=3.0)
    assert thresholds_of(given, np.ones(9), None) is given
    assert thresholds_of("auto", np.arange(9.0), None).top_percent < 100
