"""Tasks on Dask: worker processes of this machine, or the workers of an existing scheduler.

Bookkeeping is done here and not left to the scheduler, for a scheduler blames a death on every task that a worker had
been given. Workers announce the task they begin, so only the one that was running counts as involved.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import itertools
import logging
import os
import platform
import queue
import signal
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import resource_tracker
from typing import Any, Final

import dask
from distributed import Client, KilledWorker, LocalCluster
from distributed.comm import CommClosedError

from mvla_sim.cluster.pool import WORKER_DIED, Cluster, Finished, Shared, Task
from mvla_sim.cluster.worker import VERSIONED, Context, Reply, call, make, source_digest
from mvla_sim.engine.cache import URL_VARIABLE
from mvla_sim.engine.machine import core_count, package_versions
from mvla_sim.errors import RuntimeUnfitError, reason

__all__ = ["IN_FLIGHT", "MOST_DEATHS", "DaskCluster", "ExistingCluster", "LocalProcesses"]

IN_FLIGHT: Final = 3
"""Tasks a worker that the scheduler knows of; the next one is there when one ends, and a million do not flood it."""
LEAST_IN_FLIGHT: Final = 12
"""The same of a whole existing cluster, so that one that grows with its load sees some."""
MOST_DEATHS: Final = 3
"""Workers that may die of one task."""
MOST_BLAMED: Final = 6
"""Deaths that a task may be near, running or not."""
WAIT_S: Final = 0.5
COUNT_S: Final = 5.0
"""How often the workers of an existing cluster are counted."""
START_S: Final = 60.0
"""How long to wait for the first worker."""
CONNECT_S: Final = 10.0
CLOSE_S: Final = 10.0

ALGEBRA: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
LOCAL: Final[Mapping[str, Any]] = {
    "distributed.nanny.pre-spawn-environ": ALGEBRA,
    "distributed.scheduler.allowed-failures": 0,  # a death is reported at once, and counted here
    "distributed.scheduler.worker-ttl": None,  # a long compiled loop lets no heartbeat through
    "distributed.comm.timeouts.connect": "5 s",  # else a result lost with its worker is waited for half a minute
    "distributed.worker.profile.enabled": False,  # these three would interrupt the kernels a hundred times a second
    "distributed.admin.tick.interval": "1 s",
    "distributed.admin.system-monitor.interval": "2 s",
    "distributed.admin.tick.limit": "1h",
}
LOST: Final = (asyncio.CancelledError, CommClosedError, TimeoutError, OSError)
"""What a client raises whose scheduler is gone; each version of Dask has its own."""


@dataclass
class _Flight:
    """A task that the scheduler has been given."""

    number: int
    task: Task
    future: Any = None
    running: bool = False
    deaths: int = 0
    blamed: int = 0


class DaskCluster(Cluster):
    """What both kinds of cluster have in common."""

    def __init__(self, out: Callable[[str], None]) -> None:
        self.name = "the Dask cluster"
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
            stack.enter_context(_quiet())
            client = self._connect(stack)
            self._context = self._agree(client)
            client.subscribe_topic(self._topic, self._begun)
            self._client = client
            self._stack = stack.pop_all()

    def close(self) -> None:
        """End what was started."""
        self._client = None
        self._stack.close()

    def run(
        self,
        function: Callable[..., Any],
        tasks: Iterable[Task],
        *,
        label: str,
        idle: Callable[[], None] = lambda: None,
    ) -> Iterator[tuple[int, Finished]]:
        """Keep a few tasks a worker in flight."""
        self.start()
        flights: dict[int, _Flight] = {}
        again: deque[_Flight] = deque()
        fresh = (_Flight(number, task) for number, task in enumerate(tasks))
        try:
            while True:
                while len(flights) < self._room():
                    flight = again.popleft() if again else next(fresh, None)
                    if flight is None:
                        break
                    flights[self._launch(function, flight, label)] = flight
                if not flights:
                    return
                landed = self._landed(flights)
                if not landed:
                    idle()
                    self._check_alive()
                for flight, outcome in landed:
                    if isinstance(outcome, Finished):
                        yield flight.number, outcome
                    else:
                        again.append(flight)
        finally:
            flights.clear()  # lets go of the futures, and with them of what has not begun

    def _launch(self, function: Callable[..., Any], flight: _Flight, label: str) -> int:
        attempt = next(self._ids)
        arguments = [self._future(part) if isinstance(part, Shared) else part for part in flight.task]
        key = f"{label.replace(' ', '-')}-{self._topic}-{attempt}"
        flight.running = False
        with self._reaching():
            flight.future = self._client.submit(call, self._context, attempt, function, *arguments, key=key)
        events = self._events
        flight.future.add_done_callback(lambda future: events.put((attempt, future)))
        return attempt

    def _future(self, shared: Shared) -> Any:
        """Dask's future of a shared value, begun anew where its worker died."""
        if shared.kept is None or shared.kept.status in ("error", "cancelled", "lost"):
            key = f"shared-{self._topic}-{next(self._ids)}"
            with self._reaching():
                shared.kept = self._client.submit(make, self._context, shared.function, *shared.arguments, key=key)
        return shared.kept

    def _landed(self, flights: dict[int, _Flight]) -> list[tuple[_Flight, Finished | None]]:
        """Wait half a second for tasks to end; None in place of a result that is still to come from another worker.

        A result that has died with the worker that held it is one of these.
        """
        ended: list[_Flight] = []
        with contextlib.suppress(queue.Empty):
            attempt, future = self._events.get(timeout=WAIT_S)
            while True:
                if (flight := flights.get(attempt)) is not None:
                    if future is None:
                        self._count_begin(flight)
                    else:
                        ended.append(flights.pop(attempt))
                attempt, future = self._events.get_nowait()
        gone = [flight for flight in ended if flight.future.status == "lost"]
        if gone:
            self._check_alive()
            ended = [flight for flight in ended if flight not in gone]
        if any(flight.future.status == "cancelled" for flight in ended):
            raise self._lost()
        with self._reaching():
            replies = self._collected([flight.future for flight in ended])
        outcomes = [(flight, self._judge(flight, reply)) for flight, reply in zip(ended, replies, strict=True)]
        outcomes += [(flight, None) for flight in gone]
        for flight, _ in outcomes:
            flight.future = None
        return outcomes

    def _collected(self, futures: list[Any]) -> list[Reply | Exception]:
        """What tasks have replied, or why they have not; also where the worker that holds a reply has just died."""
        if all(future.status == "finished" for future in futures):
            with contextlib.suppress(KilledWorker):
                return list(self._client.gather(futures))  # all at once
        replies: list[Reply | Exception] = []
        for future in futures:
            try:
                replies.append(future.result())
            except LOST:
                raise
            except Exception as error:  # noqa: BLE001 - judged by the caller
                replies.append(error)
        return replies

    def _begun(self, event: tuple[float, int]) -> None:
        """A worker begins a task; called in the client's own thread."""
        self._events.put((event[1], None))

    def _count_begin(self, flight: _Flight) -> None:
        if flight.running:  # begun before, and never ended
            flight.deaths += 1
            self.deaths += 1
        flight.running = True

    def _judge(self, flight: _Flight, cause: Reply | Exception) -> Finished | None:
        """The result of a task; None where it is run again because a worker died, and not yet too many did."""
        if isinstance(cause, Reply):
            if cause.unfit:
                raise RuntimeUnfitError(f"{self.name}: {cause.error} ({cause.worker})")
            return Finished.of(cause, flight.deaths)
        if not isinstance(cause, KilledWorker):
            return Finished(None, reason(cause), 0.0, "", flight.deaths)
        flight.blamed += 1
        if flight.running:
            flight.deaths += 1
            self.deaths += 1
        if flight.deaths >= MOST_DEATHS or flight.blamed >= MOST_BLAMED:
            return Finished(None, WORKER_DIED, 0.0, "", flight.deaths)
        return None

    def _connect(self, stack: contextlib.ExitStack) -> Any:
        """Return a client; what must be undone goes onto the stack."""
        raise NotImplementedError

    def _agree(self, client: Any) -> Context:
        """Check the workers, and return what each must know."""
        raise NotImplementedError

    def _room(self) -> int:
        """Number of tasks that may be in flight."""
        return IN_FLIGHT * self.count

    def _check_alive(self) -> None:
        if self._client.status != "running":
            raise self._lost()

    def _lost(self) -> RuntimeUnfitError:
        return RuntimeUnfitError(
            f"{self.name}: the connection is lost; what is finished is kept, run the command again"
        )

    @contextlib.contextmanager
    def _reaching(self) -> Iterator[None]:
        """Turn the loss of the scheduler into one line."""
        try:
            yield
        except LOST as error:
            raise self._lost() from error
        except RuntimeError as error:  # a client that has closed itself
            if self._client.status == "running":
                raise
            raise self._lost() from error


class LocalProcesses(DaskCluster):
    """Single-threaded workers on this machine, listening on 127.0.0.1 alone; one that dies is replaced."""

    def __init__(self, workers: int, out: Callable[[str], None]) -> None:
        super().__init__(out)
        self.count = workers
        self.name = f"{workers} worker processes"
        self._local: Any = None
        self._began = 0.0

    def _connect(self, stack: contextlib.ExitStack) -> Any:
        stack.enter_context(dask.config.set(LOCAL))
        stack.enter_context(_environment_kept((*ALGEBRA, "PYTHONHASHSEED", "__DASK_PARENT_PID")))
        shown = importlib.util.find_spec("bokeh") is not None
        with _deaf_threads():
            local = LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # without Bokeh it serves plain pages, which are not shown
                worker_dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
            stack.callback(_end, local)
            client = Client(local, set_as_default=False)
            stack.callback(client.close, timeout=CLOSE_S)
        local.scale(self.count)
        self._out(f"dashboard: {local.dashboard_link}" if shown else f"scheduler: {local.scheduler_address}")
        self._local, self._began = local, time.monotonic()
        return client

    def _agree(self, client: Any) -> Context:
        del client
        return Context(self._topic, None, max(1, core_count() // self.count))

    def _check_alive(self) -> None:
        super()._check_alive()
        if not self._local.scheduler.workers and time.monotonic() - self._began > START_S:
            raise RuntimeUnfitError(
                f"no worker process could start within {START_S:.0f} s; a script that runs experiments must do so "
                f'under if __name__ == "__main__":'
            )
        if self._local.scheduler.workers:
            self._began = time.monotonic()


class ExistingCluster(DaskCluster):
    """The workers of somebody's scheduler, however many there are and may yet come."""

    remote = True

    def __init__(self, address: str, out: Callable[[str], None]) -> None:
        super().__init__(out)
        self.name = f"--scheduler {address}"
        self._address = address
        self._counted = 0.0

    def _connect(self, stack: contextlib.ExitStack) -> Any:
        stack.enter_context(dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TiB"}))
        try:
            client = Client(self._address, timeout=CONNECT_S, set_as_default=False)
        except (*LOST, ValueError) as error:
            raise RuntimeUnfitError(f"{self.name}: no Dask scheduler answers there ({reason(error)})") from error
        stack.callback(_close_quietly, client)
        if "dashboard" in client.scheduler_info(n_workers=0)["services"]:
            self._out(f"dashboard: {client.dashboard_link}")
        else:
            self._out(f"scheduler: {self._address}")
        deadline = time.monotonic() + START_S
        while not client.nthreads():
            if time.monotonic() > deadline:
                raise RuntimeUnfitError(f"{self.name}: no worker has joined within {START_S:.0f} s")
            time.sleep(0.1)
        return client

    def _agree(self, client: Any) -> Context:
        here = {"Python": platform.python_version()} | {k: v or "none" for k, v in package_versions(VERSIONED).items()}
        try:
            found = {"Python": client.run(platform.python_version)}  # functions that any worker has
            for name in VERSIONED:
                found[name] = client.run(version, name, on_error="return")
            self._refuse_others(found, here)
            digests = client.run(source_digest, on_error="return")
            self._refuse_others({"the same version of mvla-sim, but its code": digests}, {})
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
        except LOST as error:
            raise self._lost() from error
        self.count = len(workers)
        hosts: dict[str, list[int]] = {}
        for worker in workers:
            hosts.setdefault(worker["host"], []).append(worker["nthreads"])
        crowded = tuple((host, sum(granted)) for host, granted in hosts.items() if len(granted) > 1)
        environment = tuple((name, os.environ[name]) for name in (URL_VARIABLE,) if os.environ.get(name))
        return Context(self._topic, source_digest(), None, crowded, environment)

    def _refuse_others(self, found: Mapping[str, Mapping[str, Any]], here: Mapping[str, str]) -> None:
        """Raise where a worker answers something else than this machine."""
        for what, answers in found.items():
            wanted = here.get(what, source_digest())
            for worker, answer in answers.items():
                if answer == wanted or isinstance(answer, OSError):  # the latter has just gone
                    continue
                if what in here:
                    has = "none" if isinstance(answer, Exception) else answer
                    detail = f"{what} {has}, this machine {wanted}"
                else:
                    detail = f"{what} differs from this machine's"
                raise RuntimeUnfitError(f"{self.name}: worker {worker} has {detail}; install the same there")

    def _room(self) -> int:
        if time.monotonic() - self._counted > COUNT_S:
            with self._reaching():
                self.count = max(1, len(self._client.nthreads()))
            self._counted = time.monotonic()
        return max(LEAST_IN_FLIGHT, super()._room())


def _end(local: Any) -> None:
    """End the workers at once, by their own process numbers, then the scheduler."""
    for nanny in list(local.workers.values()):
        nanny.close_gracefully()  # so that it is not replaced
        if nanny.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
    with contextlib.suppress(*LOST):
        local.close(timeout=CLOSE_S)


def _close_quietly(client: Any) -> None:
    with contextlib.suppress(*LOST, RuntimeError):
        client.close(timeout=CLOSE_S if client.status == "running" else 0.5)


@contextlib.contextmanager
def _deaf_threads() -> Iterator[None]:
    """Threads begun within the block, and processes that these start, never see Ctrl-C: it is their parent's business.

    It is held back here meanwhile, for some milliseconds.
    """
    resource_tracker.ensure_running()  # else it is started by one of those threads, and opens its ears
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _environment_kept(names: tuple[str, ...]) -> Iterator[None]:
    """Put back variables afterwards that Dask sets for its workers in this process."""
    before = {name: os.environ.get(name) for name in names}
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
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
