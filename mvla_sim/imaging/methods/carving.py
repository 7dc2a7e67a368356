"""First-echo carving: what lies nearer to a view than its first echo is empty; the target is the hull that is left.

Nothing between an antenna and its first echo reflects. So every view clears the inside of the circle (in space the
sphere, of a pair the ellipse) that its first echo lies on, and the target is on or behind the envelope of these
circles: ``r_mn ≥ R_m`` for all m, with equality for at least one.

Sources: the principle is that of *Envelope*, which takes the inner or outer envelope of spheres about the antennas for
the target's boundary (S. Kidera, T. Sakamoto, T. Sato, introduction of IEEE TGRS 48(4), 2010, p. 1993), and of space
carving by first-returning photons (C.-Y. Tsai, K. N. Kutulakos, S. G. Narasimhan, A. C. Sankaranarayanan, CVPR 2017).
Both give a surface. The score on voxels below is our own, so that the method can be judged at the same thresholds as
any other.

It rests on every view's first echo being that of the nearest point. Where a smooth target turns that point away, as the
arms of a star do, the first echo found comes from behind it, and the point is carved.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.imaging.likelihood import range_axis
from mvla_sim.imaging.method import Method
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["FirstEchoCarving", "first_echoes"]

_NEGLIGIBLE_SIGMAS = 6.5  # beyond it a first echo is below 10⁻⁹ and taken as 0: numbers as small as exp gives are slow


def first_echoes(peaks: Peaks) -> NDArray[np.float64]:
    """R_m, the range of each view's nearest peak, ``[n_view]`` metres; −∞ for a view that has none."""
    first = np.full(peaks.n_view, -np.inf)
    found = np.flatnonzero(peaks.row_size)
    first[found] = peaks.range_m[peaks.row_start[found]]
    return first


class FirstEchoCarving(Method):
    """``s_n = −c_n where c_n > γ, else a_n``: on a first echo, and not in front of others.

    With r_mn the range of voxel n from view m, M_n the number of views whose beam covers it, and R_m the first echo:

    * ``a_n = 1/M_n Σ_m exp(−(r_mn − R_m)²/(2σ²))``, σ = ``carving.kernel``·ΔR: share of views whose first echo it is;
    * ``c_n = 1/M_n Σ_m 1{r_mn < R_m − δ}``, δ = ``carving.margin``·ΔR: share of views that carve it;
    * γ = ``carving.share``, so that a view that missed its first echo takes nothing away.

    Carved voxels come last, those that fewest views carve before the others. A view without a peak carves nothing.
    """

    name: ClassVar[str] = "carving"
    title: ClassVar[str] = "First-echo carving"

    kernel: Annotated[float, Field(gt=0, le=100, description="width σ of a first echo, in ΔR")] = 0.5
    margin: Annotated[float, Field(ge=0, le=100, description="what a view carves ends so far before its first echo, "
                                   "in ΔR")] = 0.5  # fmt: skip
    share: Annotated[float, Field(ge=0, lt=1, description="a voxel is empty if more than this share of the views that "
                                  "cover it carve it")] = 0.01  # fmt: skip

    @property
    def projections(self) -> float:
        """About how many projections its image costs."""
        return 2.0

    def image(self, seen: Observation) -> Estimate:
        """Project first echoes and what is in front of them: two sums over views, ``[nz, ny, nx]``."""
        sigma = self.kernel * seen.resolution_m
        start, step, nodes = range_axis(seen.span_m, 2 * sigma, seen.n_view)  # 8 nodes a σ: within 0.2 %
        behind = nodes - first_echoes(seen.peaks)[:, None]
        echo = np.where(np.abs(behind) < _NEGLIGIBLE_SIGMAS * sigma, behind, np.inf)
        on = RangeProfiles(np.exp(echo**2 / (-2 * sigma**2)).astype(np.float32), start, step)
        before = RangeProfiles((behind < -self.margin * seen.resolution_m).astype(np.float32), start, step)
        touching, carving = seen.project(on), seen.project(before)
        views = np.float32(seen.n_view) if touching.coverage is None else np.maximum(touching.coverage, np.float32(1))
        touched, carved = touching.total / views, carving.total / views
        return Estimate(np.where(carved > self.share, -carved, touched).astype(np.float32))
