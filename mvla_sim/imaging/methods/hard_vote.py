"""First rung of the ablation ladder: hard votes alone."""

from __future__ import annotations

from mvla_sim.imaging.methods.mvla_hard import HardVote

__all__ = ["METHOD"]


class _Ungated(HardVote):
    """``s_n = 1/M Σ_m 1{min_i |R_mi − |p_n − T_m|| ≤ ε_R}`` (``eq:hard_posterior``), without angular support."""

    title = "Hard vote"
    with_support = False


METHOD = _Ungated()
