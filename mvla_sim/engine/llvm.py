"""Which libLLVM Dr.Jit shall load, decided before it loads one.

Dr.Jit opens libLLVM the moment it is imported, and left alone takes whatever the system has. Tried with Dr.Jit 1.5.0
and Sionna RT 2.2.0 on x86-64 (a box; specular and diffuse reflection and diffraction; empty kernel cache): with 14.0.6
Dr.Jit switches its CPU backend off, with 15.0.6 and 16.0.6 the process aborts ("LLVM ERROR: Cannot select … fmaximum"),
and each version from 17.0.6 to 23.1.4 works, with the same traced power to every printed digit. Hence
:data:`MINIMUM_VERSION`.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Final

from mvla_sim.errors import RuntimeUnfitError

__all__ = [
    "MINIMUM_VERSION", "VARIABLE", "WHEEL", "Library", "choose", "preload_companions", "preset", "preset_library",
    "probe_version", "remedy", "system_files", "version_from_name", "version_text", "wheel_files",
]  # fmt: skip

MINIMUM_VERSION: Final[int] = 17
"""Oldest libLLVM that compiles every kernel; see above."""

VARIABLE: Final[str] = "DRJIT_LIBLLVM_PATH"
"""The environment variable by which Dr.Jit is told its libLLVM."""

WHEEL: Final[str] = "karellen-llvm-core"
"""The distribution this package depends on for a libLLVM (Linux, x86-64)."""

Version = tuple[int, ...]
Probe = Callable[[str], Version | None]

BEFORE_16: Final[Version] = (0,)
"""Stands for a libLLVM too old to tell its version."""

_NAMES: Final = (
    re.compile(r"^libLLVM-(\d+(?:\.\d+)*)\.(?:so|dylib)\b"),  # libLLVM-14.so.1, libLLVM-14.0.6.so, libLLVM-17.so
    re.compile(r"^libLLVM\.so\.(\d+\.\d+(?:\.\d+)*)"),  # libLLVM.so.19.1
    re.compile(r"^libLLVM\.(\d+(?:\.\d+)*)\.dylib$"),
)
_CELLAR: Final = re.compile(r"/Cellar/llvm(?:@\d+)?/(\d+(?:\.\d+)*)")

_PROBE: Final = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
library.LLVMContextCreate
if hasattr(library, "LLVMGetVersion"):
    numbers = [ctypes.c_uint() for _ in range(3)]
    library.LLVMGetVersion(*map(ctypes.byref, numbers))
    sys.stdout.write(".".join(str(n.value) for n in numbers))
else:
    sys.stdout.write("0")
"""


@dataclass(frozen=True)
class Library:
    """A libLLVM that was found."""

    path: str  # the file, or a bare name that the dynamic loader shall find
    version: Version  # as far as known, most significant number first
    origin: str  # for the user: the environment variable, the wheel or the system

    @property
    def fit(self) -> bool:
        """Whether it is new enough."""
        return self.version[0] >= MINIMUM_VERSION

    def __str__(self) -> str:
        """Version and file, as in "libLLVM 14.0.6 at /usr/lib/libLLVM-14.0.6.so"."""
        return f"libLLVM {version_text(self.version)} at {self.path}"


_preset: Library | None = None


def choose(
    environment: Mapping[str, str] | None = None,
    wheel: Callable[[], Sequence[Path]] | None = None,
    system: Callable[[], Sequence[Path]] | None = None,
    probe: Probe | None = None,
) -> Library:
    """Choose a libLLVM without loading it: the one the user names, else the wheel's, else the newest of the system.

    By default the environment is the process's own, and :func:`wheel_files`, :func:`system_files` and
    :func:`probe_version` say where to look and ask a file for its version.

    Raises
    ------
    RuntimeUnfitError
        The named library is missing or too old, or there is none that is new enough; the message says how to fix it.
    """
    environment = os.environ if environment is None else environment
    probe = probe or probe_version
    if named := environment.get(VARIABLE):
        return _preset if _preset is not None and _preset.path == named else _explicit(named, probe)
    seen: list[Library] = []
    for origin, files in ((f"wheel {WHEEL}", wheel or wheel_files), ("system", system or system_files)):
        found = [Library(str(path), version, origin) for path in files() if (version := _version(path, probe))]
        if fit := [library for library in found if library.fit]:
            return max(fit, key=lambda library: library.version)
        seen += found
    if not seen:
        raise RuntimeUnfitError(f"no libLLVM was found, which the compiled kernels need: {remedy()}")
    newest = max(seen, key=lambda library: library.version)
    raise RuntimeUnfitError(f"{newest} is too old and there is no newer one: {remedy()}")


def preset() -> None:
    """Have Dr.Jit load a fit libLLVM whoever imports it first; called when the package is imported.

    Nothing is loaded, and no library is asked for its version in a child process. Where the user names a library, or
    none is fit, nothing is changed: :func:`choose` and ``mvla doctor`` say what is wrong.
    """
    global _preset  # noqa: PLW0603 - like the variable of the environment, one a process
    if os.environ.get(VARIABLE):
        return
    with contextlib.suppress(RuntimeUnfitError, OSError):
        library = choose(probe=lambda _path: None)
        preload_companions(Path(library.path))
        os.environ[VARIABLE] = library.path
        _preset = library


def preset_library() -> Library | None:
    """What :func:`preset` has chosen, None where the variable is the user's."""
    return _preset if _preset is not None and os.environ.get(VARIABLE) == _preset.path else None


def remedy() -> str:
    """What to do about a missing or unfit libLLVM on this kind of machine, in words that follow a colon."""
    install = {
        ("Linux", "x86_64"): f"pip install {WHEEL}",
        ("Darwin", "arm64"): "brew install llvm",
        ("Darwin", "x86_64"): "brew install llvm",
    }.get((platform.system(), platform.machine()), "install your system's libLLVM (Debian: apt-get install libllvm19)")
    return f"{install}, or point {VARIABLE} to a libLLVM of version {MINIMUM_VERSION} or newer"


def version_text(version: Version) -> str:
    """A version as text: "23.1", or "older than 16" where the library cannot tell."""
    return "older than 16" if version == BEFORE_16 else ".".join(map(str, version))


def version_from_name(path: str | os.PathLike[str]) -> Version | None:
    """Version by a file's name alone; None where it has none, as in ``libLLVM.so``.

    >>> version_from_name("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1")
    (19, 1)
    >>> version_from_name("libLLVM-14.so.1")
    (14,)
    """
    name = Path(path).name
    matches = [pattern.match(name) for pattern in _NAMES] + [_CELLAR.search(str(path))]
    found = next((match for match in matches if match), None)
    return tuple(map(int, found[1].split("."))) if found else None


def probe_version(path: str) -> Version | None:
    """Version by asking the library itself, in a child process; None where it cannot be loaded or is no libLLVM."""
    try:
        answer = subprocess.run(  # noqa: S603 - our own interpreter and program; the path is an argument
            [sys.executable, "-c", _PROBE, path], capture_output=True, text=True, timeout=60, check=True
        )
        return tuple(map(int, answer.stdout.split(".")))
    except (OSError, subprocess.SubprocessError, ValueError):
        return None


def wheel_files() -> list[Path]:
    """Every libLLVM that the wheel's metadata lists, whatever kind of installation; ``<prefix>/lib`` if it lists none.

    The wheel's short names (``libLLVM.so``) are links that its helper makes when Python starts; only the file with
    the full version is certain to be there.
    """
    try:
        listed = metadata.files(WHEEL)
    except metadata.PackageNotFoundError:
        return []
    if listed is None:
        return _distinct(_matching(Path(sys.prefix) / "lib"))
    return _distinct(Path(str(item.locate())) for item in listed if item.name.startswith("libLLVM"))


def system_files() -> list[Path]:
    """Every libLLVM of Python's prefix and of the system: search path, the loader's cache, and the usual folders."""
    machine = platform.machine()
    folders = [Path(sys.prefix) / "lib"]
    folders += [Path(entry) for entry in os.environ.get("LD_LIBRARY_PATH", "").split(":") if entry]
    if sys.platform == "darwin":
        for prefix in (Path("/opt/homebrew/opt"), Path("/usr/local/opt")):
            folders += [keg / "lib" for keg in sorted(prefix.glob("llvm*"))]
    else:
        folders += [Path(f"/usr/lib/{machine}-linux-gnu"), Path("/usr/lib64"), Path("/usr/lib")]
        folders += [tree / "lib" for tree in sorted(Path("/usr/lib").glob("llvm-*"))]
    found = _loader_cache(machine)
    for folder in folders:
        found += _matching(folder)
    return _distinct(found)


def preload_companions(library: Path) -> None:
    """Load the C++ runtime that lies beside the wheel's libLLVM, if the links it is found by were never made.

    They are made when Python first starts after the installation, which fails where the environment is read-only
    for the user. A library already loaded satisfies the dependency by its name.
    """
    folders = sorted(library.parent.glob("*-linux-gnu")) if library.is_absolute() else []
    for folder in folders:
        if (folder / "libc++.so.1").exists():
            continue
        for stem in ("libunwind", "libc++abi", "libc++"):
            for file in sorted(folder.glob(f"{stem}.so.1.*")):
                ctypes.CDLL(str(file))


def _explicit(named: str, probe: Probe) -> Library:
    if os.sep in named and not Path(named).is_file():
        raise RuntimeUnfitError(
            f"{VARIABLE} = {named}: no such file; unset it or point it to a libLLVM of version "
            f"{MINIMUM_VERSION} or newer"
        )
    version = _version(Path(named), probe)
    if version is None:
        raise RuntimeUnfitError(f"{VARIABLE} = {named}: cannot be loaded as libLLVM; unset it, or {remedy()}")
    library = Library(named, version, VARIABLE)
    if not library.fit:
        raise RuntimeUnfitError(
            f"{library} is too old: unset {VARIABLE} or point it to a libLLVM of version {MINIMUM_VERSION} or newer "
            f"(pip install {WHEEL})"
        )
    return library


def _version(path: Path, probe: Probe) -> Version | None:
    resolved = path.resolve() if path.exists() else path
    return version_from_name(path) or version_from_name(resolved) or probe(str(path))


def _loader_cache(machine: str) -> list[Path]:
    """What ``ldconfig -p`` lists for this machine's own instruction set."""
    program = shutil.which("ldconfig") or shutil.which("ldconfig", path="/sbin:/usr/sbin")
    if program is None:
        return []
    try:
        listing = subprocess.run(  # noqa: S603 - a system program with a constant argument
            [program, "-p"], capture_output=True, text=True, timeout=30, check=True
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return []
    kind = {"x86_64": "x86-64", "aarch64": "AArch64"}.get(machine, "")
    lines = [line for line in listing.splitlines() if "libLLVM" in line and kind in line]
    return [Path(line.split("=>")[1].strip()) for line in lines if "=>" in line]


def _matching(folder: Path) -> list[Path]:
    """Shared libraries of a folder whose name begins like libLLVM's."""
    return sorted([*folder.glob("libLLVM*.so*"), *folder.glob("libLLVM*.dylib")])


def _distinct(paths: Iterable[Path]) -> list[Path]:
    """Existing libLLVMs (not ``libLLVMCore``), each once however many links lead to it, by the name that tells most."""
    by_file: dict[Path, Path] = {}
    for path in paths:
        if not path.is_file() or not re.match(r"libLLVM[-.]", path.name):
            continue
        real = path.resolve()
        best = max((real, path, by_file.get(real, path)), key=lambda p: len(version_from_name(p) or ()))
        by_file[real] = best
    return list(by_file.values())
