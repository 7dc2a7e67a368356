"""Backprojection with MVLA-GR's angular gate: the sum of the profiles, and Θ of the peaks."""

from __future__ import annotations

from dataclasses import replace

from mvla_sim.imaging.backprojection import backprojection_profiles
from mvla_sim.imaging.methods.base import SumOverViews
from mvla_sim.imaging.mvla import kernel_scales, nearest_peak
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["METHOD"]


class _AngleGated(SumOverViews):
    """``image_n = Σ_m P_m(2|p_n − T_m|/c)`` with Θ_n of ``eq:angular_support_range`` for the joint threshold.

    A view supports what lies in its profile's gate, where alone it adds anything.
    """

    title = "BP + angular gate"
    uses_pdp = True
    per_view = False

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        _, radius = kernel_scales(seen.settings.mvla, seen.resolution_m, seen.extent_m)
        plain = backprojection_profiles(seen.pdp)
        nearest = nearest_peak(seen.peaks, plain.start_m, plain.step_m, plain.values.shape[1])
        return replace(plain, nearest_m=nearest, radius_m=radius, gated=False)


METHOD = _AngleGated()
