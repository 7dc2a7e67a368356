"""Tasks on Dask workers: what worker processes of this machine and an existing cluster have in common.

Deaths are counted here and not left to the scheduler, for a scheduler blames a death on every task that a worker had
been given. Workers announce the task they begin, so only the one that was running counts as involved.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import queue
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

from distributed import KilledWorker
from distributed.comm import CommClosedError

from mvla_sim.cluster.interface import Arguments, Cluster, Finished, Shared, TaskError, WorkerDiedError
from mvla_sim.cluster.worker import Context, UnfitWorkerError, call, make
from mvla_sim.errors import RuntimeUnfitError, reason
from mvla_sim.interrupt import raise_lost

__all__ = ["CLOSE_S", "IN_FLIGHT", "LOST", "MOST_DEATHS", "START_S", "DaskCluster"]

IN_FLIGHT: Final = 3
"""Tasks a worker that the scheduler knows of; the next one is there when one ends, and a million do not flood it."""
MOST_DEATHS: Final = 3
"""Workers that may die of one task."""
MOST_SUSPECTED: Final = 6
"""Deaths of workers that had been given a task, running or not."""
WAIT_S: Final = 0.5
START_S: Final = 60.0
"""How long to wait for the first worker."""
CLOSE_S: Final = 10.0

LOST: Final = (asyncio.CancelledError, CommClosedError, TimeoutError, OSError)
"""What a client raises whose scheduler is gone; each version of Dask has its own."""


@dataclass(eq=False)
class _Submitted:
    """A task that the scheduler has been given."""

    number: int
    task: Arguments
    future: Any = None
    running: bool = False
    deaths: int = 0
    suspected: int = 0


class DaskCluster(Cluster):
    """Worker processes behind a Dask scheduler."""

    def __init__(self, name: str, out: Callable[[str], None]) -> None:
        self.name = name
        self._out = out
        self._stack = contextlib.ExitStack()
        self._client: Any = None
        self._context: Context | None = None
        self._events: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        self._ids = itertools.count()
        self._topic = f"mvla-{uuid.uuid4().hex}"

    def start(self) -> None:
        """Connect."""
        if self._client is not None:
            return
        with contextlib.ExitStack() as stack:
            stack.enter_context(_dask_log_silenced())
            client = self._connect(stack)
            self._context = self._check_workers(client)
            client.subscribe_topic(self._topic, self._on_begin)
            self._client = client
            self._stack = stack.pop_all()

    def close(self) -> None:
        """End what was started."""
        self._client = None
        self._stack.close()

    def _run(
        self, function: Callable[..., Any], tasks: Iterable[Arguments], label: str, idle: Callable[[], None]
    ) -> Generator[tuple[int, Finished]]:
        self.start()
        submitted: dict[int, _Submitted] = {}
        again: deque[_Submitted] = deque()
        fresh = (_Submitted(number, task) for number, task in enumerate(tasks))
        try:
            while True:
                while len(submitted) < self._most_in_flight():
                    task = again.popleft() if again else next(fresh, None)
                    if task is None:
                        break
                    submitted[self._submit(function, task, label)] = task
                if not submitted:
                    return
                ended = self._wait(submitted)
                raise_lost()
                if not ended:
                    idle()
                    self._check_alive()
                for task, outcome in ended:
                    if outcome is None:
                        again.append(task)
                    else:
                        yield task.number, outcome
        finally:
            submitted.clear()  # lets go of the futures, and with them of what has not begun

    def _submit(self, function: Callable[..., Any], task: _Submitted, label: str) -> int:
        attempt = next(self._ids)
        arguments = [self._future(part) if isinstance(part, Shared) else part for part in task.task]
        key = f"{label.replace(' ', '-')}-{self._topic}-{attempt}"
        task.running = False
        with self._losing_connection():
            task.future = self._client.submit(call, self._context, attempt, function, *arguments, key=key)
        events = self._events
        task.future.add_done_callback(lambda future: events.put((attempt, future)))
        return attempt

    def _future(self, shared: Shared) -> Any:
        """Dask's future of a shared value, begun anew where its worker died."""
        if shared.kept is None or shared.kept.status in ("error", "cancelled", "lost"):
            key = f"shared-{self._topic}-{next(self._ids)}"
            with self._losing_connection():
                shared.kept = self._client.submit(make, self._context, shared.function, *shared.arguments, key=key)
        return shared.kept

    def _wait(self, submitted: dict[int, _Submitted]) -> list[tuple[_Submitted, Finished | None]]:
        """Wait half a second for tasks to end; None in place of a result that is still to come from another worker.

        A result that has died with the worker that held it is one of these.
        """
        ended: list[_Submitted] = []
        with contextlib.suppress(queue.Empty):
            attempt, future = self._events.get(timeout=WAIT_S)
            while True:
                if (task := submitted.get(attempt)) is not None:
                    if future is not None:
                        ended.append(submitted.pop(attempt))
                    elif task.running:  # begun before, and never ended
                        self._count_death(task)
                    else:
                        task.running = True
                attempt, future = self._events.get_nowait()
        gone = [task for task in ended if task.future.status == "lost"]
        if gone:
            self._check_alive()
            ended = [task for task in ended if task not in gone]
        if any(task.future.status == "cancelled" for task in ended):
            raise self._connection_lost()
        with self._losing_connection():
            replies = self._gather([task.future for task in ended])
        outcomes = [(task, self._outcome(task, reply)) for task, reply in zip(ended, replies, strict=True)]
        outcomes += [(task, None) for task in gone]
        for task, _ in outcomes:
            task.future = None
        return outcomes

    def _gather(self, futures: list[Any]) -> list[Finished | Exception]:
        """What tasks have replied, or why they have not; also where the worker that holds a reply has just died."""
        if all(future.status == "finished" for future in futures):
            with contextlib.suppress(KilledWorker):
                return list(self._client.gather(futures))  # all at once
        replies: list[Finished | Exception] = []
        for future in futures:
            try:
                replies.append(future.result())
            except LOST:
                raise
            except Exception as error:  # noqa: BLE001 - the caller decides what it means
                replies.append(error)
        return replies

    def _on_begin(self, event: tuple[float, int]) -> None:
        """A worker begins a task; called in the client's own thread."""
        self._events.put((event[1], None))

    def _count_death(self, task: _Submitted) -> None:
        task.deaths += 1
        self.deaths += 1

    def _outcome(self, task: _Submitted, reply: Finished | Exception) -> Finished | None:
        """The result of a task; None where it is run again because a worker died, and not yet too many did."""
        if isinstance(reply, Finished):
            if isinstance(reply.error, UnfitWorkerError):
                raise RuntimeUnfitError(f"{self.name}: {reply.error} ({reply.worker})")
            return replace(reply, deaths=task.deaths)
        if not isinstance(reply, KilledWorker):
            return Finished(error=TaskError(reason(reply)), deaths=task.deaths)
        task.suspected += 1
        if task.running:
            self._count_death(task)
        if task.deaths >= MOST_DEATHS or task.suspected >= MOST_SUSPECTED:
            return Finished(error=WorkerDiedError(), deaths=task.deaths)
        return None

    def _connect(self, stack: contextlib.ExitStack) -> Any:
        """Return a client; what must be undone goes onto the stack."""
        raise NotImplementedError

    def _check_workers(self, client: Any) -> Context:
        """Check the workers, and return what each must know."""
        raise NotImplementedError

    def _most_in_flight(self) -> int:
        """Number of tasks that may be in flight."""
        return IN_FLIGHT * self.count

    def _check_alive(self) -> None:
        if self._client.status != "running":
            raise self._connection_lost()

    def _connection_lost(self) -> RuntimeUnfitError:
        return RuntimeUnfitError(
            f"{self.name}: the connection is lost; what is finished is kept, run the command again"
        )

    @contextlib.contextmanager
    def _losing_connection(self) -> Iterator[None]:
        """Turn the loss of the scheduler into one line."""
        try:
            yield
        except LOST as error:
            raise self._connection_lost() from error
        except RuntimeError as error:  # a client that has closed itself
            if self._client.status == "running":
                raise
            raise self._connection_lost() from error


@contextlib.contextmanager
def _dask_log_silenced() -> Iterator[None]:
    """Dask reports lost workers and connections in many lines; ours is one."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]
    before = {name: logging.getLogger(name).level for name in names}
    try:
        for name in names:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)
