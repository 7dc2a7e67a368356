"""Filtered backprojection: a second derivative along range sharpens the arcs before they are summed.

After Velten et al., "Recovering three-dimensional shape around a corner using ultrafast time-of-flight imaging", Nature
Communications 3, 745 (2012), who take it of the image; here it is of the profiles, which is the same projection.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mvla_sim.imaging.method import Method
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["FilteredBackprojection"]


class FilteredBackprojection(Method):
    """``image_n = max(0, −Σ_m ∂²P_m/∂r² (|p_n − T_m|))``, the derivative taken over a resolution cell."""

    name: ClassVar[str] = "bp-filtered"
    title: ClassVar[str] = "Filtered BP"
    uses_peaks: ClassVar[bool] = False
    uses_pdp: ClassVar[bool] = True

    def image(self, seen: Observation) -> Estimate:
        """Project the derivatives."""
        pdp = seen.pdp
        step = max(1, round(pdp.resolution_m / pdp.step_m))
        padded = np.pad(pdp.power, ((0, 0), (step, step)), mode="edge")
        second = padded[:, 2 * step :] - 2 * pdp.power + padded[:, : -2 * step]
        largest = np.abs(second).max() or 1.0
        profiles = RangeProfiles((-second / largest).astype(np.float32), pdp.start_m, pdp.step_m)
        return Estimate(np.maximum(seen.project(profiles).total, 0))
