"""Axes that a program printed with few digits: the even steps that its rounding hides."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["unrounded_axis"]

_FEWEST: Final = 8
"""Fewer values may seem rounded by chance: 1, 2, 4, 5 are the rounded 0.9, 2.3, 3.6, 5."""
_COARSEST: Final = 0.8
"""Of a step: with a coarser last digit, an axis that lacks a value looks like the rounded one of longer steps."""
_OFF: Final = 0.55
"""Of the last digit: half of it by rounding, a tenth more because the line fits best on average."""
_DIGITS: Final = 15
"""That float64 holds of any decimal number."""


def unrounded_axis(axis: NDArray[np.float64], tolerance: float) -> tuple[float, float] | None:
    """Start and step of even values whose rounding to the digits of ``axis`` [n_axis] gives it.

    Analysers and scripts print frequencies with a fixed number of decimals, or of digits: in GHz with three decimals,
    1.875 MHz steps become 2, 2, 1, 2 … MHz. They are the even steps that fit best, where none of the values is further
    from them than rounding by 0.8 of a step at most puts it.

    Parameters
    ----------
    axis
        Values in any unit that is a power of ten.
    tolerance
        In steps: an axis this near to even as it stands needs no such thing.

    Returns
    -------
    start, step or None
        None where the axis is even within the tolerance, or is not explained by rounding.
    """
    if axis.ndim != 1 or axis.size < _FEWEST or not (np.diff(axis) > 0).all():
        return None
    number = np.arange(axis.size)
    ends = axis[0] + (axis[-1] - axis[0]) / (axis.size - 1) * number
    step = float((axis[-1] - axis[0]) / (axis.size - 1))
    if (np.abs(axis - ends) <= tolerance * step).all():
        return None
    unit = _last_digit(axis)
    middle = (axis.size - 1) / 2
    step = float(((number - middle) * (axis - axis.mean())).sum() / ((number - middle) ** 2).sum())
    off = axis - step * number
    start = float(off.max() + off.min()) / 2
    rounded = (unit <= _COARSEST * step) & (np.abs(off - start) <= _OFF * unit + tolerance * step)
    return (max(start, 0.0), step) if rounded.all() else None


def _last_digit(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the last printed digit of each value stands for, ``[n_axis]``: decimals are fixed, or the digits are."""
    texts = [f"{value:.{_DIGITS - 1}e}".split("e") for value in axis.tolist()]
    exponent = np.array([int(power) for _, power in texts])
    digits = np.array([len(mantissa.rstrip("0").replace(".", "")) for mantissa, _ in texts])
    decimals = (digits - 1 - exponent)[axis != 0].max()
    fixed = 10.0 ** (exponent - (digits[axis != 0].max() - 1))
    coarser: NDArray[np.float64] = np.maximum(10.0**-decimals, fixed)
    return coarser
