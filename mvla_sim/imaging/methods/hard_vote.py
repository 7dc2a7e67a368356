"""First rung of the ablation ladder: hard votes alone."""

from __future__ import annotations

from typing import ClassVar

from mvla_sim.imaging.methods.mvla_hard import HardVote

__all__ = ["UngatedHardVote"]


class UngatedHardVote(HardVote):
    """``s_n = 1/M Σ_m 1{min_i |R_mi − |p_n − T_m|| ≤ ε_R}`` (``eq:hard_posterior``), without angular support."""

    name: ClassVar[str] = "hard-vote"
    title: ClassVar[str] = "Hard vote"
    with_support: ClassVar[bool] = False
