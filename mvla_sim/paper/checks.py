"""Measurements that no table of cases holds: how cost grows (claim C15), what a random phase changes (C16)."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from mvla_sim.channel.cir import Cir
from mvla_sim.evaluation.evaluate import evaluate
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.likelihood import likelihood_profiles
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.imaging.projection import project
from mvla_sim.scene.views import Views
from mvla_sim.streams import Stream, stream

__all__ = ["measure_cost", "measure_phase"]

_REPEATS = 5


def measure_cost() -> dict[str, Any]:
    """Time score and Θ while voxels, views or peaks a view grow fourfold.

    Returns
    -------
    dict
        ``base_s`` and, relative to it, ``voxels_x4``, ``views_x4`` and ``peaks_x4``: medians of repeated runs.
    """
    seconds = {
        "base": _projection_seconds(500, 90, 10),
        "voxels_x4": _projection_seconds(1000, 90, 10),
        "views_x4": _projection_seconds(500, 360, 10),
        "peaks_x4": _projection_seconds(500, 90, 40),
    }
    base = seconds.pop("base")
    return {"base_s": base, **{name: value / base for name, value in seconds.items()}}


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


def _projection_seconds(side: int, n_view: int, n_peak: int) -> float:
    """Median time to project ``n_view`` views with ``n_peak`` peaks each onto side² voxels, seconds."""
    angles = np.arange(n_view) * 360 / n_view
    positions = 10 * np.stack([np.cos(np.deg2rad(angles)), np.sin(np.deg2rad(angles)), np.zeros(n_view)], axis=1)
    views = Views(positions, angles, (0.0, 0.0))
    grid = VoxelGrid((0.0, 0.0, 0.0), (side, side, 1), 10 / side)
    span = grid.range_span_m(positions)
    random = stream(0, Stream.PHASE, n_view, n_peak)
    ranges = np.sort(random.uniform(*span, (n_view, n_peak)), axis=1).ravel()
    peaks = Peaks(ranges, np.ones(ranges.size), np.full(n_view, n_peak))
    profiles = likelihood_profiles(peaks, 0.025, 0.32, span)
    project(grid, views, profiles)
    seconds = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        project(grid, views, profiles)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))
