"""Second rung of the ablation ladder: a soft kernel in place of the hard vote; every peak of a view weighs the same."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mvla_sim.imaging.likelihood import kernel_scales, likelihood_profiles
from mvla_sim.imaging.method import SumOverViews
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["SoftKernel"]


class SoftKernel(SumOverViews):
    """``s_n = 1/M Σ_m b_mn Σ_i φ(|p_n − T_m| − R_mi)/K_m``: MVLA-GR with w_mi = 1/K_m, without angular support."""

    name: ClassVar[str] = "soft-kernel"
    title: ClassVar[str] = "Soft kernel"
    with_support: ClassVar[bool] = False

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """The kernel sum of every view, peaks weighing alike."""
        sigma, radius = kernel_scales(seen.settings.mvla, seen.resolution_m, seen.extent_m)
        weight = 1 / np.repeat(seen.peaks.row_size, seen.peaks.row_size)
        return likelihood_profiles(seen.peaks, sigma, radius, seen.span_m, weight)
