"""Incoherent backprojection, the paper's baseline."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mvla_sim.imaging.method import SumOverViews
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["Backprojection", "backprojection_profiles"]


def backprojection_profiles(pdp: Pdp) -> RangeProfiles:
    """Profiles of BP: q_m(r) = P_m(2r/c), linear between the PDP's samples, nothing outside its gate.

    Powers are scaled by their largest magnitude, which changes no ranking, so that float32 holds them.
    """
    largest = np.abs(pdp.power).max()
    scaled = pdp.power / largest if largest > 0 else pdp.power
    return RangeProfiles(scaled.astype(np.float32), pdp.start_m, pdp.step_m)


class Backprojection(SumOverViews):
    """``image_n = Σ_m P_m(2|p_n − T_m|/c)`` (``eq:bp_baseline``)."""

    name: ClassVar[str] = "bp"
    title: ClassVar[str] = "Backprojection"
    score_label: ClassVar[str] = "sum of normalised profiles"
    uses_peaks: ClassVar[bool] = False
    uses_pdp: ClassVar[bool] = True
    per_view: ClassVar[bool] = False

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """The profiles of the PDP."""
        return backprojection_profiles(seen.pdp)
