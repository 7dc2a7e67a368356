"""Time and peak memory of one piece of work, each measured in a fresh child process.

A child has an empty kernel cache, one thread of Dr.Jit and of linear algebra, and has loaded what the work needs before
the clock starts. So nothing is left over from other points, and seconds are those of one core.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from mvla_sim.errors import RuntimeUnfitError
from mvla_sim.interrupt import interruptible

__all__ = ["ALONE", "Engine", "Measured", "Memory", "Work", "measure", "memory_of"]

Engine = Literal["none", "projector", "tracer"]

ALONE: Final = 0.8
"""Share of the time on the clock that its core must have worked for a point to count as undisturbed."""
SINGLE_THREADED: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
LONGEST_S: Final = 3600.0


@dataclass(frozen=True)
class Work:
    """What a child does."""

    target: str  # module:class of a mvla_sim.bench.child.Job that takes ``params``
    params: Mapping[str, Any] = field(default_factory=dict)  # plain values
    engine: Engine = "none"  # loaded before memory is counted: Dr.Jit (projector), or Sionna RT as well (tracer)
    warmups: int = 1  # calls that are not counted, at least 1; the first of them is reported on its own
    repeats: int = 5  # counted calls, fewer where they take longer than the budget together, but at least 2
    budget_s: float = 4.0
    cores: int | None = None  # that the child and its own children may use; None for all


@dataclass(frozen=True)
class Measured:
    """What a child found: seconds and bytes.

    Waiting for other programs is not in ``core_s``, but what they slow down in shared caches and memory is.
    """

    first_s: float  # the first call, in which kernels are compiled
    median_s: float  # of the counted calls, on the clock
    core_s: float  # the least time that cores worked in a counted call
    repeats: int  # counted calls
    memory_bytes: float  # peak memory beyond ``loaded_bytes``, compilation included
    steady_bytes: float  # the same of the counted calls alone, in which nothing large is compiled
    loaded_bytes: float  # memory before the work: Python, libraries and backend
    facts: Mapping[str, float] = field(default_factory=dict)  # what else the work says about itself


@dataclass(frozen=True)
class Memory:
    """Resident memory of a process, bytes: now, and the most it ever was or was since the last reset."""

    now: float
    peak: float


def memory_of(process: int | str = "self") -> Memory:
    """Memory of a process by its number.

    ``ru_maxrss`` is only the fallback: on Linux a child inherits its parent's through fork and exec, and with a parent
    of 300 MB no child would seem to need less.
    """
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        import resource  # noqa: PLC0415 - only where there is no /proc, and not on every system

        unit = 1 if sys.platform == "darwin" else 1024
        peak = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit)
        return Memory(peak, peak)
    values = {key: text.split() for key, _, text in (line.partition(":") for line in lines)}
    now, peak = (1024.0 * int(values.get(key, ["0"])[0]) for key in ("VmRSS", "VmHWM"))
    return Memory(now, peak)


def measure(work: Work, *, kernels: Path | None = None, cache: Path | None = None) -> Measured:
    """Do the work in a fresh child process.

    Several points may share a folder of compiled ``kernels``, and one of traced channels as ``cache``; by default this
    one's are kept apart and thrown away.

    Raises
    ------
    RuntimeUnfitError
        The work failed, or its process died; one line.
    """
    with interruptible(), tempfile.TemporaryDirectory(prefix="mvla-bench-", ignore_cleanup_errors=True) as name:
        scratch = Path(name)
        places = {"DRJIT_CACHE_DIR": kernels or scratch / "kernels", "MVLA_CACHE_DIR": cache or scratch / "cache"}
        for place in places.values():
            place.mkdir(parents=True, exist_ok=True)
        environment = os.environ | SINGLE_THREADED | {key: str(place) for key, place in places.items()}
        environment["TMPDIR"] = name  # so that nothing of a child that is killed stays behind
        environment.pop("MVLA_CACHE_URL", None)
        order = {key: getattr(work, key) for key in Work.__dataclass_fields__} | {"params": dict(work.params)}
        answer = _child(work, json.dumps(order), environment)
    if "error" in answer:
        raise RuntimeUnfitError(f"bench: {work.target} {_shown(work)}: {answer['error']}")
    return Measured(**answer)


def _child(work: Work, order: str, environment: Mapping[str, str]) -> dict[str, Any]:
    """Run a child and return its answer. It is a session of its own, so Ctrl-C reaches this process alone."""
    command = [sys.executable, "-m", "mvla_sim.bench.child"]
    pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(command, text=True, env=environment, start_new_session=True, **pipes) as child:  # noqa: S603
        try:
            output, errors = child.communicate(order, timeout=LONGEST_S)
        except subprocess.TimeoutExpired as error:
            raise RuntimeUnfitError(f"bench: {work.target} {_shown(work)}: no end after {LONGEST_S:.0f} s") from error
        finally:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(child.pid, signal.SIGKILL)  # its workers too
    try:
        answer: dict[str, Any] = json.loads(output)
    except ValueError:
        last = (errors.strip().splitlines() or ["no message"])[-1]
        return {"error": f"its process ended with code {child.returncode} ({last})"}
    return answer


def _shown(work: Work) -> str:
    return ", ".join(f"{key} = {value}" for key, value in work.params.items())
