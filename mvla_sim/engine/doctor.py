"""Whether this machine can run the program, and how to fix it if not."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import psutil

from mvla_sim.engine import backend as backends
from mvla_sim.engine import llvm
from mvla_sim.engine.cache import cache_folder
from mvla_sim.engine.machine import core_count, cpu_name, package_versions, program_version
from mvla_sim.errors import OutputError

__all__ = ["Facts", "Smoke", "collect", "run_smoke"]

SMOKE_COMMAND: Final = (sys.executable, "-m", "mvla_sim.engine.smoke")
TIMEOUT_S: Final[float] = 180.0
"""Far above the seconds that the first compilation takes on a slow machine."""
GIB: Final[int] = 2**30


@dataclass(frozen=True, eq=False)
class Smoke:
    """What the child process that traces one ray reported."""

    backend: Mapping[str, Any]  # backend, libllvm, libllvm_version, origin, threads; empty if it did not get so far
    result: str | None  # in words, if the ray came back
    problem: str | None  # one line with its remedy, if it did not


@dataclass(frozen=True)
class Facts:
    """Everything the report shows: pairs of a name and a value, and problems, one line each with its remedy."""

    rows: tuple[tuple[str, str], ...]
    problems: tuple[str, ...]


def collect(smoke: Smoke | None = None) -> Facts:
    """Look at this machine; ``smoke`` replaces the trace in a child process."""
    smoke = smoke or run_smoke()
    backend = smoke.backend
    memory = psutil.virtual_memory()
    problems = [smoke.problem] if smoke.problem else []
    versions = package_versions()
    problems += [f"{name} is not installed: pip install {name}" for name, version in versions.items() if not version]
    try:
        folder = cache_folder()
        cache = f"{folder} ({shutil.disk_usage(folder).free / GIB:.1f} GiB free)"
    except OutputError as error:
        cache = "not usable"
        problems.append(str(error))
    if backend.get("backend") == "llvm":
        compute = f"LLVM on the CPU, {backend['threads']} threads"
    elif backend.get("backend") == "cuda":
        compute = "CUDA"
    else:
        compute = {
            "cuda": "none: CUDA is asked for and no device is found",
            "unknown": f"none: {backends.VARIABLE} names none",
        }.get(_asked_for(), "none that is fit")
    rows = [
        ("mvla-sim", program_version()),
        ("backend", compute),
        ("libLLVM", _library(backend)),
        ("smoke trace", smoke.result or "failed"),
        ("python", f"{platform.python_version()} ({sys.executable})"),
        *((name, version or "not installed") for name, version in versions.items()),
        ("processor", f"{cpu_name()}, {core_count()} cores"),
        ("memory", f"{memory.available / GIB:.1f} of {memory.total / GIB:.1f} GiB available"),
        ("cache folder", cache),
    ]
    return Facts(tuple(rows), tuple(problems))


def run_smoke(command: Sequence[str] = SMOKE_COMMAND, timeout_s: float = TIMEOUT_S) -> Smoke:
    """Trace one ray in a child process and read its report, however it ends."""
    environment = dict(os.environ)
    if llvm.preset_library() is not None:  # the child chooses by itself, and tells where its choice comes from
        del environment[llvm.VARIABLE]
    try:
        child = subprocess.run(  # noqa: S603 - our own interpreter and module
            list(command), env=environment, capture_output=True, text=True, timeout=timeout_s, check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Smoke({}, None, f"the smoke trace did not end within {timeout_s:g} s: free the processor and try again")
    backend: dict[str, Any] = {}
    said: dict[str, Any] = {}
    for line in child.stdout.splitlines():
        with contextlib.suppress(ValueError):  # libraries may print as well
            facts = json.loads(line)
            if isinstance(facts, dict):
                backend, said = (facts, said) if "backend" in facts else (backend, facts)
    if "error" in said:
        return Smoke(backend, None, str(said["error"]))
    if child.returncode == 0 and "range_m" in said:
        return Smoke(backend, f"1 ray, {said['range_m']:.3f} m as expected, {said['seconds']:.1f} s", None)
    return Smoke(backend, None, _crash_report(child.returncode, child.stderr, backend))


def _crash_report(code: int, errors: str, backend: Mapping[str, Any]) -> str:
    """One line on a child that reported nothing: how it ended, its last line of errors, and how to fix it."""
    how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"failed with exit status {code}"
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    words = next((line for line in lines if "ERROR" in line), lines[-1] if code >= 0 and lines else "")
    words = f" ({words[:120]})" if words else ""
    if code < 0 and _uses_libllvm(backend):
        return f"the smoke trace {how}{words} with {_library(backend)}: {llvm.remedy()}"
    return f"the smoke trace {how}{words}: reinstall mvla-sim in a fresh virtual environment"


def _library(backend: Mapping[str, Any]) -> str:
    if not backend.get("libllvm_version"):
        return "no fit libLLVM" if _uses_libllvm(backend) else "not used"
    return f"{backend['libllvm_version']}, {backend['libllvm'] or 'file unknown'} ({backend['origin']})"


def _uses_libllvm(backend: Mapping[str, Any]) -> bool:
    """Whether libLLVM is in use, or was looked for; not where CUDA is in use or asked for, or no known backend is."""
    return backend.get("backend", _asked_for()) in ("auto", "llvm")


def _asked_for() -> str:
    """The backend that the environment names: "auto" where it names none, "unknown" where it names no backend."""
    wanted = os.environ.get(backends.VARIABLE) or "auto"
    return wanted if wanted in backends.NAMES else "unknown"
