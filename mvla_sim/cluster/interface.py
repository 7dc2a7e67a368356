"""What every cluster offers: it takes the same tasks and gives the same results, wherever they run."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any

from mvla_sim.errors import MvlaError, reason

__all__ = ["Arguments", "Cluster", "Finished", "Shared", "TaskError", "WorkerDiedError"]

Arguments = tuple[Any, ...]
"""Arguments of one task; a :class:`Shared` among them is replaced with its value."""


class TaskError(MvlaError):
    """Type and message of an exception that a task raised and that is none of this package's."""


class WorkerDiedError(TaskError):
    """A task was given up, for too many workers died of it."""

    def __init__(self, message: str = "worker died") -> None:
        super().__init__(message)


@dataclass(frozen=True, eq=False)
class Finished:
    """What came of a task."""

    value: Any = None  # what the function returned
    error: MvlaError | None = None  # what it raised; a TaskError in place of others' exceptions, or a WorkerDiedError
    seconds: float = 0.0  # on its worker
    worker: str = ""
    deaths: int = 0  # of workers while they ran it

    @property
    def reason(self) -> str:
        """Type and message of the error in one line; empty where there is none."""
        if self.error is None or isinstance(self.error, TaskError):
            return str(self.error or "")
        return reason(self.error)


class Shared:
    """A value that many tasks take: made where it is used, and sent from worker to worker, never once a task.

    It is let go of when nothing refers to this object any more. Where making it fails, the tasks that take it fail with
    the same error.
    """

    def __init__(self, function: Callable[..., Any], arguments: Arguments) -> None:
        self.function = function
        self.arguments = arguments
        self.kept: Any = None
        """The value, or Dask's future of it; None as long as nobody needed it."""


class Cluster:
    """Workers; see :func:`mvla_sim.cluster.opening.open_cluster`."""

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
        tasks: Iterable[Arguments],
        *,
        label: str,
        idle: Callable[[], None] = lambda: None,
    ) -> Generator[tuple[int, Finished]]:
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
        return self._run(function, tasks, label, idle)

    def _run(
        self, function: Callable[..., Any], tasks: Iterable[Arguments], label: str, idle: Callable[[], None]
    ) -> Generator[tuple[int, Finished]]:
        """:meth:`run` of a kind of workers."""
        raise NotImplementedError

    def close(self) -> None:
        """End what was started."""
