"""Run every experiment of the paper and build the report: ``mvla reproduce``."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from mvla_sim.channel.simulate import simulate
from mvla_sim.cluster.interface import Cluster
from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output
from mvla_sim.measured.command import run_process
from mvla_sim.paper.checks import measure_cost, measure_phase
from mvla_sim.paper.experiments import execute
from mvla_sim.paper.report import draw_examples, write_report
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import Plan, expand

__all__ = ["EXPERIMENTS", "MEASURED", "reproduce"]

EXPERIMENTS: Final = (
    "main", "kappa-eta", "star-optimal", "star-calibrated", "examples", "sensitivity-star", "sensitivity-map",
)  # fmt: skip
"""Experiments in the order they run; the calibrated one needs the optimal one's table."""
MEASURED: Final = ("vehicle", "vehicle-3d")
"""Measurements that are processed, not swept."""
QUICK_SKIPS: Final = ("sensitivity-star", "sensitivity-map")
QUICK_OVERRIDES: Final = dict.fromkeys(("kappa-eta", "star-optimal", "star-calibrated"), ("axes.seed=[0]",))


def reproduce(
    experiments: Path, folder: Path, out: Console, errors: Console, *, cluster: Cluster, quick: bool = False
) -> int:
    """Run the experiments, the checks, and build the report from what they stored.

    Parameters
    ----------
    experiments
        Folder with the experiment files.
    folder
        Folder of the results; one sub-folder an experiment.
    out, errors
        Where to print.
    cluster
        What runs the cases.
    quick
        One noise seed, and no sensitivity study.

    Returns
    -------
    int
        Exit code: 1 where a case failed, else 0.

    Raises
    ------
    DataError
        An experiment file is missing; nothing has run by then.
    """
    names = [name for name in EXPERIMENTS if not (quick and name in QUICK_SKIPS)]
    for name in (*names, *MEASURED):
        if not (experiments / f"{name}.toml").is_file():
            raise DataError(f"{experiments / name}.toml: no such experiment file; run this in a checkout, or name the "
                            f"folder with --experiments")  # fmt: skip
    seconds: dict[str, float] = {}
    worst = 0
    for name in names:
        began = time.perf_counter()
        plan = _plan(experiments, folder, name, QUICK_OVERRIDES.get(name, ()) if quick else ())
        worst = max(worst, execute(plan, folder / name, out, errors, cluster=cluster))
        if name == "examples":
            draw_examples(plan, folder / name)
        seconds[name] = time.perf_counter() - began
    for name in MEASURED:
        began = time.perf_counter()
        run_process(experiments / f"{name}.toml", folder / name, (), out)
        seconds[name] = time.perf_counter() - began
    began = time.perf_counter()
    star = Scene.load(experiments.parent / "scenes" / "star.toml")
    _write(folder / "checks.json", {"c15": measure_cost(), "c16": measure_phase(simulate(star))})
    seconds["checks"] = time.perf_counter() - began
    _write(folder / "run.json", {"quick": quick, "seconds": seconds, "total_s": sum(seconds.values())})
    out.print(f"report:   {write_report(folder)}", markup=False)
    return worst


def _plan(experiments: Path, folder: Path, name: str, overrides: Sequence[str]) -> Plan:
    return expand(load_experiment(experiments / f"{name}.toml", overrides), folder / name, None)


def _write(file: Path, data: dict[str, Any]) -> None:
    with atomic_output(file) as temporary:
        temporary.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")
