"""Time a sweep and the share of each of its stages; run as ``python tests/benchmarks/bench_sweep.py``.

The star from 36 views, every offset of 10°, 30° and 60°, two SNRs, MVLA-GR and BP: 40 cases on 40,000 voxels, traced,
prepared, imaged, searched, scored and stored in one process on one core. Shares are of the time without tracing, which
is done once and cached. The last line runs the same cases in worker processes, start-up included.
"""

from __future__ import annotations

import functools
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from mvla_sim.channel.simulate import cache_file, simulate
from mvla_sim.engine.backend import set_threads
from mvla_sim.engine.machine import core_count, cpu_name
from mvla_sim.sweep.batch import Batch, prepare, run_batch
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.run import run_plan
from mvla_sim.sweep.schedule import tasks_of
from mvla_sim.sweep.store import Store, identity

SCENES = Path(__file__).parents[2] / "scenes"
EXPERIMENT = f"""
name = "bench"
scenes = ["{SCENES / "star.toml"}"]
[axes]
"scene.trajectory.interval_deg" = [10.0]
interval_deg = [10.0, 30.0, 60.0]
offset = "all"
snr_db = [0.0, 20.0]
method = ["mvla-gr", "bp"]
"""
STAGES = {
    "noise": ("sweep.batch", "add_noise"),
    "peaks": ("sweep.batch", "extract_peaks"),
    "profiles": ("imaging.methods.mvla_gr", "likelihood_profiles"),
    "projection": ("imaging.observation", "project"),
    "truth": ("sweep.batch", "ground_truth"),
    "search": ("evaluation.evaluate", "optimal_thresholds"),
    "threshold": ("evaluation.evaluate", "joint_threshold"),
    "scores": ("evaluation.evaluate", "score"),
}


class Clock:
    """Seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - began

    def watch(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            with self.stage(name):
                return function(*arguments, **named)

        return timed


def main() -> None:
    write = sys.stdout.write
    with tempfile.TemporaryDirectory() as scratch:
        os.environ["MVLA_CACHE_DIR"] = f"{scratch}/cache"
        file = Path(scratch) / "bench.toml"
        file.write_text(EXPERIMENT)
        plan = expand(load_experiment(file))
        (task,) = tasks_of(plan, plan.cases, 1)
        clock = Clock()
        with clock.stage("trace"):
            simulate(task.scene)
        set_threads(1)
        with clock.stage("PDP"):
            channel = prepare(cache_file(task.scene), *task.key[1:], with_amplitude=False)
        run_batch(Batch(channel, task.cases[:2] + task.cases[-2:]))  # compiles the kernels
        for name, (module, function) in STAGES.items():
            home = import_module(f"mvla_sim.{module}")
            setattr(home, function, clock.watch(name, getattr(home, function)))
        began = time.perf_counter()
        rows = run_batch(Batch(channel, task.cases))
        batch = time.perf_counter() - began
        with clock.stage("store"), Store.open(Path(scratch) / "one", identity(plan)) as store:
            for row in rows:
                store.add(row)
        if failed := [row.error for row in rows if row.status == "failed"]:
            raise SystemExit(failed[0])
        clock.seconds["other"] = batch - sum(clock.seconds[name] for name in STAGES)
        total = batch + clock.seconds["PDP"] + clock.seconds["store"]
        write(f"{cpu_name()}: {len(rows)} cases of {task.scene.name}, {len(task.scene.views)} views\n")
        write(f"  {len(rows) / batch:.1f} cases/s on one core, {1e3 * batch / len(rows):.1f} ms a case\n")
        write(f"  {'trace':<11}{1e3 * clock.seconds['trace']:9.1f} ms\n")
        for name in ("PDP", *STAGES, "other", "store"):
            seconds = clock.seconds[name]
            write(f"  {name:<11}{1e3 * seconds:9.1f} ms  {100 * seconds / total:5.1f} %\n")
        began = time.perf_counter()
        run_plan(plan, Path(scratch) / "all")
        seconds = time.perf_counter() - began
        write(f"  {len(rows) / seconds:.1f} cases/s with {core_count()} workers, {seconds:.1f} s with their start-up\n")


if __name__ == "__main__":
    main()
