"""Incoherent backprojection, the paper's baseline."""

from __future__ import annotations

from mvla_sim.imaging.backprojection import backprojection_profiles
from mvla_sim.imaging.methods.base import SumOverViews
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["METHOD"]


class _Backprojection(SumOverViews):
    """``image_n = Σ_m P_m(2|p_n − T_m|/c)`` (``eq:bp_baseline``)."""

    title = "Backprojection"
    uses_peaks = False
    uses_pdp = True
    per_view = False

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        return backprojection_profiles(seen.pdp)


METHOD = _Backprojection()
