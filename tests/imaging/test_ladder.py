"""The ablation ladder, relatives of backprojection, and MVLA-EM: what each changes, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import ring, scatterers

from mvla_sim.engine.backend import set_threads
from mvla_sim.engine.machine import core_count
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.method import METHODS, phase_free_methods
from mvla_sim.imaging.methods.mvla_em import echoes
from mvla_sim.imaging.pdp import compute_pdp, gate_for
from mvla_sim.imaging.pipeline import reconstruct

POINTS = [[1.0, 0.5, 0.0], [-0.8, -0.4, 0.0], [0.3, -1.2, 0.0]]
SCALE_FREE = ("hard-vote", "soft-kernel", "power-weights", "mvla-gr", "mvla-hard", "bp-normalised", "mvla-em")
"""Methods to which the power of a view as a whole says nothing."""


def options(**values):
    return imaging_settings(**({"grid.size_m": [4.0, 4.0, 0.0], "grid.spacing_m": 0.05, "snr_db": None} | values))


def image(method, cir=None, **values):
    return reconstruct(scatterers(POINTS, ring(36)) if cir is None else cir, options(method=method, **values))


@pytest.mark.parametrize("method", METHODS.names())
def test_every_method_finds_points(method):
    found = image(method)
    points = found.grid.centers()
    best = points[found.score.ravel().argmax()]
    assert min(np.linalg.norm(best - point) for point in POINTS) < 0.08
    assert np.isfinite(found.score).all()
    assert found.score.dtype == np.float32


@pytest.mark.parametrize("method", phase_free_methods())
def test_phases_change_no_phase_free_method(method):
    """Claim C16, of every method; a turned gain is rounded to complex64 again."""
    cir = scatterers(POINTS, ring(24))
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, 24)
    one, other = (image(method, c, snr_db=20).score for c in (cir, cir.with_phases(phase)))
    assert np.abs(one - other).max() <= 2e-3 * np.abs(one).max()


@pytest.mark.parametrize(("rung", "gated"), [("hard-vote", "mvla-hard"), ("power-weights", "mvla-gr")])
def test_a_rung_is_its_gated_method_without_angular_support(rung, gated):
    one, other = image(rung), image(gated)
    assert np.array_equal(one.score, other.score)
    assert one.support_deg is None
    assert other.support_deg is not None


def test_soft_kernels_weigh_peaks_alike_and_power_weights_do_not():
    """With one point every view has one peak, and the two are the same; with a weak and a strong one they differ."""
    alone = scatterers(POINTS[:1], ring(24))
    assert np.allclose(image("soft-kernel", alone).score, image("power-weights", alone).score, atol=1e-6)
    both = scatterers(POINTS[:2], ring(24))
    weak = np.tile([1.0, 0.2], 24).astype(np.complex64)
    both = replace(both, gain=both.gain * weak)

    def level(method):
        found = image(method, both)
        near = np.linalg.norm(found.grid.centers() - POINTS[1], axis=1).argmin()
        return found.score.ravel()[near] / found.score.max()

    assert level("power-weights") < 0.3
    assert level("soft-kernel") > 0.6


@pytest.mark.parametrize("method", sorted({*SCALE_FREE, "bp", "bp-peaks", "bp-gated", "bp-filtered"}))
def test_only_normalised_methods_forget_the_power_of_a_view(method):
    cir = scatterers(POINTS, ring(24))
    factors = np.repeat(np.random.default_rng(1).uniform(0.1, 10, 24), cir.row_size).astype(np.float32)
    one, other = image(method, cir).score, image(method, replace(cir, gain=cir.gain * factors)).score
    same = np.allclose(one, other, atol=2e-3 * np.abs(one).max())
    assert same == (method in SCALE_FREE)


def test_a_peak_gate_keeps_what_is_near_a_peak_and_nothing_else():
    cir = scatterers(POINTS, ring(3))
    full, gated, voted = image("bp", cir), image("bp-peaks", cir), image("mvla-gr", cir)
    silent = voted.score == 0  # no peak within R_T in any view
    assert silent.any()
    assert np.abs(gated.score[silent]).max() < 1e-3 * gated.score.max()
    near = np.linalg.norm(full.grid.centers() - POINTS[0], axis=1).argmin()
    assert gated.score.ravel()[near] == pytest.approx(full.score.ravel()[near], rel=0.1)


def test_the_angular_gate_adds_support_to_backprojection_and_nothing_more():
    gated = image("bp-gated")
    assert np.array_equal(gated.score, image("bp").score)
    assert np.array_equal(gated.support_deg, image("mvla-gr").support_deg)


def test_the_coherence_factor_is_the_formula():
    """Against the sums over views of P and P² at each voxel's range, interpolated on their own."""
    cir = scatterers(POINTS, ring(12))
    settings = options(method="bp-coherence")
    grid = VoxelGrid.from_settings(settings.grid)
    pdp = compute_pdp(cir, settings.pdp, gate_for(grid, cir.views, settings.pdp))
    power = pdp.power / pdp.power.max()
    total, squares = np.zeros(grid.size), np.zeros(grid.size)
    for view in range(12):
        ranges = np.linalg.norm(grid.centers() - cir.views.positions_m[view], axis=1)
        total += np.interp(ranges, pdp.range_m, power[view])
        squares += np.interp(ranges, pdp.range_m, power[view] ** 2)
    expected = total**2 / (12 * squares) * total
    found = reconstruct(cir, settings).score.ravel()
    assert np.abs(found - expected).max() < 1e-3 * expected.max()


def test_filtering_sharpens_a_point():
    def width(method):
        found = image(method, scatterers(POINTS[:1], ring(72)))
        return (found.score > 0.1 * found.score.max()).sum()

    assert image("bp-filtered").score.min() == 0
    assert width("bp-filtered") < width("bp")


def test_echoes_are_shares_of_a_view_and_noise_is_none():
    cir = scatterers(POINTS, ring(12))
    settings = options()
    pdp = compute_pdp(cir, settings.pdp, gate_for(VoxelGrid.from_settings(settings.grid), cir.views, settings.pdp))
    found = echoes(pdp, 4.0)
    assert np.allclose(found.sum(axis=1), 1)
    noise = replace(pdp, power=np.random.default_rng(0).normal(size=pdp.power.shape))
    assert (echoes(noise, 6.0) == 0).all()


def test_em_explains_each_echo_once():
    """Arcs that cross nowhere else lose their weight to the points that explain them."""

    def share(method):
        found = image(method, snr_db=20)
        points = found.grid.centers()
        near = np.min([np.linalg.norm(points - point, axis=1) for point in POINTS], axis=0) < 0.12
        score = np.maximum(found.score.ravel(), 0)
        return score[near].sum() / score.sum()

    assert share("mvla-em") > 3 * share("mvla-gr")
    assert np.array_equal(image("mvla-em").support_deg, image("mvla-gr").support_deg)
    assert image("mvla-em").score.min() >= 0


def test_more_em_steps_sharpen_further():
    cir = scatterers(POINTS, ring(24))

    def spread(steps):
        found = image("mvla-em", cir, **{"em.iterations": steps}).score.ravel()
        return (found.sum() ** 2) / (found**2).sum()

    assert spread(16) < spread(4) < spread(1)


def test_the_number_of_threads_changes_no_bit():
    """Voxels that EM drives to nothing end as nothing, whether or not a thread keeps subnormal numbers."""
    scores = []
    for threads in (1, 2, 1):
        set_threads(threads)
        scores.append(image("mvla-em", scatterers(POINTS, ring(12)), **{"em.iterations": 40}).score)
    set_threads(core_count())
    assert (scores[0] == 0).any()
    assert np.array_equal(scores[0], scores[1])
    assert np.array_equal(scores[0], scores[2])


def test_methods_say_what_they_need():
    assert not METHODS.find("bp").uses_peaks
    assert METHODS.find("bp-gated").uses_peaks
    assert "bp-coherent" not in phase_free_methods()
