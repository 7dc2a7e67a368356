"""What a folder without sweeps is instead, and which file or folder near it can be read."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

__all__ = ["is_deepmimo_3", "what_to_give"]

_DEPTH: Final = 2
_MOST_ENTRIES: Final = 5000
_DEEPMIMO_3: Final = re.compile(r"(.+\.)?(params|TX_Loc|\d+\.(CIR|DoA|DoD|PL|LoS))\.mat", re.IGNORECASE)
_KINDS: Final = {
    "Touchstone files": re.compile(r".+\.(s\d+p|ts)", re.IGNORECASE),
    "paths of Wireless InSite": re.compile(r".+\.p2m", re.IGNORECASE),
    "a DeepMIMO scenario": re.compile(r"params\.json"),
}
_FILES: Final = re.compile(r".+\.(mat|npz|h5|hdf5|nc|csv)", re.IGNORECASE)


def is_deepmimo_3(name: str) -> bool:
    """Whether a file's name is one of a DeepMIMO scenario of version 3 or before: ``O1_28.params.mat``."""
    return _DEEPMIMO_3.fullmatch(name) is not None


def what_to_give(folder: Path) -> str | None:
    """Say of a folder without sweeps what it is, and what to give instead; None where nothing is known.

    Two levels of folders within it are looked at, some thousand names at most.
    """
    holders: dict[str, list[Path]] = {kind: [] for kind in _KINDS}
    old = file = None
    for place, name in itertools.islice(_names(folder, _DEPTH), _MOST_ENTRIES):
        old = old or ((place, name) if is_deepmimo_3(name) else None)
        file = file or (name if _FILES.fullmatch(name) and place == folder else None)
        for kind, pattern in _KINDS.items():
            if pattern.fullmatch(name) and place != folder and place not in holders[kind]:
                holders[kind].append(place)
    for kind, places in holders.items():
        if places and (old is None or old[0] != folder):
            more = f" and {len(places) - 1} more of its folders; give one of them" if places[1:] else "; give that"
            return f"holds {kind} in {places[0].relative_to(folder)}{more}: {places[0]}"
    if old is not None:
        return (
            f"{old[1]} is of a DeepMIMO scenario of version 3; give one of version 4, a folder with params.json "
            f"(DeepMIMO's Python package loads it: deepmimo.download('{old[1].partition('.')[0].lower()}'))"
        )
    return None if file is None else f"holds no sweeps; to read a file in it, as {file}, give the file's name"


def _names(folder: Path, depth: int) -> Iterator[tuple[Path, str]]:
    """Folder and name of every file, a folder's own before those within it."""
    within: list[Path] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                if entry.is_file():
                    yield folder, entry.name
                elif entry.is_dir():
                    within.append(folder / entry.name)
    except OSError:
        return  # what may not be looked into is not told of
    if depth:
        for place in sorted(within):
            yield from _names(place, depth - 1)
