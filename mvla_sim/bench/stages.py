"""The points of every stage: how large they are, what is run at each, and the loop that measures them."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from mvla_sim.bench.measure import ALONE, Engine, Measured, Work, measure
from mvla_sim.errors import ConfigError
from mvla_sim.interrupt import interruptible
from mvla_sim.progress import progress

__all__ = ["SIZES", "STAGES", "Point", "Series", "TimedPoint", "measure_stages", "points_of", "series_of"]

STAGES: Final = ("tracing", "projection", "search", "sweep")
SIZES: Final = ("rays", "views", "facets", "voxels", "thresholds", "workers", "cases", "tasks")
"""Everything a point's size can be made of."""
PATHS_PER_VIEW: Final = 4400
"""Of the star at the default numbers of rays."""
Size = Mapping[str, float]


@dataclass(frozen=True)
class Series:
    """Points that differ in one size at a time.

    Attributes
    ----------
    stage, name
        The stage, and what of it is measured.
    target
        Class of the job, ``module:name``; its arguments are the size and ``params``.
    base
        Size of the point that all axes share.
    axes
        Sizes along which cost is measured, with the values it is measured at.
    counted, unit
        Sizes whose product is what a call gets done, and its name.
    params, engine, warmups, repeats
        As of :class:`~mvla_sim.bench.measure.Work`.
    pinned
        Whether the child and its workers get as many cores as there are workers.
    """

    stage: str
    name: str
    target: str
    base: Size
    axes: Mapping[str, tuple[float, ...]]
    counted: tuple[str, ...]
    unit: str
    params: Mapping[str, Any] = field(default_factory=dict)
    engine: Engine = "none"
    warmups: int = 1
    repeats: int = 5
    pinned: bool = False

    def sizes(self) -> Iterator[dict[str, float]]:
        """Size of each point, the base first, each once."""
        seen = [dict(self.base)]
        for axis, values in self.axes.items():
            seen += [{**self.base, axis: value} for value in values]
        yield from (size for place, size in enumerate(seen) if size not in seen[:place])


@dataclass(frozen=True)
class Point:
    """One size of a series."""

    series: Series
    size: Size

    @property
    def work(self) -> Work:
        """What a child does."""
        series = self.series
        cores = round(self.size["workers"]) if series.pinned else None
        params = {**self.size, **series.params}
        return Work(series.target, params, series.engine, series.warmups, series.repeats, cores=cores)


@dataclass(frozen=True)
class TimedPoint:
    """One point with what was measured."""

    series: Series
    size: Size
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
    makers = {"tracing": _tracing, "projection": _projection, "search": _search, "sweep": _sweep}
    if stage not in makers:
        raise ConfigError(f"stage = {stage}: no such stage; allowed: {', '.join(STAGES)}")
    return makers[stage](quick)


def points_of(stages: Sequence[str], *, quick: bool = False) -> list[Point]:
    """All points of the stages. Raises as :func:`series_of`."""
    chosen = [one for stage in dict.fromkeys(stages) for one in series_of(stage, quick=quick)]
    return [Point(one, size) for one in chosen for size in one.sizes()]


def measure_stages(stages: Sequence[str] = STAGES, *, quick: bool = False) -> list[TimedPoint]:
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
            rows.append(
                TimedPoint(point.series, point.size, measure(point.work, kernels=kernels, cache=Path(name) / "cache"))
            )
            advance(1)
    return rows


def _tracing(quick: bool) -> tuple[Series, ...]:
    """A scene of the star, and a circle for the facets: from settings to a CIR file.

    The first two scenes of a process compile the large kernels, so neither is counted.
    """
    target = "mvla_sim.bench.tracing_jobs:TracingJob"
    rays = 26_000.0
    common: dict[str, Any] = {"counted": ("views",), "unit": "views", "engine": "tracer", "warmups": 2}
    if quick:
        star = Series(
            "tracing", "star", target, {"rays": rays, "views": 2}, {"rays": (rays, 4 * rays), "views": (2, 8)},
            repeats=2, **common,
        )  # fmt: skip
        return (star,)
    few: dict[str, Any] = {"repeats": 3, **common}
    base = {"rays": rays, "views": 2.0}
    return (
        Series(
            "tracing", "star", target, base,
            {"rays": (rays / 2, rays, 4 * rays, 16 * rays), "views": (1, 2, 8, 24)}, **few,
        ),
        Series("tracing", "circle", target, {**base, "facets": 360}, {"facets": (36, 360, 3600, 36_000)}, **few),
    )  # fmt: skip


def _projection(quick: bool) -> tuple[Series, ...]:
    """The projector with and without angular support, and what makes the profiles it projects."""
    voxels = (10_000.0, 160_000.0) if quick else (10_000.0, 40_000.0, 160_000.0, 640_000.0, 2_560_000.0)
    views = (36.0, 144.0) if quick else (9.0, 36.0, 72.0, 144.0, 720.0)
    base = {"voxels": 160_000.0, "views": 36.0 if quick else 72.0}
    projections = tuple(
        Series(
            "projection", method, "mvla_sim.bench.projection_jobs:ProjectionJob", base,
            {"voxels": voxels, "views": views}, ("voxels", "views"), "voxel·view", {"method": method}, "projector",
        )
        for method in ("mvla-gr", "bp")
    )  # fmt: skip
    seen = (9.0, 36.0) if quick else (9.0, 36.0, 144.0)
    front = tuple(
        Series(
            "projection", name, "mvla_sim.bench.imaging_jobs:FrontEndJob", {"views": 36}, {"views": seen}, ("views",),
            "views", {"part": part, "paths_per_view": PATHS_PER_VIEW},
        )
        for part, name in (("pdp", "read and PDP"), ("peaks", "noise, peaks, profiles"))
    )  # fmt: skip
    return projections + front


def _search(quick: bool) -> tuple[Series, ...]:
    """The exact search for a usual and for the worst image, and what prepares a truth for it."""
    voxels = (10_000.0, 40_000.0) if quick else (10_000.0, 40_000.0, 160_000.0, 640_000.0)
    thresholds = (18.0, 72.0) if quick else (6.0, 18.0, 72.0, 360.0)
    base = {"voxels": 40_000.0, "thresholds": 72.0}
    searches = tuple(
        Series(
            "search", name, "mvla_sim.bench.search_jobs:SearchJob", base,
            {"voxels": sizes, "thresholds": thresholds}, (), "images", {"image": image},
        )
        for image, name, sizes in (
            ("contour", "image of the target", voxels), ("unrelated", "unrelated image", voxels[:3])
        )
    )  # fmt: skip
    truth = Series(
        "search", "truth", "mvla_sim.bench.search_jobs:TruthJob", {"voxels": 40_000}, {"voxels": voxels}, (), "truths"
    )
    others = tuple(
        Series(
            "search", name, "mvla_sim.bench.search_jobs:SearchJob", base, {"voxels": (base["voxels"],)}, (), "images",
            {"image": image},
        )
        for image, name in (("half", "half of the target"), ("score alone", "no support"), ("white", "white noise"))
    )  # fmt: skip
    return (searches[0], truth) if quick else (*searches, truth, *others)


def _sweep(quick: bool) -> tuple[Series, ...]:
    """Cases on one and two workers, each on a core of its own, and empty tasks."""
    size = {"workers": 1.0, "cases": 128.0 if quick else 640.0, "views": 12.0 if quick else 36.0}
    return (
        Series(
            "sweep", "cases", "mvla_sim.bench.sweep_jobs:SweepJob", size, {"workers": (1, 2)}, ("cases",), "cases",
            repeats=2, pinned=True,
        ),
        Series(
            "sweep", "empty tasks", "mvla_sim.bench.sweep_jobs:HandingOutJob",
            {"workers": 1, "tasks": 200.0 if quick else 500.0}, {}, ("tasks",), "tasks", repeats=3,
        ),
    )  # fmt: skip
