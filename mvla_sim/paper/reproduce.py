"""Run every experiment of the paper and build the report: ``mvla reproduce``."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from mvla_sim.channel.simulate import simulate
from mvla_sim.cluster.interface import Cluster
from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output, make_folder
from mvla_sim.measured.process import Processed, load_process, process
from mvla_sim.measured.process_files import write_processed
from mvla_sim.paper.checks import count_work, measure_phase
from mvla_sim.paper.report import draw_examples, write_report
from mvla_sim.pictures.run_pictures import draw_run
from mvla_sim.scene.world import Scene
from mvla_sim.shipped import shipped_folder
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import Plan, expand
from mvla_sim.sweep.run import RunResult, run_plan

__all__ = ["EXPERIMENTS", "MEASURED", "MeasurementStep", "RunStep", "reproduce"]

EXPERIMENTS: Final = (
    "main", "kappa-eta", "star-optimal", "star-calibrated", "examples", "sensitivity-star", "sensitivity-map",
)  # fmt: skip
"""Experiments in the order they run; the calibrated one needs the optimal one's table."""
MEASURED: Final = ("vehicle", "vehicle-3d")
"""Measurements that are processed, not swept."""
QUICK_SKIPS: Final = ("sensitivity-star", "sensitivity-map")
QUICK_OVERRIDES: Final = dict.fromkeys(("kappa-eta", "star-optimal", "star-calibrated"), ("axes.seed=[0]",))


@dataclass(frozen=True, eq=False)
class RunStep:
    """An experiment that is finished: its plan, what its run left, and its pictures."""

    plan: Plan = field(repr=False)
    result: RunResult
    pictures: list[Path] = field(repr=False)


@dataclass(frozen=True, eq=False)
class MeasurementStep:
    """A measurement that is processed: its name, what came of it, and its files."""

    name: str
    done: Processed
    files: list[Path] = field(repr=False)


def reproduce(
    experiments: Path | None, folder: Path, *, cluster: Cluster, quick: bool = False
) -> Iterator[RunStep | MeasurementStep | Path]:
    """Run the experiments, the checks, and build the report from what they stored; yield each when it is finished.

    ``experiments`` is the folder with their files, None for those of this package. ``folder`` gets one for each, and
    last the report is yielded. ``quick``: one noise seed, no sensitivity study. Raises DataError where an
    experiment file is missing; nothing has run by then.
    """
    experiments = experiments or shipped_folder("experiments")
    names = [name for name in EXPERIMENTS if not (quick and name in QUICK_SKIPS)]
    files = {name: _file(experiments, name) for name in (*names, *MEASURED)}
    seconds: dict[str, float] = {}
    for name in names:
        began = time.perf_counter()
        settings = load_experiment(files[name], QUICK_OVERRIDES.get(name, ()) if quick else ())
        plan = expand(settings, folder / name, None)
        result = run_plan(plan, folder / name, cluster=cluster)
        pictures = draw_run(plan, result.table, folder / name)
        if name == "examples":
            pictures += draw_examples(plan, folder / name)
        seconds[name] = time.perf_counter() - began
        yield RunStep(plan, result, pictures)
    for name in MEASURED:
        began = time.perf_counter()
        chosen = load_process(files[name])
        done = process(chosen, make_folder(folder / name))
        written = write_processed(done, chosen, folder / name)
        seconds[name] = time.perf_counter() - began
        yield MeasurementStep(chosen.name, done, written)
    began = time.perf_counter()
    star = Scene.load(experiments.parent / "scenes" / "star.toml")
    _write(folder / "checks.json", {"c15": count_work(), "c16": measure_phase(simulate(star))})
    seconds["checks"] = time.perf_counter() - began
    _write(folder / "run.json", {"quick": quick, "seconds": seconds, "total_s": sum(seconds.values())})
    yield write_report(folder)


def _file(experiments: Path, name: str) -> Path:
    """File of an experiment or measurement."""
    file = experiments / f"{name}.toml"
    if not file.is_file():
        raise DataError(f"{file}: no such experiment file")
    return file


def _write(file: Path, data: dict[str, Any]) -> None:
    with atomic_output(file) as temporary:
        temporary.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")
