"""The projector again, in plain float64 NumPy and loops: slow, and meant to be obviously right."""

from __future__ import annotations

import numpy as np


def distances(points_m, position_m):
    """Range of every point ``[n, 3]`` from one sensor ``[3]``, metres."""
    return np.sqrt(((points_m - position_m) ** 2).sum(axis=1))


def supports(points_m, positions_m, peaks, radius_m):
    """b_mn: whether some peak of view m is within R_T of the voxel's range; ``[n_view, n]``, and near ties as well.

    ``peaks`` is one pair (ranges, weights) a view.
    """
    result = np.zeros((len(positions_m), len(points_m)), bool)
    for m, (ranges, _) in enumerate(peaks):
        r = distances(points_m, positions_m[m])
        for peak in ranges:
            result[m] |= np.abs(r - peak) <= radius_m
    return result


def score(points_m, positions_m, peaks, sigma_m, radius_m):
    """Σ_m Σ_i w_mi φ(d_mi,n), with φ truncated at R_T; ``[n]``."""
    total = np.zeros(len(points_m))
    for m, (ranges, weights) in enumerate(peaks):
        r = distances(points_m, positions_m[m])
        for peak, weight in zip(ranges, weights, strict=True):
            d = r - peak
            total += np.where(np.abs(d) <= radius_m, weight * np.exp(-(d**2) / (2 * sigma_m**2)), 0.0)
    return total


def support_width(angles_deg, supported, closed):
    """Θ of one voxel: width of the longest run of consecutive supporting views, by trying every run.

    Views are in rising order along the trajectory; on a closed one a run may go on past the last view.
    """
    count = len(angles_deg)
    widest = 0.0
    for first in range(count):
        if not supported[first]:
            continue
        for length in range(1, count + 1):
            last = first + length - 1
            if last >= count and not closed:
                break
            if not supported[last % count]:
                break
            widest = max(widest, angles_deg[last % count] + 360 * (last // count) - angles_deg[first])
    return widest


def support_widths(angles_deg, b, closed):
    """Θ_n of every voxel from b ``[n_view, n]``; equal columns are looked at once."""
    columns, inverse = np.unique(b.T, axis=0, return_inverse=True)
    widths = np.array([support_width(angles_deg, column, closed) for column in columns])
    return widths[inverse.ravel()]


def backprojection(points_m, positions_m, power, range_m):
    """Σ_m P_m(r), linear between samples and nothing outside them; ``[n]``."""
    total = np.zeros(len(points_m))
    for m, profile in enumerate(power):
        total += np.interp(distances(points_m, positions_m[m]), range_m, profile, left=0.0, right=0.0)
    return total
