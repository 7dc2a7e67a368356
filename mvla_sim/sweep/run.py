"""Run an experiment: what is stored already is kept, what is missing is computed on all cores, case by case."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from mvla_sim.channel.simulate import SimulationInterruptedError, cache_file, simulate
from mvla_sim.config.experiment import ExperimentSettings
from mvla_sim.errors import ConfigError, MvlaError, OutputError, RuntimeUnfitError
from mvla_sim.files import atomic_output
from mvla_sim.runtime.interrupt import interruptible
from mvla_sim.runtime.machine import core_count
from mvla_sim.runtime.progress import Advance, progress
from mvla_sim.runtime.provenance import provenance
from mvla_sim.sweep.batch import Batch, Channel, Outcome, prepare, reason, results
from mvla_sim.sweep.case import Case, Row
from mvla_sim.sweep.plan import Plan, expand
from mvla_sim.sweep.pool import BatchJob, Died, Event, Pool, PrepareJob
from mvla_sim.sweep.schedule import Task, tasks_of
from mvla_sim.sweep.store import Store, identity
from mvla_sim.sweep.table import RECORD, build_table, write_table

__all__ = ["RunInterruptedError", "RunResult", "images_of", "missing_cases", "run_experiment", "run_plan"]

WAIT_S = 0.5
MOST_DEATHS = 10
"""Workers lost in one run before it is given up: something is wrong with the machine, not with a case."""


class RunInterruptedError(MvlaError):
    """Ctrl-C; the cases finished so far are stored and the next run goes on from them."""

    exit_code = 130


@dataclass(frozen=True)
class RunResult:
    """What a run leaves.

    Attributes
    ----------
    table
        One row a case; see :func:`mvla_sim.sweep.table.build_table`.
    files
        The tables written.
    notes
        What to know beside failed cases: workers that died, CIRs that had to be traced again, cases of older code.
    """

    table: pd.DataFrame
    files: tuple[Path, ...]
    notes: tuple[str, ...]

    def count(self, status: str) -> int:
        """Number of cases that are ``done``, ``failed`` or ``missing``."""
        return int((self.table["status"] == status).sum())


def run_experiment(
    settings: ExperimentSettings, folder: str | os.PathLike[str], workers: int | None = None
) -> pd.DataFrame:
    """Run what is missing of an experiment and return its table.

    Worker processes import the main module, so a script must call this under ``if __name__ == "__main__":``.

    Parameters
    ----------
    settings
        The experiment.
    folder
        Where its store and tables are kept.
    workers
        Number of processes, by default one a core. It changes no number.

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
    return run_plan(expand(settings, Path(folder), limit=None), Path(folder), workers=workers).table


def run_plan(plan: Plan, folder: Path, *, workers: int | None = None, fresh: bool = False) -> RunResult:
    """Run what is missing of a plan. Parameters and errors as :func:`run_experiment`.

    Parameters
    ----------
    plan
        From :func:`mvla_sim.sweep.plan.expand`.
    folder
        Where store and tables are kept.
    workers
        Number of processes.
    fresh
        Discard what is stored.
    """
    workers = core_count() if workers is None else workers
    if workers < 1:
        raise ConfigError(f"workers = {workers}; at least 1")
    with Store.open(folder, identity(plan), fresh=fresh) as store:
        missing = missing_cases(plan, store.rows())
        runner = _Runner(plan, store)
        try:
            with interruptible():
                if missing:
                    runner.run(missing, workers)
        except BaseException as error:
            finished = "finished"
            with contextlib.suppress(MvlaError):  # what ended the run may also be in the way of its table
                store.flush()
                table, _ = _write(plan, store, folder)
                finished = f"{(table['status'] == 'done').sum()} of {len(table)}"
            if isinstance(error, KeyboardInterrupt | SimulationInterruptedError):
                detail = f" ({error})" if str(error) else ""
                raise RunInterruptedError(
                    f"stopped{detail}; {finished} cases are stored in {folder}: run the same command to go on"
                ) from error
            raise
        store.flush()
        table, files = _write(plan, store, folder)
    return RunResult(table, tuple(files), (*store.notes, *runner.notes))


def missing_cases(plan: Plan, rows: dict[str, Row]) -> list[Case]:
    """Cases that are not stored, or failed before and are tried again; each key once."""
    wanted = {
        case.key: case for case in reversed(plan.cases) if case.key not in rows or rows[case.key].status != "done"
    }
    return sorted(wanted.values(), key=lambda case: case.number)


def images_of(plan: Plan, cases: Sequence[Case]) -> Iterator[Outcome]:
    """Compute cases in this process and yield them with their images, in the order given; failed ones are left out."""
    found: dict[int, Outcome] = {}
    for task in tasks_of(plan, cases, 1):
        simulate(task.scene)
        channel = prepare(cache_file(task.scene), *task.key[1:], with_amplitude=task.with_amplitude)
        outcomes = [outcome for _, outcome in results(Batch(channel, task.cases)) if outcome is not None]
        found |= {outcome.case.number: outcome for outcome in outcomes}
    yield from (found[case.number] for case in cases if case.number in found)


class _Runner:
    """One run of the missing cases."""

    def __init__(self, plan: Plan, store: Store) -> None:
        self.plan = plan
        self.store = store
        self.notes: list[str] = []
        self._tasks: list[Task] = []
        self._retraced: set[int] = set()
        self._deaths = 0

    def run(self, cases: Sequence[Case], workers: int) -> None:
        """Trace what is not cached, then compute all cases in worker processes."""
        self._tasks = tasks_of(self.plan, cases, workers)
        with progress(self.plan.experiment.name, len(cases), "cases") as advance:
            ready = [number for number, task in enumerate(self._tasks) if self._traced(task, advance)]
            self.store.flush()
            pieces = max((len(ready), sum(len(self._tasks[number].batches) for number in ready)))
            if not ready:
                return
            count = min(workers, pieces)
            with Pool(count, max(1, core_count() // count)) as pool:
                for number in ready:
                    pool.submit(self._prepare(number))
                while pool.busy:
                    for event in pool.step(WAIT_S):
                        self._handle(pool, event, advance)
                    self.store.flush_if_due()

    def _traced(self, task: Task, advance: Advance) -> bool:
        """Make sure a CIR is cached; its cases fail where it cannot be traced."""
        if cache_file(task.scene).exists():
            return True  # whether it is whole is found out when it is read
        try:
            simulate(task.scene)
        except (OutputError, RuntimeUnfitError, SimulationInterruptedError):
            raise
        except MvlaError as error:
            self._fail(task.cases, reason(error), advance)
            return False
        return True

    def _prepare(self, number: int) -> PrepareJob:
        task = self._tasks[number]
        return PrepareJob(number, cache_file(task.scene), *task.key[1:], task.with_amplitude)

    def _handle(self, pool: Pool, event: Event, advance: Advance) -> None:
        job, reply = event
        if isinstance(reply, Row):
            self._keep(reply, advance)
        elif isinstance(reply, Died):
            self._bury(pool, job, reply)
        elif isinstance(job, PrepareJob):
            task = self._tasks[job.number]
            if isinstance(reply, Channel):
                for batch in reversed(task.batches):
                    pool.submit(BatchJob(Batch(reply, batch)), first=True)
            elif reply.damaged and job.number not in self._retraced:
                self._retraced.add(job.number)
                self.notes.append(f"scene {task.scene.name}: the cached CIR was damaged and was traced again")
                if self._traced_again(task, advance):
                    pool.submit(job, first=True)
            else:
                self._fail(task.cases, reply.error, advance)

    def _traced_again(self, task: Task, advance: Advance) -> bool:
        cache_file(task.scene).unlink(missing_ok=True)
        return self._traced(task, advance)

    def _bury(self, pool: Pool, job: PrepareJob | BatchJob, death: Died) -> None:
        """Leave the case that a worker died of for the next run; the others of its batch go on."""
        self._deaths += 1
        if isinstance(job, PrepareJob):
            task = self._tasks[job.number]
            lost = f"the {len(task.cases)} cases of {task.scene.name} that needed its profiles are"
        else:
            lost = f"case {job.batch.cases[death.done].number} is"
            if rest := job.without(death.done + 1).batch.cases:
                pool.submit(BatchJob(Batch(job.batch.channel, rest)), first=True)
        self.notes.append(f"a worker process died ({death.how}); {lost} left for the next run")
        if self._deaths >= MOST_DEATHS:
            raise RuntimeUnfitError(
                f"{self._deaths} worker processes died, the last one {death.how}; what is finished is stored. "
                f"Is there enough memory? Try --workers 1"
            )

    def _keep(self, row: Row, advance: Advance) -> None:
        self.store.add(row)
        advance(1)

    def _fail(self, cases: Sequence[Case], error: str, advance: Advance) -> None:
        for case in cases:
            self._keep(Row(case.key, "failed", error), advance)


def _write(plan: Plan, store: Store, folder: Path) -> tuple[pd.DataFrame, list[Path]]:
    """Write the tables and the record of what made them."""
    stored = store.rows()
    table = build_table(plan.cases, {case.key: stored[case.key] for case in plan.cases if case.key in stored})
    record = {
        "settings": plan.experiment.model_dump(mode="json", by_alias=True),
        "cases": {status: int((table["status"] == status).sum()) for status in ("done", "failed", "missing")},
        "provenance": provenance(),
    }
    record["settings"]["scenes"] = [Path(name).name for name in plan.experiment.scenes]
    with atomic_output(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return table, write_table(table, folder)
