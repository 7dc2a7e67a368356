"""Time what every method spends on the projector; run as ``python tests/benchmarks/bench_methods.py``.

Two sizes: the default grid (40,000 voxels) with 72 views, and a million voxels with 360. Reported is the time inside
projections of each method over that of backprojection, measured in turn with it; of iterative methods the whole time of
an iteration. Profiles and peaks are random, which costs what real ones do.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mvla_sim.engine.machine import cpu_name
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.methods.registry import find_method, phase_free_methods
from mvla_sim.imaging.observation import FrontEnd, Observation
from mvla_sim.imaging.projection import Projection, RangeProfiles

sys.path.append(str(Path(__file__).parent))
from bench_projection import LARGE, RESOLUTION, peaks, power, ring

RUNS = 7
PEAKS = 10
ITERATIVE = {"mlem": "mlem.iterations", "nnls": "nnls.iterations", "mvla-em": "em.iterations"}
SIZES = ((VoxelGrid((0, 0, 0), (200, 200, 1), 0.05), 72), (LARGE, 360))


class Timed(Observation):
    """An observation that keeps the time its projections take."""

    spent: float = 0.0

    def project(self, profiles: RangeProfiles) -> Projection:
        began = time.perf_counter()
        result = super().project(profiles)
        Timed.spent += time.perf_counter() - began
        return result


def observe(grid: VoxelGrid, views: int, **settings: Any) -> Timed:
    found = FrontEnd(power(views), peaks(views, PEAKS), RESOLUTION)
    span = grid.range_span_m(ring(views).positions_m)
    return Timed(found, ring(views), grid, imaging_settings(**settings), 8.0, span)


def projecting(seen: Timed) -> float:
    """Seconds inside projections of one image."""
    Timed.spent = 0.0
    find_method(seen.settings.method).image(seen)
    return Timed.spent


def iterating(seen: Timed) -> float:
    """Seconds of one iteration, from one image with two more of them than another has."""

    def image(count: int) -> float:
        key, _, name = ITERATIVE[seen.settings.method].partition(".")
        block = getattr(seen.settings, key).model_copy(update={name: count})
        began = time.perf_counter()
        find_method(seen.settings.method).image(replace(seen, settings=seen.settings.model_copy(update={key: block})))
        return time.perf_counter() - began

    few, many = image(2), image(12)
    return (many - few) / 10


def ratio(one: Callable[[], float], other: Callable[[], float]) -> tuple[float, float]:
    """Median seconds of one, and the median of its ratio to the other, measured in turn."""
    one()
    other()
    pairs = [(one(), other()) for _ in range(RUNS)]
    return statistics.median(a for a, _ in pairs), statistics.median(a / b for a, b in pairs)


def main() -> None:
    write = sys.stdout.write
    write(f"{cpu_name()}, medians of {RUNS} pairs of runs\n")
    for grid, views in SIZES:
        write(f"{grid.size} voxels, {views} views\n")
        base = observe(grid, views, method="bp")
        for name in phase_free_methods():
            seen = observe(grid, views, method=name)
            measure = iterating if name in ITERATIVE else projecting
            seconds, against = ratio(lambda s=seen, m=measure: m(s), lambda b=base: projecting(b))  # type: ignore[misc]
            what = "an iteration" if name in ITERATIVE else ""
            write(f"  {name:14s} {1e3 * seconds:8.1f} ms {against:6.2f} × BP {what}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
