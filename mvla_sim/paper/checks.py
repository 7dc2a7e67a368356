"""Measurements that no table of cases holds: how work grows (claim C15), what a random phase changes (C16)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mvla_sim.channel.cir import Cir
from mvla_sim.evaluation.evaluate import evaluate
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.likelihood import kernel_samples, likelihood_profiles
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.imaging.projection import project
from mvla_sim.scene.views import Views
from mvla_sim.streams import Stream, stream

__all__ = ["count_work", "measure_phase"]

_SIGMA_M, _RADIUS_M = 0.025, 0.32  # at κ = 0.5, η = 0.04, ΔR = 0.05 m, D = 8 m


def count_work() -> dict[str, float]:
    """Count the updates that score and Θ take while voxels, views or peaks a view grow fourfold.

    An update is one view's profile read at one voxel, or one sample of a peak's kernel put into a profile. The reads
    are counted by the projector itself: it sums profiles that are 1 everywhere.

    Returns
    -------
    dict
        ``base_updates``, of 500 × 500 voxels, 90 views and 10 peaks a view, and the work relative to it:
        ``voxels_x4``, ``views_x4`` and ``peaks_x4``.
    """
    base = _updates(500, 90, 10)
    grown = {"voxels_x4": _updates(1000, 90, 10), "views_x4": _updates(500, 360, 10), "peaks_x4": _updates(500, 90, 40)}
    return {"base_updates": base, **{name: updates / base for name, updates in grown.items()}}


def measure_phase(cir: Cir, seed: int = 0) -> dict[str, Any]:
    """Score a scene with and without a random phase a view.

    Returns
    -------
    dict
        ``cd_db`` and ``cd_random_phase_db`` by method, and ``largest_score_change`` relative to the largest score.
    """
    phases = 2 * np.pi * stream(seed, Stream.PHASE).random(cir.n_view)
    turned = cir.with_phases(phases)
    found: dict[str, Any] = {"cd_db": {}, "cd_random_phase_db": {}, "largest_score_change": {}}
    for method in ("mvla-gr", "bp"):
        settings = imaging_settings(method=method, snr_db=20, interval_deg=5)
        before, after = reconstruct(cir, settings), reconstruct(turned, settings)
        found["cd_db"][method] = evaluate(before).cd_db
        found["cd_random_phase_db"][method] = evaluate(after).cd_db
        change = np.abs(after.score - before.score).max() / np.abs(before.score).max()
        found["largest_score_change"][method] = float(change)
    return found


def _updates(side: int, n_view: int, n_peak: int) -> int:
    """Updates to put ``n_view`` views with ``n_peak`` peaks each onto side² voxels."""
    angles = np.arange(n_view) * 360 / n_view
    positions = 10 * np.stack([np.cos(np.deg2rad(angles)), np.sin(np.deg2rad(angles)), np.zeros(n_view)], axis=1)
    grid = VoxelGrid((0.0, 0.0, 0.0), (side, side, 1), 10 / side)
    span = grid.range_span_m(positions)
    random = stream(0, Stream.PHASE, n_view, n_peak)
    ranges = np.sort(random.uniform(*span, (n_view, n_peak)), axis=1).ravel()
    peaks = Peaks(ranges, np.ones(ranges.size), np.full(n_view, n_peak))
    profiles = likelihood_profiles(peaks, _SIGMA_M, _RADIUS_M, span)
    ones = replace(profiles, values=np.ones_like(profiles.values), gated=False)
    reads = np.rint(project(grid, Views(positions, angles, (0.0, 0.0)), ones).total).sum(dtype=np.int64)
    return int(reads) + ranges.size * kernel_samples(_SIGMA_M, _RADIUS_M).size
