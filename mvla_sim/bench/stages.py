"""The points of every stage: how large they are, what is run at each, and the loop that measures them."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from mvla_sim.bench.measure import ALONE, Measured, Work, measure
from mvla_sim.errors import ConfigError
from mvla_sim.interrupt import interruptible
from mvla_sim.progress import progress

__all__ = ["SIZES", "STAGES", "Point", "Series", "TimedPoint", "measure_stages", "points_of", "series_of"]

SIZES: Final = ("rays", "views", "facets", "voxels", "thresholds", "workers", "cases", "tasks")
"""Everything a point's size can be made of."""
PATHS_PER_VIEW: Final = 4400
"""Of the star at the default numbers of rays."""
Size = Mapping[str, float]


@dataclass(frozen=True)
class Series:
    """Points that differ in one size at a time."""

    stage: str
    name: str  # what is measured of the stage
    work: Work  # the job; its arguments are the size of the point and ``params``
    base: Size  # of the point that all axes share
    axes: Mapping[str, tuple[float, ...]]  # sizes along which cost is measured, and the values it is measured at
    counted: tuple[str, ...]  # sizes whose product is what a call gets done
    unit: str  # the name of that
    pinned: bool = False  # whether the child and its workers get as many cores as there are workers

    def points(self) -> Iterator[Point]:
        """The points, the base first, each once."""
        seen = [dict(self.base)]
        for axis, values in self.axes.items():
            seen += [{**self.base, axis: value} for value in values]
        yield from (Point(self, size) for place, size in enumerate(seen) if size not in seen[:place])


@dataclass(frozen=True)
class Point:
    """One size of a series."""

    series: Series
    size: Size

    @property
    def work(self) -> Work:
        """What a child does."""
        work = self.series.work
        cores = round(self.size["workers"]) if self.series.pinned else None
        return replace(work, params={**self.size, **work.params}, cores=cores)


@dataclass(frozen=True)
class TimedPoint(Point):
    """One point with what was measured."""

    measured: Measured

    @property
    def rate(self) -> float:
        """Units that a core gets done in a second of work; of workers, units they all get done in a second."""
        return self.done / (self.measured.median_s if self.series.pinned else self.measured.core_s)

    @property
    def done(self) -> float:
        """Units a call gets done."""
        return math.prod(self.size[name] for name in self.series.counted)

    @property
    def disturbed(self) -> bool:
        """Whether the work had to wait for other programs, so that less was done than could have been."""
        workers = self.size["workers"] if self.series.pinned else 1.0
        return self.measured.core_s < ALONE * workers * self.measured.median_s


def series_of(stage: str, *, quick: bool = False) -> tuple[Series, ...]:
    """The series of a stage; ``quick`` has few and small points.

    Raises
    ------
    ConfigError
        There is no such stage.
    """
    if stage not in STAGES:
        raise ConfigError(f"stage = {stage}: no such stage; allowed: {', '.join(STAGES)}")
    return STAGES[stage](quick)


def points_of(stages: Sequence[str], *, quick: bool = False) -> list[Point]:
    """All points of the stages. Raises as :func:`series_of`."""
    chosen = [one for stage in dict.fromkeys(stages) for one in series_of(stage, quick=quick)]
    return [point for one in chosen for point in one.points()]


def measure_stages(stages: Sequence[str], *, quick: bool = False) -> list[TimedPoint]:
    """Measure every point of the stages, one after the other.

    Quick points share one folder of compiled kernels, so only the first of them shows how long compiling takes.

    Raises
    ------
    ConfigError
        There is no such stage; one line.
    RuntimeUnfitError
        A point failed; one line.
    """
    points = points_of(stages, quick=quick)
    rows = []
    with (
        interruptible(),
        tempfile.TemporaryDirectory(prefix="mvla-bench-", ignore_cleanup_errors=True) as name,
        progress("bench", len(points), "points") as advance,
    ):
        kernels = Path(name) / "kernels" if quick else None
        for point in points:
            found = measure(point.work, kernels=kernels, cache=Path(name) / "cache")
            rows.append(TimedPoint(point.series, point.size, found))
            advance(1)
    return rows


def _tracing(quick: bool) -> tuple[Series, ...]:
    """A scene of the star, and a circle for the facets: from settings to a CIR file.

    The first two scenes of a process compile the large kernels, so neither is counted.
    """
    work = Work("mvla_sim.bench.tracing_jobs:TracingJob", engine="tracer", warmups=2, repeats=2 if quick else 3)
    rays = 26_000.0
    base = {"rays": rays, "views": 2.0}
    axes: dict[str, tuple[float, ...]] = {"rays": (rays / 2, rays, 4 * rays, 16 * rays), "views": (1, 2, 8, 24)}
    if quick:
        axes = {"rays": (rays, 4 * rays), "views": (2, 8)}
    star = Series("tracing", "star", work, base, axes, ("views",), "views")
    facets = {"facets": (36.0, 360.0, 3600.0, 36_000.0)}
    circle = Series("tracing", "circle", work, {**base, "facets": 360}, facets, ("views",), "views")
    return (star,) if quick else (star, circle)


def _projection(quick: bool) -> tuple[Series, ...]:
    """The projector with and without angular support, and what makes the profiles it projects."""
    voxels = (10_000.0, 160_000.0) if quick else (10_000.0, 40_000.0, 160_000.0, 640_000.0, 2_560_000.0)
    views = (36.0, 144.0) if quick else (9.0, 36.0, 72.0, 144.0, 720.0)
    base = {"voxels": 160_000.0, "views": 36.0 if quick else 72.0}
    job = Work("mvla_sim.bench.imaging_jobs:ProjectionJob", engine="projector")
    projections = tuple(
        Series(
            "projection", method, replace(job, params={"method": method}), base, {"voxels": voxels, "views": views},
            ("voxels", "views"), "voxel·view",
        )
        for method in ("mvla-gr", "bp")
    )  # fmt: skip
    seen = {"views": (9.0, 36.0) if quick else (9.0, 36.0, 144.0)}
    front = tuple(
        Series(
            "projection", name,
            Work("mvla_sim.bench.imaging_jobs:FrontEndJob", {"part": part, "paths_per_view": PATHS_PER_VIEW}),
            {"views": 36}, seen, ("views",), "views",
        )
        for part, name in (("pdp", "read and PDP"), ("peaks", "noise, peaks, profiles"))
    )  # fmt: skip
    return projections + front


def _search(quick: bool) -> tuple[Series, ...]:
    """The exact search for a usual and for the worst image, and what prepares a truth for it."""
    voxels = (10_000.0, 40_000.0) if quick else (10_000.0, 40_000.0, 160_000.0, 640_000.0)
    thresholds = (18.0, 72.0) if quick else (6.0, 18.0, 72.0, 360.0)
    target, unrelated = (
        Series(
            "search", name, Work("mvla_sim.bench.search_jobs:SearchJob", {"image": image}),
            {"voxels": 40_000.0, "thresholds": 72.0}, {"voxels": sizes, "thresholds": thresholds}, (), "images",
        )
        for image, name, sizes in (
            ("contour", "image of the target", voxels), ("unrelated", "unrelated image", voxels[:3])
        )
    )  # fmt: skip
    work = Work("mvla_sim.bench.search_jobs:TruthJob")
    truth = Series("search", "truth", work, {"voxels": 40_000}, {"voxels": voxels}, (), "truths")
    return (target, truth) if quick else (target, unrelated, truth)


def _sweep(quick: bool) -> tuple[Series, ...]:
    """Cases on one and two workers, each on a core of its own, and empty tasks."""
    job = "mvla_sim.bench.sweep_jobs"
    size = {"workers": 1.0, "cases": 128.0 if quick else 640.0, "views": 12.0 if quick else 36.0}
    tasks = {"workers": 1, "tasks": 200.0 if quick else 500.0}
    return (
        Series(
            "sweep", "cases", Work(f"{job}:SweepJob", repeats=2), size, {"workers": (1, 2)}, ("cases",), "cases", True
        ),
        Series("sweep", "empty tasks", Work(f"{job}:HandingOutJob", repeats=3), tasks, {}, ("tasks",), "tasks"),
    )


STAGES: Final[dict[str, Callable[[bool], tuple[Series, ...]]]] = {
    "tracing": _tracing, "projection": _projection, "search": _search, "sweep": _sweep,
}  # fmt: skip
"""The series of every stage, in the order they are measured in."""
