"""View-normalised backprojection: every view's profile has the same total, as MVLA-GR's weights have."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mvla_sim.imaging.method import SumOverViews
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["ViewNormalisedBackprojection"]


class ViewNormalisedBackprojection(SumOverViews):
    """``image_n = Σ_m P_m(2|p_n − T_m|/c) / Σ_l P_m(τ_l)``.

    The sum over l is that of the samples above zero. With noise of zero mean the plain sum would be about the same, but
    may be near zero, or below it, where a view has no echo.
    """

    name: ClassVar[str] = "bp-normalised"
    title: ClassVar[str] = "View-normalised BP"
    uses_peaks: ClassVar[bool] = False
    uses_pdp: ClassVar[bool] = True

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """The profiles of the PDP over each view's total."""
        pdp = seen.pdp
        total = np.maximum(pdp.power, 0).sum(axis=1, keepdims=True)
        values = pdp.power / np.where(total > 0, total, 1.0)
        return RangeProfiles(values.astype(np.float32), pdp.start_m, pdp.step_m)
