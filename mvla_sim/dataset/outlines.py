"""Random outlines: star-shaped polygons and smooth closed curves, as vertices about an object's centre."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["random_polygon", "smooth_outline"]

Vertices = NDArray[np.float64]

NARROWEST: Final = 0.25
"""Least angle between neighbouring corners, relative to that of a regular polygon."""


def random_polygon(random: np.random.Generator, corners: int, roughness: float) -> Vertices:
    """Corners of a random simple polygon, counter-clockwise, ``[corners, 2]``; the outermost lies on the unit circle.

    Parameters
    ----------
    random
        Source of the draw.
    corners
        Number of corners, at least 3.
    roughness
        Radii are uniform between 1 − roughness and 1, and then scaled until the largest is 1.

    Notes
    -----
    The corners follow each other in rising direction about the centre, and no two are half a turn or more apart, so the
    centre sees all of the outline and no side crosses another.
    """
    share = _steps(random, corners)
    angles = 2 * np.pi * (random.random() + np.concatenate([[0.0], np.cumsum(share)[:-1]]))
    radii = np.asarray(1 - roughness * random.random(corners), np.float64)
    return _around(radii / radii.max(), angles)


def smooth_outline(random: np.random.Generator, harmonics: int, roughness: float, facets: int) -> Vertices:
    """Points on a random smooth closed curve, counter-clockwise, ``[facets, 2]``; the outermost at a radius of 1.

    Parameters
    ----------
    random
        Source of the draw.
    harmonics
        Highest Fourier term of the radius, at least 2. The first is left out: it would move the curve sideways.
    roughness
        Sum of the terms' amplitudes relative to the mean radius, below 1, so that the radius stays above 0.
    facets
        Number of points.

    Notes
    -----
    r(θ) ∝ 1 + Σ_k a_k·cos(kθ + φ_k) for k = 2 … ``harmonics``, a_k uniform times 1/k, so that coarse features prevail.
    """
    order = np.arange(2, harmonics + 1)
    amplitude = (0.1 + 0.9 * random.random(order.size)) / order
    amplitude *= roughness / amplitude.sum()
    phase = 2 * np.pi * random.random(order.size)
    angles = np.asarray(2 * np.pi / facets * np.arange(facets), np.float64)
    radii = np.asarray(1 + np.cos(order[:, None] * angles + phase[:, None]).T @ amplitude, np.float64)
    return _around(radii / radii.max(), angles)


def _steps(random: np.random.Generator, corners: int) -> Vertices:
    """Angles between neighbouring corners as shares of a turn, ``[corners]``, each below 0.45.

    Where a share is wider, it and the others are moved towards equal ones, which 3 corners need most of all.
    """
    raw = NARROWEST + (1 - NARROWEST) * 2 * random.random(corners)
    share = raw / raw.sum()
    equal = 1 / corners
    if (widest := share.max()) > 0.45:
        share = equal + (share - equal) * (0.45 - equal) / (widest - equal)
    return np.asarray(share, np.float64)


def _around(radii: Vertices, angles: Vertices) -> Vertices:
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
