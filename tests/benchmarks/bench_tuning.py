"""Time the exact threshold search; run as ``python tests/benchmarks/bench_tuning.py``.

The target is the paper's star (outer radius 4 m) on 10 m × 10 m at 0.05 m, seen from 72 views. Images:

* ``blurred contour``: a score that falls off from the contour, with speckle; wide support near the contour; and
  clutter of high score and narrow support;
* ``half the contour``: the same with nothing on one side, so that much of the truth is far from any voxel;
* ``no angular test``: the first image as backprojection is searched, over p alone;
* ``white``, ``smooth``: score and support that know nothing of the truth, the worst cases.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter
from shapely.geometry import Polygon

from mvla_sim.evaluation.ground_truth import TruthGeometry, rasterize
from mvla_sim.evaluation.tuning import optimal_thresholds
from mvla_sim.grid import VoxelGrid

RUNS = 7
Image = NDArray[np.float32]


def star(radius_m: float) -> Polygon:
    angle = np.pi / 2 + np.arange(10) * np.pi / 5
    inner = radius_m * np.sin(np.pi / 10) / np.sin(3 * np.pi / 10)
    radius = np.where(np.arange(10) % 2 == 0, radius_m, inner)
    return Polygon(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))


def support(likelihood: NDArray[np.float64], interval_deg: float) -> Image:
    """Θ in whole view intervals."""
    return np.asarray(np.round(likelihood * 180 / interval_deg) * interval_deg, np.float32).clip(0, 355)


def cases(truth: NDArray[np.bool_], grid: VoxelGrid) -> Iterator[tuple[str, Image, Image | None]]:
    rng = np.random.default_rng(1)
    distance = distance_transform_edt(~truth) * grid.spacing_m
    speckle = rng.exponential(size=grid.shape)
    smooth = gaussian_filter(rng.standard_normal(grid.shape), (0, 12, 12))
    smooth = (smooth - smooth.min()) / np.ptp(smooth)
    clutter = rng.random(grid.shape) < 0.02
    score = np.asarray((np.exp(-distance / 0.15) + 0.05 * smooth + clutter) * speckle, np.float32)
    theta = support(np.exp(-distance / 1.5) * rng.random(grid.shape) + 0.3 * smooth, 5)
    side = np.linspace(0, 1, grid.counts[0]) > 0.5
    yield "blurred contour", score, theta
    yield "half the contour", np.asarray(score * side, np.float32), np.asarray(theta * side, np.float32)
    yield "no angular test", score, None
    random_theta = support(2 * rng.random(grid.shape), 5)
    yield "white", rng.random(grid.shape).astype(np.float32), random_theta
    yield "smooth", smooth.astype(np.float32), support(2 * np.roll(smooth, 60, axis=2), 5)


def median_ms(function: object, *arguments: object) -> float:
    assert callable(function)
    function(*arguments)
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        function(*arguments)
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times)


def cpu_name() -> str:
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown CPU")


def main() -> None:
    write = sys.stdout.write
    for size_m, spacing_m in ((10.0, 0.05), (20.0, 0.05), (12.0, 0.01)):
        count = round(size_m / spacing_m)
        grid = VoxelGrid((0.0, 0.0, 0.0), (count, count, 1), spacing_m)
        outline = star(4.0)
        truth = rasterize(outline, grid, "contour")
        geometry = TruthGeometry.build(truth, grid)
        write(f"{cpu_name()}, median of {RUNS} runs: {grid.size} voxels, {geometry.voxels.size} truth voxels\n")
        write(f"  {median_ms(rasterize, outline, grid, 'contour'):8.1f} ms  rasterize\n")
        write(f"  {median_ms(TruthGeometry.build, truth, grid):8.1f} ms  TruthGeometry.build\n")
        for name, score, theta in cases(truth, grid):
            best = optimal_thresholds(score, theta, geometry)
            levels = 1 if theta is None else np.unique(theta).size
            write(
                f"  {median_ms(optimal_thresholds, score, theta, geometry):8.1f} ms  {name}, {levels} levels: "
                f"{best.cd_db:.2f} dB at p = {best.top_percent:.3f} %, T = {best.min_support_deg:g} deg\n"
            )


if __name__ == "__main__":
    main()
