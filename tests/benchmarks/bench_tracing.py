"""Time the tracer on the paper's star; run as ``python tests/benchmarks/bench_tracing.py``.

The program's tracer with its defaults (sector launch, passes) against the plain use of the engine: ``PathSolver`` with
everything enabled in one call and rays launched over the whole sphere. What is compared is the time per diffuse path
gathered, as the resolution cells of a PDP want tens of them each. The plain call gathers few at the default scattering
coefficient; it is timed at the largest number of rays that fits, and its time is scaled to the same number of paths.
Then the rays are doubled, and the mean PDP must stay within its speckle's spread.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import INTERACTIONS
from mvla_sim.channel.raytrace import ViewTracer
from mvla_sim.channel.simulate import simulate
from mvla_sim.engine.machine import cpu_name
from mvla_sim.imaging.imaging_settings import PdpSettings
from mvla_sim.imaging.pdp import compute_pdp
from mvla_sim.scene.scene_settings import SceneSettings
from mvla_sim.scene.world import Scene
from mvla_sim.settings import parse

VIEWS = 24
PLAIN_RAYS = (1_000_000, 4_000_000)
PLAIN_VIEWS = 3


def star(interval_deg: float, **ray_tracing: Any) -> Scene:
    data = {
        "name": "star",
        "objects": [{"shape": "star"}],
        "trajectory": {"kind": "circle", "interval_deg": interval_deg, "start_deg": 1.0},
        "ray_tracing": ray_tracing,
    }
    return Scene.from_settings(parse(SceneSettings, data, "star"))


def ours(scene: Scene) -> tuple[float, float]:
    """Median seconds and mean diffuse paths a view."""
    tracer = ViewTracer(scene)
    tracer.trace(scene.views.positions_m[0])
    times, counts = [], []
    for position in scene.views.positions_m:
        start = time.perf_counter()
        paths = tracer.trace(position)
        times.append(time.perf_counter() - start)
        counts.append(int((paths.interaction == INTERACTIONS["diffuse"]).sum()))
    return statistics.median(times), statistics.mean(counts)


def plain(scene: Scene, rays: int) -> tuple[float, float]:
    """Median seconds and mean diffuse paths a view of the engine's own call."""
    import mitsuba as mi  # noqa: PLC0415 - only after the backend is chosen

    tracer = ViewTracer(scene)  # for its scene: the same objects and materials
    solver = tracer._rt.PathSolver()
    times, counts = [], []
    for position in [scene.views.positions_m[0], *scene.views.positions_m[:PLAIN_VIEWS]]:
        start = time.perf_counter()
        point = mi.Point3f(*(float(c) for c in position))
        tracer._scene.get("tx").position = point
        tracer._scene.get("rx").position = point
        paths = solver(
            tracer._scene, max_depth=1, samples_per_src=rays, max_num_paths_per_src=1_000_000,
            los=False, refraction=False, specular_reflection=True, diffuse_reflection=True, diffraction=True,
        )  # fmt: skip
        kinds = paths.interactions.numpy()
        times.append(time.perf_counter() - start)
        counts.append(int((kinds == INTERACTIONS["diffuse"]).sum()))
    return statistics.median(times[1:]), statistics.mean(counts[1:])


def mean_pdp(scene: Scene) -> tuple[float, float, NDArray[np.float64]]:
    """Mean diffuse PDP over range and views, its expected relative speckle spread, and incoherent power a view."""
    cir = simulate(scene, cache=False)
    gain = np.where(cir.interaction == INTERACTIONS["diffuse"], cir.gain, np.complex64(0))
    pdp = compute_pdp(dataclasses.replace(cir, gain=gain), PdpSettings(), (4.0, 16.0))
    cell = 4 * pdp.broadening  # samples that are correlated
    spread = np.sqrt(cell * (pdp.power**2).sum() / 2) / pdp.power.sum()
    energy = np.add.reduceat(np.abs(gain.astype(np.complex128)) ** 2, cir.row_start[:-1])
    return float(pdp.power.mean()), float(spread), energy


def main() -> None:
    write = sys.stdout.write
    write(f"{cpu_name()}: star, 36 GHz, depth 1, S = 0.1\n")
    seconds, paths = ours(star(360 / VIEWS))
    write(
        f"this program, defaults: {1 / seconds:6.1f} views/s (target 6), "
        f"{paths:6.0f} diffuse paths a view (target 2000), median of {VIEWS} views after one to warm up\n"
    )
    for rays in PLAIN_RAYS:
        plain_seconds, plain_paths = plain(star(360 / VIEWS), rays)
        needed = plain_seconds * paths / plain_paths
        write(
            f"plain PathSolver, {rays:.0e} rays: {plain_seconds:6.2f} s a view for {plain_paths:5.0f} diffuse paths; "
            f"scaled to {paths:.0f} paths {needed:6.1f} s: {needed / seconds:5.0f} × slower (target 4)\n"
        )
    levels, spreads, energies = [], [], []
    for factor in (1, 2, 4):
        level, spread, energy = mean_pdp(star(10.0, diffuse_rays=6000 * factor))
        levels.append(level)
        spreads.append(spread)
        energies.append(energy)
    for one, factor in ((1, 2), (2, 4)):
        ratio, spread = levels[one] / levels[one - 1], float(np.hypot(spreads[one], spreads[one - 1]))
        incoherent = energies[one] / energies[one - 1]
        write(
            f"rays × {factor}: mean diffuse PDP × {ratio:.3f} of half as many, expected speckle spread {spread:.3f}; "
            f"incoherent power a view × {incoherent.min():.3f} to {incoherent.max():.3f}\n"
        )


if __name__ == "__main__":
    main()
