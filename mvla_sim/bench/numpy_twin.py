"""The projector in plain float64 NumPy and loops: what speed is compared with, and tests hold kernels to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["backprojection", "distances", "score", "supports"]

Floats = NDArray[np.float64]
Rows = Sequence[tuple[Floats, Floats]]
"""Ranges, in metres, and weights of the peaks of each view."""


def distances(points_m: Floats, position_m: Any) -> Floats:
    """Range of every point ``[n, 3]`` from one sensor ``[3]``, metres.

    Of a pair ``[2, 3]``, transmitter and receiver, it is half the way from one over the point to the other.
    """
    ends = np.reshape(position_m, (-1, 3))
    ways = [np.sqrt(((points_m - end) ** 2).sum(axis=1)) for end in ends]
    return np.asarray(np.mean(ways, axis=0), np.float64)


def supports(points_m: Floats, positions_m: Floats, peaks: Rows, radius_m: float) -> NDArray[np.bool_]:
    """b_mn: whether some peak of view m is within R_T of the voxel's range; ``[n_view, n]``."""
    result = np.zeros((len(positions_m), len(points_m)), bool)
    for m, (ranges, _) in enumerate(peaks):
        r = distances(points_m, positions_m[m])
        for peak in ranges:
            result[m] |= np.abs(r - peak) <= radius_m
    return result


def score(
    points_m: Floats, positions_m: Floats, peaks: Rows, sigma_m: float, radius_m: float, *, covered: Any = True
) -> Floats:
    """Σ_m Σ_i w_mi φ(d_mi,n), with φ truncated at R_T, over the views that cover the voxel; ``[n]``."""
    total = np.zeros(len(points_m))
    covered = np.broadcast_to(covered, (len(positions_m), len(points_m)))
    for m, (ranges, weights) in enumerate(peaks):
        r = distances(points_m, positions_m[m])
        for peak, weight in zip(ranges, weights, strict=True):
            d = r - peak
            near = covered[m] & (np.abs(d) <= radius_m)
            total += np.where(near, weight * np.exp(-(d**2) / (2 * sigma_m**2)), 0.0)
    return total


def backprojection(
    points_m: Floats, positions_m: Floats, power: Floats, range_m: Floats, covered: Any = True
) -> Floats:
    """Σ_m P_m(r) over the views that cover the voxel, linear between samples and nothing outside them; ``[n]``."""
    total = np.zeros(len(points_m))
    covered = np.broadcast_to(covered, (len(power), len(points_m)))
    for m, profile in enumerate(power):
        r = distances(points_m, positions_m[m])
        total += np.where(covered[m], np.interp(r, range_m, profile, left=0.0, right=0.0), 0.0)
    return total
