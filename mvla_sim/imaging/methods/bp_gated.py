"""Backprojection with MVLA-GR's angular gate: the sum of the profiles, and Θ of the peaks."""

from __future__ import annotations

import numpy as np

from mvla_sim.imaging.backprojection import backprojection_profiles
from mvla_sim.imaging.methods.base import Method
from mvla_sim.imaging.mvla import kernel_scales, likelihood_profiles
from mvla_sim.imaging.observation import Estimate, Observation

__all__ = ["METHOD"]


class _AngleGated(Method):
    """``image_n = Σ_m P_m(2|p_n − T_m|/c)`` with Θ_n of ``eq:angular_support_range`` for the joint threshold."""

    title = "BP + angular gate"
    uses_pdp = True

    def image(self, seen: Observation) -> Estimate:
        sigma, radius = kernel_scales(seen.settings.mvla, seen.resolution_m, seen.extent_m)
        profiles = likelihood_profiles(seen.peaks, sigma, radius, seen.span_m)
        support = seen.project(profiles).support_deg
        return Estimate(seen.project(backprojection_profiles(seen.pdp)).total.astype(np.float32, copy=False), support)


METHOD = _AngleGated()
