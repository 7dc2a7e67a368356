"""From measured points over simple cost models to what a campaign takes on many nodes, and what was assumed.

Models are fitted by least squares: power laws, and fixed costs with a cost a unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mvla_sim.bench.stages import STAGES, TimedPoint
from mvla_sim.errors import ConfigError, DataError

__all__ = [
    "Affine", "CostForecast", "CostScenario", "Costs", "PowerLaw", "StageCost", "costs_from", "estimate", "fit_affine",
    "fit_power_law", "rows_along",
]  # fmt: skip

Floats = NDArray[np.float64]

TASKS_PER_SCENE: Final = 3
"""Trace it, make its profiles, run its case."""
SWEEP_VOXELS: Final = 40_000
"""Of the cases of the measured sweep: the program's default."""


@dataclass(frozen=True)
class PowerLaw:
    """y = scale·x^exponent; ``spread`` is the root mean square of ln(y/law): 0.1 is about 10 %."""

    scale: float
    exponent: float
    spread: float

    def __call__(self, x: float) -> float:
        """The law's value."""
        return float(self.scale * x**self.exponent)


@dataclass(frozen=True)
class Affine:
    """y = fixed + per_unit·x, neither below 0; ``spread`` is the root mean square of (law − y)/y."""

    fixed: float
    per_unit: float
    spread: float

    def __call__(self, x: float) -> float:
        """The law's value."""
        return self.fixed + self.per_unit * x


@dataclass(frozen=True)
class CostScenario:
    """What is to be computed, and on what: scenes, each traced and imaged once, and cores of each node.

    Every core runs one single-threaded worker.
    """

    scenes: int = 1_000_000
    views: int = 360
    nodes: int = 64
    cores: int = 32
    voxels: int = 40_000

    def __post_init__(self) -> None:
        """Refuse what is no campaign."""
        for name in ("scenes", "views", "nodes", "cores", "voxels"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}; at least 1")


@dataclass(frozen=True)
class Costs:
    """Cost models of all stages; seconds are those of one core, bytes beyond what is loaded."""

    trace: Affine  # a scene's tracing, over views
    pdp: Affine  # reading and PDP of a scene, over views
    peaks: Affine  # noise, peaks and profiles of a scene, over views
    project: Affine  # over voxels, at the base number of views
    project_views: Affine  # over views, at the base number of voxels
    search: PowerLaw  # of the target's image, over voxels, at the base number of thresholds
    search_levels: PowerLaw  # over thresholds
    base_views: float
    base_thresholds: float
    truth: PowerLaw  # preparing a truth, over voxels
    case_s: float  # a case of the measured sweep
    parts_s: float  # its noise, peaks, profiles, projection and search as measured on their own
    handing_out_s: float  # the coordinator's own time for a task
    efficiency: float  # core seconds of a case on one worker over those on two
    paths_per_view: float
    memory_bytes_per_path: float
    disk_bytes_per_path: float
    compiling_bytes: float  # peak of tracing while kernels are compiled
    trace_bytes: Affine  # the same afterwards, over views
    pdp_bytes: Affine  # of reading and PDP, over views
    loaded_bytes: float  # of a process that has loaded the tracer
    compile_s: float  # the first scene of a process beyond a usual one
    most_views: float  # that were traced
    disturbed: int  # points at which other programs were in the way
    points: int

    @property
    def rest_s(self) -> float:
        """What else a case takes: scores, storing, its share of the coordinator."""
        return max(0.0, self.case_s - self.parts_s)

    def project_s(self, voxels: float, views: float) -> float:
        """Seconds of a projection."""
        return self.project(voxels) * self.project_views(views) / self.project_views(self.base_views)

    def search_s(self, voxels: float, thresholds: float) -> float:
        """Seconds of a search."""
        return self.search(voxels) * float((thresholds / self.base_thresholds) ** self.search_levels.exponent)


@dataclass(frozen=True)
class StageCost:
    """Core seconds of one stage for one scene, and hours for all of them on all cores."""

    name: str
    core_s: float
    hours: float


@dataclass(frozen=True)
class CostForecast:
    """What a campaign takes. The one coordinator works while all stages go on one after the other on all cores."""

    campaign: CostScenario
    stages: tuple[StageCost, ...]  # that run on the workers
    computing_hours: float
    coordinating_hours: float
    bound: str  # the stage that takes longest, or "coordination" where that takes longer than all computing
    disk_bytes: float  # of all CIR files
    disk_bytes_per_s: float
    worker_bytes: float
    node_bytes: float
    assumptions: tuple[str, ...]  # one sentence each

    @property
    def hours(self) -> float:
        """Hours from start to end."""
        return max(self.computing_hours, self.coordinating_hours)


def rows_along(rows: Sequence[TimedPoint], stage: str, name: str, axis: str) -> list[TimedPoint]:
    """Rows of a series in which only ``axis`` differs from the base, by its value."""
    found = [row for row in rows if (row.series.stage, row.series.name) == (stage, name)]
    others = [
        row for row in found if all(value == row.series.base[key] for key, value in row.size.items() if key != axis)
    ]
    return sorted(others, key=lambda row: row.size[axis])


def costs_from(rows: Sequence[TimedPoint]) -> Costs:
    """Fit the cost models.

    Raises
    ------
    DataError
        A stage was not measured.
    """
    missing = [stage for stage in STAGES if stage not in {row.series.stage for row in rows}]
    if missing:
        raise DataError(f"no estimate without the measured points of {', '.join(missing)}")
    star = rows_along(rows, "tracing", "star", "views")
    typical = max(star, key=lambda row: row.size["views"])
    images = rows_along(rows, "projection", "mvla-gr", "voxels")
    read = rows_along(rows, "projection", "read and PDP", "views")
    searches = rows_along(rows, "search", "image of the target", "voxels")
    alone, both = rows_along(rows, "sweep", "cases", "workers")
    (tasks,) = rows_along(rows, "sweep", "empty tasks", "workers")
    costs = Costs(
        trace=_affine(star, "views"),
        pdp=_affine(read, "views"),
        peaks=_affine(rows_along(rows, "projection", "noise, peaks, profiles", "views"), "views"),
        project=_affine(images, "voxels"),
        project_views=_affine(rows_along(rows, "projection", "mvla-gr", "views"), "views"),
        base_views=images[0].series.base["views"],
        search=_law(searches, "voxels"),
        search_levels=_law(rows_along(rows, "search", "image of the target", "thresholds"), "thresholds"),
        base_thresholds=searches[0].series.base["thresholds"],
        truth=_law(rows_along(rows, "search", "truth", "voxels"), "voxels"),
        case_s=alone.measured.core_s / alone.done,
        parts_s=0.0,
        handing_out_s=tasks.measured.core_s / tasks.done,
        efficiency=min(1.0, alone.measured.core_s / both.measured.core_s),
        paths_per_view=typical.measured.facts["paths_per_view"],
        memory_bytes_per_path=typical.measured.facts["memory_bytes_per_path"],
        disk_bytes_per_path=typical.measured.facts["disk_bytes_per_path"],
        compiling_bytes=max(row.measured.memory_bytes for row in star),
        trace_bytes=_memory(star, "views"),
        pdp_bytes=_memory(read, "views"),
        loaded_bytes=typical.measured.loaded_bytes,
        compile_s=max(0.0, min(row.measured.first_s - row.measured.median_s for row in star)),
        most_views=typical.size["views"],
        disturbed=sum(row.disturbed for row in rows),
        points=len(rows),
    )
    views = alone.size["views"]
    parts = costs.peaks(views) + costs.project_s(SWEEP_VOXELS, views) + costs.search_s(SWEEP_VOXELS, views)
    return replace(costs, parts_s=parts)


def estimate(costs: Costs, campaign: CostScenario | None = None) -> CostForecast:
    """Extrapolate to a campaign: every scene is traced, imaged with MVLA-GR, and scored at the best thresholds."""
    campaign = campaign or CostScenario()
    views, voxels = campaign.views, campaign.voxels
    per_scene = {
        "tracing": costs.trace(views),
        "reading and PDP": costs.pdp(views),
        "noise, peaks, profiles": costs.peaks(views),
        "projection": costs.project_s(voxels, views),
        "search": costs.search_s(voxels, views) + costs.truth(voxels),
        "scores, storing, the rest": costs.rest_s,
    }
    hours_per_s = campaign.scenes / (campaign.nodes * campaign.cores * costs.efficiency) / 3600
    stages = tuple(StageCost(name, seconds, seconds * hours_per_s) for name, seconds in per_scene.items())
    computing = sum(stage.hours for stage in stages)
    coordinating = TASKS_PER_SCENE * campaign.scenes * costs.handing_out_s / 3600
    bound = "coordination" if coordinating > computing else max(stages, key=lambda stage: stage.hours).name
    disk = campaign.scenes * views * costs.paths_per_view * costs.disk_bytes_per_path
    worker = costs.loaded_bytes + max(costs.compiling_bytes, costs.trace_bytes(views), costs.pdp_bytes(views))
    return CostForecast(
        campaign=campaign,
        stages=stages,
        computing_hours=computing,
        coordinating_hours=coordinating,
        bound=bound,
        disk_bytes=disk,
        disk_bytes_per_s=disk / (3600 * max(computing, coordinating)),
        worker_bytes=worker,
        node_bytes=worker * campaign.cores,
        assumptions=_assumptions(costs, campaign),
    )


def _assumptions(costs: Costs, campaign: CostScenario) -> tuple[str, ...]:
    noisy = (
        f"Other programs were running at {costs.disturbed} of {costs.points} points, so all seconds are too high "
        "by an unknown factor, and the stage that bounds may be another on a quiet machine.",
    )
    return (
        *(noisy if costs.disturbed else ()),
        "Every scene is like the paper's star: 26,000 rays a view, one interaction, "
        f"{costs.paths_per_view:.0f} paths a view; rays, depth and facets change that as their tables say.",
        f"Every scene is traced once and imaged once, with MVLA-GR on {campaign.voxels:,} voxels and all "
        f"{campaign.views} views, and scored at the exact optimum over {campaign.views} values of Θ.",
        "A core of a node is as fast as the one measured; every core runs one single-threaded worker.",
        f"{campaign.cores} workers of a node slow each other down as two did here: "
        f"{100 * costs.efficiency:.0f} % of the speed of one. More of them share caches and memory, which was not "
        "measured.",
        f"Kernels are compiled in a worker's first two scenes ({costs.compile_s:.0f} s each, not counted) "
        "and serve all others.",
        f"Tracing is affine in views, also beyond the {costs.most_views:.0f} that were traced, and projection in "
        "voxels and in views; the search follows its power laws.",
        f"One coordinator hands out {TASKS_PER_SCENE} tasks a scene, {1e3 * costs.handing_out_s:.1f} ms each; traced "
        "channels are kept in a shared cache and do not pass through it.",
        "The shared file system takes what is written; no time is counted for waiting for it.",
        "No worker is lost, nothing is computed twice, and the last scenes end together.",
    )


def _affine(rows: Sequence[TimedPoint], axis: str) -> Affine:
    return fit_affine([row.size[axis] for row in rows], [row.measured.core_s for row in rows])


def _memory(rows: Sequence[TimedPoint], axis: str) -> Affine:
    return fit_affine([row.size[axis] for row in rows], [max(1.0, row.measured.steady_bytes) for row in rows])


def _law(rows: Sequence[TimedPoint], axis: str) -> PowerLaw:
    return fit_power_law([row.size[axis] for row in rows], [row.measured.core_s for row in rows])


def fit_power_law(x: Sequence[float], y: Sequence[float]) -> PowerLaw:
    """Fit a straight line to ln y over ln x.

    Raises
    ------
    DataError
        Fewer than two different sizes, or a value that is not above 0.
    """
    sizes, values = _checked(x, y)
    exponent, level = np.polyfit(np.log(sizes), np.log(values), 1)
    residual = np.log(values) - level - exponent * np.log(sizes)
    return PowerLaw(float(np.exp(level)), float(exponent), float(np.sqrt(np.mean(residual**2))))


def fit_affine(x: Sequence[float], y: Sequence[float]) -> Affine:
    """Fit a fixed cost and a cost a unit, neither negative; every point counts by its relative error.

    Raises
    ------
    DataError
        As :func:`fit_power_law`.
    """
    sizes, values = _checked(x, y)
    unit = sizes.max()  # keeps both columns of one size
    (fixed, slope), _ = nnls(np.stack([1 / values, sizes / unit / values], axis=1), np.ones(values.size))
    residual = (fixed + slope * sizes / unit) / values - 1
    return Affine(float(fixed), float(slope / unit), float(np.sqrt(np.mean(residual**2))))


def _checked(x: Sequence[float], y: Sequence[float]) -> tuple[Floats, Floats]:
    sizes, values = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if np.unique(sizes).size < 2:
        raise DataError(f"fit: {sizes.size} points at {np.unique(sizes).size} sizes; at least 2 sizes are needed")
    if sizes.min() <= 0 or values.min() <= 0 or not np.isfinite([sizes, values]).all():
        raise DataError("fit: sizes and costs must be finite and above 0")
    return sizes, values
