"""Simple cost models by least squares: power laws, and fixed costs with a cost a unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mvla_sim.errors import DataError

__all__ = ["Affine", "PowerLaw", "fit_affine", "fit_power_law"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PowerLaw:
    """y = scale·x^exponent; ``spread`` is the root mean square of ln(y/law): 0.1 is about 10 %."""

    scale: float
    exponent: float
    spread: float

    def __call__(self, x: float) -> float:
        """The law's value."""
        return float(self.scale * x**self.exponent)


@dataclass(frozen=True)
class Affine:
    """y = fixed + per_unit·x, neither below 0; ``spread`` is the root mean square of (law − y)/y."""

    fixed: float
    per_unit: float
    spread: float

    def __call__(self, x: float) -> float:
        """The law's value."""
        return self.fixed + self.per_unit * x


def fit_power_law(x: Sequence[float], y: Sequence[float]) -> PowerLaw:
    """Fit a straight line to ln y over ln x.

    Raises
    ------
    DataError
        Fewer than two different sizes, or a value that is not above 0.
    """
    sizes, values = _checked(x, y)
    exponent, level = np.polyfit(np.log(sizes), np.log(values), 1)
    residual = np.log(values) - level - exponent * np.log(sizes)
    return PowerLaw(float(np.exp(level)), float(exponent), float(np.sqrt(np.mean(residual**2))))


def fit_affine(x: Sequence[float], y: Sequence[float]) -> Affine:
    """Fit a fixed cost and a cost a unit, neither negative; every point counts by its relative error.

    Raises
    ------
    DataError
        As :func:`fit_power_law`.
    """
    sizes, values = _checked(x, y)
    unit = sizes.max()  # keeps both columns of one size
    (fixed, slope), _ = nnls(np.stack([1 / values, sizes / unit / values], axis=1), np.ones(values.size))
    residual = (fixed + slope * sizes / unit) / values - 1
    return Affine(float(fixed), float(slope / unit), float(np.sqrt(np.mean(residual**2))))


def _checked(x: Sequence[float], y: Sequence[float]) -> tuple[Floats, Floats]:
    sizes, values = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if np.unique(sizes).size < 2:
        raise DataError(f"fit: {sizes.size} points at {np.unique(sizes).size} sizes; at least 2 sizes are needed")
    if sizes.min() <= 0 or values.min() <= 0 or not np.isfinite([sizes, values]).all():
        raise DataError("fit: sizes and costs must be finite and above 0")
    return sizes, values
