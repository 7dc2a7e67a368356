"""Refusing what cannot fit into memory before it is allocated."""

from __future__ import annotations

from typing import Final

import psutil

from mvla_sim.errors import ConfigError

__all__ = ["check_memory"]

USABLE: Final = 0.8
"""Share of the free memory that one array may take."""


def check_memory(needed_bytes: float, what: str, mend: str) -> None:
    """Raise ConfigError, naming ``what`` needs how much and the ``mend``, if it exceeds the free memory's usable share.

    ``mend`` may hold ``{factor:.2g}``: how many times too large the need is.
    """
    free = psutil.virtual_memory().available
    if needed_bytes > USABLE * free:
        factor = needed_bytes / (USABLE * free)
        raise ConfigError(
            f"{what} need {needed_bytes / 2**30:.1f} GiB, {free / 2**30:.1f} GiB are free; {mend.format(factor=factor)}"
        )
