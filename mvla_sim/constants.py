"""Physical constants, in one place."""

from __future__ import annotations

from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["SPEED_OF_LIGHT", "delay_to_range", "range_resolution", "range_to_delay"]

SPEED_OF_LIGHT: Final[float] = 299_792_458.0
"""Speed of light in vacuum, m/s (exact by definition)."""

Value = TypeVar("Value", float, NDArray[np.float32], NDArray[np.float64])


def delay_to_range(delay_s: Value) -> Value:
    """One-way range R = c·τ/2 in metres of a round-trip delay in seconds (the paper's ``eq:Rmi``)."""
    return delay_s * (SPEED_OF_LIGHT / 2)


def range_to_delay(range_m: Value) -> Value:
    """Round-trip delay τ = 2R/c in seconds of a one-way range in metres (``eq:delay``)."""
    return range_m * (2 / SPEED_OF_LIGHT)


def range_resolution(bandwidth_hz: float) -> float:
    """Range resolution ΔR = c/(2B) in metres (``eq:resolution``); 0.05 m at 3 GHz."""
    return SPEED_OF_LIGHT / (2 * bandwidth_hz)
