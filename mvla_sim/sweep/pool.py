"""Worker processes: jobs go out, replies come in one at a time, and a worker that dies takes one case with it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Final

from mvla_sim.config.imaging import PdpSettings
from mvla_sim.errors import DataError, RuntimeUnfitError
from mvla_sim.runtime.backend import set_threads
from mvla_sim.sweep.batch import Batch, Channel, prepare, reason, results
from mvla_sim.sweep.case import Row

__all__ = ["BatchJob", "Died", "Event", "Failed", "Pool", "PrepareJob"]

SINGLE_THREADED: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Linear algebra uses one thread in every worker, so that no number depends on how many cores there are."""


@dataclass(frozen=True)
class Failed:
    """A preparation that failed; ``damaged`` where its CIR file cannot be read."""

    error: str
    damaged: bool


@dataclass(frozen=True)
class PrepareJob:
    """Compute clean profiles; ``number`` is the caller's."""

    number: int
    file: Path
    settings: PdpSettings
    gate_m: tuple[float, float]
    with_amplitude: bool

    def replies(self) -> Iterator[Channel | Failed]:
        """Do the work."""
        try:
            yield prepare(self.file, self.settings, self.gate_m, with_amplitude=self.with_amplitude)
        except Exception as error:  # noqa: BLE001 - becomes the error of every case that needs it
            yield Failed(reason(error), isinstance(error, DataError) and str(self.file) in str(error))


@dataclass(frozen=True)
class BatchJob:
    """Run cases."""

    batch: Batch

    def replies(self) -> Iterator[Row]:
        """Do the work."""
        for row, _ in results(self.batch):
            yield row

    def without(self, count: int) -> BatchJob:
        """What is left without the first cases."""
        return BatchJob(replace(self.batch, cases=self.batch.cases[count:]))


Job = PrepareJob | BatchJob


@dataclass(frozen=True)
class Died:
    """A worker ended in the middle of a job; ``done`` counts the replies that came before."""

    how: str
    done: int


Event = tuple[Job, Row | Channel | Failed | Died]


class _Ready:
    """A worker waits for a job."""


class Pool:
    """A fixed number of workers; a context manager that ends them.

    Parameters
    ----------
    workers
        Number of processes.
    threads
        Threads of the compute backend in each.
    """

    def __init__(self, workers: int, threads: int) -> None:
        self._jobs: deque[Job] = deque()
        self._threads = threads
        self._count = workers
        self._workers: list[_Handle] = []

    def __enter__(self) -> Pool:
        with _worker_environment():
            self._workers = [_Handle(self._threads) for _ in range(self._count)]
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()

    @property
    def busy(self) -> bool:
        """Whether any job waits or runs."""
        return bool(self._jobs) or any(worker.job is not None for worker in self._workers)

    def submit(self, job: Job, *, first: bool = False) -> None:
        """Queue a job, at the front or at the end."""
        if first:
            self._jobs.appendleft(job)
        else:
            self._jobs.append(job)

    def step(self, timeout_s: float) -> list[Event]:
        """Give idle workers jobs, wait for replies at most so long, and return what came.

        Raises
        ------
        RuntimeUnfitError
            A worker ended before it was ready.
        """
        for worker in self._workers:
            if worker.idle and self._jobs and worker.give(self._jobs[0]):
                self._jobs.popleft()
        events: list[Event] = []
        by_connection = {worker.connection: worker for worker in self._workers}
        for connection in wait(list(by_connection), timeout_s):
            worker = by_connection[connection]  # type: ignore[index]
            events += worker.read()
            if worker.dead:
                with _worker_environment():
                    self._workers[self._workers.index(worker)] = _Handle(self._threads)
        return events


class _Handle:
    """One worker as its parent sees it."""

    def __init__(self, threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(target=_work, args=(theirs, threads), daemon=True)
        self.process.start()
        theirs.close()
        self.ready = False
        self.dead = False
        self.job: Job | None = None
        self.done = 0

    @property
    def idle(self) -> bool:
        return self.ready and not self.dead and self.job is None

    def give(self, job: Job) -> bool:
        """Send a job; False where the worker has just died, which reading finds out."""
        try:
            self.connection.send(job)
        except OSError:
            return False
        self.job, self.done = job, 0
        return True

    def read(self) -> list[Event]:
        """All replies that have come."""
        events: list[Event] = []
        try:
            while self.connection.poll():
                reply = self.connection.recv()
                if isinstance(reply, _Ready):
                    self.ready, self.job = True, None
                elif self.job is not None:
                    self.done += 1
                    events.append((self.job, reply))
        except (EOFError, OSError):
            self.dead = True
            self.process.join()
            code = self.process.exitcode or 0
            how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
            if not self.ready:
                raise RuntimeUnfitError(f"a worker process could not start ({how})") from None
            if self.job is not None:
                events.append((self.job, Died(how, self.done)))
        return events

    def end(self) -> None:
        self.connection.close()
        self.process.terminate()
        self.process.join()


def _work(connection: Connection, threads: int) -> None:
    """Body of a worker: Ctrl-C is its parent's business, and it ends when its parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    set_threads(threads)
    with contextlib.suppress(EOFError, OSError):
        while True:
            connection.send(_Ready())
            job: Job = connection.recv()
            for reply in job.replies():
                connection.send(reply)


@contextlib.contextmanager
def _worker_environment() -> Iterator[None]:
    """What processes started within inherit: single-threaded linear algebra, and deafness to Ctrl-C from birth."""
    before = {name: os.environ.get(name) for name in SINGLE_THREADED}
    os.environ.update(SINGLE_THREADED)
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
