"""Run an experiment: what is stored already is kept, what is missing is computed on a cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from mvla_sim.cluster.interface import Cluster
from mvla_sim.errors import check_argument
from mvla_sim.files import as_path
from mvla_sim.imaging.pipeline import Pipeline
from mvla_sim.sweep.batch import Outcome, load_profiles, results
from mvla_sim.sweep.case import Case
from mvla_sim.sweep.design_plan import plan_design
from mvla_sim.sweep.design_run import run_design
from mvla_sim.sweep.experiment import ExperimentSettings
from mvla_sim.sweep.plan import Plan, expand
from mvla_sim.sweep.schedule import groups_of
from mvla_sim.sweep.session import RunResult, open_session, write_record
from mvla_sim.sweep.store import Store, identity
from mvla_sim.sweep.table import build_table, write_table

__all__ = ["images_of", "run_experiment", "run_plan"]


def run_experiment(
    settings: ExperimentSettings, folder: str | os.PathLike[str], workers: int | None = None
) -> pd.DataFrame:
    """Run what is missing of an experiment and return its table; that of a design's samples is in ``load_design``.

    Worker processes import the main module, so a script must call this under ``if __name__ == "__main__":``.

    Parameters
    ----------
    settings
        The experiment.
    folder
        Where its store and tables are kept.
    workers
        Number of processes, by default one a core; 0 for none but this one. It changes no number.

    Returns
    -------
    DataFrame
        One row a case, in the order of the plan; failed cases say why in ``error``.

    Raises
    ------
    ConfigError, DataError, OutputError
        The experiment, the store or the folder cannot be used; one line.
    RunInterruptedError
        Ctrl-C.
    """
    check_argument("settings", settings, ExperimentSettings, "see load_experiment")
    place = as_path(folder)
    if settings.design is not None:
        return run_design(plan_design(settings, place, limit=None), place, workers=workers).table
    return run_plan(expand(settings, place, limit=None), place, workers=workers).table


def run_plan(
    plan: Plan, folder: Path, *, workers: int | None = None, cluster: Cluster | None = None, fresh: bool = False
) -> RunResult:
    """Run what is missing of a plan; parameters and errors as :func:`run_experiment`.

    A ``cluster`` runs the cases instead of so many workers, and stays open. ``fresh``: discard what is stored.
    """
    with Store.open(folder, identity(plan), fresh=fresh) as store:
        with open_session(store, folder, workers, cluster, lambda: _write(plan, store, folder)[0]) as session:
            session.run(plan, plan.experiment.name)
        table, files = _write(plan, store, folder)
    return RunResult(table, tuple(files), (*store.notes, *session.notes))


def images_of(plan: Plan, cases: Sequence[Case]) -> Iterator[Outcome]:
    """Compute cases in this process and yield them with their images, in the order given; failed ones are left out."""
    found: dict[int, Outcome] = {}
    for group in groups_of(plan, cases, 1):
        group.source.make()
        stages = Pipeline(load_profiles(group.source.file, group.wanted))
        outcomes = [outcome for _, outcome in results(stages, group.cases) if outcome is not None]
        found |= {outcome.case.number: outcome for outcome in outcomes}
    yield from (found[case.number] for case in cases if case.number in found)


def _write(plan: Plan, store: Store, folder: Path) -> tuple[pd.DataFrame, list[Path]]:
    """Write the tables and the record of what made them."""
    stored = store.rows()
    table = build_table(plan.cases, {case.key: stored[case.key] for case in plan.cases if case.key in stored})
    write_record(plan.experiment, table, folder)
    return table, write_table(table, folder)
