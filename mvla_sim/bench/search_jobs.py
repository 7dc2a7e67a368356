"""What is timed of the search for the best thresholds."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mvla_sim.bench.child import Job
from mvla_sim.bench.inputs import grid_of
from mvla_sim.evaluation.ground_truth import TruthGeometry, rasterize
from mvla_sim.evaluation.tuning import optimal_thresholds
from mvla_sim.grid import VoxelGrid
from mvla_sim.scene.shapes.star import Star

__all__ = ["SearchJob", "TruthJob"]

WAVES = 24


class TruthJob(Job):
    """Rasterise the star's outline and prepare it for the search."""

    def __init__(self, voxels: float) -> None:
        self.grid, self.outline = grid_of(voxels), Star().outline()
        self.truth_voxels, self.rasterize_s = 0, 0.0

    def call(self, number: int) -> None:
        """Prepare the truth."""
        del number
        began = time.perf_counter()
        truth = rasterize(self.outline, self.grid, "contour")
        self.rasterize_s = time.perf_counter() - began
        geometry = TruthGeometry.build(truth, self.grid)
        self.truth_voxels = geometry.voxels.size

    def facts(self) -> dict[str, float]:
        """Voxels of the truth, and the part of the last call that went into rasterising it, seconds."""
        return {"truth_voxels": float(self.truth_voxels), "rasterize_s": self.rasterize_s}


class SearchJob(Job):
    """The exact optimum over every p and every T_θ, of an image with so many distinct values of Θ at most.

    Image ``contour`` is a score that falls off from the star's contour, with speckle and clutter, and wide support near
    it; ``unrelated`` has smooth random score and support, the worst case.
    """

    def __init__(self, voxels: float, thresholds: float, image: str) -> None:
        grid = grid_of(voxels)
        truth = rasterize(Star().outline(), grid, "contour")
        self.geometry = TruthGeometry.build(truth, grid)
        rng = np.random.default_rng(1)
        smooth = _waves(grid, 2)
        if image == "contour":
            distance = distance_transform_edt(~truth) * grid.spacing_m
            clutter = rng.random(grid.shape) < 0.02
            score = (np.exp(-distance / 0.15) + 0.05 * smooth + clutter) * rng.exponential(size=grid.shape)
            likely = np.exp(-distance / 1.5) * rng.random(grid.shape) + 0.3 * smooth
        else:
            score, likely = smooth, _waves(grid, 3)
        self.score = np.asarray(score, np.float32)
        self.theta = _levels(likely, round(thresholds))

    def call(self, number: int) -> None:
        """Search."""
        del number
        optimal_thresholds(self.score, self.theta, self.geometry)

    def facts(self) -> dict[str, float]:
        """Values of Θ that occur."""
        return {"distinct_thresholds": float(np.unique(self.theta).size)}


def _waves(grid: VoxelGrid, seed: int) -> NDArray[np.float64]:
    """Smooth random field between 0 and 1 that is the same on every grid, ``[nz, ny, nx]``: waves of 1.5 m and more."""
    rng = np.random.default_rng(seed)
    x, y, z = grid.axes()
    total = np.zeros((z.size, y.size, x.size))
    for _ in range(WAVES):
        direction, number, phase = rng.uniform(0, 2 * np.pi), 2 * np.pi / rng.uniform(1.5, 6), rng.uniform(0, 2 * np.pi)
        total += np.cos(number * (np.cos(direction) * x + np.sin(direction) * y[:, None]) + phase)
    return np.asarray((total - total.min()) / np.ptp(total), np.float64)


def _levels(likely: NDArray[np.float64], count: int) -> NDArray[np.float32]:
    """Θ in degrees with so many distinct values."""
    share = (likely - likely.min()) / np.ptp(likely)
    return np.asarray(np.minimum(np.floor(share * count), count - 1) * (360 / count), np.float32)
