"""Thresholds from the image alone, for data without a truth."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.config.imaging import ThresholdSettings
from mvla_sim.errors import DataError

__all__ = ["automatic_thresholds", "otsu", "thresholds_of"]

CLIP_PERCENTILE: Final = 99.5
"""Brighter voxels count as this bright: a few flashes would be a class of their own."""
BINS: Final = 256


def otsu(values: NDArray[Any]) -> float:
    """The value that parts others best into two classes: the variance between their means is largest there.

    N. Otsu, "A Threshold Selection Method from Gray-Level Histograms", IEEE Transactions on Systems, Man, and
    Cybernetics 9(1), 1979. From a histogram of 256 bins; what lies above the returned edge is the upper class.

    Parameters
    ----------
    values
        Any shape, finite, at least one.
    """
    counts, edges = np.histogram(values, BINS)
    middle = (edges[1:] + edges[:-1]) / 2
    below, moment = np.cumsum(counts).astype(float), np.cumsum(counts * middle)
    total, sum_all = below[-1], moment[-1]
    spread = below * (total - below)
    between = np.divide((sum_all * below / total - moment) ** 2, spread, out=np.zeros(BINS), where=spread > 0)
    return float(edges[1 + int(between.argmax())])


def automatic_thresholds(score: NDArray[Any], support_deg: NDArray[Any] | None) -> ThresholdSettings:
    """Choose p and T_θ without a truth: Otsu's criterion on the score, then on Θ of what passes.

    Parameters
    ----------
    score
        Image, any shape; what is below 0 counts as 0. Its square root is what is parted, for powers and weights vary
        over decades.
    support_deg
        Θ_n of the same shape, degrees; None for methods without it.

    Raises
    ------
    DataError
        The image is the same everywhere, so that there is nothing to part.
    """
    level = np.maximum(np.asarray(score, np.float64).ravel(), 0)
    level = np.sqrt(np.minimum(level, np.percentile(level, CLIP_PERCENTILE)))
    if level.min() == level.max():
        raise DataError("threshold = 'auto': the image is the same nearly everywhere; give top_percent instead")
    passes = level > otsu(level)
    percent = max(100 * np.count_nonzero(passes) / level.size, 100 / level.size)
    support = 0.0 if support_deg is None else otsu(np.asarray(support_deg, np.float64).ravel()[passes])
    return ThresholdSettings(top_percent=percent, min_support_deg=min(support, 360.0))


def thresholds_of(
    wanted: ThresholdSettings | str, score: NDArray[Any], support_deg: NDArray[Any] | None
) -> ThresholdSettings:
    """Thresholds that settings ask for: given ones as they are, automatic ones for this image."""
    return automatic_thresholds(score, support_deg) if isinstance(wanted, str) else wanted
