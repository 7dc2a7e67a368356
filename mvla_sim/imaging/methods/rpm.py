"""Range Points Migration: every range gets the direction in which the circles of its neighbours cross its own.

A range point q_i = (X_i, R_i) is a peak at range R_i of the view at X_i; its contour point lies on the circle of radius
R_i about X_i, in the direction ``θ_i = arg max_θ Σ_j s_j exp(−(θ − θ(q_i, q_j))²/(2σ_θ²)) exp(−|X_i − X_j|²/(2σ_X²))``
with θ(q_i, q_j) the direction, seen from X_i, in which circles i and j intersect, and s_j the amplitude of peak j. No
peaks need to be connected from view to view.

Source: S. Kidera, T. Sakamoto, T. Sato, "Accurate UWB Radar Three-Dimensional Imaging Algorithm for a Complex Boundary
Without Range Point Connections", IEEE Transactions on Geoscience and Remote Sensing 48(4), 1993 ff., 2010; the formula
as descriptions of the method give it, not checked against the paper's own text. What is ours:

* It is the two-dimensional form, in the one layer of the grid. A view above or below it sees the layer in a circle of
  radius √(R² − h²), h the difference in height.
* Antennas stand around the target, not in a plane on one side of it. Both intersections of two circles count, as far as
  they lie on the grid and in the beams of both views.
* Points of one view do not count for each other, and those farther than 3 σ_X away are left out.
* The original's result is a set of points. Here each becomes a bell on the voxels, as high as its maximum over θ, so
  that the result can be thresholded.

Directions agree only as far as views are close: circles of neighbours Δ apart cross about Δ/(2R) from the point of a
flat wall that they touch. σ_θ and σ_X were chosen on circle, square and triangle with a view every 5°.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import gaussian_filter1d

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.method import Method
from mvla_sim.imaging.observation import Estimate, Observation

__all__ = ["ContourPoints", "RangePointsMigration", "contour_points"]

_REACH_SIGMAS = 3.0
"""Neighbours farther away, in σ_X, weigh under 0.011 of the nearest and are left out."""
_BINS_PER_SIGMA = 8
_STEPS = 12
"""Steps from the best bin to the maximum itself; each shrinks the distance several times."""
_PULL_SIGMAS = 5.0
"""Directions farther from the maximum, in σ_θ, weigh under 4·10⁻⁶ of those in it and do not move it."""
_BELL_SIGMAS = 4.0
_AT_ONCE = 1 << 18  # pairs of points, or values of bells: bounds the memory

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ContourPoints:
    """Contour points of a target.

    Attributes
    ----------
    position_m
        ``[n, 2]`` float64, metres.
    agreement
        The maximum over θ that is the point's direction, ``[n]`` float64, amplitude: how well neighbours agree.
    """

    position_m: Floats
    agreement: Floats


@dataclass(frozen=True, eq=False)
class _RangePoints:
    """Range points, view after view: circles in the layer; one entry a point, of ``center`` a row."""

    center: Floats
    radius: Floats
    amplitude: Floats
    view: Indices


@dataclass(frozen=True, eq=False)
class _Crossings:
    """Where circles of neighbours cross those of one view: index of its range point, direction, weight; ``[n]``."""

    row: Indices
    theta: Floats
    weight: Floats


class RangePointsMigration(Method):
    """``s_n = Σ_i a_i exp(−|p_n − x_i|²/(2σ²))``: x_i contour points, a_i their maxima, σ = ``rpm.kernel``·ΔR."""

    name: ClassVar[str] = "rpm"
    title: ClassVar[str] = "Range Points Migration"

    sigma_theta_deg: Annotated[float, Field(ge=0.01, le=30, description="σ_θ: how well directions must agree")] = 1.0
    sigma_x_m: Annotated[float, Field(gt=0, le=1e4, description="σ_X: how far away neighbouring views count")] = 4.0
    kernel: Annotated[float, Field(gt=0, le=100, description="width σ of a contour point on the grid, in ΔR")] = 1.0

    def image(self, seen: Observation) -> Estimate:
        """Find the contour points and put them on the grid, ``[1, ny, nx]``.

        Raises
        ------
        ConfigError
            The grid has several layers, or receivers stand apart from transmitters.
        DataError
            No two circles intersect on the grid.
        """
        found = contour_points(seen, self.sigma_x_m, np.deg2rad(self.sigma_theta_deg))
        sigma = self.kernel * seen.resolution_m
        weight = found.agreement / found.agreement.max()
        return Estimate(_bells(seen.grid, found.position_m, weight, sigma))


def contour_points(seen: Observation, sigma_x: float, sigma_theta: float) -> ContourPoints:
    """Contour point of every range point that any neighbour's circle meets on the grid, views in order of position.

    σ_X is in metres, σ_θ in radians.

    Raises
    ------
    ConfigError
        The grid has several layers, or receivers stand apart from transmitters.
    DataError
        No two circles intersect on the grid.
    """
    layers = seen.grid.counts[2]
    if layers > 1:
        raise ConfigError(f"method = 'rpm': the grid has {layers} layers; rpm works in one, set grid.size_m[2] = 0")
    if seen.views.receivers_m is not None:
        raise ConfigError("method = 'rpm': receivers stand apart from transmitters; rpm takes circles, not ellipses")
    points = _range_points(seen)
    starts = np.flatnonzero(np.diff(points.view, prepend=-1))
    stops = np.append(starts[1:], points.view.size)
    positions = seen.views.positions_m[points.view[starts]]
    parts = []
    for own, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        distance = np.linalg.norm(positions - positions[own], axis=1)
        near = (distance <= _REACH_SIGMAS * sigma_x) & (np.arange(starts.size) != own)
        per_point = np.repeat(np.where(near, np.exp(distance**2 / (-2 * sigma_x**2)), 0.0), stops - starts)
        others = np.flatnonzero(per_point)
        weight = points.amplitude[others] * per_point[others]
        block = max(1, _AT_ONCE // max(1, others.size))
        for first in range(start, stop, block):
            rows = np.arange(first, min(first + block, stop))
            parts.append(_migrated(points, rows, _crossings(seen, points, rows, others, weight), sigma_theta))
    if not sum(part.agreement.size for part in parts):
        raise DataError(
            f"rpm.sigma_x_m = {sigma_x:g}: no circles of views within {_REACH_SIGMAS:g} times as many metres of each "
            "other intersect on the grid; raise it, or use more views"
        )
    position = np.concatenate([part.position_m for part in parts])
    return ContourPoints(position, np.concatenate([part.agreement for part in parts]))


def _range_points(seen: Observation) -> _RangePoints:
    """Peaks as circles in the grid's layer, views in the order of their positions; spheres that miss it are none."""
    place = seen.views.positions_m
    rank = np.empty(len(place), np.intp)
    rank[np.lexsort(place.T)] = np.arange(len(place))
    peaks = seen.peaks
    height = place[peaks.view, 2] - seen.grid.center_m[2]
    square = peaks.range_m**2 - height**2
    order = np.lexsort((peaks.range_m, rank[peaks.view]))
    order = order[square[order] > 0]
    view = peaks.view[order]
    return _RangePoints(place[view, :2], np.sqrt(square[order]), np.sqrt(peaks.power[order]), view)


def _crossings(seen: Observation, points: _RangePoints, rows: Indices, others: Indices, weight: Floats) -> _Crossings:
    """Both intersections of the circles ``rows`` of one view with ``others``, where they lie on the grid and in beams.

    ``weight`` is that of each of the others, ``[n_other]``.
    """
    center, radius = points.center[rows[0]], points.radius[rows]
    offset = points.center[others] - center
    apart = np.hypot(offset[:, 0], offset[:, 1])
    apart[apart == 0] = np.inf  # of views above each other: circles about one centre never cross
    with np.errstate(invalid="ignore"):
        cosine = (radius[:, None] ** 2 - points.radius[others] ** 2 + apart**2) / (2 * radius[:, None] * apart)
    row, column = np.nonzero(np.abs(cosine) <= 1)
    half = np.arccos(cosine[row, column])
    middle = np.arctan2(offset[:, 1], offset[:, 0])[column]
    row, column = np.concatenate([row, row]), np.concatenate([column, column])
    theta = np.concatenate([middle + half, middle - half])
    lower, upper = seen.grid.bounds_m()
    x, y = center[0] + radius[row] * np.cos(theta), center[1] + radius[row] * np.sin(theta)
    meets = (x >= lower[0]) & (x <= upper[0]) & (y >= lower[1]) & (y <= upper[1])
    if seen.beam is not None:
        where = np.stack([x, y, np.full(x.size, seen.grid.center_m[2])], axis=1)
        for view in (np.full(x.size, points.view[rows[0]]), points.view[others[column]]):
            meets &= seen.beam.covers(where - seen.views.positions_m[view], seen.views.directions[view])
    return _Crossings(row[meets], theta[meets], weight[column[meets]])


def _migrated(points: _RangePoints, rows: Indices, found: _Crossings, sigma: float) -> ContourPoints:
    """Contour points of range points of one view, of those that any circle crosses; ``sigma`` is σ_θ, radians."""
    crossed = np.bincount(found.row, minlength=rows.size) > 0
    if not crossed.any():
        return ContourPoints(np.zeros((0, 2)), np.zeros(0))
    row = (np.cumsum(crossed) - 1)[found.row]
    theta, agreement = _best_direction(row, found.theta, found.weight, sigma)
    kept = rows[crossed]
    towards = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    return ContourPoints(points.center[kept] + points.radius[kept, None] * towards, agreement)


def _best_direction(row: Indices, theta: Floats, weight: Floats, sigma: float) -> tuple[Floats, Floats]:
    """Arg max and max over θ of Σ_j w_j exp(−(θ − θ_j)²/(2σ²)): on bins first, then exactly.

    ``row`` says which sum a direction belongs to, 0 … n_row − 1, none empty; the results are ``[n_row]``.
    """
    rows = int(row.max()) + 1
    origin = theta[0]  # so that angles of less than half a turn do not jump between π and −π
    theta = np.mod(theta - origin + np.pi, 2 * np.pi) - np.pi
    width = float(np.ptp(theta)) + 2 * _PULL_SIGMAS * sigma
    around = width >= 2 * np.pi  # bins close to a circle; otherwise their ends are empty
    width = min(width, 2 * np.pi)
    low = theta.min() - _PULL_SIGMAS * sigma
    bins = int(np.ceil(width * _BINS_PER_SIGMA / sigma))
    cell = width / bins
    place = ((theta - low) / cell).astype(np.intp) % bins + bins * row
    counts = np.bincount(place, weight, bins * rows).reshape(rows, bins)
    best = low + cell * (gaussian_filter1d(counts, sigma / cell, axis=1, mode="wrap").argmax(axis=1) + 0.5)
    distance = theta - best[row]
    if around:
        distance = np.mod(distance + np.pi, 2 * np.pi) - np.pi
    near = np.abs(distance) < (_PULL_SIGMAS + 1) * sigma
    row, weight, theta = row[near], weight[near], (best[row] + distance)[near]
    agreement = np.zeros(rows)
    for _ in range(_STEPS):
        distance = theta - best[row]
        pull = weight * np.exp(distance**2 / (-2 * sigma**2))
        agreement = np.bincount(row, pull, rows).astype(np.float64)
        best = best + np.bincount(row, pull * distance, rows) / np.maximum(agreement, np.finfo(np.float64).tiny)
    return np.asarray(best + origin, np.float64), agreement


def _bells(grid: VoxelGrid, position_m: Floats, weight: Floats, sigma_m: float) -> NDArray[np.float32]:
    """Σ_i w_i exp(−|p_n − x_i|²/(2σ²)) of every voxel of a grid of one layer, ``[1, ny, nx]``."""
    nx, ny, _ = grid.counts
    half = int(np.ceil(_BELL_SIGMAS * sigma_m / grid.spacing_m))
    around = np.arange(-half, half + 1)
    width = (nx + 2 * half, ny + 2 * half)  # a margin, so that bells may reach over the border
    total = np.zeros(width[0] * width[1])
    block = max(1, _AT_ONCE // around.size**2)
    for start in range(0, len(position_m), block):
        cell = (position_m[start : start + block] - np.asarray(grid.origin_m[:2])) / grid.spacing_m
        middle = np.clip(np.rint(cell), 0, (nx - 1, ny - 1)).astype(np.intp)
        distance = (middle[:, :, None] + around - cell[:, :, None]) * grid.spacing_m
        bell = np.exp(distance**2 / (-2 * sigma_m**2))
        values = (weight[start : start + block, None] * bell[:, 1])[:, :, None] * bell[:, 0][:, None, :]
        row, column = middle[:, 1, None] + half + around, middle[:, 0, None] + half + around
        place = row[:, :, None] * width[0] + column[:, None, :]
        total += np.bincount(place.ravel(), values.ravel(), total.size)
    inner = total.reshape(width[1], width[0])[half : half + ny, half : half + nx]
    return np.ascontiguousarray(inner[None], np.float32)
