"""Where intermediate results are kept between runs."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Final

import platformdirs

from mvla_sim.errors import OutputError

__all__ = ["VARIABLE", "cache_folder"]

VARIABLE: Final[str] = "MVLA_CACHE_DIR"
"""The environment variable that names another cache folder."""


def cache_folder() -> Path:
    """Return the cache folder, made if it is not there: ``MVLA_CACHE_DIR``, else the user's cache of ``mvla-sim``.

    Raises
    ------
    OutputError
        It cannot be made or written to.
    """
    named = os.environ.get(VARIABLE)
    folder = Path(named).expanduser() if named else platformdirs.user_cache_path("mvla-sim")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be used as the cache folder ({error.strerror}); set {VARIABLE} to a folder of yours"
        ) from error
    return folder
