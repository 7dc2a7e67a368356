"""A score without thresholds: how well an image ranks the voxels of its target before all others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from mvla_sim.evaluation.ground_truth import TruthGeometry
from mvla_sim.imaging.thresholds import rank_order

__all__ = ["average_precision"]


def average_precision(score: NDArray[Any], geometry: TruthGeometry, distance_m: float) -> float:
    """Area under the curve of precision against recall, both within a distance, over every number of best voxels.

    For the n best-scored voxels, precision is the share of them within ``distance_m`` of a truth voxel, recall the
    share of truth voxels with one of them within ``distance_m``. The area is
    ``Σ_n precision(n)·(recall(n) − recall(n−1))``.

    Parameters
    ----------
    score
        Image, ``[nz, ny, nx]`` or flattened.
    geometry
        The truth, prepared.
    distance_m
        Tolerance, metres.

    Returns
    -------
    float
        In (0, 1]; 1 where every voxel within the distance of the truth is before all others.
    """
    grid = geometry.grid
    order = rank_order(np.asarray(score).reshape(grid.shape))
    reach = distance_m / grid.spacing_m * (1 + 1e-9)
    precision = np.cumsum(geometry.squared[order] <= reach**2) / np.arange(1, grid.size + 1)
    rank = np.empty(grid.size, np.int64)
    rank[order] = np.arange(grid.size)
    half = int(reach)
    axes = [np.arange(-half, half + 1) if count > 1 else np.zeros(1) for count in grid.shape]
    ball = sum(axis**2 for axis in np.meshgrid(*axes, indexing="ij")) <= reach**2
    first = minimum_filter(rank.reshape(grid.shape), footprint=ball, mode="constant", cval=grid.size)
    return float(precision[first.ravel()[geometry.voxels]].mean())
