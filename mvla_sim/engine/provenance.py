"""What a result was made with, stored in every file."""

from __future__ import annotations

import datetime
import functools
import hashlib
import platform
import shutil
import subprocess
from pathlib import Path
from typing import Final

from mvla_sim.engine.backend import active
from mvla_sim.engine.machine import cpu_name, package_versions, program_version

__all__ = ["code_commit", "code_digest", "provenance"]

PACKAGE: Final = Path(__file__).resolve().parents[1]


def provenance() -> dict[str, str]:
    """Program, commit, package versions, machine, backend and time (UTC); no name of a user, host or folder.

    The backend is the one in use, "none" as long as nothing was traced or projected.
    """
    backend = active()
    if backend is None:
        backend_text = "none"
    else:
        backend_text = f"llvm {backend.libllvm_version}" if backend.name == "llvm" else backend.name
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {**_installation(), "created": created, "backend": backend_text}


@functools.cache
def _installation() -> dict[str, str]:
    """What stays the same as long as the process runs; git is asked once."""
    return {
        "program": f"mvla-sim {program_version()}",
        "commit": code_commit(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_name(),
    } | {name: version or "missing" for name, version in package_versions().items()}


@functools.cache
def code_digest(*parts: str) -> str:
    """SHA-256, in hexadecimal, over the source of subpackages and modules, as ``imaging`` and ``grid``, or of all.

    The files are read once a process, as Python itself does.
    """
    digest = hashlib.sha256()
    for file in sorted(PACKAGE.rglob("*.py")):
        name = file.relative_to(PACKAGE)
        if not parts or name.parts[0].removesuffix(".py") in parts:
            digest.update(f"{name}\n".encode() + file.read_bytes())
    return digest.hexdigest()


def code_commit(folder: Path = PACKAGE.parent) -> str:
    """Commit of the code, "-dirty" where files differ from it, "unknown" where ``folder`` is no checkout's top.

    So an installed copy inside some other repository is not taken for that repository.
    """
    git = shutil.which("git")
    if git is None or not (folder / ".git").exists():
        return "unknown"
    commit = _git(git, folder, "rev-parse", "HEAD")
    if not commit:
        return "unknown"
    changes = _git(git, folder, "status", "--porcelain", "--untracked-files=no")
    return commit.strip() if changes == "" else f"{commit.strip()}-dirty"


def _git(git: str, folder: Path, *arguments: str) -> str | None:
    """Output of a git command, None where it fails."""
    try:
        return subprocess.run(  # noqa: S603 - git with constant arguments
            [git, "-C", str(folder), "--no-optional-locks", *arguments],
            capture_output=True, text=True, timeout=30, check=True,
        ).stdout  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
