"""Dask workers that are processes of this machine."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from multiprocessing import resource_tracker
from typing import Any, Final

from distributed import Client, LocalCluster

from mvla_sim.cluster.dask_cluster import CLOSE_S, LOST, START_S, DaskCluster
from mvla_sim.cluster.dask_settings import only_these_settings
from mvla_sim.cluster.worker import Context
from mvla_sim.engine.machine import core_count, environment_kept
from mvla_sim.errors import RuntimeUnfitError

__all__ = ["LocalProcesses"]

ALGEBRA: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
CONFIGURATION: Final[Mapping[str, Any]] = {
    "distributed.nanny.pre-spawn-environ": ALGEBRA,
    "distributed.scheduler.allowed-failures": 0,  # a death is reported at once, and counted here
    "distributed.scheduler.worker-ttl": None,  # a long compiled loop lets no heartbeat through
    "distributed.comm.timeouts.connect": "5 s",  # else a result lost with its worker is waited for half a minute
    "distributed.worker.profile.enabled": False,  # these three would interrupt the kernels a hundred times a second
    "distributed.admin.tick.interval": "1 s",
    "distributed.admin.system-monitor.interval": "2 s",
    "distributed.admin.tick.limit": "1h",
}


class LocalProcesses(DaskCluster):
    """Single-threaded workers on this machine, listening on 127.0.0.1 alone; one that dies is replaced."""

    def __init__(self, workers: int, out: Callable[[str], None]) -> None:
        super().__init__(f"{workers} worker processes", out)
        self.count = workers
        self._local: Any = None
        self._began = 0.0

    def _connect(self, stack: contextlib.ExitStack) -> Any:
        stack.enter_context(only_these_settings(CONFIGURATION))
        stack.enter_context(environment_kept(*ALGEBRA, "PYTHONHASHSEED", "__DASK_PARENT_PID"))  # Dask sets them here
        shown = importlib.util.find_spec("bokeh") is not None
        with _interrupts_blocked():
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
            stack.callback(_close_local, local)
            client = Client(local, set_as_default=False)
            stack.callback(client.close, timeout=CLOSE_S)
        local.scale(self.count)
        self._out(f"dashboard: {local.dashboard_link}" if shown else f"scheduler: {local.scheduler_address}")
        self._local, self._began = local, time.monotonic()
        return client

    def _check_workers(self, client: Any) -> Context:
        del client
        return Context(self._topic, None, max(1, core_count() // self.count))

    def _check_alive(self) -> None:
        super()._check_alive()
        if self._local.scheduler.workers:
            self._began = time.monotonic()
        elif time.monotonic() - self._began > START_S:
            raise RuntimeUnfitError(
                f"no worker process could start within {START_S:.0f} s; a script that runs experiments must do so "
                f'under if __name__ == "__main__":'
            )


def _close_local(local: Any) -> None:
    """End the workers at once, by their own process numbers, then the scheduler."""
    for nanny in list(local.workers.values()):
        nanny.close_gracefully()  # so that it is not replaced
        if nanny.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)
    with contextlib.suppress(*LOST):
        local.close(timeout=CLOSE_S)


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Threads begun within the block, and processes that these start, never see Ctrl-C: it is their parent's business.

    It is held back here meanwhile, for some milliseconds.
    """
    resource_tracker.ensure_running()  # else one of those threads starts it, and it unblocks the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
