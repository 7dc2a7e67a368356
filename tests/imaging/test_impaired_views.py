"""Images of impaired channels: what they lose, what they do not, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from cases import PAPER_METHODS, channel, response, ring, scatterers

from mvla_sim.channel.components import Components
from mvla_sim.channel.impairments import impair_channel
from mvla_sim.errors import ConfigError, MvlaError
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.pipeline import profile_key, reconstruct, views_needed
from mvla_sim.imaging.view_selection import select_views as nominal_views

POINTS = [(0.5, 0.2, 0.0), (-0.6, -0.4, 0.0), (0.1, 0.7, 0.0)]
GRID = {"size_m": [2.0, 2.0, 0.0], "spacing_m": 0.05}


def settings(method="mvla-gr", snr_db=None, **impairments):
    return imaging_settings(
        method=method, snr_db=snr_db, grid=GRID, mvla={"extent_m": 2.0}, impairments=impairments or {}
    )


def image(cir, method="mvla-gr", **impairments):
    return reconstruct(cir, settings(method, **impairments))


def sharpness(found):
    """Mean score at the points, relative to that of the whole image."""
    x, y, _ = found.grid.axes()
    places = [(np.argmin(abs(y - p[1])), np.argmin(abs(x - p[0]))) for p in POINTS]
    return np.mean([found.score[0][place] for place in places]) / found.score.mean()


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_a_random_phase_changes_no_image_without_phase(method):
    cir = scatterers(POINTS, ring(36))
    before, after = image(cir, method), image(cir, method, random_phase=True)
    np.testing.assert_allclose(after.score, before.score, atol=2e-5 * before.score.max())


@pytest.mark.parametrize("method", ["mvla-gr", "bp"])
def test_a_position_error_of_10_cm_hurts_and_one_of_a_tenth_of_a_millimetre_does_not(method):
    cir = scatterers(POINTS, ring(72))
    clean, fine, coarse = (sharpness(image(cir, method, position_error_m=e)) for e in (0.0, 1e-4, 0.1))
    assert fine == pytest.approx(clean, rel=0.02)
    assert coarse < 0.6 * clean


def test_the_error_is_undone_by_nothing_but_the_true_positions():
    """Imaging sees the assumed positions alone: the same image comes of a file that says these."""
    cir = scatterers(POINTS, ring(24))
    chosen = settings(position_error_m=0.03)
    _, impairments, _, gate_m = profile_key(chosen, cir.views)
    wrong = impair_channel(cir, impairments, gate_m)
    assert np.array_equal(reconstruct(wrong, settings()).score, reconstruct(cir, chosen).score)


def test_a_timing_offset_is_a_shift_in_range():
    """All echoes 30 cm too far: what was a point is a ring of that radius about it."""
    cir = scatterers([(0.0, 0.0, 0.0)], ring(72))
    found = image(cir, "bp", timing_offset_s=2 * 0.3 / 299_792_458)
    x, y, _ = found.grid.axes()
    radius = np.hypot(*np.meshgrid(x, y))
    best = radius[found.score[0] >= np.quantile(found.score[0], 0.97)]
    assert best == pytest.approx(0.3, abs=0.08)


def test_strides_are_judged_on_the_nominal_views_before_any_are_lost():
    views = ring(36)
    chosen = imaging_settings(interval_deg=20, offset=1, impairments={"missing_share": 0.5, "position_error_m": 1.0})
    nominal = nominal_views(views, chosen.views)
    left = views_needed(views, chosen)
    assert nominal.tolist() == list(range(1, 36, 2))
    assert left.size == 9
    assert {*left.tolist()} < {*nominal.tolist()}
    assert reconstruct(scatterers(POINTS, views), chosen).n_view == 9


def test_a_blocked_sector_is_the_image_of_the_other_views():
    cir = scatterers(POINTS, ring(36))
    kept = np.flatnonzero((cir.views.angles_deg < 100) | (cir.views.angles_deg >= 200))
    blocked = image(cir, blocked_sector_deg=[100.0, 200.0])
    assert blocked.n_view == kept.size == 26
    alone = image(cir.select(kept))
    np.testing.assert_allclose(blocked.score, alone.score, atol=1e-5 * alone.score.max())
    np.testing.assert_allclose(blocked.support_deg, alone.support_deg, atol=1e-3)


def test_the_seed_is_the_noises_own_unless_it_is_given():
    views = ring(36)
    lost = [
        views_needed(views, imaging_settings(seed=noise, impairments={"missing_share": 0.5} | given)).tolist()
        for noise, given in ((1, {}), (2, {}), (1, {"seed": 1}), (2, {"seed": 1}))
    ]
    assert lost[0] != lost[1]
    assert lost[0] == lost[2] == lost[3]


@pytest.mark.parametrize("method", ["mvla-gr", "bp"])
def test_clutter_adds_peaks_where_there_is_nothing(method):
    cir = scatterers(POINTS, ring(36))
    assert sharpness(image(cir, method, clutter_paths=20.0, clutter_db=0.0)) < 0.9 * sharpness(image(cir, method))


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_views_at_one_place_without_peaks_or_alone_are_no_trouble(method):
    """Errors far above the spacing throw views over each other; two stand at one place from the start."""
    views = ring(36).select(np.r_[0, 0, 1:36])
    rows = [[] if view % 5 == 0 else [(10.0, 1.0)] for view in range(37)]
    found = image(channel(rows, views), method, position_error_m=3.0, timing_jitter_s=1e-9, missing_share=0.4)
    assert np.isfinite(found.score).all()
    assert found.n_view == 22
    assert image(channel(rows, views), method, missing_share=0.5, blocked_sector_deg=[15.0, 355.0]).n_view <= 3
    fixed = image(channel(rows, views), method, blocked_sector_deg=[15.0, 5.0])
    assert fixed.n_view == 1


def measured(kind):
    views = ring(12)
    if kind == "components":
        return Components(
            np.full(12, 10.0), np.ones(12), np.ones(12, np.int64), views=views, carrier_hz=36e9, bandwidth_hz=3e9
        )
    return response([[(10.0, 1.0)]] * 12, views, count=2001)


@pytest.mark.parametrize("kind", ["components", "responses"])
def test_measured_channels_take_position_errors_and_lose_views(kind):
    clean = image(measured(kind))
    found = image(measured(kind), position_error_m=0.1, missing_share=0.25, blocked_sector_deg=[0.0, 30.0])
    assert 8 <= found.n_view <= 9
    assert found.score.max() < clean.score.max()


@pytest.mark.parametrize("kind", ["components", "responses"])
def test_measured_channels_refuse_the_rest_in_one_line(kind):
    for values in ({"timing_offset_s": 1e-9}, {"random_phase": True}, {"clutter_paths": 1.0}):
        with pytest.raises(ConfigError, match=f"impairments.{next(iter(values))} = .*traced paths") as raised:
            image(measured(kind), **values)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("position_error_m=-0.1", "position_error_m = -0.1"),
        ("timing_offset_s=1", "timing_offset_s = 1"),
        ("timing_jitter_s=-1e-9", "timing_jitter_s = -1e-09"),
        ("random_phase=1", "random_phase = 1"),
        ("missing_share=1.5", "missing_share = 1.5"),
        ("blocked_sector_deg=[0, 400]", r"blocked_sector_deg\[1\] = 400"),
        ("blocked_sector_deg=[10]", r"blocked_sector_deg\[1\]: missing"),
        ("clutter_paths=1e9", "clutter_paths = 1000000000.0"),
        ("clutter_db=nan", "clutter_db"),
        ("seed=-1", "impairments.seed = -1"),
        ("jitter=1", "unknown key"),
    ],
)
def test_bad_settings_are_one_line(override, said):
    with pytest.raises(MvlaError, match=said) as raised:
        imaging_settings([f"impairments.{override}"])
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"missing_share": 1.0}, "none of the 36 chosen views is left"),
        ({"blocked_sector_deg": [0.0, 360.0]}, "none of the 36 chosen views is left"),
        ({"timing_offset_s": -1e-7}, "none may be below 0"),
        ({"timing_offset_s": 1e-6}, "no path lies inside the range gate"),
    ],
)
def test_what_leaves_nothing_to_image_is_one_line(values, said):
    with pytest.raises(MvlaError, match=said) as raised:
        image(scatterers(POINTS, ring(36)), **values)
    assert "\n" not in str(raised.value)
