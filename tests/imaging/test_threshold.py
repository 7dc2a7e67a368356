"""The joint threshold, by its definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mvla_sim.errors import ConfigError
from mvla_sim.imaging.thresholds import joint_threshold, rank_order, top_count

SHAPES = st.tuples(st.integers(1, 3), st.integers(1, 8), st.integers(1, 8))
SCORES = SHAPES.flatmap(lambda shape: arrays(np.float32, shape, elements=st.integers(-3, 3).map(float)))  # many ties


@settings(max_examples=50)
@given(SCORES, st.floats(0.01, 100), st.floats(0, 360), st.integers(0, 2**32 - 1))
def test_equals_the_definition(score, percent, least, seed):
    """Rank by score, ties by index; take round(p/100·N), at least one; then drop what has too little support."""
    support = np.random.default_rng(seed).uniform(0, 360, score.shape).astype(np.float32)
    ranked = sorted(range(score.size), key=lambda n: (-score.ravel()[n], n))
    kept = set(ranked[: max(1, round(percent / 100 * score.size))])
    expected = [n in kept and support.ravel()[n] >= least for n in range(score.size)]
    result = joint_threshold(score, support, percent, least)
    assert result.shape == score.shape
    assert result.ravel().tolist() == expected
    assert rank_order(score).tolist() == ranked


@settings(max_examples=50)
@given(SCORES, st.floats(0.01, 100))
def test_without_support_the_count_is_exact(score, percent):
    assert joint_threshold(score, None, percent).sum() == top_count(percent, score.size)


def test_threshold_of_support_is_inclusive():
    support = np.array([10.0, 20.0, 30.0], np.float32)
    assert joint_threshold(np.ones(3, np.float32), support, 100.0, 20.0).tolist() == [False, True, True]


def test_ties_go_to_the_lower_index():
    assert joint_threshold(np.array([1, 2, 2, 2, 0], np.float32), None, 40.0).tolist() == [
        False,
        True,
        True,
        False,
        False,
    ]


@pytest.mark.parametrize(("percent", "size", "count"), [(0.61, 40_000, 244), (100, 7, 7), (1e-6, 1000, 1), (50, 3, 2)])
def test_count(percent, size, count):
    assert top_count(percent, size) == count


@pytest.mark.parametrize("percent", [0.0, -1.0, 100.5, float("nan")])
def test_impossible_percentages_are_refused(percent):
    with pytest.raises(ConfigError, match=r"threshold\.top_percent"):
        top_count(percent, 10)


def test_angular_threshold_needs_support():
    with pytest.raises(ConfigError, match=r"threshold\.min_support_deg = 5"):
        joint_threshold(np.ones(3, np.float32), None, 50.0, 5.0)
