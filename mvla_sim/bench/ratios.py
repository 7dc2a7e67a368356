"""What things cost beside a reference that is measured in turn with them, in one run of one process.

Seconds differ from machine to machine and from hour to hour on a shared one; ratios much less.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.bench import numpy_twin as twin
from mvla_sim.bench.inputs import DEFAULT_RAYS, EXTENT_M, RESOLUTION_M, grid_of, ring, scene_settings
from mvla_sim.bench.sweep_jobs import star_plan
from mvla_sim.channel.cir import INTERACTIONS
from mvla_sim.channel.raytrace import ViewTracer
from mvla_sim.channel.simulate import simulate
from mvla_sim.engine.backend import set_threads
from mvla_sim.engine.cache import URL_VARIABLE, VARIABLE
from mvla_sim.engine.machine import core_count, environment_kept
from mvla_sim.errors import ConfigError
from mvla_sim.evaluation.evaluate import ground_truth
from mvla_sim.evaluation.metrics import score
from mvla_sim.evaluation.tuning import optimal_thresholds
from mvla_sim.imaging.detectors.local_maxima import LocalMaxima
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.likelihood import kernel_scales, likelihood_profiles
from mvla_sim.imaging.method import phase_free_methods
from mvla_sim.imaging.methods.bp import backprojection_profiles
from mvla_sim.imaging.noise import Noise
from mvla_sim.imaging.observation import FrontEnd, Observation
from mvla_sim.imaging.pdp import Pdp, PdpSettings, compute_pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.projection import project
from mvla_sim.imaging.thresholds import joint_threshold
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.run import run_plan
from mvla_sim.sweep.store import Store

__all__ = ["RATIOS", "Ratio", "check_stages", "measure_ratios", "watched"]

TWIN_SIZE: Final = (10_000, 36)
"""Voxels and views of the NumPy twin, whose cost grows in proportion to both."""
METHOD_SIZES: Final = ((40_000, 72), (1_000_000, 360))
ITERATIONS: Final = {"mlem": "mlem.iterations", "nnls": "nnls.iterations", "mvla-em": "em.iterations"}
"""Where the iterations of iterative methods are set."""
PEAKS: Final = 10
PLAIN_RAYS: Final = (1_000_000, 4_000_000)
AXES: Final = {
    "interval_deg": [10.0, 30.0, 60.0], "offset": "all", "snr_db": [0.0, 20.0], "method": ["mvla-gr", "bp"],
}  # fmt: skip
VIEWS: Final = 36
"""40 cases of so many views."""
PARTS: Final[dict[str, Callable[..., Any]]] = {
    "PDP": compute_pdp, "noise": Noise.add, "peaks": LocalMaxima.peaks_of, "profiles": likelihood_profiles,
    "projection": project, "truth": ground_truth, "search": optimal_thresholds, "threshold": joint_threshold,
    "scores": score, "store": Store.add,
}  # fmt: skip
"""Functions that a case of a sweep goes through, none of which calls another."""


@dataclass(frozen=True)
class Ratio:
    """A cost and what it was compared with."""

    stage: str
    name: str
    seconds: float  # median, of one piece of work; NaN where no time is compared
    ratio: float
    against: str
    rate_per_s: float = math.nan  # units that get done; NaN where nothing is counted
    unit: str = ""


def measure_ratios(stages: Sequence[str] = (), *, runs: int = 5) -> Iterator[Ratio]:
    """Measure the ratios of some stages of :data:`RATIOS`, by default all; medians are of so many runs after a first.

    Raises
    ------
    ConfigError
        There is no such stage; one line.
    """
    check_stages(stages)
    for stage in stages or RATIOS:
        yield from RATIOS[stage](runs)


def check_stages(stages: Sequence[str]) -> None:
    """Refuse stages of which there are no ratios. Raises as :func:`measure_ratios`."""
    for stage in stages:
        if stage not in RATIOS:
            raise ConfigError(f"stage = {stage}: no ratios of it; allowed: {', '.join(RATIOS)}")


@contextlib.contextmanager
def watched(**functions: Callable[..., Any]) -> Iterator[dict[str, float]]:
    """Seconds spent in functions and methods of this package, by name, wherever its modules refer to them."""
    seconds = dict.fromkeys(functions, 0.0)

    def watch(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            began = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                seconds[name] += time.perf_counter() - began

        return timed

    pairs = [(function, watch(name, function)) for name, function in functions.items()]
    _exchange(pairs)
    try:
        yield seconds
    finally:
        _exchange([(timed, function) for function, timed in pairs])


def _exchange(pairs: Sequence[tuple[Callable[..., Any], Callable[..., Any]]]) -> None:
    homes: list[Any] = [module for name, module in sys.modules.items() if name.startswith("mvla_sim.")]
    homes += {value for home in homes for value in vars(home).values() if isinstance(value, type)}
    for home in homes:
        for name, value in [*vars(home).items()]:
            for old, new in pairs:
                if value is old:
                    setattr(home, name, new)


def _median_s(call: Callable[[], object], runs: int) -> float:
    call()
    return statistics.median(_seconds(call) for _ in range(runs))


def _seconds(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def _peaks(views: int, count: int) -> Peaks:
    rng = np.random.default_rng(count)
    ranges = np.sort(rng.uniform(4, 16, (views, count)), axis=1)
    return Peaks(ranges.ravel(), rng.exponential(size=ranges.size) + 1e-3, np.full(views, count))


def _pdp(views: int) -> Pdp:
    rng = np.random.default_rng(0)
    return Pdp(rng.exponential(size=(views, 1200)), None, 2.5, RESOLUTION_M / 4, RESOLUTION_M, 1.5)


def _projection(runs: int) -> Iterator[Ratio]:
    """Updates a second of a million voxels from 360 views, over those of the NumPy twin without its search for Θ."""
    grid, views, few = grid_of(1_000_000), ring(360), ring(TWIN_SIZE[1])
    points, work, small = grid_of(TWIN_SIZE[0]).centers(), grid.size * len(views), math.prod(TWIN_SIZE)
    positions, pdp = few.positions_m, _pdp(len(few))
    plain = _median_s(lambda: twin.backprojection(points, positions, pdp.power, pdp.range_m), runs) / small
    profiles = backprojection_profiles(_pdp(len(views)))
    seconds = _median_s(lambda: project(grid, views, profiles), runs)
    yield Ratio("projection", "BP", seconds, plain * work / seconds, "a NumPy twin", work / seconds, "voxel·view")
    scales = kernel_scales(ImagingSettings().mvla, RESOLUTION_M, EXTENT_M)
    span = grid.range_span_m(views.positions_m)
    for count in (10, 100):
        sparse, found = _peaks(len(few), count), _peaks(len(views), count)
        plain = _median_s(functools.partial(_twin_mvla, points, positions, sparse, *scales), min(runs, 3)) / small
        building = _median_s(functools.partial(likelihood_profiles, found, *scales, span), min(runs, 3))
        profiles = likelihood_profiles(found, *scales, span)
        seconds = _median_s(functools.partial(project, grid, views, profiles), runs)
        name = f"MVLA-GR, {count} peaks a view"
        yield Ratio("projection", name, seconds, plain * work / seconds, "a NumPy twin", work / seconds, "voxel·view")
        yield Ratio("projection", f"its profiles, {count} peaks", building, building / seconds, "projecting them")


def _twin_mvla(
    points: NDArray[np.float64], positions: NDArray[np.float64], found: Peaks, sigma: float, radius: float
) -> None:
    rows = [(found.range_m[found.view == m], found.weight[found.view == m]) for m in range(found.n_view)]
    twin.score(points, positions, rows, sigma, radius)
    twin.supports(points, positions, rows, radius)


def _methods(runs: int) -> Iterator[Ratio]:
    """Time that each method spends in projections, of iterative ones that of an iteration, over BP's projection."""
    for voxels, views in METHOD_SIZES:
        base = functools.partial(_projecting, _observation("bp", voxels, views))
        for name in phase_free_methods():
            if name in ITERATIONS:
                few, many = (_observation(name, voxels, views, f"{ITERATIONS[name]}={n}") for n in (2, 12))
                own = functools.partial(_iterating, few, many)
            else:
                own = functools.partial(_projecting, _observation(name, voxels, views))
            own()
            base()
            pairs = [(own(), base()) for _ in range(runs)]
            what = f"{name}, {'an iteration, ' if name in ITERATIONS else ''}{voxels:,} voxels × {views} views"
            seconds, ratio = statistics.median(a for a, _ in pairs), statistics.median(a / b for a, b in pairs)
            yield Ratio("methods", what, seconds, ratio, "BP's projection")


def _observation(method: str, voxels: int, views: int, *settings: str) -> Observation:
    grid, seen = grid_of(voxels), ring(views)
    front = FrontEnd(_pdp(views), _peaks(views, PEAKS), RESOLUTION_M)
    chosen = imaging_settings([*settings], method=method)
    return Observation(front, seen, grid, chosen, EXTENT_M, grid.range_span_m(seen.positions_m))


def _projecting(seen: Observation) -> float:
    with watched(project=project) as spent:
        seen.settings.chosen.image(seen)
    return spent["project"]


def _iterating(few: Observation, many: Observation) -> float:
    one, other = few.settings.chosen, many.settings.chosen
    return (_seconds(lambda: other.image(many)) - _seconds(lambda: one.image(few))) / 10


def _tracing(runs: int) -> Iterator[Ratio]:
    """Time a diffuse path of the star, over plain use of the engine; then how the PDP changes with twice the rays.

    Plain is ``PathSolver`` with everything enabled in one call and rays over the whole sphere. It gathers few diffuse
    paths, so its time is scaled to as many as the tracer finds.
    """
    scene = _star(24)
    positions = scene.views.positions_m
    tracer = ViewTracer(scene)
    tracer.trace(positions[0])
    times, counts = [], []
    for position in positions:
        began = time.perf_counter()
        found = tracer.trace(position)
        times.append(time.perf_counter() - began)
        counts.append(int((found.interaction == INTERACTIONS["diffuse"]).sum()))
    seconds, paths = statistics.median(times), statistics.mean(counts)
    name = f"star, {paths:.0f} diffuse paths a view"
    for rays in PLAIN_RAYS:
        plain, gathered = _plain(tracer, positions[: min(runs, 3)], rays)
        against = f"a plain PathSolver of {rays:.0e} rays, scaled from {gathered:.0f} paths"
        yield Ratio("tracing", name, seconds, plain * paths / gathered / seconds, against, 1 / seconds, "views")
    levels = [_mean_pdp(_star(36, 6000 * factor)) for factor in (1, 2, 4)]
    for (level, spread, energy), (more, narrower, energies), factor in zip(levels, levels[1:], (2, 4), strict=False):
        expected = float(np.hypot(spread, narrower))
        against = f"half as many; speckle spreads it by {expected:.3f}"
        yield Ratio("tracing", f"mean diffuse PDP, rays × {factor}", math.nan, more / level, against)
        change = energies / energy
        worst = float(change[np.argmax(np.abs(change - 1))])
        yield Ratio(
            "tracing", f"incoherent power of a view, rays × {factor}", math.nan, worst, "half as many, at worst"
        )


def _star(views: int, diffuse_rays: int = DEFAULT_RAYS[0]) -> Scene:
    settings = scene_settings("star", views, sum(DEFAULT_RAYS))
    tracing = settings.ray_tracing.model_copy(update={"diffuse_rays": diffuse_rays})
    return Scene(settings.model_copy(update={"ray_tracing": tracing}))


def _plain(tracer: ViewTracer, positions: NDArray[np.float64], rays: int) -> tuple[float, float]:
    """Median seconds and mean diffuse paths a view of the engine's own call, on the same objects and materials."""
    solver = tracer._rt.PathSolver()
    times, counts = [], []
    for position in [positions[0], *positions]:
        began = time.perf_counter()
        for antenna in ("tx", "rx"):
            tracer._scene.get(antenna).position = [float(c) for c in position]
        paths = solver(
            tracer._scene, max_depth=1, samples_per_src=rays, max_num_paths_per_src=1_000_000,
            los=False, refraction=False, specular_reflection=True, diffuse_reflection=True, diffraction=True,
        )  # fmt: skip
        kinds = paths.interactions.numpy()
        times.append(time.perf_counter() - began)
        counts.append(int((kinds == INTERACTIONS["diffuse"]).sum()))
    return statistics.median(times[1:]), statistics.mean(counts[1:])


def _mean_pdp(scene: Scene) -> tuple[float, float, NDArray[np.float64]]:
    """Mean diffuse PDP over range and views, its expected relative speckle spread, and incoherent power a view."""
    cir = simulate(scene, cache=False)
    gain = np.where(cir.interaction == INTERACTIONS["diffuse"], cir.gain, np.complex64(0))
    pdp = compute_pdp(replace(cir, gain=gain), PdpSettings(), (4.0, 16.0))
    cell = 4 * pdp.broadening  # samples that are correlated
    spread = np.sqrt(cell * (pdp.power**2).sum() / 2) / pdp.power.sum()
    energy = np.add.reduceat(np.abs(gain.astype(np.complex128)) ** 2, cir.row_start[:-1])
    return float(pdp.power.mean()), float(spread), energy


def _sweep(runs: int) -> Iterator[Ratio]:
    """Share of each part in 40 cases of the star, in this process on one thread; then the same in worker processes."""
    del runs
    with tempfile.TemporaryDirectory(prefix="mvla-bench-") as name, environment_kept(VARIABLE, URL_VARIABLE):
        os.environ.pop(URL_VARIABLE, None)
        os.environ[VARIABLE] = f"{name}/cache"  # traced channels of one's own
        folder = Path(name)
        plan = star_plan(folder, VIEWS, AXES)
        for source in plan.sources.values():
            traced = _seconds(source.make)
        set_threads(1)
        try:
            run_plan(star_plan(folder, VIEWS, AXES | {"interval_deg": [60.0]}), folder / "warm-up", workers=0)
            with watched(**PARTS) as spent:
                seconds = _seconds(lambda: run_plan(plan, folder / "one", workers=0))
        finally:
            set_threads(core_count())
        count, all_cases = len(plan.cases), f"{len(plan.cases)} cases in one process"
        yield Ratio("sweep", "tracing", traced, traced / seconds, all_cases)
        for part, value in {**spent, "the rest": seconds - sum(spent.values())}.items():
            yield Ratio("sweep", part, value, value / seconds, all_cases)
        yield Ratio("sweep", "all cases", seconds, 1.0, all_cases, count / seconds, "cases")
        workers = _seconds(lambda: run_plan(plan, folder / "all"))
        what = f"in {core_count()} workers, with their start"
        yield Ratio("sweep", what, workers, workers / seconds, all_cases, count / workers, "cases")


RATIOS: Final[dict[str, Callable[[int], Iterator[Ratio]]]] = {
    "projection": _projection, "methods": _methods, "tracing": _tracing, "sweep": _sweep,
}  # fmt: skip
"""Everything that is compared, by stage."""
