"""The hard vote that MVLA-GR softens: a view votes for the voxels within ε_R of one of its peaks."""

from __future__ import annotations

from typing import ClassVar

from mvla_sim.imaging.likelihood import hard_profiles
from mvla_sim.imaging.method import SumOverViews
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["HardVote"]


class HardVote(SumOverViews):
    """``s_n = 1/M Σ_m 1{min_i |R_mi − |p_n − T_m|| ≤ ε_R}`` (``eq:event_hard``, ``eq:hard_posterior``)."""

    name: ClassVar[str] = "mvla-hard"
    title: ClassVar[str] = "MVLA hard vote"

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """The kernel sum, or votes, of every view's peaks."""
        tolerance = seen.settings.mvla.tolerance_m
        return hard_profiles(seen.peaks, seen.resolution_m if tolerance is None else tolerance, seen.span_m)
