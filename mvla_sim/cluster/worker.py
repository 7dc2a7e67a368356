"""What runs on a worker around every task: fitness and threads once, one task at a time, errors as values."""

from __future__ import annotations

import contextlib
import copy
import functools
import hashlib
import importlib
import os
import platform
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from mvla_sim.cluster.interface import Finished, TaskError
from mvla_sim.engine.backend import set_threads
from mvla_sim.engine.machine import PACKAGES, core_count, package_versions
from mvla_sim.engine.provenance import code_digest
from mvla_sim.errors import MvlaError, RuntimeUnfitError, reason

__all__ = [
    "VERSIONED", "Context", "UnfitWorkerError", "attempt", "call", "fair_share", "make", "program_digest",
    "single_threaded_algebra",
]  # fmt: skip

VERSIONED: Final = ("mvla-sim", *PACKAGES)
"""Distributions of which every worker must have the coordinator's version."""


@dataclass(frozen=True)
class Context:
    """What a worker must know of the run."""

    topic: str  # name under which it announces the tasks it begins
    digest: str | None  # program_digest() of the coordinator; None where the workers cannot have any other
    threads: int | None  # of Dr.Jit in each worker process; None lets the worker find its share
    shared_hosts: tuple[tuple[str, int], ...] = ()  # threads granted to all workers of hosts that have several
    environment: tuple[tuple[str, str], ...] = ()  # variables to set


class UnfitWorkerError(RuntimeUnfitError):
    """This process may not work on the run, which ends."""


_one_task = threading.Lock()
_prepared_for: Context | None = None


def call(context: Context, number: int, function: Callable[..., Any], *arguments: Any) -> Finished:
    """Run one task; never raises. Workers with several threads do one task at a time, with all their threads."""
    from distributed import get_worker  # noqa: PLC0415 - the in-process runner does without it
    from distributed.utils import sync  # noqa: PLC0415

    worker = get_worker()
    with _one_task, _no_nested_dask():
        sync(worker.loop, worker.scheduler.log_event, topic=context.topic, msg=number)  # known there before it begins
        return attempt(str(worker.name), function, *arguments, context=context)


def make(context: Context, function: Callable[..., Any], *arguments: Any) -> Any:
    """Make a shared value; where that fails, what came of it takes its place. Never raises."""
    with _one_task, _no_nested_dask():
        finished = attempt("", function, *arguments, context=context)
    return finished.value if finished.error is None else finished


def attempt(worker: str, function: Callable[..., Any], *arguments: Any, context: Context | None = None) -> Finished:
    """Call a function, in a process prepared for a run's ``context`` if there is one, and wrap what comes of it."""
    began = time.perf_counter()
    value: Any = None
    error: MvlaError | None = None
    try:
        if context is not None:
            _prepare(context)
        broken = next((argument for argument in arguments if isinstance(argument, Finished)), None)
        if broken is None:
            value = function(*arguments)
        else:
            error = broken.error
    except Exception as failure:  # noqa: BLE001 - an error is a result; the coordinator decides what it means
        error = _sendable(failure)
    return Finished(value, error, time.perf_counter() - began, worker)


def _sendable(error: Exception) -> MvlaError:
    """An error without its frames and causes, as text where the coordinator may not know its class."""
    if isinstance(error, MvlaError) and type(error).__module__.startswith("mvla_sim."):
        return copy.copy(error)
    return TaskError(reason(error))


def fair_share(granted: int, granted_to_all: int, machine: int, usable: int) -> int:
    """Threads a worker of somebody's cluster may use: of those it, and all on its host together, were started with.

    The host has ``machine`` cores, and the worker may run on ``usable`` of them.
    """
    if granted_to_all > machine:
        granted = machine * granted // granted_to_all
    return max(1, min(granted, usable))


@functools.cache
def program_digest() -> str:
    """SHA-256, in hexadecimal, over Python's version, those of the packages that count, and this package's source."""
    versions = {"python": platform.python_version(), **package_versions(VERSIONED)}
    return hashlib.sha256(f"{sorted(versions.items())} {code_digest()}".encode()).hexdigest()


def single_threaded_algebra() -> contextlib.AbstractContextManager[object]:
    """From now on, or within a block, linear algebra uses one thread: no number depends on how many cores there are."""
    import threadpoolctl  # noqa: PLC0415 - only where cases are computed

    limits: contextlib.AbstractContextManager[object] = threadpoolctl.threadpool_limits(1)
    return limits


def _no_nested_dask() -> contextlib.AbstractContextManager[object]:
    """Within the block xarray does not take files' locks from the scheduler, which knows none for those in memory."""
    import dask  # noqa: PLC0415

    nested: contextlib.AbstractContextManager[object] = dask.config.set(scheduler="synchronous")
    return nested


def _prepare(context: Context) -> None:
    """Make this process fit for a run, once: same program, its share of threads, variables."""
    global _prepared_for  # noqa: PLW0603 - a process belongs to one run at a time
    if _prepared_for == context:
        return
    if context.digest not in (None, program_digest()):
        raise UnfitWorkerError("a worker that joined has another Python, mvla-sim or package that counts than this "
                               "machine")  # fmt: skip
    os.environ.update(dict(context.environment))
    set_threads(_own_share(context) if context.threads is None else context.threads)
    for library in ("numpy", "scipy.linalg"):  # what is loaded later reads the variables that workers are started with
        importlib.import_module(library)
    single_threaded_algebra()
    _prepared_for = context


def _own_share(context: Context) -> int:
    from distributed import get_worker  # noqa: PLC0415
    from distributed.comm import get_address_host  # noqa: PLC0415

    worker = get_worker()
    granted = worker.state.nthreads
    all_granted = dict(context.shared_hosts).get(get_address_host(worker.address), granted)
    return fair_share(granted, all_granted, os.cpu_count() or 1, core_count())
