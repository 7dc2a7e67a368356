"""What is timed of tracing."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any, Final

from mvla_sim.bench.child import Job
from mvla_sim.bench.inputs import scene_settings
from mvla_sim.channel.cir import Cir
from mvla_sim.channel.simulate import simulate
from mvla_sim.scene.world import Scene

__all__ = ["TracingJob"]

GOLDEN: Final = 0.6180339887498949
ASIDE_M: Final = (0.4, 0.3, 0.0)
"""Where the circle is put, so that it does not look the same from every view."""


class TracingJob(Job):
    """From settings to a CIR file of so many rays a view. Every call has a scene that was never traced before.

    The target is a circle of so many facets, without them the star.
    """

    def __init__(self, rays: float, views: float, facets: float | None = None) -> None:
        self.rays, self.views = rays, views
        self.more: dict[str, Any] = {} if facets is None else {"facets": round(facets), "position_m": ASIDE_M}
        self.shape = "star" if facets is None else "circle"
        self.file = Path(tempfile.mkdtemp()) / "cir.nc"
        self.cir: Cir | None = None

    def call(self, number: int) -> None:
        """Build, trace and write a scene."""
        turn = 360 * math.modf((number + 1) * GOLDEN)[0]  # no two scenes look alike from any two views
        settings = scene_settings(self.shape, self.views, self.rays, turn, **self.more)
        self.cir = simulate(Scene(settings), cache=False)
        self.cir.save(self.file)

    def facts(self) -> dict[str, float]:
        """Paths a view, and bytes a path in memory and on disk."""
        assert self.cir is not None
        cir, paths = self.cir, self.cir.gain.size
        arrays = (cir.gain, cir.delay_s, cir.interaction, cir.first_point_m, cir.row_size)
        return {
            "paths_per_view": paths / cir.n_view,
            "memory_bytes_per_path": sum(array.nbytes for array in arrays) / paths,
            "disk_bytes_per_path": self.file.stat().st_size / paths,
        }
