"""Columns of frequency, by which a table of frequency responses is told from one of components."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mvla_sim.spreadsheet import header_names

__all__ = ["FREQUENCIES", "has_frequencies", "is_table"]

FREQUENCIES: Final = {
    f"{name}_{unit}": scale
    for name in ("frequency", "freq", "f")
    for unit, scale in (("hz", 1.0), ("khz", 1e3), ("mhz", 1e6), ("ghz", 1e9))
}
"""Hertz per unit of each column that may hold frequencies."""
_WITHOUT_UNIT: Final = ("frequency", "freq")
_OF_COMPONENTS: Final = ("view", "delay_s", "delay_ns", "range_m", "power", "power_db")


def is_table(source: Path) -> bool:
    """Whether a file's suffix is one of a table of text."""
    return source.suffix.lower() in (".csv", ".tsv", ".txt") and source.is_file()


def has_frequencies(source: Path) -> bool:
    """Whether a table's header has a column of frequency."""
    names = header_names(source, _weight)
    return any(map(_is_frequency, names)) and not set(_OF_COMPONENTS[1:]) & set(names)


def _is_frequency(name: str) -> bool:
    return name in FREQUENCIES or name in _WITHOUT_UNIT


def _weight(names: Sequence[str]) -> int:
    return 2 * sum(map(_is_frequency, names)) + sum(name in _OF_COMPONENTS for name in names)
