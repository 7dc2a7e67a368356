"""What is timed of projection."""

from __future__ import annotations

import numpy as np

from mvla_sim.bench.child import Job
from mvla_sim.bench.inputs import RESOLUTION_M, grid_of, ring
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.projection import RangeProfiles, project

__all__ = ["ProjectionJob"]

NODES_PER_SIGMA = 16
SAMPLES_PER_CELL = 4
RADIUS_M = 0.32


class ProjectionJob(Job):
    """Project random range profiles onto a grid, as dense as the method makes them.

    Those of ``mvla-gr`` have distances, hence angular support, those of ``bp`` none.
    """

    def __init__(self, method: str, voxels: float, views: float) -> None:
        self.grid, self.views = grid_of(voxels), ring(views)
        soft = method == "mvla-gr"
        step = (
            ImagingSettings().mvla.kappa * RESOLUTION_M / NODES_PER_SIGMA if soft else RESOLUTION_M / SAMPLES_PER_CELL
        )
        near, far = self.grid.range_span_m(self.views.positions_m)
        rng = np.random.default_rng(1)
        shape = (len(self.views), int((far - near) / step) + 3)
        values = rng.random(shape, np.float32)
        distance = rng.random(shape, np.float32) if soft else None
        self.profiles = RangeProfiles(values, near - step, step, distance, RADIUS_M)

    def call(self, number: int) -> None:
        """Project; the result is a NumPy array, so everything has been evaluated."""
        del number
        np.asarray(project(self.grid, self.views, self.profiles).total)
