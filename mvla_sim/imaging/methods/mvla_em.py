"""MVLA-EM: a few EM iterations over view-normalised echoes, so that every echo is explained once; then MVLA-GR's gate.

MVLA-GR adds every echo in full to all voxels of its arc. Here the echo is shared out among them in proportion to what
the other views say of each, which is the EM step of emission tomography (Shepp and Vardi, IEEE Transactions on Medical
Imaging 1(2), 1982). Three things make it fit for echoes of specular targets: every view counts alike, whatever the
power of its flashes; what the noise may have made is no echo; a part of each view may be explained by nothing.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.dsp import noise_level
from mvla_sim.imaging.likelihood import kernel_scales, likelihood_profiles
from mvla_sim.imaging.method import Method
from mvla_sim.imaging.methods.mlem import maximize
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.tomography import LinearModel

__all__ = ["MvlaEm", "echoes"]

LEAST_TOTAL: Final = 1e-30


def echoes(pdp: Pdp, threshold_sigma: float) -> NDArray[np.float64]:
    """Samples that stand above the noise, each view's divided by their sum, ``[n_view, n_range]``; 0 elsewhere.

    A sample stands above the noise where it exceeds the median by ``threshold_sigma`` robust standard deviations, as a
    peak must. A view without such a sample is 0 everywhere.
    """
    level, sigma = noise_level(pdp.power)
    kept = np.where(pdp.power > (level + threshold_sigma * sigma)[:, None], np.maximum(pdp.power, 0), 0.0)
    total = kept.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(kept, total, out=np.zeros_like(kept), where=total > LEAST_TOTAL), np.float64)


class MvlaEm(Method):
    """``x_n ← x_n/c_n Σ_ml A_(ml),n y_ml/(Σ_k A_(ml),k x_k + β/L)``, ``c_n = Σ_ml A_(ml),n``, from a uniform x.

    y_ml are :func:`echoes` of view m at range l of L, A the pulse's power at a voxel's range, β the share of a view
    that nothing may explain. Θ_n is that of ``eq:angular_support_range``.
    """

    name: ClassVar[str] = "mvla-em"
    block: ClassVar[str | None] = "em"
    title: ClassVar[str] = "MVLA-EM"
    uses_pdp: ClassVar[bool] = True

    iterations: Annotated[int, Field(ge=1, le=10_000, description="steps; more sharpen the image, and the noise")] = 8
    unexplained: Annotated[
        float, Field(gt=0, le=100, description="share of a view that may be explained by nothing")
    ] = 1.0

    @property
    def projections(self) -> float:
        """About how many projections its image costs."""
        return 2.0 * self.iterations + 2

    def image(self, seen: Observation) -> Estimate:
        """Iterate, and project the peaks for Θ."""
        settings = seen.settings
        observed = echoes(seen.pdp, settings.peaks.threshold_sigma)
        share = np.full(seen.n_view, self.unexplained / observed.shape[1])
        score = maximize(LinearModel.of(seen, fading=False), observed, share, self.iterations)
        sigma, radius = kernel_scales(settings.mvla, seen.resolution_m, seen.extent_m)
        support = seen.project(likelihood_profiles(seen.peaks, sigma, radius, seen.span_m)).support_deg
        return Estimate(score, support)
