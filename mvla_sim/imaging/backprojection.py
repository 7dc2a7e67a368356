"""Incoherent backprojection: the PDP itself is the range profile (``eq:bp_baseline``)."""

from __future__ import annotations

import numpy as np

from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["backprojection_profiles"]


def backprojection_profiles(pdp: Pdp) -> RangeProfiles:
    """Profiles of BP: q_m(r) = P_m(2r/c), linear between the PDP's samples, nothing outside its gate.

    Powers are scaled by their largest magnitude, which changes no ranking, so that float32 holds them.
    """
    largest = np.abs(pdp.power).max()
    scaled = pdp.power / largest if largest > 0 else pdp.power
    return RangeProfiles(scaled.astype(np.float32), pdp.start_m, pdp.step_m)
