"""From a scene to its CIR dataset: trace every view, keep the result, never trace the same thing twice."""

from __future__ import annotations

import hashlib
import inspect
import json
import logging
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mvla_sim.channel import raytrace
from mvla_sim.channel.cir import Cir
from mvla_sim.channel.raytrace import ViewPaths, ViewTracer
from mvla_sim.engine.cache import cache_folder, discard, pull, push
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import DataError, MvlaError, OutputError, check_argument
from mvla_sim.interrupt import deferred_interrupt
from mvla_sim.progress import progress
from mvla_sim.scene import antenna
from mvla_sim.scene.world import Scene

__all__ = ["SimulationInterruptedError", "cache_file", "simulate"]


class SimulationInterruptedError(MvlaError):
    """Ctrl-C while tracing; the views traced so far are kept and the next run goes on from them."""

    exit_code = 130


def cache_file(scene: Scene) -> Path:
    """Name of the cached CIR of a scene.

    The key covers the scene's geometry and settings, its views, radio and solver settings, the CIR schema, the versions
    of the packages that trace, and the code of the tracer itself.
    """
    key = {
        "scene": scene.fingerprint(),
        "schema": Cir.VERSION,
        "versions": {name: version(name) for name in ("sionna-rt", "mitsuba", "drjit")},
        "tracer": hashlib.sha256((inspect.getsource(raytrace) + inspect.getsource(antenna)).encode()).hexdigest(),
    }
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()
    return cache_folder() / "cir" / f"{digest[:32]}.nc"


def simulate(scene: Scene, *, cache: bool = True) -> Cir:
    """Trace every view of a scene.

    Parameters
    ----------
    scene
        The scene to trace.
    cache
        Reuse the result of an equal scene traced before, and keep this one. A damaged cache entry is traced again.

    Returns
    -------
    Cir
        One row of paths a view, in the order of ``scene.views``. Views without any path have a row of size 0.

    Raises
    ------
    ConfigError
        It is no scene.
    DataError
        No view has a path, or a view met the cap on paths.
    SimulationInterruptedError
        Ctrl-C; with ``cache`` the views traced so far are kept for the next run.
    """
    check_argument("scene", scene, Scene, "for a file: Scene.load")
    kept = cache_file(scene) if cache else None
    if kept is not None:
        pull(kept)
    if kept is not None and (cached := _load(kept)) is not None:
        settings = scene.settings  # an equal scene, and an equal pattern file, may bear another name
        return replace(cached, config=settings.model_dump(mode="json"), antenna=settings.radio.antenna)
    partial = kept.with_suffix(".partial.nc") if kept is not None else None
    views = _resume(partial)
    total = len(scene.views)
    with progress(f"tracing {scene.name}", total, "views") as advance:
        advance(len(views))
        try:
            with deferred_interrupt() as check:
                tracer = ViewTracer(scene)  # loading the engine must not be interrupted either
                check()
                for number in range(len(views), total):
                    views.append(_trace(tracer, scene, number))
                    advance(1)
                    check()
        except KeyboardInterrupt as stop:
            message = f"stopped after {len(views)} of {total} views"
            if partial is not None and views:
                partial.parent.mkdir(parents=True, exist_ok=True)
                _assemble(scene, views).save(partial)
                message += "; they are kept, run the same command to go on"
            raise SimulationInterruptedError(message) from stop
    cir = _assemble(scene, views)
    if cir.gain.size == 0:
        raise DataError(
            f"{scene.name}: no path was found at any of {total} views; enable ray_tracing.specular, diffuse or "
            f"diffraction, or raise the ray counts and the scattering coefficient"
        )
    if kept is not None and partial is not None:
        try:
            kept.parent.mkdir(parents=True, exist_ok=True)
            cir.save(kept)
            push(kept)
        except (OSError, OutputError) as error:  # the result is whole; only the next run will have to trace again
            logging.getLogger("mvla_sim").warning("mvla: note: not cached: %s", error)
        partial.unlink(missing_ok=True)
    return cir


def _trace(tracer: ViewTracer, scene: Scene, number: int) -> ViewPaths:
    views = scene.views
    receiver = None if views.receivers_m is None else views.receivers_m[number]
    boresight = views.directions[number] if scene.settings.radio.antenna.directional else None
    label = f"{scene.name}, view {number}"
    return tracer.trace(views.positions_m[number], label, receiver_m=receiver, boresight=boresight)


def _load(path: Path) -> Cir | None:
    """Read a cached file; None where there is none or it is damaged."""
    if not path.exists():
        return None
    try:
        return Cir.load(path)
    except DataError:
        discard(path)
        return None


def _resume(partial: Path | None) -> list[ViewPaths]:
    """Views that an interrupted run left behind."""
    earlier = _load(partial) if partial is not None else None
    if earlier is None:
        return []
    names = ViewPaths.__dataclass_fields__
    rows = [earlier.rows(m) for m in range(earlier.n_view)]
    return [ViewPaths(**{name: getattr(earlier, name)[row] for name in names}) for row in rows]


def _assemble(scene: Scene, views: list[ViewPaths]) -> Cir:
    """Join the views into one dataset, with everything that decided it."""
    return Cir(
        **{name: np.concatenate([getattr(v, name) for v in views]) for name in ViewPaths.__dataclass_fields__},
        row_size=np.array([v.gain.size for v in views], np.int64),
        views=scene.views.select(np.arange(len(views))),
        carrier_hz=scene.settings.radio.carrier_hz,
        bandwidth_hz=scene.settings.radio.bandwidth_hz,
        extent_m=scene.extent_m,
        outline=scene.outline,
        plane_height_m=scene.settings.plane_height_m,
        antenna=scene.settings.radio.antenna,
        config=scene.settings.model_dump(mode="json"),
        provenance=provenance(),
    )
