"""Which compute backend runs the compiled kernels: CUDA where Dr.Jit finds a device, else LLVM on the CPU.

Dr.Jit loads libLLVM when it is imported, so nothing in this package imports drjit, mitsuba or sionna before
:func:`activate`; a program may once it has imported ``mvla_sim``.
"""

from __future__ import annotations

import functools
import importlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Literal, cast

from mvla_sim.engine import llvm
from mvla_sim.errors import ConfigError, RuntimeUnfitError

__all__ = ["NAMES", "VARIABLE", "Backend", "activate", "activate_sionna", "active", "set_threads"]

VARIABLE: Final[str] = "MVLA_BACKEND"
"""The environment variable that overrides the choice, with one of :data:`NAMES`."""
NAMES: Final = ("auto", "cuda", "llvm")

Name = Literal["cuda", "llvm"]

_DEVICE_FILES: Final = ("/dev/nvidiactl", "/dev/nvidia0", "/dev/dxg")


@dataclass(frozen=True)
class Backend:
    """The backend in use."""

    name: Name
    libllvm: Path | None = None  # the file that is loaded; None on CUDA or where the system does not tell
    libllvm_version: str | None = None  # in full, "23.1.4"; None on CUDA
    origin: str | None = None  # the environment variable, the wheel, the system, or what had loaded it before

    @property
    def arrays(self) -> ModuleType:
        """Dr.Jit's module of array types without derivatives: ``drjit.llvm`` or ``drjit.cuda``."""
        return importlib.import_module(f"drjit.{self.name}")

    @property
    def variant(self) -> str:
        """The Mitsuba variant that Sionna RT needs on this backend."""
        return f"{self.name}_ad_mono_polarized"


@functools.cache
def activate() -> Backend:
    """Choose the backend, load Dr.Jit with a fit libLLVM, and return what is in use; the same at every call.

    Raises
    ------
    ConfigError
        ``MVLA_BACKEND`` is neither ``auto`` nor ``cuda`` nor ``llvm``.
    RuntimeUnfitError
        No backend can run here; the message says how to fix it.
    """
    wanted = os.environ.get(VARIABLE, "auto") or "auto"
    if wanted not in NAMES:
        raise ConfigError(f"{VARIABLE} = '{wanted}' is no backend; allowed: {', '.join(NAMES)}")
    chosen = llvm.preset_library() if "drjit" in sys.modules else _choose_library(wanted)
    dr = cast("Any", importlib.import_module("drjit"))
    if wanted != "llvm" and dr.has_backend(dr.JitBackend.CUDA):
        return Backend("cuda")
    if wanted == "cuda":
        raise RuntimeUnfitError(
            f"{VARIABLE} = cuda, but Dr.Jit finds no CUDA device: install NVIDIA's driver or unset {VARIABLE}"
        )
    version = tuple(dr.detail.llvm_version()) if dr.has_backend(dr.JitBackend.LLVM) else ()
    if not version:
        library = chosen or "a libLLVM (it was imported before mvla_sim)"
        raise RuntimeUnfitError(f"Dr.Jit could not load {library}: {llvm.remedy()}")
    text = llvm.version_text(version)
    if version[0] < llvm.MINIMUM_VERSION:
        raise RuntimeUnfitError(
            f"Dr.Jit was imported before mvla_sim and uses libLLVM {text}, which is too old: import "
            f"mvla_sim before drjit, mitsuba and sionna, or set {llvm.VARIABLE}"
        )
    if chosen is None:
        return Backend("llvm", _loaded_library(), text, "loaded before")
    return Backend("llvm", _loaded_library() or Path(chosen.path), text, chosen.origin)


def active() -> Backend | None:
    """The backend if something has activated one in this process, else None; loads nothing."""
    return activate() if activate.cache_info().currsize else None


def activate_sionna() -> ModuleType:
    """Activate the backend, set Mitsuba's variant to match it, and return the module ``sionna.rt``.

    Raises
    ------
    ConfigError, RuntimeUnfitError
        As :func:`activate`; also where the program has set Mitsuba to a variant Sionna RT cannot use here.
    """
    backend = activate()
    mitsuba = cast("Any", importlib.import_module("mitsuba"))
    current = mitsuba.variant()
    if current != backend.variant:
        if "sionna.rt" in sys.modules:
            raise RuntimeUnfitError(
                f"sionna.rt was imported with Mitsuba's variant {current}: import it after "
                f'mvla_sim, or call mitsuba.set_variant("{backend.variant}") first'
            )
        mitsuba.set_variant(backend.variant)
    return importlib.import_module("sionna.rt")


def set_threads(count: int) -> None:
    """Let the LLVM backend compute on ``count`` threads; by default it uses every core.

    Raises
    ------
    ConfigError
        ``count`` is below 1.
    """
    if count < 1:
        raise ConfigError(f"threads = {count}; at least 1")
    activate()
    cast("Any", importlib.import_module("drjit")).set_thread_count(count)


def _choose_library(wanted: str) -> llvm.Library | None:
    """Point Dr.Jit to a fit libLLVM. Without one only CUDA can run, so the error passes where that is possible."""
    try:
        chosen = llvm.choose()
    except RuntimeUnfitError:
        if wanted == "cuda" or (wanted == "auto" and any(Path(file).exists() for file in _DEVICE_FILES)):
            return None
        raise
    os.environ[llvm.VARIABLE] = chosen.path
    llvm.preload_companions(Path(chosen.path))
    return chosen


def _loaded_library() -> Path | None:
    """The libLLVM mapped into this process, where the system tells (Linux)."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    mapped = [Path(line.split(maxsplit=5)[5]) for line in lines if "/libLLVM" in line]
    return next((path for path in mapped if path.name.startswith(("libLLVM-", "libLLVM."))), None)
