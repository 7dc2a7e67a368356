"""Refusing what cannot fit into memory before it is allocated."""

from __future__ import annotations

from typing import Final

import psutil

from mvla_sim.errors import ConfigError

__all__ = ["check_memory"]

USABLE: Final = 0.8
"""Share of the free memory that one array may take."""


def check_memory(needed_bytes: float, what: str, remedy: str) -> None:
    """Refuse what exceeds the usable share of the free memory.

    Parameters
    ----------
    needed_bytes
        How much it needs.
    what
        What it is, in the plural.
    remedy
        What to do about it; may hold ``{factor:.2g}``: how many times too large the need is.

    Raises
    ------
    ConfigError
        It does not fit.
    """
    free = psutil.virtual_memory().available
    if needed_bytes > USABLE * free:
        factor = needed_bytes / (USABLE * free)
        sizes = f"{needed_bytes / 2**30:.1f} GiB, {free / 2**30:.1f} GiB are free"
        raise ConfigError(f"{what} need {sizes}; {remedy.format(factor=factor)}")
