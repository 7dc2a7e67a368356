"""The oracle's threshold search: the exact optimum over every p and every T_θ (``eq:joint_thresholding_new``).

Definitions
-----------
The voxels are put in one order: score descending, equal scores by voxel index ascending. The top-p% set is the
first n voxels of that order, for any n = 1…N; of those, the voxels with Θ ≥ T_θ are retained. So for each T_θ the
candidates are all prefixes of the filtered order, and only the distinct values of Θ matter as T_θ. A scan with bounds
or steps (:class:`~mvla_sim.evaluation.scan.ScanSettings`) leaves some n and T_θ out; what follows holds for it too.

How it is exact and cheap
-------------------------
All distances are between voxel centres of one grid, so squared distances are whole numbers of spacing². They are kept
as such, in float64, where whole numbers below 2⁵³ are exact. With A the sum of squared distances truth →
reconstruction and B that of reconstruction → truth, CD = (A·k + B·U)/(U·k) for U truth voxels and k retained ones.

* B of every prefix is a running sum of the truth's distance transform.
* A of every prefix comes from one stencil: the neighbours of a truth voxel by distance. The running minimum of their
  ranks says from which prefix length on the nearest retained voxel is that near. A truth voxel with nothing in its
  stencil is at least ``cap`` away; so A is exact once every stencil is filled, and a lower bound before.
* A only grows with T_θ and shrinks with n; B and k only grow with n. This bounds CD from below for whole blocks of n at
  every T_θ at once. The search opens the most promising T_θ first, fills in exact distances where a bound still beats
  the best value, and ends when no bound does.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from mvla_sim.errors import DataError
from mvla_sim.evaluation.ground_truth import TruthGeometry, whole_coordinates
from mvla_sim.evaluation.metrics import chamfer_of_sums, decibel
from mvla_sim.evaluation.scan import ScanSettings
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.thresholds import rank_order

__all__ = ["Optimum", "TruthGeometry", "chamfer_for_prefixes", "optimal_thresholds"]

Floats = NDArray[np.float64]
Integers = NDArray[np.intp]

BRUTE_FORCE_ENTRIES = 200_000  # distances computed in one piece; above it an interval of n is halved
BLOCK_GROWTH = 1.02  # blocks of n grow by this factor, so that their bounds are about as tight everywhere
LEVELS_AT_ONCE = 512  # keeps memory flat where nearly every voxel has a Θ of its own


@dataclass(frozen=True)
class Optimum:
    """The best thresholds of one image against one ground truth.

    Attributes
    ----------
    cd_db
        The smallest Chamfer distance over every p and T_θ, dB(m²); −inf where the truth is met exactly.
    top_percent
        p = 100·n_top/N of the smallest top-p% set that gives it, per cent of all voxels; a multiple of the scan's step.
    min_support_deg
        T_θ, degrees: 0 or a value that occurs in Θ. Any T_θ down to the next lower value gives the same set. Or a
        multiple of the scan's step.
    n_top
        Number of voxels in the top-p% set; without a step its last voxel is retained.
    n_retained
        Number of voxels that also pass Θ ≥ T_θ.
    area_m2
        Retained area n_retained·spacing², m² (the footprint of the voxels; p depends on the grid, this does not).
    """

    cd_db: float
    top_percent: float
    min_support_deg: float
    n_top: int
    n_retained: int
    area_m2: float

    def __repr__(self) -> str:
        """One line: the distance and its thresholds."""
        pair = f"p = {self.top_percent:.4g} %, T_θ = {self.min_support_deg:.4g}°"
        return f"Optimum(CD {self.cd_db:.2f} dB(m²) at {pair})"


def optimal_thresholds(
    score: NDArray[Any], theta_deg: NDArray[Any] | None, geometry: TruthGeometry, scan: ScanSettings | None = None
) -> Optimum:
    """Return the exact optimum of the Chamfer distance over every p and every T_θ, or those of a scan.

    Equal Chamfer distances are resolved to the smallest T_θ, then to the smallest n.

    Parameters
    ----------
    score
        Image, ``[nz, ny, nx]`` or flattened; any unit, finite.
    theta_deg
        Angular support Θ_n, same shape, degrees, at least 0; None for no angular test (backprojection).
    geometry
        The ground truth, prepared.
    scan
        Bounds and steps of p and T_θ; by default all.

    Raises
    ------
    DataError
        A shape is not the grid's, or a value is not finite or, for Θ, negative.
    ConfigError
        The scan's bounds hold no voxel of the grid.
    """
    ranking = _Ranking.of(score, theta_deg, geometry, scan or ScanSettings())
    search = _Search(ranking)
    for first in range(0, ranking.values.size, LEVELS_AT_ONCE):
        search.run(first, min(first + LEVELS_AT_ONCE, ranking.values.size))
    value, level, n_top = search.best
    grid = geometry.grid
    percent = 100 * n_top / grid.size
    if ranking.steps is not None:  # the voxels after the last retained one change nothing
        step = int(np.searchsorted(ranking.steps[0], n_top))
        n_top, percent = int(ranking.steps[0][step]), float(ranking.steps[1][step])
    retained = int(np.count_nonzero(ranking.level[:n_top] >= level))
    return Optimum(
        cd_db=float(decibel(value * grid.spacing_m**2)),
        top_percent=percent,
        min_support_deg=float(ranking.values[level]) if level else 0.0,
        n_top=n_top,
        n_retained=retained,
        area_m2=retained * grid.spacing_m**2,
    )


def chamfer_for_prefixes(
    score: NDArray[Any], theta_deg: NDArray[Any] | None, geometry: TruthGeometry, min_support_deg: float = 0.0
) -> Floats:
    """Return the exact Chamfer distance for every n at one T_θ, ``[N]`` dB(m²).

    Entry n − 1 is the distance of the n best-scored voxels after the test Θ ≥ ``min_support_deg``; NaN where that
    retains none. Parameters and errors as in :func:`optimal_thresholds`.
    """
    ranking = _Ranking.of(score, theta_deg, geometry, ScanSettings())
    if not 0 <= min_support_deg < np.inf or (theta_deg is None and min_support_deg > 0):
        allowed = "0, for there is no angular support" if theta_deg is None else "a number, at least 0"
        raise DataError(f"min_support_deg = {min_support_deg:g}: must be {allowed}")
    level = int(np.searchsorted(ranking.values, ranking.values.dtype.type(min_support_deg)))
    row = _Row.open(ranking, level, geometry.grid.size)
    curve = np.full(geometry.grid.size, np.nan)
    if row.positions.size == 0:
        return curve
    truth = row.truth
    start = 0
    while start < row.unfilled:
        waiting = int(np.count_nonzero(row.filled_at > row.positions[start]))
        stop = min(row.unfilled, start + 1 + BRUTE_FORCE_ENTRIES // waiting)
        truth[start:stop] += row.excess(start, stop)
        start = stop
    values = decibel(row.chamfer(truth) * geometry.grid.spacing_m**2)
    counts = np.cumsum(np.bincount(row.positions, minlength=geometry.grid.size))
    curve[counts > 0] = values[counts[counts > 0] - 1]
    return curve


@dataclass(frozen=True, eq=False)
class _Ranking:
    """The n best voxels of one image, in the order of their scores, n being the most that the scan tries.

    ``values`` are the T_θ that differ, the smallest of each set: all distinct Θ where nothing is left out. ``level``
    says up to which of them a voxel passes.
    """

    geometry: TruthGeometry
    order: Integers  # [n] voxel of each rank
    level: Integers  # [n] index into values, by rank
    values: NDArray[Any]  # [L] degrees, ascending
    squared: Floats  # [n] squared distance to the truth, by rank
    steps: tuple[Integers, Floats] | None  # [C] prefix lengths that are tried, the last being n, and p; None for all

    @classmethod
    def of(
        cls, score: NDArray[Any], theta_deg: NDArray[Any] | None, geometry: TruthGeometry, scan: ScanSettings
    ) -> _Ranking:
        steps = scan.counts(geometry.grid)
        largest = scan.largest_count(geometry.grid) if steps is None else int(steps[0][-1])
        order = rank_order(_image(score, geometry.grid, "score"), largest)
        values: NDArray[Any] = np.zeros(1)
        if theta_deg is None:
            level = np.zeros(order.size, np.intp)
        else:
            theta = _image(theta_deg, geometry.grid, "theta_deg")
            if theta.min() < 0:
                raise DataError(f"theta_deg: smallest value {theta.min():g}; an angular support is at least 0")
            theta = theta if theta.dtype.kind == "f" else theta.astype(float)
            if scan.every_support and order.size == theta.size:
                values, inverse = np.unique(theta, return_inverse=True)
                level = inverse[order]
            else:
                supports = scan.supports(theta)
                passed = np.searchsorted(supports.astype(theta.dtype), theta[order], side="right") - 1
                used, level = np.unique(passed, return_inverse=True)
                values = supports[np.append(0, used[:-1] + 1)]
        return cls(geometry, order, level, values, geometry.squared[order], steps)

    @property
    def counts(self) -> Integers | None:
        """Prefix lengths that are tried, ascending; None for all."""
        return None if self.steps is None or self.steps[0].size == self.order.size else self.steps[0]


@dataclass(frozen=True, eq=False)
class _Row:
    """One T_θ: the voxels that pass it, in order, up to some n, and the bounds of their prefixes."""

    ranking: _Ranking
    level: int
    positions: Integers  # [k] ranks of the voxels that pass; the prefix that ends there has n = rank + 1
    back: Floats  # [k] B, spacing²
    truth: Floats  # [k] A, spacing²: a lower bound before entry ``unfilled``, exact from there on
    filled_at: NDArray[np.int32]  # [U] rank that first fills a truth voxel's stencil; the limit where none does
    unfilled: int
    barred: Floats | None  # [k] ∞ for prefixes that are not tried, else 0; None where all are

    @classmethod
    def open(cls, ranking: _Ranking, level: int, limit: int) -> _Row:
        """Look at all n ≤ ``limit``."""
        geometry = ranking.geometry
        positions = np.flatnonzero(ranking.level[:limit] >= level)
        rank = np.full(geometry.grid.size + 1, limit, np.int32)
        rank[ranking.order[positions]] = positions
        near = rank.take(geometry.neighbours)
        first = np.empty((geometry.steps.size, geometry.voxels.size), np.int32)
        for shell, (start, stop) in enumerate(zip(geometry.shells[:-1], geometry.shells[1:], strict=True)):
            np.minimum.reduce(near[start:stop], axis=0, out=first[shell])
        np.minimum.accumulate(first, axis=0, out=first)
        gain = np.bincount(first.ravel(), np.repeat(geometry.steps, first.shape[1]), minlength=limit + 1)
        truth = np.asarray(geometry.voxels.size * geometry.cap - np.cumsum(gain)[positions], np.float64)
        back = np.asarray(np.cumsum(ranking.squared[positions]), np.float64)
        filled_at = first[-1]
        unfilled = int(np.searchsorted(positions, filled_at.max()))
        barred = None
        if ranking.counts is not None:
            barred = np.full(positions.size, np.inf)
            ends = np.searchsorted(positions, ranking.counts[ranking.counts <= limit])
            barred[ends[ends > 0] - 1] = 0.0
        return cls(ranking, level, positions, back, truth, filled_at, unfilled, barred)

    def chamfer(self, truth: Floats, start: int = 0) -> Floats:
        """CD in spacing² of the prefixes from entry ``start`` on, for values or bounds of A; ∞ where not tried."""
        kept = np.arange(start + 1, start + 1 + truth.size, dtype=float)
        part = slice(start, start + truth.size)
        chamfer = chamfer_of_sums(truth, self.back[part], self.ranking.geometry.voxels.size, kept)
        return np.asarray(chamfer if self.barred is None else chamfer + self.barred[part], np.float64)

    def excess(self, start: int, stop: int) -> Floats:
        """Exact A minus the bound ``truth`` for the entries from ``start`` up to ``stop``, ``[stop - start]``."""
        ranking, geometry = self.ranking, self.ranking.geometry
        targets = geometry.points[self.filled_at > self.positions[start]]
        if len(targets) == 0:
            return np.zeros(stop - start)
        voxels = whole_coordinates(ranking.order[self.positions[:stop]], geometry.grid)
        nearest = _nearest(voxels[: start + 1], targets)
        if stop > start + 1:
            table = np.empty((stop - start, len(targets)))
            table[0] = nearest
            table[1:] = cdist(voxels[start + 1 :], targets, "sqeuclidean")
            np.minimum.accumulate(table, axis=0, out=table)
        else:
            table = nearest[None]
        return np.asarray(np.maximum(table - geometry.cap, 0, out=table).sum(axis=1), np.float64)


class _Table:
    """Lower bounds of CD for blocks of n at several T_θ, all at once.

    Block e holds the n with ``edges[e] < n <= edges[e + 1]``. Within it A is at least its value at the block's end,
    B at least its value before the block, and k at most its value at the end. Where a scan's step leaves the end as the
    only n of the block that is tried, B too is that at the end.
    """

    def __init__(self, ranking: _Ranking, edges: Integers, first: int, stop: int, floor: Floats) -> None:
        self.first = first
        self.edges = edges
        self.truth_size = ranking.geometry.voxels.size
        blocks = edges.size - 1
        cell = np.minimum(ranking.level, stop) - first
        cell *= blocks
        cell += np.repeat(np.arange(blocks), np.diff(edges))
        squared = ranking.squared
        if first:
            squared, cell = squared[cell >= 0], cell[cell >= 0]
        shape = (stop - first + 1, blocks)
        length = shape[0] * blocks
        added = np.bincount(cell, minlength=length).reshape(shape)[::-1].cumsum(axis=0)[::-1][:-1]
        back = np.bincount(cell, squared, minlength=length).reshape(shape)[::-1].cumsum(axis=0)[::-1][:-1]
        self.kept = added.cumsum(axis=1).astype(float)
        self.kept[added == 0] = np.nan  # nothing is retained in the block, so no prefix ends there
        self.back = back.cumsum(axis=1)
        if ranking.counts is not None:
            back[:, np.diff(np.searchsorted(ranking.counts, edges, side="right")) == 1] = 0
        self.back -= back
        self.floor = np.tile(floor, (stop - first, 1))
        self.bound = np.empty(self.floor.shape)
        self.lowest = np.empty(stop - first)
        self.closed = np.zeros(stop - first, bool)
        self.raise_floor(first, floor)

    def raise_floor(self, level: int, truth: Floats) -> None:
        """At ``level`` and all above it, A at the blocks' ends is at least ``truth``, ``[E]`` spacing²."""
        rows = slice(level - self.first, None)
        np.maximum(self.floor[rows], truth, out=self.floor[rows])
        bound = chamfer_of_sums(self.floor[rows], self.back[rows], self.truth_size, self.kept[rows])
        self.bound[rows] = np.where(np.isnan(bound), np.inf, bound)
        self.lowest[rows] = np.where(self.closed[rows], np.inf, self.bound[rows].min(axis=1))


class _Search:
    """Best-first search; ``best`` is (CD in spacing², level, n), compared in this order."""

    def __init__(self, ranking: _Ranking) -> None:
        self.ranking = ranking
        self.best: tuple[float, int, int] = (np.inf, ranking.values.size, 0)
        self.queue: list[tuple[float, int, int, int, int, float, _Row]] = []
        size = ranking.order.size
        growth = np.geomspace(1, size, 2 + int(np.log(size) / np.log(BLOCK_GROWTH)))
        self.edges = np.unique(np.append(0, np.ceil(growth - 0.5))).astype(np.intp)
        if (counts := ranking.counts) is not None:
            if counts.size > self.edges.size:
                counts = np.unique(counts[np.searchsorted(counts, self.edges[1:])])
            self.edges = np.append(0, counts)
        self.floor = np.zeros(self.edges.size - 1)

    def run(self, first: int, stop: int) -> None:
        """Search the levels from ``first`` up to ``stop``; all below ``first`` are done."""
        table = _Table(self.ranking, self.edges, first, stop, self.floor)
        if first == 0:
            self.open(table, 0)
        while True:
            row = int(np.argmin(table.lowest))
            promise = (float(table.lowest[row]), row + first)
            if self.queue and self.queue[0][:2] <= promise:
                if self.queue[0][:3] >= self.best:
                    break
                self.refine(table)
            elif promise < self.best[:2]:
                self.open(table, row + first)
            else:
                break
        self.queue.clear()
        self.floor = table.floor[-1]

    def open(self, table: _Table, level: int) -> None:
        """Compute one T_θ as far as its stencils reach; queue the prefixes that are not exact and may be better."""
        bound = table.bound[level - table.first]
        limit = int(self.edges[np.flatnonzero(bound <= self.best[0])[-1] + 1])
        row = _Row.open(self.ranking, level, limit)
        table.closed[level - table.first] = True
        self._offer(row, row.truth[row.unfilled :], row.unfilled)
        blocks = np.searchsorted(self.edges, row.positions[: row.unfilled], side="right") - 1
        floor = np.maximum(row.truth[: row.unfilled], table.floor[level - table.first, blocks])
        self._push(row, row.chamfer(floor), 0, 0.0)
        self._raise_floor(table, row, 0.0, limit)

    def refine(self, table: _Table) -> None:
        """Take the most promising interval of prefixes: settle it, or bound it by its last prefix and halve it."""
        _, _, _, start, last, excess, row = heapq.heappop(self.queue)
        hopeful = np.flatnonzero(row.chamfer(row.truth[start : last + 1] + excess, start) <= self.best[0])
        if hopeful.size == 0:
            return
        start, last = start + int(hopeful[0]), start + int(hopeful[-1])
        waiting = np.count_nonzero(row.filled_at > row.positions[start])
        if start == last or waiting * (last + 1 - start) <= BRUTE_FORCE_ENTRIES:
            self._offer(row, row.truth[start : last + 1] + row.excess(start, last + 1), start)
            return
        excess = float(row.excess(last, last + 1)[0])
        self._offer(row, row.truth[last : last + 1] + excess, last)
        self._raise_floor(table, row, excess, int(row.positions[last]) + 1)
        middle = (start + last) // 2
        for begin, end in ((start, middle), (middle, last)):
            self._push(row, row.chamfer(row.truth[begin:end] + excess, begin), begin, excess)

    def _offer(self, row: _Row, truth: Floats, start: int) -> None:
        """Keep the best of the prefixes from entry ``start`` on, whose A is given exactly."""
        if truth.size:
            values = row.chamfer(truth, start)
            entry = int(np.argmin(values))
            if values[entry] < np.inf:
                self.best = min(self.best, (float(values[entry]), row.level, int(row.positions[start + entry]) + 1))

    def _push(self, row: _Row, bounds: Floats, start: int, excess: float) -> None:
        """Queue the entries from ``start`` on whose bounds may beat the best value."""
        hopeful = np.flatnonzero((bounds <= self.best[0]) & (bounds < np.inf))
        if hopeful.size:
            begin, last = start + int(hopeful[0]), start + int(hopeful[-1])
            key = (float(bounds.min()), row.level, int(row.positions[begin]) + 1)
            heapq.heappush(self.queue, (*key, begin, last, excess, row))

    def _raise_floor(self, table: _Table, row: _Row, excess: float, limit: int) -> None:
        """What one T_θ shows of A up to n = ``limit`` holds for every higher T_θ as well."""
        kept = np.searchsorted(row.positions, self.edges[1:])
        known = (kept > 0) & (self.edges[1:] <= limit)
        truth = np.where(known, row.truth[kept - 1] + excess, 0.0)
        table.raise_floor(row.level, truth)


def _image(image: NDArray[Any], grid: VoxelGrid, name: str) -> NDArray[Any]:
    values = np.asarray(image)
    if values.shape not in (grid.shape, (grid.size,)):
        raise DataError(f"{name}: shape {values.shape} is not the grid's {grid.shape}")
    if not np.isfinite(values).all():
        raise DataError(f"{name}: {np.count_nonzero(~np.isfinite(values))} of {grid.size} values are not finite")
    return values.ravel()


def _nearest(voxels: Floats, targets: Floats) -> Floats:
    """Squared distance of each target to the nearest voxel, exact for whole-number coordinates."""
    if len(voxels) * len(targets) <= BRUTE_FORCE_ENTRIES:
        return np.asarray(cdist(voxels, targets, "sqeuclidean").min(axis=0), np.float64)
    tree = cKDTree(voxels, balanced_tree=False, compact_nodes=False)
    return np.asarray(np.rint(tree.query(targets)[0] ** 2), np.float64)
