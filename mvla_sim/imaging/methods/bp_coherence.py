"""Coherence-factor backprojection: voxels on which the views agree keep their sum, others lose most of it.

The factor is that of Mallart and Fink (Journal of the Acoustical Society of America 96(6), 1994), of powers instead of
complex amplitudes, for there is no phase.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mvla_sim.imaging.method import Method
from mvla_sim.imaging.methods.bp import backprojection_profiles
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["CoherenceFactor"]


class CoherenceFactor(Method):
    """``image_n = CF_n·S_n``, ``S_n = Σ_m a_mn``, ``CF_n = S_n²/(M Σ_m a_mn²)``, ``a_mn = P_m(2|p_n − T_m|/c)``.

    a² is interpolated between its own samples, not squared after the interpolation: at four samples a cell the two
    differ by some per cent of a pulse's peak.
    """

    name: ClassVar[str] = "bp-coherence"
    title: ClassVar[str] = "Coherence-factor BP"
    uses_peaks: ClassVar[bool] = False
    uses_pdp: ClassVar[bool] = True

    @property
    def projections(self) -> float:
        """About how many projections its image costs."""
        return 2.0

    def image(self, seen: Observation) -> Estimate:
        """Project the profiles and their squares."""
        first = backprojection_profiles(seen.pdp)
        first = RangeProfiles(np.maximum(first.values, 0), first.start_m, first.step_m)
        total = seen.project(first).total
        squares = seen.project(RangeProfiles(first.values**2, first.start_m, first.step_m)).total
        factor = np.divide(total**2, seen.n_view * squares, out=np.zeros_like(total), where=squares > 0)
        return Estimate(factor * total)
