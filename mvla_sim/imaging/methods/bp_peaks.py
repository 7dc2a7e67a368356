"""Peak-gated backprojection: profiles count only near a peak, so noise between the echoes adds nothing."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mvla_sim.imaging.likelihood import kernel_scales, nearest_peak, range_axis
from mvla_sim.imaging.method import SumOverViews
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["PeakGatedBackprojection"]


class PeakGatedBackprojection(SumOverViews):
    """``image_n = Σ_m b_mn P_m(2|p_n − T_m|/c)``, b_mn = 1 where a peak is within R_T, as in MVLA-GR; no support."""

    name: ClassVar[str] = "bp-peaks"
    title: ClassVar[str] = "Peak-gated BP"
    uses_pdp: ClassVar[bool] = True
    per_view: ClassVar[bool] = False
    with_support: ClassVar[bool] = False

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """The profiles of the PDP near peaks."""
        pdp = seen.pdp
        sigma, radius = kernel_scales(seen.settings.mvla, seen.resolution_m, seen.extent_m)
        start, step, nodes = range_axis(seen.span_m, sigma, seen.n_view)
        near = np.abs(nodes - nearest_peak(seen.peaks, start, step, nodes.size)) <= radius + step
        values = np.stack([np.interp(nodes, pdp.range_m, power, 0.0, 0.0) for power in pdp.power])
        largest = np.abs(pdp.power).max() or 1.0
        return RangeProfiles((values * near / largest).astype(np.float32), start, step)
