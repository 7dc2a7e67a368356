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

    By ``signal`` its mean is ⟨P⟩/ρ or max P/ρ instead. It is white on the profile's axis, as Gaussian noise is.
    """

    kind: Literal["exponential"] = "exponential"

    def drawn(self, pdp: Pdp, ratio: float, generators: Sequence[np.random.Generator]) -> Pdp:
        """P + n."""
        mean = self.level(pdp.power, ratio, 2.0)
        draw = np.array([generator.standard_exponential(pdp.power.shape[1]) for generator in generators])
        noisy = pdp.power + mean[:, None] * draw
        return replace(pdp, power=noisy, amplitude=None, noise_mean=mean, noise_sigma=mean)
