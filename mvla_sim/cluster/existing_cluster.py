"""The workers of a Dask scheduler that somebody else has started, on whatever machines."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import dask
import distributed
from distributed import Client, Security, rpc

from mvla_sim.cluster.dask_cluster import CLOSE_S, LOST, START_S, DaskCluster
from mvla_sim.cluster.worker import VERSIONED, Context, program_digest
from mvla_sim.engine.cache import URL_VARIABLE
from mvla_sim.errors import RuntimeUnfitError, reason

__all__ = ["ExistingCluster"]

LEAST_IN_FLIGHT: Final = 12
"""Tasks that the scheduler knows of at least, so that a cluster that grows with its load sees some."""
COUNT_S: Final = 5.0
"""How often the workers are counted."""
CONNECT_S: Final = 10.0
OLDEST: Final = (2026, 8)
"""Dask that this package works with, which its dependencies say too."""
ENCRYPTION: Final = "distributed.comm.require-encryption"


class ExistingCluster(DaskCluster):
    """The workers of somebody's scheduler, however many there are and may yet come."""

    remote = True

    def __init__(self, address: str, out: Callable[[str], None]) -> None:
        super().__init__(f"scheduler {address}", out)
        self._address = address
        self._counted = 0.0

    def _connect(self, stack: contextlib.ExitStack) -> Any:
        stack.enter_context(dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TiB"}))
        if dask.config.get(ENCRYPTION, None) and not self._address.startswith(("tls://", "wss://")):
            raise RuntimeUnfitError(
                f"{self.name}: Dask's configuration on this machine has {ENCRYPTION} = true; give a tls:// address, or "
                "take that setting out"
            )
        try:
            there = _version_there(self._address)
            if tuple(map(int, re.findall(r"\d+", there)[:2])) < OLDEST:
                here = distributed.__version__
                raise RuntimeUnfitError(
                    f"{self.name}: its Dask is {there}, this machine's {here}; install the same there"
                )
            client = Client(self._address, timeout=CONNECT_S, set_as_default=False)
        except (*LOST, ValueError) as error:
            raise RuntimeUnfitError(f"{self.name}: no Dask scheduler answers there ({reason(error)})") from error
        stack.callback(_close_client, client)
        services = client.scheduler_info(n_workers=0)["services"]
        if "dashboard" in services:
            self._out(f"dashboard: {client.dashboard_link}")
        else:
            self._out(f"scheduler: {self._address}")
        deadline = time.monotonic() + START_S
        while not client.nthreads():
            if time.monotonic() > deadline:
                raise RuntimeUnfitError(f"{self.name}: no worker has joined within {START_S:.0f} s")
            time.sleep(0.1)
        return client

    def _check_workers(self, client: Any) -> Context:
        try:
            self._check_versions(client.get_versions(packages=list(VERSIONED)))
            for worker, digest in client.run(program_digest, on_error="return").items():
                if digest != program_digest() and not isinstance(digest, OSError):  # the latter has just gone
                    raise self._unfit(worker, "the same version of mvla-sim, but its code differs from this machine's")
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
        except LOST as error:
            raise self._connection_lost() from error
        self.count = len(workers)
        hosts: dict[str, list[int]] = {}
        for worker in workers:
            hosts.setdefault(worker["host"], []).append(worker["nthreads"])
        shared_hosts = tuple((host, sum(granted)) for host, granted in hosts.items() if len(granted) > 1)
        environment = tuple((name, os.environ[name]) for name in (URL_VARIABLE,) if os.environ.get(name))
        return Context(self._topic, program_digest(), None, shared_hosts, environment)

    def _check_versions(self, found: Any) -> None:
        """Refuse workers with other versions than the client; of all that Dask lists, only what can change a result."""
        here = found["client"]["packages"]
        for worker, told in found["workers"].items():
            for name in ("python", *VERSIONED):
                if (there := told["packages"].get(name)) != here[name]:
                    raise self._unfit(worker, f"{name} {there or 'none'}, this machine {here[name] or 'none'}")

    def _unfit(self, worker: str, what: str) -> RuntimeUnfitError:
        return RuntimeUnfitError(f"{self.name}: worker {worker} has {what}; install the same there")

    def _most_in_flight(self) -> int:
        if time.monotonic() - self._counted > COUNT_S:
            with self._losing_connection():
                self.count = max(1, len(self._client.nthreads()))
            self._counted = time.monotonic()
        return max(LEAST_IN_FLIGHT, super()._most_in_flight())


def _version_there(address: str) -> str:
    """Version of Dask on a scheduler, which those of any version tell, while a client of another may hang.

    It is asked in a thread of its own, for in a notebook a loop runs already.
    """

    async def ask() -> str:
        async with rpc(address, connection_args=Security().get_connection_args("client")) as scheduler:
            return str((await scheduler.versions())["packages"]["distributed"])

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(lambda: asyncio.run(asyncio.wait_for(ask(), CONNECT_S))).result()


def _close_client(client: Any) -> None:
    with contextlib.suppress(*LOST, RuntimeError):
        client.close(timeout=CLOSE_S if client.status == "running" else 0.5)
