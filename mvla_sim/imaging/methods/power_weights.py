"""Third rung of the ablation ladder: peaks weighted by their power. The last rung, the angular gate, is MVLA-GR."""

from __future__ import annotations

from mvla_sim.imaging.methods.mvla_gr import MvlaGr

__all__ = ["METHOD"]


class _PowerWeights(MvlaGr):
    """``s_n = 1/M Σ_m b_mn Σ_i w_mi φ(|p_n − T_m| − R_mi)`` (``eq:view_support_new``), without angular support."""

    title = "Power weights"
    with_support = False


METHOD = _PowerWeights()
