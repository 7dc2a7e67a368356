"""A cluster at work for a store: the missing cases of one plan after another are computed, some cases at a time."""

from __future__ import annotations

import contextlib
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mvla_sim.channel.simulate import SimulationInterruptedError
from mvla_sim.cluster.interface import Cluster, Finished, Shared, WorkerDiedError
from mvla_sim.cluster.opening import open_cluster
from mvla_sim.engine.cache import cache_url, discard, pull, push
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import MvlaError, OutputError, RuntimeUnfitError, reason
from mvla_sim.files import atomic_output
from mvla_sim.interrupt import interruptible
from mvla_sim.progress import Advance, progress
from mvla_sim.sweep import jobs
from mvla_sim.sweep.case import Case, Row
from mvla_sim.sweep.experiment import ExperimentSettings
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.schedule import CaseGroup, groups_of
from mvla_sim.sweep.store import Store
from mvla_sim.sweep.table import RECORD

__all__ = ["RunInterruptedError", "RunResult", "Session", "missing_cases", "open_session", "write_record"]

MOST_DEATHS = 10
"""Workers lost in one run before it is given up: something is wrong with the machine, not with a case."""


class RunInterruptedError(MvlaError):
    """Ctrl-C; the cases finished so far are stored and the next run goes on from them."""

    exit_code = 130


@dataclass(frozen=True, eq=False)
class RunResult:
    """What a run leaves."""

    table: pd.DataFrame  # one row a case; see `build_table`
    files: tuple[Path, ...]  # the tables written
    notes: tuple[str, ...]  # beside failed cases: workers that died, CIRs traced again, cases of older code

    def __repr__(self) -> str:
        """One line: how many cases are done."""
        return f"RunResult({self.count('done')} of {len(self.table)} cases done)"

    def count(self, status: str) -> int:
        """Number of cases that are ``done``, ``failed`` or ``missing``."""
        return int((self.table["status"] == status).sum())


class Session:
    """What runs plans; see :func:`open_session`."""

    def __init__(self, store: Store, cluster: Cluster) -> None:
        self.notes: list[str] = []
        """Workers that died, CIRs that were traced again."""
        self._store = store
        self._cluster = cluster

    def run(self, plan: Plan, title: str) -> None:
        """Run the cases of a plan that are not stored; ``title`` stands before the progress bar."""
        if missing := missing_cases(plan, self._store.rows()):
            runner = _Runner(plan, self._store, title)
            runner.run(missing, self._cluster)
            self.notes += runner.notes
        self._store.flush()


@contextlib.contextmanager
def open_session(
    store: Store, folder: Path, workers: int | None, cluster: Cluster | None, write: Callable[[], pd.DataFrame]
) -> Iterator[Session]:
    """Open a cluster of so many workers, unless there is one, for a store in a folder.

    Where the run ends before its time, what is finished is kept, and ``write`` writes its tables and returns that of
    the cases.

    Raises
    ------
    RunInterruptedError
        Ctrl-C.
    """
    try:
        own = open_cluster(workers) if cluster is None else contextlib.nullcontext(cluster)
        with interruptible(), own as chosen:
            yield Session(store, chosen)
    except BaseException as error:
        finished = "finished"
        with contextlib.suppress(MvlaError):  # what ended the run may also be in the way of its table
            store.flush()
            table = write()
            finished = f"{(table['status'] == 'done').sum()} of {len(table)}"
        if isinstance(error, KeyboardInterrupt | SimulationInterruptedError):
            detail = f" ({error})" if str(error) else ""
            raise RunInterruptedError(
                f"stopped{detail}; {finished} cases are stored in {folder}: run the same command to go on"
            ) from error
        raise


def missing_cases(plan: Plan, rows: Mapping[str, Row]) -> list[Case]:
    """Cases that are not stored, or failed before and are tried again; each key once."""
    wanted = {
        case.key: case for case in reversed(plan.cases) if case.key not in rows or rows[case.key].status != "done"
    }
    return sorted(wanted.values(), key=lambda case: case.number)


@dataclass(frozen=True)
class _Piece:
    """Cases that run together: those of one channel, by its number, as of its so many-th CIR."""

    number: int
    cases: tuple[Case, ...]
    edition: int = 0


class _Runner:
    """One run of the missing cases."""

    def __init__(self, plan: Plan, store: Store, title: str) -> None:
        self.plan = plan
        self.store = store
        self.title = title
        self.notes: list[str] = []
        self._groups: list[CaseGroup] = []
        self._editions: dict[int, int] = {}

    def run(self, cases: Sequence[Case], cluster: Cluster) -> None:
        """Trace what is not cached, then compute all cases."""
        cluster.start()
        died_before = cluster.deaths
        self._groups = groups_of(self.plan, cases, cluster.count)
        with progress(self.title, len(cases), "cases") as advance:
            if cluster.remote:
                ready = self._traced_there(cluster, advance)
            else:
                ready = [number for number, group in enumerate(self._groups) if self._traced(group, advance)]
            self.store.flush()
            pieces = [_Piece(number, batch) for number in ready for batch in self._groups[number].batches]
            while pieces:
                again: list[_Piece] = []
                for index, finished in cluster.run(
                    jobs.run_cases, self._arguments(pieces, cluster), label="cases", idle=self.store.flush_if_due
                ):
                    again += self._take(pieces[index], finished, advance)
                    if (deaths := cluster.deaths - died_before) >= MOST_DEATHS:
                        raise RuntimeUnfitError(
                            f"workers died {deaths} times in the middle of their cases; what is finished is stored. Is "
                            f"there enough memory? Try workers = 1",
                            setting="workers",
                        )
                pieces = again

    def _traced(self, group: CaseGroup, advance: Advance) -> bool:
        """Make sure that this machine has a CIR; its cases fail where it cannot be traced."""
        source = group.source
        if source.scene is not None:
            pull(source.file)
        if source.file.exists():
            return True  # whether it is whole is found out when it is read
        try:
            source.make()
        except (OutputError, RuntimeUnfitError, SimulationInterruptedError):
            raise
        except MvlaError as error:
            self._fail(group.cases, reason(error), advance)
            return False
        return True

    def _traced_there(self, cluster: Cluster, advance: Advance) -> list[int]:
        """Have workers trace what is not there, one scene a task; return the groups whose channel is there then."""
        shared = cache_url() is not None
        traced = {group.source.key: group.source for group in self._groups if group.source.scene is not None}
        missing = []
        for key, source in traced.items():
            if source.file.exists() and shared:
                push(source.file)
            elif not source.file.exists():
                missing.append(key)
        broken: dict[str, str] = {}
        trace = jobs.trace_and_share if shared else jobs.trace_and_send
        with progress("tracing", len(missing), "scenes") as done:
            tasks = ((traced[key].scene,) for key in missing)
            for index, finished in cluster.run(trace, tasks, label="trace"):
                if finished.error:
                    broken[missing[index]] = finished.reason
                elif not shared:
                    _keep_file(traced[missing[index]].file, finished.value)
                done(1)
        for group in self._groups:
            if group.source.key in broken:
                self._fail(group.cases, broken[group.source.key], advance)
        return [number for number, group in enumerate(self._groups) if group.source.key not in broken]

    def _arguments(self, pieces: Sequence[_Piece], cluster: Cluster) -> Iterator[tuple[Shared, tuple[Case, ...]]]:
        """Channel and cases of each piece; neighbours of one channel share it."""
        for number, group in itertools.groupby(pieces, key=lambda piece: piece.number):
            shared = self._channel(number, cluster)
            for piece in group:
                yield shared, piece.cases

    def _channel(self, number: int, cluster: Cluster) -> Shared:
        """The profiles of a group's channel: from this machine's file, from its content, or from the shared cache."""
        group = self._groups[number]
        file = group.source.file
        if not cluster.remote:
            return cluster.share(jobs.prepare_here, file, group.wanted)
        if cache_url() is not None and group.source.scene is not None:
            return cluster.share(jobs.prepare_shared, file.name, group.wanted)
        return cluster.share(jobs.prepare_sent, file.read_bytes(), group.wanted)

    def _take(self, piece: _Piece, finished: Finished, advance: Advance) -> list[_Piece]:
        """Keep what came of a piece, and return what of it must be run again."""
        group = self._groups[piece.number]
        if finished.deaths:
            times = "once" if finished.deaths == 1 else f"{finished.deaths} times"
            which = f"case {piece.cases[0].number}" if len(piece.cases) == 1 else f"{len(piece.cases)} cases"
            self.notes.append(f"a worker died {times} while it ran {which} of {group.source.name}")
        value: Any = finished.value
        if isinstance(finished.error, WorkerDiedError) and len(piece.cases) > 1:
            # One of them may be the cause: each on its own.
            return [_Piece(piece.number, (case,), piece.edition) for case in piece.cases]
        if finished.error:
            self._fail(piece.cases, finished.reason, advance)
        elif not isinstance(value, jobs.Failed):
            self._keep(value, advance)
        elif value.damaged and (edition := self._retraced(piece, advance)) is not None:
            return [_Piece(piece.number, piece.cases, edition)]
        elif not value.damaged or piece.edition or group.source.scene is None:
            self._fail(piece.cases, value.error, advance)
        return []

    def _retraced(self, piece: _Piece, advance: Advance) -> int | None:
        """Trace a damaged CIR anew, once; the edition to run the piece with, None where that cannot help."""
        group = self._groups[piece.number]
        if piece.edition or group.source.scene is None:
            return None
        if piece.number not in self._editions:
            self.notes.append(f"scene {group.source.name}: the cached CIR was damaged and was traced again")
            discard(group.source.file)
            self._editions[piece.number] = 1 if self._traced(group, advance) else 0
        return self._editions[piece.number] or None

    def _keep(self, rows: Iterable[Row], advance: Advance) -> None:
        for row in rows:
            self.store.add(row)
            advance(1)

    def _fail(self, cases: Sequence[Case], error: str, advance: Advance) -> None:
        self._keep((Row(case.key, "failed", error) for case in cases), advance)


def _keep_file(file: Path, content: bytes) -> None:
    """Keep a CIR that a worker has traced."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(file) as temporary:
        temporary.write_bytes(content)


def write_record(experiment: ExperimentSettings, table: pd.DataFrame, folder: Path) -> None:
    """Write the settings and provenance of a table beside it; of files there are the names alone."""
    record = {
        "settings": _without_folders(experiment.model_dump(mode="json", by_alias=True)),
        "cases": {status: int((table["status"] == status).sum()) for status in ("done", "failed", "missing")},
        "provenance": provenance(),
    }
    with atomic_output(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(record, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _without_folders(settings: Any) -> Any:
    """Plain settings with the names alone of scene and channel files, in parts as well."""
    if isinstance(settings, list):
        return [_without_folders(item) for item in settings]
    if not isinstance(settings, dict):
        return settings
    return {
        key: [Path(name).name for name in value]
        if key in ("scenes", "channels") and isinstance(value, list)
        else _without_folders(value)
        for key, value in settings.items()
    }
