"""Where tasks run: in this process, in processes of this machine, or on the workers of a Dask cluster.

All three take the same tasks and give the same results, so that callers need not know which one they have.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from mvla_sim.cluster.worker import Broken, Reply, attempt, single_threaded_algebra
from mvla_sim.engine.machine import core_count
from mvla_sim.errors import ConfigError
from mvla_sim.interrupt import deferred_interrupt

__all__ = ["WORKER_DIED", "Cluster", "Finished", "InProcess", "Shared", "open_cluster"]

WORKER_DIED: Final = "worker died"
"""The error of a task whose worker died three times."""

ADDRESS: Final = re.compile(r"([a-z]+://)?[^\s/:]+:\d{1,5}|([a-z]+://)?\[[0-9a-fA-F:]+\]:\d{1,5}|wss?://\S+")

Task = tuple[Any, ...]
"""Arguments of one call; a :class:`Shared` among them is replaced with its value."""


@dataclass(frozen=True)
class Finished:
    """What came of a task.

    Attributes
    ----------
    value
        What the function returned; None where it failed.
    error
        Type and message in one line, :data:`WORKER_DIED`, or empty.
    seconds
        Time it took on its worker.
    worker
        Name of the worker.
    deaths
        Workers that died while they ran it.
    """

    value: Any
    error: str
    seconds: float
    worker: str
    deaths: int = 0

    @classmethod
    def of(cls, reply: Reply, deaths: int = 0) -> Finished:
        """From what a worker replied."""
        return cls(reply.value, reply.error, reply.seconds, reply.worker, deaths)


class Shared:
    """A value that many tasks take: made where it is used, and sent from worker to worker, never once a task.

    It is let go of when nothing refers to this object any more. Where making it fails, the tasks that take it fail with
    the same error.
    """

    def __init__(self, function: Callable[..., Any], arguments: Task) -> None:
        self.function = function
        self.arguments = arguments
        self.kept: Any = None
        """The value, or Dask's future of it; None as long as nobody needed it."""


class Cluster:
    """Workers; see :func:`open_cluster`."""

    remote = False
    """Whether workers may have other files than this machine."""
    count = 1
    """Number of workers, as far as it is known."""
    deaths = 0
    """Workers that died in the middle of a task."""

    def start(self) -> None:
        """Start or find the workers and check them, unless it is done; :meth:`run` does so otherwise.

        Raises
        ------
        RuntimeUnfitError
            There are none, or they run other versions; one line.
        """

    def share(self, function: Callable[..., Any], *arguments: Any) -> Shared:
        """Return a value that tasks can take, made on a worker by calling a function."""
        return Shared(function, arguments)

    def run(
        self,
        function: Callable[..., Any],
        tasks: Iterable[Task],
        *,
        label: str,
        idle: Callable[[], None] = lambda: None,
    ) -> Iterator[tuple[int, Finished]]:
        """Call a function once a task, and yield each task's number and result in the order they finish.

        Parameters
        ----------
        function
            Importable on the workers.
        tasks
            Arguments of each call. They are taken one by one as workers become free, so there may be very many.
        label
            What they are called in Dask's dashboard.
        idle
            Called about twice a second while nothing finishes.

        Notes
        -----
        An exception of the function is a result. A task whose worker dies is run again on another one, up to three
        times. Ending the iteration early gives up tasks that have not begun.

        Raises
        ------
        RuntimeUnfitError
            The cluster is lost.
        """
        raise NotImplementedError


class InProcess(Cluster):
    """No other process. Ctrl-C waits for the end of a task, and is raised when its result has been taken."""

    def run(
        self,
        function: Callable[..., Any],
        tasks: Iterable[Task],
        *,
        label: str,
        idle: Callable[[], None] = lambda: None,
    ) -> Iterator[tuple[int, Finished]]:
        """Call it here, one task after the other."""
        del label, idle
        for number, task in enumerate(tasks):
            with deferred_interrupt() as check, single_threaded_algebra():
                arguments = [_value(part) if isinstance(part, Shared) else part for part in task]
                reply = attempt("this process", lambda: None, function, *arguments)
            yield number, Finished.of(reply)
            check()


@contextlib.contextmanager
def open_cluster(
    workers: int | None = None, scheduler: str | None = None, out: Callable[[str], None] = lambda _: None
) -> Iterator[Cluster]:
    """Yield a cluster, whose workers start when they are first needed and end with the block.

    Parameters
    ----------
    workers
        0: in this process, without Dask. N: so many processes on this machine. None: one a core.
    scheduler
        Address of an existing Dask scheduler, as "tcp://10.0.0.1:8786", whose workers are used instead.
    out
        Told the dashboard's address, once.

    Raises
    ------
    ConfigError
        Both are given, ``workers`` is negative, or the address is none.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError(f"--workers {workers} and --scheduler {scheduler}: give one of them")
    if workers is not None and workers < 0:
        raise ConfigError(f"workers = {workers}; at least 0")
    if scheduler is not None and not ADDRESS.fullmatch(scheduler):
        raise ConfigError(f"--scheduler {scheduler}: must be an address with a port, as tcp://10.0.0.1:8786")
    if workers == 0:
        yield InProcess()
        return
    from mvla_sim.cluster.dask_cluster import DaskCluster, ExistingCluster, LocalProcesses  # noqa: PLC0415 - only where used

    local = core_count() if workers is None else workers
    cluster: DaskCluster = LocalProcesses(local, out) if scheduler is None else ExistingCluster(scheduler, out)
    try:
        yield cluster
    finally:
        cluster.close()


def _value(shared: Shared) -> Any:
    if shared.kept is None:
        reply = attempt("this process", lambda: None, shared.function, *shared.arguments)
        shared.kept = Broken(reply.error) if reply.error else reply.value
    return shared.kept
