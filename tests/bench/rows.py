"""Made-up measured rows that follow known laws."""

from __future__ import annotations

from mvla_sim.bench.measure import Measured
from mvla_sim.bench.stages import TimedPoint, points_of

FACTS = {
    "paths_per_view": 1000.0, "memory_bytes_per_path": 29.0, "disk_bytes_per_path": 20.0,
}  # fmt: skip
LOADED = 300e6


LAWS = {
    "star": lambda size: 0.1 + 0.2 * size["views"],
    "circle": lambda size: 0.1 + 0.2 * size["views"],
    "mvla-gr": lambda size: 1e-9 * size["voxels"] * size["views"],
    "bp": lambda size: 1e-9 * size["voxels"] * size["views"],
    "read and PDP": lambda size: 0.05 + 0.01 * size["views"],
    "noise, peaks, profiles": lambda size: 1e-3 * size["views"],
    "image of the target": lambda size: 1e-6 * size["voxels"] * (size["thresholds"] / 72) ** 0.5,
    "unrelated image": lambda size: 1e-5 * size["voxels"],
    "truth": lambda size: 1e-6 * size["voxels"],
    "cases": lambda size: size["cases"] * (0.125 if size["workers"] == 2 else 0.1),
    "empty tasks": lambda size: 0.004 * size["tasks"],
}
"""Core seconds of a point, by series."""


def measured_rows(stages=("tracing", "projection", "search", "sweep"), quick=False, factor=None):
    """A row for every point; ``factor(series)`` makes a series slower."""
    rows = []
    for point in points_of(stages, quick=quick):
        core = LAWS[point.series.name](point.size) * (factor(point.series) if factor else 1.0)
        clock = core / (point.size["workers"] if point.series.pinned else 1)
        memory = 10e6 + 1e6 * point.size.get("views", 0.0)
        found = Measured(core + 5, clock, core, 3, memory + 5e6, memory, LOADED, FACTS)
        rows.append(TimedPoint(point.series, point.size, found))
    return rows
