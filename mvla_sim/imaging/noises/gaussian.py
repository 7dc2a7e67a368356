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
    """White and of zero mean, added to the PDP: P + n, n ~ N(0, σ²), σ² = ⟨P²⟩/ρ.

    The signal whose power is measured is the PDP itself, as the usual AWGN tools with 'measured' power do. The result
    may be negative. The noise is white on the profile's axis, so that in a resolution cell falls as
    ``pdp.oversampling`` rises.
    """

    kind: Literal["gaussian"] = "gaussian"

    def drawn(self, pdp: Pdp, ratio: float, generators: Sequence[np.random.Generator]) -> Pdp:
        """P + n."""
        variance = self.mean_over_gate(pdp.power**2) / ratio
        draw = np.array([generator.standard_normal(pdp.power.shape[1]) for generator in generators])
        return replace(pdp, power=pdp.power + np.sqrt(variance)[:, None] * draw, amplitude=None)
