"""Noise power behind a square-law detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from mvla_sim.imaging.noise import Noise
from mvla_sim.imaging.pdp import Pdp

__all__ = ["ExponentialNoise"]


class ExponentialNoise(Noise):
    """Noise power that does not beat with the signal: P + n, n exponential of mean √(⟨P²⟩/(2ρ)), so that ⟨n²⟩ = ⟨P²⟩/ρ.

    It is white on the profile's axis, as Gaussian noise is.
    """

    kind: Literal["exponential"] = "exponential"

    def drawn(self, pdp: Pdp, ratio: float, generators: Sequence[np.random.Generator]) -> Pdp:
        """P + n."""
        second_moment = self.mean_over_gate(pdp.power**2) / ratio
        draw = np.array([generator.standard_exponential(pdp.power.shape[1]) for generator in generators])
        return replace(pdp, power=pdp.power + np.sqrt(second_moment / 2)[:, None] * draw, amplitude=None)
