"""What is timed between a CIR file and an image's score: the way to range profiles, and their projection."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from mvla_sim.bench.child import Job
from mvla_sim.bench.inputs import EXTENT_M, RESOLUTION_M, grid_of, ring
from mvla_sim.channel.cir import INTERACTIONS, Cir
from mvla_sim.constants import range_to_delay
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.likelihood import kernel_scales, likelihood_profiles
from mvla_sim.imaging.pdp import Pdp, compute_pdp
from mvla_sim.imaging.projection import RangeProfiles, project

__all__ = ["FrontEndJob", "ProjectionJob"]

NODES_PER_SIGMA = 16
SAMPLES_PER_CELL = 4
RADIUS_M = 0.32


class FrontEndJob(Job):
    """Part of the way from a CIR file to range profiles. The paths are random.

    Part ``pdp`` reads the file and computes power delay profiles; ``peaks`` adds noise to them, extracts peaks, and
    makes range profiles.
    """

    def __init__(self, part: str, views: float, paths_per_view: float) -> None:
        rng = np.random.default_rng(1)
        seen, count = ring(views), round(paths_per_view)
        paths = len(seen) * count
        ranges = np.sort(rng.uniform(6, 14, (len(seen), count)), axis=1).ravel()
        gain = 1e-6 * (rng.standard_normal(paths) + 1j * rng.standard_normal(paths))
        cir = Cir(
            gain=gain.astype(np.complex64),
            delay_s=np.asarray(range_to_delay(ranges), np.float64),
            interaction=np.full(paths, INTERACTIONS["diffuse"], np.uint8),
            first_point_m=rng.uniform(-4, 4, (paths, 3)).astype(np.float32),
            row_size=np.full(len(seen), count, np.int64),
            views=seen,
            carrier_hz=36e9,
            bandwidth_hz=3e9,
            extent_m=EXTENT_M,
        )
        self.file = Path(tempfile.mkdtemp()) / "cir.nc"
        cir.save(self.file)
        self.settings = imaging_settings(method="mvla-gr", snr_db=20.0)
        self.span_m = VoxelGrid.from_settings(self.settings.grid).range_span_m(seen.positions_m)
        self.part = part
        self.pdp = self._profiles()
        self.found = 0.0

    def _profiles(self) -> Pdp:
        return compute_pdp(Cir.load(self.file), self.settings.pdp, self.span_m)

    def call(self, number: int) -> None:
        """Do the part for all views."""
        if self.part == "pdp":
            self.pdp = self._profiles()
            return
        noise = self.settings.noise.model_copy(update={"seed": number})
        peaks = self.settings.peaks.peaks_of(noise.add(self.pdp))
        likelihood_profiles(peaks, *kernel_scales(self.settings.mvla, self.pdp.resolution_m, EXTENT_M), self.span_m)
        self.found = peaks.range_m.size / peaks.n_view

    def facts(self) -> dict[str, float]:
        """Peaks a view."""
        return {"peaks_per_view": self.found} if self.found else {}


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
