"""Run every experiment of the paper and build the report: ``mvla reproduce``."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
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
from mvla_sim.paper.reading_sections import FRESH, READINGS, draw_examples
from mvla_sim.paper.report import write_report
from mvla_sim.pictures.run_pictures import draw_run
from mvla_sim.scene.world import Scene
from mvla_sim.shipped import shipped_folder
from mvla_sim.sweep.experiment import ExperimentSettings, load_experiment
from mvla_sim.sweep.plan import Plan, expand
from mvla_sim.sweep.run import run_plan
from mvla_sim.sweep.session import RunResult

__all__ = ["EXPERIMENTS", "MEASURED", "MeasurementStep", "RunStep", "reproduce"]

EXPERIMENTS: Final = ("main", "kappa-eta", "star-optimal", "star-calibrated", "examples")
"""Experiments in the order they run; the calibrated one needs the optimal one's table."""
MEASURED: Final = ("vehicle", "vehicle-3d")
"""Measurements that are processed, not swept."""
JUDGED: Final = ("kappa-eta", "star-optimal", "star-calibrated")
"""Those that claims rest on."""
FRESH_TRACING, FRESH_NOISE = 2, (2, 3, 4, 5, 6)
"""Seeds that no reading was chosen with."""
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
    experiments: Path | None,
    folder: Path,
    *,
    cluster: Cluster,
    quick: bool = False,
    readings: Sequence[str] = READINGS,
    fresh_seeds: bool = False,
) -> Iterator[RunStep | MeasurementStep | Path]:
    """Run the experiments, the checks, and build the report from what they stored; yield each when it is finished.

    Parameters
    ----------
    experiments
        Folder with their files; None for those of this package.
    folder
        Gets a folder a reading, with one for each experiment, and one for each measurement; the report last.
    quick
        One noise seed.
    readings
        Readings that each experiment is run under; see :mod:`mvla_sim.imaging.reading`.
    fresh_seeds
        Judge each reading on seeds that it was not chosen with as well: another tracing seed, noise seeds 2 to 6.

    Raises
    ------
    DataError
        An experiment or a reading is missing; nothing has run by then.
    ConfigError
        A reading is not valid.
    """
    experiments = experiments or shipped_folder("experiments")
    files = {name: _file(experiments, name) for name in (*EXPERIMENTS, *MEASURED)}
    chosen = {
        (Path(reading).stem, name): load_experiment(
            files[name], [f"reading={reading}", *(QUICK_OVERRIDES.get(name, ()) if quick else ())]
        )
        for reading in readings
        for name in EXPERIMENTS
    }
    if fresh_seeds:
        chosen |= {
            (f"{reading}{FRESH}", name): _on_fresh_seeds(settings)
            for (reading, name), settings in chosen.items()
            if name in JUDGED
        }
    seconds: dict[str, float] = {}
    for (reading, name), settings in chosen.items():
        began = time.perf_counter()
        place = folder / reading / name
        plan = expand(settings, place, None)
        result = run_plan(plan, place, cluster=cluster)
        pictures = draw_run(plan, result.table, place)
        if name == "examples":
            pictures += draw_examples(plan, place)
        seconds[f"{reading}/{name}"] = time.perf_counter() - began
        yield RunStep(plan, result, pictures)
    for name in MEASURED:
        began = time.perf_counter()
        measurement = load_process(files[name])
        done = process(measurement, make_folder(folder / name))
        written = write_processed(done, measurement, folder / name)
        seconds[name] = time.perf_counter() - began
        yield MeasurementStep(measurement.name, done, written)
    began = time.perf_counter()
    star = Scene.load(experiments.parent / "scenes" / "star.toml")
    _write(folder / "checks.json", {"c15": count_work(), "c16": measure_phase(simulate(star))})
    seconds["checks"] = time.perf_counter() - began
    _write(folder / "run.json", {"quick": quick, "seconds": seconds, "total_s": sum(seconds.values())})
    yield write_report(folder)


def _on_fresh_seeds(settings: ExperimentSettings) -> ExperimentSettings:
    """The same experiment with another tracing seed and other noise seeds; as many of these as it had, at most five."""
    count = len(settings.axes.get("seed", FRESH_NOISE))
    axes = {**settings.axes, "scene.ray_tracing.seed": (FRESH_TRACING,), "seed": FRESH_NOISE[:count]}
    return settings.model_copy(update={"axes": axes})


def _file(experiments: Path, name: str) -> Path:
    """File of an experiment or measurement."""
    file = experiments / f"{name}.toml"
    if not file.is_file():
        raise DataError(f"{file}: no such experiment file")
    return file


def _write(file: Path, data: dict[str, Any]) -> None:
    with atomic_output(file) as temporary:
        temporary.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")
