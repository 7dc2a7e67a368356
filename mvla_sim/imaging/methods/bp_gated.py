"""Backprojection with MVLA-GR's angular gate: the sum of the profiles, and Θ of the peaks."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from mvla_sim.imaging.likelihood import kernel_scales, nearest_peak
from mvla_sim.imaging.method import SumOverViews
from mvla_sim.imaging.methods.bp import backprojection_profiles
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["AngleGatedBackprojection"]


class AngleGatedBackprojection(SumOverViews):
    """``image_n = Σ_m P_m(2|p_n − T_m|/c)`` with Θ_n of ``eq:angular_support_range`` for the joint threshold.

    A view supports what lies in its profile's gate, where alone it adds anything.
    """

    name: ClassVar[str] = "bp-gated"
    title: ClassVar[str] = "BP + angular gate"
    uses_pdp: ClassVar[bool] = True
    per_view: ClassVar[bool] = False

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """The profiles of the PDP, with the ranges of peaks."""
        _, radius = kernel_scales(seen.settings.mvla, seen.resolution_m, seen.extent_m)
        plain = backprojection_profiles(seen.pdp)
        nearest = nearest_peak(seen.peaks, plain.start_m, plain.step_m, plain.values.shape[1])
        return replace(plain, nearest_m=nearest, radius_m=radius, gated=False)
