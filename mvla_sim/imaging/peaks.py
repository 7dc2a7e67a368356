"""Multipath components from power delay profiles: the phase-free observations C_m (``eq:obs``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat

from mvla_sim.errors import DataError
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.kinds import Kind, Kinds
from mvla_sim.ragged import Ragged

__all__ = ["DETECTORS", "PeakDetector", "Peaks"]

DETECTORS: Final[Kinds[PeakDetector]] = Kinds(
    "peak detector", "mvla_sim.detectors", "mvla_sim.imaging.detectors", key="kind", default="local-maxima"
)
"""All peak detectors by name."""


@dataclass(frozen=True, eq=False, repr=False)
class Peaks(Ragged):
    """Detected components of M views, view after view, by increasing range within a view.

    Attributes
    ----------
    range_m
        R_mi, ``[n_peak]`` float64, metres (``eq:Rmi``).
    power
        p_mi, ``[n_peak]`` float64, path gain (``eq:pmi_full``).
    row_size
        K_m, ``[n_view]`` int64; 0 where a view has no peak.
    """

    range_m: NDArray[np.float64]
    power: NDArray[np.float64]
    row_size: NDArray[np.int64]

    def __post_init__(self) -> None:
        """Check that the rows add up and powers can be weights."""
        if self.range_m.shape != self.power.shape or self.row_size.sum() != self.range_m.size:
            raise DataError(f"peaks: {self.range_m.size} ranges, {self.power.size} powers, rows add up to "
                            f"{self.row_size.sum()}; these must agree")  # fmt: skip
        if not (np.isfinite(self.range_m).all() and np.isfinite(self.power).all() and (self.power > 0).all()):
            raise DataError("peaks: ranges must be finite and powers above 0")

    def __repr__(self) -> str:
        return f"Peaks({self.range_m.size} in {self.n_view} views)"

    @classmethod
    def none(cls, n_view: int) -> Peaks:
        """No peak in any of ``n_view`` views."""
        return cls(np.zeros(0), np.zeros(0), np.zeros(n_view, np.int64))

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return self.row_size.size

    @property
    def view(self) -> NDArray[np.int64]:
        """Index of each peak's view, ``[n_peak]``."""
        return self.row_index

    @property
    def weight(self) -> NDArray[np.float64]:
        """w_mi = p_mi / Σ_l p_ml, ``[n_peak]`` (``eq:nor_w_new``)."""
        totals = np.bincount(self.view, self.power, self.n_view)
        return np.asarray(self.power / np.repeat(totals, self.row_size), np.float64)

    def select(self, indices: NDArray[np.intp]) -> Peaks:
        """Return the given views, in the given order."""
        taken = self.elements(indices)
        return Peaks(self.range_m[taken], self.power[taken], self.row_size[indices])


class PeakDetector(Kind):
    """A way to find multipath components in profiles.

    A detector has the field ``kind``, a ``Literal`` of its name, and :meth:`peaks_of`, which looks at the true noise
    only where its settings say so.
    """

    kinds: ClassVar[Kinds[PeakDetector]] = DETECTORS

    threshold_sigma: PositiveFloat = Field(4.0, description="threshold above the median, in robust standard deviations")

    def peaks_of(self, pdp: Pdp) -> Peaks:
        """Find the components of every view, each on its own; views may have none."""
        raise NotImplementedError
