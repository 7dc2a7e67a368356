"""Windows over the band: their weights, and by how much they broaden a pulse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Window"]

_COSINES = {"rectangular": (1.0,), "hann": (0.5, 0.5), "hamming": (0.54, 0.46), "blackman": (0.42, 0.5, 0.08)}
_NODES = 4096  # of the integral over a Kaiser window


@dataclass(frozen=True)
class Window:
    """A window by name; ``kaiser_beta`` is β of the Kaiser window I₀(β√(1 − x²))/I₀(β), −1 ≤ x ≤ 1, and of no other."""

    name: str = "rectangular"
    kaiser_beta: float = 6.0

    def weights(self, count: int) -> NDArray[np.float64]:
        """Weights at ``count`` frequencies centred in equal shares of the band, ``[count]``."""
        position = (np.arange(count) + 0.5) / count - 0.5
        if self.name == "kaiser":
            return np.asarray(np.i0(self.kaiser_beta * np.sqrt(1 - 4 * position**2)) / np.i0(self.kaiser_beta))
        terms = _COSINES[self.name]
        return np.asarray(sum(a * np.cos(2 * np.pi * k * position) for k, a in enumerate(terms)), np.float64)

    @property
    def broadening(self) -> float:
        """Equivalent noise bandwidth in units of 1/B: 1 for rectangular, 1.5 for Hann."""
        if self.name == "kaiser":
            weights = self.weights(_NODES)
            return float(_NODES * (weights**2).sum() / weights.sum() ** 2)
        terms = np.array(_COSINES[self.name])
        return float((terms[0] ** 2 + 0.5 * (terms[1:] ** 2).sum()) / terms[0] ** 2)
