"""Time the projector; run as ``python tests/benchmarks/bench_projection.py``.

A million voxels (10 m × 10 m at 0.01 m) and 360 views on a circle of 10 m. Reported are voxel × view updates a second
of backprojection and of MVLA-GR (score and Θ in one pass), the latter at 10 and at 100 peaks a view, and how long the
profiles take to build. The reference is the float64 NumPy twin of the tests on 10,000 voxels and 36 views, without its
search for Θ, which is a Python loop: score and support indicators alone, summed over every peak.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mvla_sim.engine.machine import cpu_name
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.backprojection import backprojection_profiles
from mvla_sim.imaging.mvla import likelihood_profiles
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.projection import RangeProfiles, project
from mvla_sim.scene.views import Views

sys.path.append(str(Path(__file__).parents[1] / "imaging"))
import twin

RUNS = 5
SIGMA, RADIUS, RESOLUTION = 0.025, 0.32, 0.05
LARGE, SMALL = VoxelGrid((0, 0, 0), (1000, 1000, 1), 0.01), VoxelGrid((0, 0, 0), (100, 100, 1), 0.1)


def median_s(function: Callable[[], object], runs: int = RUNS) -> float:
    function()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def ring(count: int) -> Views:
    angles = 360 / count * np.arange(count)
    turn = np.deg2rad(angles)
    return Views(10 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1), angles, (0.0, 0.0))


def peaks(views: int, count: int) -> Peaks:
    rng = np.random.default_rng(count)
    ranges = np.sort(rng.uniform(4, 16, (views, count)), axis=1)
    return Peaks(ranges.ravel(), rng.exponential(size=ranges.size) + 1e-3, np.full(views, count))


def power(views: int) -> Pdp:
    rng = np.random.default_rng(0)
    return Pdp(rng.exponential(size=(views, 1200)), None, 2.5, RESOLUTION / 4, RESOLUTION, 1.5)


def soft(grid: VoxelGrid, views: Views, found: Peaks) -> RangeProfiles:
    return likelihood_profiles(found, SIGMA, RADIUS, grid.range_span_m(views.positions_m))


def twin_mvla(points: NDArray[np.float64], views: Views, found: Peaks) -> None:
    rows = [(found.range_m[found.view == m], found.weight[found.view == m]) for m in range(found.n_view)]
    twin.score(points, views.positions_m, rows, SIGMA, RADIUS)
    twin.supports(points, views.positions_m, rows, RADIUS)


def main() -> None:
    write = sys.stdout.write
    write(f"{cpu_name()}, median of {RUNS} runs after one to warm up\n")
    views, few, points = ring(360), ring(36), SMALL.centers()
    work, small_work = LARGE.size * len(views), SMALL.size * len(few)

    pdp = power(36)
    reference = small_work / median_s(lambda: twin.backprojection(points, few.positions_m, pdp.power, pdp.range_m))
    profiles = backprojection_profiles(power(360))
    seconds = median_s(lambda: project(LARGE, views, profiles))
    write(
        f"BP:                   {seconds:6.3f} s, {work / seconds / 1e9:5.2f}e9 updates/s (target 0.5e9), "
        f"{work / seconds / reference:6.0f} × NumPy (target 50)\n"
    )
    for count in (10, 100):
        sparse = peaks(36, count)
        reference = small_work / median_s(lambda found=sparse: twin_mvla(points, few, found), 3)  # type: ignore[misc]
        found = peaks(360, count)
        building = median_s(lambda found=found: soft(LARGE, views, found), 3)  # type: ignore[misc]
        profiles = soft(LARGE, views, found)
        seconds = median_s(lambda p=profiles: project(LARGE, views, p))  # type: ignore[misc]
        write(
            f"MVLA-GR, {count:3d} peaks:  {seconds:6.3f} s, {work / seconds / 1e9:5.2f}e9 updates/s (target 0.3e9), "
            f"{work / seconds / reference:6.0f} × NumPy (target 50); building its profiles {building:.2f} s\n"
        )


if __name__ == "__main__":
    main()
