"""White Gaussian noise on the PDP, as the paper adds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from mvla_sim.imaging.noise import Noise
from mvla_sim.imaging.pdp import Pdp

__all__ = ["GaussianNoise"]


class GaussianNoise(Noise):
    """White and of zero mean, added to the PDP: P + n, n ~ N(0, σ²), σ = √(⟨P²⟩/ρ); by ``signal`` ⟨P⟩/ρ or max P/ρ.

    The result may be negative, unless it is clipped. The noise is white on the profile's axis, so that in a resolution
    cell falls as ``pdp.oversampling`` rises.
    """

    kind: Literal["gaussian"] = "gaussian"

    def drawn(self, pdp: Pdp, ratio: float, generators: Sequence[np.random.Generator]) -> Pdp:
        """P + n."""
        sigma = self.level(pdp.power, ratio)
        draw = np.array([generator.standard_normal(pdp.power.shape[1]) for generator in generators])
        noisy = pdp.power + sigma[:, None] * draw
        return replace(pdp, power=noisy, amplitude=None, noise_mean=np.zeros_like(sigma), noise_sigma=sigma)
