"""From a CIR to an image: views, methods, and what must not change the picture."""

from __future__ import annotations

import numpy as np
import pytest
import twin
from cases import PAPER_METHODS, channel, make_peaks, per_view, random_channel, ring, scatterers, views_at
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging import pipeline
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.pdp import compute_pdp
from mvla_sim.imaging.pipeline import observe, reconstruct
from mvla_sim.imaging.thresholds import joint_threshold
from mvla_sim.imaging.view_selection import ViewSettings, select_views
from mvla_sim.scene.views import Views

SMALL = {"grid.size_m": [4.0, 4.0, 0.0], "grid.spacing_m": 0.05}
POINTS = [[1.0, 0.5, 0.0], [-0.8, -0.4, 0.0], [0.3, -1.2, 0.0]]


def options(**values):
    return imaging_settings(**(SMALL | values))


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_points_stand_out_at_their_places(method):
    image = reconstruct(scatterers(POINTS, ring(72)), options(method=method, snr_db=20))
    points = image.grid.centers()
    flat = image.score.ravel().astype(np.float64)
    for point in POINTS:
        near = np.linalg.norm(points - point, axis=1) < 0.06
        assert flat[near].max() > 0.999 * np.quantile(flat, 0.995)
    best = points[flat.argmax()]
    assert min(np.linalg.norm(best - point) for point in POINTS) < 0.06  # a voxel's diagonal is 7 cm


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_random_phase_per_view_changes_nothing(method):
    """Claim C16. A turned gain is stored as complex64 again, rounded to 6e-8 of itself."""
    cir = scatterers(POINTS, ring(36))
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, 36)
    one, other = (reconstruct(c, options(method=method, snr_db=20)) for c in (cir, cir.with_phases(phase)))
    assert np.abs(one.score - other.score).max() <= 1e-4 * one.score.max()
    if method != "bp":
        # A peak's range moves by 1e-6 of a sample, and voxels on the edge of R_T with it.
        assert (one.support_deg == other.support_deg).mean() > 0.999


@pytest.mark.parametrize("method", ["mvla-gr", "bp", "mlem"])
def test_profiles_are_computed_of_the_views_that_are_used_alone(method, monkeypatch):
    """Noise whose power is that of all views needs them all."""
    computed = []

    def counting(channel, settings, gate_m, views):
        found = compute_pdp(channel, settings, gate_m, views)
        computed.append(len(found.power))
        return found

    monkeypatch.setattr(pipeline, "compute_pdp", counting)
    cir = scatterers(POINTS, ring(72))
    assert reconstruct(cir, options(method=method, interval_deg=10)).n_view == 36
    assert observe(cir, options(method=method, interval_deg=40)).pdp.power.shape[0] == 9
    reconstruct(cir, options(method=method, interval_deg=10, **{"noise.reference": "all"}))
    assert computed == [36, 9, 72]


@settings(max_examples=10)
@given(st.permutations(range(12)), st.sampled_from(PAPER_METHODS))
def test_order_of_the_views_changes_nothing_without_noise(order, method):
    cir = scatterers(POINTS, ring(12))
    one, other = (reconstruct(c, options(method=method, snr_db=None)) for c in (cir, cir.select(np.array(order))))
    assert np.array_equal(one.score, other.score)


@pytest.mark.parametrize("method", PAPER_METHODS)
@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_turning_target_and_sensors_turns_the_image(method, quarters):
    c, s = [(0, 1), (-1, 0), (0, -1)][quarters - 1]
    turned = [[c * x - s * y, s * x + c * y, z] for x, y, z in POINTS]
    one = reconstruct(scatterers(POINTS, ring(24)), options(method=method, snr_db=None))
    other = reconstruct(scatterers(turned, ring(24, start_deg=90.0 * quarters)), options(method=method, snr_db=None))
    error = np.abs(np.rot90(one.score[0], -quarters) - other.score[0])
    # Ranges are float32: 1e-6 m, which moves a smooth profile by 1e-4, and a vote at its edge by a whole view of 24.
    assert np.quantile(error, 0.99) <= 1e-4 * one.score.max()
    assert error.max() <= 1.01 / 24 * max(1.0, one.score.max())


def test_hard_vote_is_the_share_of_supporting_views():
    cir = scatterers(POINTS, ring(24))
    chosen = options(method="mvla-hard", snr_db=20)
    image = reconstruct(cir, chosen)
    peaks = observe(cir, chosen).front.peaks
    b = twin.supports(image.grid.centers(), cir.views.positions_m, per_view(peaks), 0.05)
    votes = image.score.ravel() * 24
    assert (np.abs(votes - b.sum(axis=0)) < 1e-4).mean() >= 0.999  # edges in float32, gaps narrower than two nodes
    assert image.score.max() <= 1


def test_soft_score_is_a_share_too():
    image = reconstruct(scatterers([POINTS[0]], ring(24)), options(snr_db=None))
    assert image.score.max() == pytest.approx(1, abs=0.5)  # the point lies between voxels, σ_R is half a voxel
    assert image.score.max() <= 1 + 1e-6  # float32
    assert image.n_view == 24


def test_noise_does_not_depend_on_the_views_chosen_later():
    cir = random_channel(1, ring(12))
    every = options(snr_db=0)
    grid = VoxelGrid.from_settings(every.grid)
    front = observe(cir, every).front
    for offset in (0, 2):
        taken = np.arange(offset, 12, 3)
        some = reconstruct(cir, options(method="bp", snr_db=0, interval_deg=90, offset=offset))
        power = front.pdp.power[taken]
        total = twin.backprojection(grid.centers(), cir.views.positions_m[taken], power, front.pdp.range_m)
        total /= np.abs(power).max()
        # Samples of the profile are white noise, so 1e-6 m of range in float32 is 1e-4 of a step; four views.
        np.testing.assert_allclose(some.score.ravel(), total, atol=4 * 2e-4)
        assert some.n_view == 4


def test_binary_image_is_the_joint_threshold():
    cir = scatterers(POINTS, ring(24))
    image = reconstruct(cir, options(threshold={"top_percent": 2.0, "min_support_deg": 60.0}))
    expected = joint_threshold(image.score, image.support_deg, 2.0, 60.0)
    assert np.array_equal(image.occupied, expected)
    assert 0 < image.occupied.sum() <= 128  # 2 % of 6,400
    assert reconstruct(cir, options()).occupied is None
    with pytest.raises(ConfigError, match="no angular support"):
        reconstruct(cir, options(method="bp", threshold={"top_percent": 2.0, "min_support_deg": 60.0}))


def test_views_without_paths_do_no_harm():
    cir = channel([[(9.0, 1.0)], [], [(9.5, 1.0)], []], ring(4))
    for method in PAPER_METHODS:
        image = reconstruct(cir, options(method=method))
        assert np.isfinite(image.score).all()
        assert image.score.max() > 0
        assert image.n_view == 4


def test_chosen_views_without_peaks_are_an_error():
    cir = channel([[(9.0, 1.0)], [], [(9.5, 1.0)], []], ring(4))
    with pytest.raises(DataError, match=r"no peak in any of the 2 chosen views.*sigma \(now 4\)"):
        reconstruct(cir, options(interval_deg=180, offset=1))


def test_every_interval_and_offset_partitions_the_views():
    views = ring(24)
    for interval in (15.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0, 360.0):
        stride = round(interval / 15)
        parts = [select_views(views, ViewSettings(interval_deg=interval, offset=k)) for k in range(stride)]
        assert sorted(np.concatenate(parts).tolist()) == list(range(24))
        for part in parts:
            assert (np.diff(part) == stride).all()
    assert select_views(views, ViewSettings()).tolist() == list(range(24))


def test_turntable_views_run_backwards_and_are_selected_alike():
    views = views_at(-15.0 * np.arange(24))
    assert select_views(views, ViewSettings(interval_deg=45.0, offset=1)).tolist() == list(range(1, 24, 3))


def test_interval_is_chosen_alike_at_every_height():
    """A circle of 24 views at each of two heights; every 16th, 240°, would divide the 48 views but no turn of 24."""
    views = views_at(np.tile(15.0 * np.arange(24), 2))
    for interval, stride in ((15.0, 1), (30.0, 2), (120.0, 8)):
        chosen = select_views(views, ViewSettings(interval_deg=interval, offset=stride - 1))
        one = np.arange(stride - 1, 24, stride)
        assert chosen.tolist() == [*one, *(24 + one)]
    for interval in (240.0, 720.0, 80.0):
        with pytest.raises(ConfigError, match=r"does not divide.*allowed: 15, 30, 45, 60, 90, 120, 180, 360$"):
            select_views(views, ViewSettings(interval_deg=interval))


@pytest.mark.parametrize(
    ("chosen", "match"),
    [
        ({"interval_deg": 50.0}, r"interval_deg = 50 does not divide the file's 24 views at 15°; allowed: 15, 30, 45"),
        ({"interval_deg": 20.0}, "does not divide"),
        ({"interval_deg": 7.5}, "does not divide"),
        ({"interval_deg": 75.0}, "does not divide"),
        ({"interval_deg": 45.0, "offset": 3}, r"offset = 3: at 45° allowed: 0 to 2"),
        ({"offset": 1}, r"views\.offset = 1 needs views\.interval_deg"),
    ],
)
def test_selections_that_do_not_fit_are_refused(chosen, match):
    with pytest.raises(ConfigError, match=match):
        select_views(ring(24), ViewSettings(**chosen))


@pytest.mark.parametrize(
    "views",
    [
        views_at([0, 10, 20, 35]),
        views_at([0, 10, 0, 10]),  # to and fro
        Views(np.array([[6.0, 0, 0], [8, 0, 0], [10, 0, 0]]), np.zeros(3), (0, 0)),  # along a ray
        views_at([5.0]),
    ],
    ids=["uneven", "zigzag", "radial", "single"],
)
def test_interval_needs_evenly_spaced_views(views):
    with pytest.raises(ConfigError, match="not evenly spaced"):
        select_views(views, ViewSettings(interval_deg=10.0))


def test_image_carries_settings_and_origin():
    cir = scatterers(POINTS, ring(4))
    image = reconstruct(cir, options(method="mvla-hard", seed=3))
    assert image.config["imaging"]["noise"]["seed"] == 3
    assert image.method == "mvla-hard"
    assert image.provenance["program"].startswith("mvla-sim")
    assert image.outline is None


def test_extent_comes_from_the_file_or_the_settings():
    unknown = channel([[(9.0, 1.0)]] * 3, ring(3), extent_m=float("nan"))
    with pytest.raises(ConfigError, match=r"mvla\.extent_m"):
        reconstruct(unknown, options())
    given_ = reconstruct(unknown, options(**{"mvla.extent_m": 4.0}))
    known = reconstruct(channel([[(9.0, 1.0)]] * 3, ring(3)), options())
    assert np.array_equal(given_.score, known.score)


def test_peaks_helper_orders_rows():
    assert make_peaks([[(3.0, 1.0), (2.0, 1.0)], []]).range_m.tolist() == [2.0, 3.0]
