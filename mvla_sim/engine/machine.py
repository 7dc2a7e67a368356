"""What this machine and this installation are: processor, cores, versions."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Final

__all__ = ["PACKAGES", "core_count", "cpu_name", "environment_kept", "package_versions", "program_version"]

PACKAGES: Final = ("drjit", "mitsuba", "sionna-rt", "numpy", "scipy", "xarray", "trimesh")
"""The distributions whose versions can change a result."""


def program_version() -> str:
    """Version of this program, "unknown" where it runs without being installed."""
    return package_versions(("mvla-sim",))["mvla-sim"] or "unknown"


def package_versions(names: tuple[str, ...] = PACKAGES) -> dict[str, str | None]:
    """Installed versions by name of distribution; None where one is missing."""
    versions: dict[str, str | None] = {}
    for name in names:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return versions


def core_count() -> int:
    """Cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def environment_kept(*names: str) -> Iterator[None]:
    """Within the block variables of the environment may change; afterwards they are what they were."""
    before = {name: os.environ.get(name) for name in names}
    try:
        yield
    finally:
        for name in names:
            os.environ.pop(name, None)
        os.environ.update({name: value for name, value in before.items() if value is not None})


def cpu_name() -> str:
    """The processor's name as its maker writes it, else its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(names), "") or platform.processor() or platform.machine()
