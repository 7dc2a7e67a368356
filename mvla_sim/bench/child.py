"""The child process of a measured point: loads, resets the peak of memory, and times the calls of one job."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import pkgutil
import statistics
import sys
import threading
import time
from pathlib import Path
from typing import Any, Final

from mvla_sim.bench.measure import memory_of
from mvla_sim.errors import MvlaError, reason

__all__ = ["Job", "main", "perform"]

LEAST: Final = 2
"""Counted calls, however long they take."""


class Job:
    """Work that is timed call by call. What it needs is made in its constructor, before the first call."""

    def call(self, number: int) -> None:
        """Do the work for the ``number``-th time, and wait for its results."""
        raise NotImplementedError

    def facts(self) -> dict[str, float]:
        """What else is to be known; asked after the last call. May replace what is said of memory."""
        return {}

    def core_s(self) -> float:
        """Time that cores have worked so far, seconds."""
        return time.process_time()

    def close(self) -> None:
        """Let go of what was started."""


def perform(order: dict[str, Any]) -> dict[str, Any]:
    """Carry out an order, the fields of :class:`~mvla_sim.bench.measure.Work`; returns those of ``Measured``."""
    if order["cores"] is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: order["cores"]])
    make = pkgutil.resolve_name(order["target"])
    _load(order["engine"])
    loaded = _reset_peak()
    with contextlib.closing(make(**order["params"])) as job:
        calls = [_timed(job, number) for number in range(order["warmups"])]
        compiling = memory_of().peak
        _reset_peak()
        counted: list[tuple[float, float]] = []
        while len(counted) < order["repeats"]:
            if len(counted) >= LEAST and sum(seconds for seconds, _ in counted) > order["budget_s"]:
                break
            counted.append(_timed(job, len(calls) + len(counted)))
        steady = memory_of().peak
        facts = job.facts()
    return {
        "first_s": calls[0][0],
        "median_s": statistics.median(seconds for seconds, _ in counted),
        "core_s": min(seconds for _, seconds in counted),
        "repeats": len(counted),
        "memory_bytes": facts.pop("memory_bytes", max(0.0, compiling - loaded, steady - loaded)),
        "steady_bytes": facts.pop("steady_bytes", max(0.0, steady - loaded)),
        "loaded_bytes": facts.pop("loaded_bytes", loaded),
        "facts": facts,
    }


def main() -> int:
    """Read an order from standard input and write the answer to standard output, both JSON."""
    order = json.load(sys.stdin)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    answers = os.dup(1)
    os.dup2(2, 1)  # what libraries print does not mix with the answer
    try:
        answer = perform(order)
    except MvlaError as error:
        answer = {"error": str(error)}
    except Exception as error:  # noqa: BLE001 - becomes the parent's one line
        answer = {"error": reason(error)}
    with os.fdopen(answers, "w", encoding="utf-8") as out:
        json.dump(answer, out)
    return 0


def _end_with(parent: int) -> None:
    """End when the parent is gone: nobody waits for the answer, and a point may take minutes."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(1)


def _load(engine: str) -> None:
    """Load what the work computes with, on one thread."""
    from mvla_sim.engine import backend  # noqa: PLC0415 - only where something is measured

    if engine == "tracer":
        backend.activate_sionna()
    if engine != "none":
        backend.set_threads(1)
    if engine == "projector":
        importlib.import_module("mvla_sim.imaging.kernels")


def _reset_peak() -> float:
    """Start the peak anew from the memory in use, bytes; where the system has no such thing, from the peak so far."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return memory_of().peak


def _timed(job: Job, number: int) -> tuple[float, float]:
    """Seconds of a call: on the clock, and of work."""
    worked, began = job.core_s(), time.perf_counter()
    job.call(number)
    return time.perf_counter() - began, job.core_s() - worked


if __name__ == "__main__":
    sys.exit(main())
