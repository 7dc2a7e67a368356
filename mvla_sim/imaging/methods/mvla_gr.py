"""MVLA-GR, the paper's method: soft kernels on peaks, power weights, angular support (Section III)."""

from __future__ import annotations

from typing import ClassVar

from mvla_sim.imaging.likelihood import kernel_scales, likelihood_profiles
from mvla_sim.imaging.method import SumOverViews
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["MvlaGr"]


class MvlaGr(SumOverViews):
    """``s_n = 1/M Σ_m b_mn Σ_i w_mi φ(|p_n − T_m| − R_mi)`` (``eq:view_support_new``)."""

    name: ClassVar[str] = "mvla-gr"
    title: ClassVar[str] = "MVLA-GR"

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """The kernel sum, or votes, of every view's peaks."""
        sigma, radius = kernel_scales(seen.settings.mvla, seen.resolution_m, seen.extent_m)
        return likelihood_profiles(seen.peaks, sigma, radius, seen.span_m)
