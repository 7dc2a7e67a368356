"""Third rung of the ablation ladder: peaks weighted by their power. The last rung, the angular gate, is MVLA-GR."""

from __future__ import annotations

from typing import ClassVar

from mvla_sim.imaging.methods.mvla_gr import MvlaGr

__all__ = ["PowerWeights"]


class PowerWeights(MvlaGr):
    """``s_n = 1/M Σ_m b_mn Σ_i w_mi φ(|p_n − T_m| − R_mi)`` (``eq:view_support_new``), without angular support."""

    name: ClassVar[str] = "power-weights"
    title: ClassVar[str] = "Power weights"
    with_support: ClassVar[bool] = False
