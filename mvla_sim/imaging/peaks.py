"""Multipath components from power delay profiles: the phase-free observations C_m (``eq:obs``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from mvla_sim.errors import DataError
from mvla_sim.imaging.imaging_settings import PeakSettings
from mvla_sim.imaging.pdp import Pdp

__all__ = ["Peaks", "extract_peaks"]

_MAD_TO_SIGMA = 1.4826  # median absolute deviation of a normal distribution is σ/1.4826


@dataclass(frozen=True)
class Peaks:
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
        return np.repeat(np.arange(self.n_view), self.row_size)

    @property
    def weight(self) -> NDArray[np.float64]:
        """w_mi = p_mi / Σ_l p_ml, ``[n_peak]`` (``eq:nor_w_new``)."""
        totals = np.bincount(self.view, self.power, self.n_view)
        return np.asarray(self.power / np.repeat(totals, self.row_size), np.float64)

    def select(self, indices: NDArray[np.intp]) -> Peaks:
        """Return the given views, in the given order."""
        start = np.concatenate([[0], np.cumsum(self.row_size)])
        rows = [np.arange(start[i], start[i + 1]) for i in indices]
        taken = np.concatenate(rows) if rows else np.zeros(0, np.intp)
        return Peaks(self.range_m[taken], self.power[taken], self.row_size[indices])


def extract_peaks(pdp: Pdp, settings: PeakSettings) -> Peaks:
    """Detect multipath components in every view.

    A sample is a component if it is a local maximum above the threshold and no stronger one is closer than the minimum
    separation. The noise floor is estimated from the profile itself, never from the true noise: the median is the
    level, 1.4826 times the median absolute deviation the standard deviation, both insensitive to the few samples that
    hold echoes.

    Parameters
    ----------
    pdp
        Profiles, noisy or clean.
    settings
        Threshold in standard deviations over the floor and in dB under the strongest sample; separation in resolution
        cells (1/B times the window's broadening); refinement.

    Raises
    ------
    DataError
        No view has any peak.
    """
    distance = max(1.0, settings.min_separation * pdp.broadening * pdp.resolution_m / pdp.step_m)
    ranges, powers, sizes = [], [], []
    for power in pdp.power:
        level = np.median(power)
        sigma = _MAD_TO_SIGMA * np.median(np.abs(power - level))
        floor = max(level + settings.threshold_sigma * sigma, power.max() * 10 ** (-settings.dynamic_range_db / 10))
        found, _ = find_peaks(power, height=max(floor, np.finfo(np.float64).tiny), distance=distance)
        shift, height = _vertex(power, found) if settings.refine else (np.zeros(found.size), power[found])
        if settings.max_peaks is not None and found.size > settings.max_peaks:
            strongest = np.sort(np.argsort(-height, kind="stable")[: settings.max_peaks])
            found, shift, height = found[strongest], shift[strongest], height[strongest]
        ranges.append(pdp.start_m + pdp.step_m * (found + shift))
        powers.append(height)
        sizes.append(found.size)
    if not sum(sizes):
        raise DataError(
            f"no peak in any of {len(sizes)} views; lower peaks.threshold_sigma (now {settings.threshold_sigma:g}) "
            f"or raise the SNR"
        )
    return Peaks(np.concatenate(ranges), np.concatenate(powers), np.array(sizes, np.int64))


def _vertex(power: NDArray[np.float64], found: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Vertex of the parabola through each peak and its neighbours: shift in samples (within ±1/2) and height."""
    left, middle, right = power[found - 1], power[found], power[found + 1]
    curvature = left - 2 * middle + right
    safe = np.where(curvature < 0, curvature, -1.0)  # a flat top has no curvature and stays where it is
    shift = np.where(curvature < 0, 0.5 * (left - right) / safe, 0.0)
    return shift, middle - 0.25 * (left - right) * shift
