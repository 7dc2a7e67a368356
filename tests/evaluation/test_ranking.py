"""The score without thresholds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from mvla_sim.evaluation.ground_truth import TruthGeometry
from mvla_sim.evaluation.ranking import average_precision
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.thresholds import rank_order

GRID = VoxelGrid((0.0, 0.0, 0.0), (14, 11, 1), 0.1)


def ring() -> np.ndarray:
    truth = np.zeros(GRID.shape, bool)
    truth[0, 3:8, 4:10] = True
    truth[0, 4:7, 5:9] = False
    return truth


def by_hand(score, truth, distance):
    """The definition, with all distances at hand."""
    points = np.argwhere(np.ones(GRID.shape, bool)) * GRID.spacing_m
    near = cdist(points, points[truth.ravel()]) <= distance * (1 + 1e-9)
    order = rank_order(score)
    area, before = 0.0, 0.0
    for n in range(1, order.size + 1):
        kept = near[order[:n]]
        recall = kept.any(axis=0).mean()
        area += kept.any(axis=1).mean() * (recall - before)
        before = recall
    return area


@pytest.mark.parametrize("distance", [0.05, 0.1, 0.25])
def test_it_is_the_area_of_the_definition(distance):
    score = np.random.default_rng(0).normal(size=GRID.shape).astype(np.float32) + ring()
    truth = TruthGeometry.build(ring(), GRID)
    assert average_precision(score, truth, distance) == pytest.approx(by_hand(score, ring(), distance), rel=1e-9)


def test_the_truth_ranks_itself_perfectly_and_its_opposite_badly():
    truth = TruthGeometry.build(ring(), GRID)
    assert average_precision(ring().astype(np.float32), truth, 0.05) == 1
    assert average_precision(-ring().astype(np.float32), truth, 0.05) < 0.15


def test_it_looks_at_the_order_alone():
    score = np.random.default_rng(1).random(GRID.shape).astype(np.float32)
    truth = TruthGeometry.build(ring(), GRID)
    assert average_precision(score, truth, 0.1) == average_precision(np.exp(3 * score), truth, 0.1)


def test_it_works_in_three_dimensions():
    grid = VoxelGrid((0.0, 0.0, 0.0), (6, 6, 6), 0.1)
    truth = np.zeros(grid.shape, bool)
    truth[2:4, 2:4, 2:4] = True
    assert average_precision(truth.astype(np.float32), TruthGeometry.build(truth, grid), 0.1) == 1
