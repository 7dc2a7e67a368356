"""Scenes, experiments and readings that come with the package, found by their names."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import Literal

from mvla_sim.errors import DataError
from mvla_sim.files import as_path

__all__ = ["find", "shipped_folder"]

PACKAGE = Path(__file__).parent
ROOTS = (PACKAGE / "data", PACKAGE.parent)
"""Where they may be: inside an installed package, or beside it in a checkout."""

Folder = Literal["scenes", "experiments", "readings"]


def shipped_folder(folder: Folder) -> Path:
    """Folder of the scenes, experiments or readings that come with the package."""
    inside = "experiments/readings" if folder == "readings" else folder
    return next((root / inside for root in ROOTS if (root / inside).is_dir()), PACKAGE / "data" / inside)


def find(folder: Folder, name: str | os.PathLike[str], beside: Path | None = None) -> Path:
    """Return the file of a name: the user's own one, or else a shipped one.

    Parameters
    ----------
    folder
        What it is one of.
    name
        A file, which wins wherever it exists, or the bare name of a shipped one, as ``star`` or ``star.toml``.
    beside
        Folder that file names are relative to; by default the working directory.

    Returns
    -------
    Path
        The file. One that is given with a folder need not exist.

    Raises
    ------
    DataError
        There is neither a file nor anything shipped of a bare name; the message lists what is shipped.
    """
    path = as_path(name)
    here = path if beside is None else beside / path
    if path.name != str(path) or os.path.isfile(here):  # noqa: PTH113 - Path.is_file raises in a locked folder
        return here
    home = shipped_folder(folder)
    names = sorted(file.stem for file in home.glob("*.toml"))
    stem = path.name.removesuffix(".toml")
    if stem in names:
        return home / f"{stem}.toml"
    close = difflib.get_close_matches(stem, names, n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    raise DataError(f"{here}: no such file, nor one of the {folder} that come with mvla-sim{hint}: {', '.join(names)}")
