"""The choice of a cluster: this process, processes of this machine, or the workers of an existing scheduler."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from typing import Final

from mvla_sim.cluster.dask_settings import readable_configuration
from mvla_sim.cluster.in_process import InProcess
from mvla_sim.cluster.interface import Cluster
from mvla_sim.engine.machine import core_count
from mvla_sim.errors import ConfigError

__all__ = ["open_cluster"]

ADDRESS: Final = re.compile(r"([a-z]+://)?[^\s/:]+:\d{1,5}|([a-z]+://)?\[[0-9a-fA-F:]+\]:\d{1,5}|wss?://\S+")


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
        Both are given, ``workers`` is negative, the address is none, or Dask cannot read a file of its own settings.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError(f"workers = {workers} and scheduler = {scheduler}: give one of them", setting="scheduler")
    if workers is not None and workers < 0:
        raise ConfigError(f"workers = {workers}; at least 0", setting="workers")
    if scheduler is not None and not ADDRESS.fullmatch(scheduler):
        raise ConfigError(
            f"scheduler = {scheduler}: must be an address with a port, as tcp://10.0.0.1:8786", setting="scheduler"
        )
    with readable_configuration():
        chosen = _chosen(core_count() if workers is None else workers, scheduler, out)
    with contextlib.closing(chosen) as cluster:
        yield cluster


def _chosen(workers: int, scheduler: str | None, out: Callable[[str], None]) -> Cluster:
    """The cluster, not started; Dask is imported where it is used alone."""
    if scheduler is not None:
        from mvla_sim.cluster.existing_cluster import ExistingCluster  # noqa: PLC0415

        return ExistingCluster(scheduler, out)
    if workers == 0:
        return InProcess()
    from mvla_sim.cluster.local_processes import LocalProcesses  # noqa: PLC0415

    return LocalProcesses(workers, out)
