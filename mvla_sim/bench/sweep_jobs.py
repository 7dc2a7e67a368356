"""Throughput of a sweep on local worker processes, their start-up apart, and how fast tasks can be handed out."""

from __future__ import annotations

import contextlib
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import psutil

from mvla_sim.bench.child import Job
from mvla_sim.bench.inputs import DEFAULT_RAYS
from mvla_sim.bench.measure import memory_of
from mvla_sim.cluster.opening import open_cluster
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import Plan, expand
from mvla_sim.sweep.run import run_plan
from mvla_sim.sweep.schedule import groups_of

__all__ = ["HandingOutJob", "SweepJob", "nothing", "star_plan"]

SCENE: Final = """
name = "bench"
[[objects]]
shape = "star"
[trajectory]
kind = "circle"
interval_deg = {interval}
start_deg = 1.0
[ray_tracing]
diffuse_rays = {diffuse}
specular_rays = {specular}
"""
SETTLE_S: Final = 0.05
MOST_S: Final = 60.0


def star_plan(folder: Path, views: float, axes: Mapping[str, Any]) -> Plan:
    """Cases of the star at the program's defaults along some axes; its scene file is written into ``folder``."""
    diffuse, specular = DEFAULT_RAYS
    scene = folder / "bench.toml"
    scene.write_text(SCENE.format(interval=360 / views, diffuse=diffuse, specular=specular), encoding="utf-8")
    file = folder / "bench-experiment.toml"
    lines = [f"{key} = {json.dumps(values)}" for key, values in axes.items()]
    file.write_text("\n".join(['name = "bench"', f"scenes = [{json.dumps(str(scene))}]", "[axes]", *lines]), "utf-8")
    return expand(load_experiment(file), limit=None)


def nothing(seconds: float) -> None:
    """Do nothing for a while; what workers are asked to show that they are there."""
    time.sleep(seconds)


class _Workers(Job):
    """Local workers that have started and have each done something."""

    def __init__(self, workers: float) -> None:
        self.workers = round(workers)
        self.folder = Path(tempfile.mkdtemp())
        self._stack = contextlib.ExitStack()
        began = time.perf_counter()
        self.cluster = self._stack.enter_context(open_cluster(self.workers))
        self.cluster.start()
        seen: set[str] = set()
        while len(seen) < self.workers and time.perf_counter() - began < MOST_S:
            tasks = [(SETTLE_S,)] * (2 * self.workers)
            seen |= {finished.worker for _, finished in self.cluster.run(nothing, tasks, label="start")}
        self.startup_s = time.perf_counter() - began
        self.loaded = max(memory_of(process.pid).now for process in self._processes())

    def _processes(self) -> list[psutil.Process]:
        """The workers, without the helper processes that Python starts beside them."""
        children = psutil.Process().children(recursive=True)
        return [child for child in children if any("spawn_main" in part for part in child.cmdline())]

    def core_s(self) -> float:
        """Of this process, which hands out the work, and of all workers."""
        times = [process.cpu_times() for process in (psutil.Process(), *self._processes())]
        return float(sum(one.user + one.system for one in times))

    def close(self) -> None:
        """End the workers."""
        self._stack.close()


class SweepJob(_Workers):
    """Cases of one traced channel, each from noise to scores, stored as they finish.

    All are MVLA-GR at 40,000 voxels from all ``views``, with noise of their own.
    """

    def __init__(self, workers: float, cases: float, views: float) -> None:
        super().__init__(workers)
        axes = {"method": ["mvla-gr"], "snr_db": [20.0], "seed": list(range(round(cases)))}
        self.plan = star_plan(self.folder, views, axes)
        for source in self.plan.sources.values():
            source.make()
        self.batches = sum(len(task.batches) for task in groups_of(self.plan, self.plan.cases, self.workers))
        self.failed = 0

    def call(self, number: int) -> None:
        """Run all cases into a new store."""
        result = run_plan(self.plan, self.folder / f"run-{number}", cluster=self.cluster)
        self.failed += result.count("failed") + result.count("missing")

    def facts(self) -> dict[str, float]:
        """Start-up, batches, cases that failed, and memory of the largest worker."""
        peak = max(memory_of(process.pid).peak for process in self._processes())
        return {
            "startup_s": self.startup_s,
            "batches": float(self.batches),
            "failed": float(self.failed),
            "memory_bytes": max(0.0, peak - self.loaded),
            "steady_bytes": max(0.0, peak - self.loaded),
            "loaded_bytes": self.loaded,
        }


class HandingOutJob(_Workers):
    """Tasks that do nothing: what remains is the coordinator's own work."""

    def __init__(self, workers: float, tasks: float) -> None:
        super().__init__(workers)
        self.tasks = round(tasks)

    def call(self, number: int) -> None:
        """Hand them all out and take the replies."""
        del number
        for _ in self.cluster.run(nothing, ((0.0,) for _ in range(self.tasks)), label="nothing"):
            pass

    def core_s(self) -> float:
        """Of this process alone, which the scheduler is part of."""
        return time.process_time()

    def facts(self) -> dict[str, float]:
        """Start-up."""
        return {"startup_s": self.startup_s}
