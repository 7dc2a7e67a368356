"""What a result was made with, stored in every file."""

from __future__ import annotations

import datetime
import platform
import shutil
import subprocess
from pathlib import Path

from mvla_sim.engine.backend import active
from mvla_sim.engine.machine import cpu_name, package_versions, program_version

__all__ = ["code_commit", "provenance"]


def provenance() -> dict[str, str]:
    """Program, commit, package versions, machine, backend and time (UTC); no name of a user, host or folder.

    The backend is the one in use, "none" as long as nothing was traced or projected.
    """
    backend = active()
    if backend is None:
        backend_text = "none"
    else:
        backend_text = f"llvm {backend.libllvm_version}" if backend.name == "llvm" else backend.name
    return {
        "program": f"mvla-sim {program_version()}",
        "commit": code_commit(),
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_name(),
        "backend": backend_text,
    } | {name: version or "missing" for name, version in package_versions().items()}


def code_commit(folder: Path | None = None) -> str:
    """Commit of the code, "-dirty" where files differ from it, "unknown" outside a checkout.

    Parameters
    ----------
    folder
        The checkout's top; by default the one this package lies in. An installed copy inside some other
        repository is not taken for that repository.
    """
    folder = folder or Path(__file__).resolve().parents[2]
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
            capture_output=True,
            text=True,
            timeout=30,
            check=True,
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return None
