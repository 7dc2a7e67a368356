"""The peak detector: what it resolves, how accurate it is, how often it is wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import RESOLUTION, channel, noise_of, random_channel, response, ring
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.imaging.detectors.local_maxima import LocalMaxima
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.pdp import Pdp, PdpSettings, compute_pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.pipeline import observe

CELL = 1.5 * RESOLUTION  # Hann's
ONE = ring(1)
GRID = {"size_m": [4.0, 4.0, 0.0], "spacing_m": 0.1}


def peaks_of(paths, peaks=None, **pdp):
    return (peaks or LocalMaxima()).peaks_of(compute_pdp(channel([paths], ONE), PdpSettings(**pdp), (8.0, 12.0)))


def profile(power):
    return Pdp(np.atleast_2d(np.asarray(power, np.float64)), None, 0.0, RESOLUTION / 4, RESOLUTION, 1.5)


@pytest.mark.parametrize(("separation", "count"), [(0.5, 1), (1.0, 1), (2.0, 2)])
@pytest.mark.parametrize("turn", [1j, -1j])
def test_two_echoes_are_resolved_from_two_cells_on(separation, count, turn):
    """Equal echoes in quadrature, so that powers add: the lobes of Hann's window are two cells wide at their feet."""
    for offset in np.linspace(0, RESOLUTION / 4, 5):  # wherever the samples fall
        first = 10 + offset
        found = peaks_of([(first, 1.0), (first + separation * CELL, turn)])
        assert found.row_size.tolist() == [count]
        if count == 2:
            # Each sits on the first sidelobe of the other, 31 dB down: 3 % of its power, with a slope of its own.
            np.testing.assert_allclose(found.range_m, [first, first + separation * CELL], rtol=0, atol=RESOLUTION / 10)


def test_nothing_closer_than_the_minimum_separation():
    pdp = noise_of(snr_db=0.0).add(compute_pdp(random_channel(1, ring(30)), PdpSettings(), (6.0, 14.0)))
    for separation in (0.5, 1.0, 2.0):
        found = LocalMaxima(threshold_sigma=2.0, min_separation=separation, refine=False).peaks_of(pdp)
        same_view = np.diff(found.view) == 0
        assert np.diff(found.range_m)[same_view].min() >= separation * CELL - 1e-9
    assert found.row_size.min() > 0


@settings(max_examples=50)
@given(st.floats(9.0, 11.0), st.sampled_from(["hann", "hamming", "blackman"]))
def test_range_is_better_than_a_sample(range_m, window):
    found = peaks_of([(range_m, 3.0)], window=window)
    # The parabola through samples of a cosine-like lobe, four a cell of no window: below 2 % of a sample of 12.5 mm.
    assert found.range_m == pytest.approx([range_m], abs=0.02 * RESOLUTION / 4)
    assert found.power == pytest.approx([9.0], rel=0.01)
    raw = peaks_of([(range_m, 3.0)], LocalMaxima(refine=False), window=window)
    assert raw.range_m == pytest.approx([range_m], abs=0.501 * RESOLUTION / 4)


@pytest.mark.parametrize("sigmas", [3.0, 3.5])
def test_false_alarms_are_as_many_as_the_threshold_says(sigmas):
    """On white normal noise; a sample above so high a threshold is all but always a local maximum."""
    rng = np.random.default_rng(2)
    views, samples = 300, 2000
    found = LocalMaxima(threshold_sigma=sigmas, min_separation=0.0).peaks_of(
        profile(rng.standard_normal((views, samples)))
    )
    tail = norm.sf(sigmas)
    # A neighbour that is higher still takes a sample's place; both of two being so happens with probability 2·tail.
    expected = views * samples * tail
    # Poisson's spread, and 5 % for the floor's own scatter: it is convex in σ, which a view knows to 2 to 3 %.
    assert abs(found.range_m.size - expected) < 5 * np.sqrt(expected) + 0.05 * expected


def test_floor_is_estimated_from_the_profile():
    """The same noise at any level and offset gives the same peaks."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((20, 1000))
    noise[:, 500] += 30
    options = LocalMaxima(dynamic_range_db=300.0)
    one = options.peaks_of(profile(noise + 10))
    other = options.peaks_of(profile(1e-12 * (noise + 50)))
    np.testing.assert_array_equal(one.row_size, other.row_size)
    np.testing.assert_allclose(one.range_m, other.range_m, atol=1e-9)


def test_dynamic_range_drops_weak_echoes():
    echoes = [(9.0, 1.0), (10.0, 10 ** (-25 / 20)), (11.0, 10 ** (-35 / 20))]
    for limit, count in ((20.0, 1), (30.0, 2), (40.0, 3)):
        found = peaks_of(echoes, LocalMaxima(dynamic_range_db=limit), window="blackman")  # sidelobes 58 dB down
        assert found.row_size.tolist() == [count]


def test_strongest_are_kept_in_order_of_range():
    echoes = [(8.5 + 0.5 * k, gain) for k, gain in enumerate([0.3, 1.0, 0.5, 0.9, 0.4])]
    found = peaks_of(echoes, LocalMaxima(max_peaks=3))
    np.testing.assert_allclose(found.range_m, [9.0, 9.5, 10.0], atol=1e-3)
    np.testing.assert_allclose(found.power, [1.0, 0.25, 0.81], rtol=0.01)
    np.testing.assert_allclose(found.weight, found.power / found.power.sum(), rtol=1e-12)
    assert peaks_of(echoes, LocalMaxima(max_peaks=9)).row_size.tolist() == [5]


def test_flat_top_stays_where_it_is():
    power = np.zeros(50)
    power[[20, 21, 22]] = 1.0
    found = LocalMaxima().peaks_of(profile(power))
    assert found.range_m == pytest.approx([21 * RESOLUTION / 4])
    assert found.power == pytest.approx([1.0])


def test_views_without_peak_are_counted():
    power = np.zeros((3, 60))
    power[1, 30] = 1.0
    found = LocalMaxima().peaks_of(profile(power))
    assert found.row_size.tolist() == [0, 1, 0]
    assert found.view.tolist() == [1]
    assert found.weight.tolist() == [1.0]
    assert LocalMaxima().peaks_of(profile(np.zeros((4, 60)))).row_size.tolist() == [0] * 4


def test_selection_keeps_rows_together():
    found = LocalMaxima().peaks_of(noise_of().add(compute_pdp(random_channel(4, ring(6)), PdpSettings(), (7.0, 13.0))))
    taken = np.array([4, 4, 1])
    some = found.select(taken)
    for new, old in enumerate(taken):
        np.testing.assert_array_equal(some.range_m[some.view == new], found.range_m[found.view == old])
        np.testing.assert_array_equal(some.weight[some.view == new], found.weight[found.view == old])


@pytest.mark.parametrize(
    "change",
    [{"power": np.ones(2)}, {"row_size": np.array([2])}, {"power": np.array([0.0])}, {"range_m": np.array([np.nan])}],
)
def test_inconsistent_peaks_are_refused(change):
    good = Peaks(np.ones(1), np.ones(1), np.array([1]))
    with pytest.raises(DataError, match="peaks: "):
        dataclasses.replace(good, **change)


def test_true_noise_gives_the_false_alarms_that_the_threshold_says():
    """Exponential noise exceeds mean + kσ, its mean being its σ, with probability e^−(k+1)."""
    rng = np.random.default_rng(8)
    power = rng.standard_exponential((300, 2000)) * np.linspace(1, 3, 300)[:, None]
    level = np.linspace(1, 3, 300)
    pdp = dataclasses.replace(profile(power), noise_mean=level, noise_sigma=level)
    detector = LocalMaxima(threshold_sigma=5.0, relative_to="true-noise", min_separation=0.0, refine=False)
    expected = power.size * np.exp(-6)
    found = detector.peaks_of(pdp)
    # a higher neighbour takes a sample's place with probability 2·e^−6, half a per cent
    assert abs(found.range_m.size - expected) < 5 * np.sqrt(expected) + 0.005 * expected
    assert (found.power > 6 * level[found.view]).all()


def test_true_noise_does_not_rise_with_the_echoes():
    """Where echoes fill more than half of the profile the estimated floor is that of echoes."""
    power = np.tile([0.0, 2.0, 5.0, 2.0], 50)
    known = dataclasses.replace(profile(power), noise_mean=np.zeros(1), noise_sigma=np.array([0.1]))
    assert LocalMaxima(min_separation=0.0).peaks_of(known).range_m.size == 0
    assert LocalMaxima(min_separation=0.0, relative_to="true-noise").peaks_of(known).range_m.size == 50


def test_relative_to_the_maximum_the_dynamic_range_alone_decides():
    rng = np.random.default_rng(9)
    pdp = profile(rng.standard_exponential((10, 1000)))
    for limit in (3.0, 10.0):
        options = {"relative_to": "maximum", "dynamic_range_db": limit, "min_separation": 0.0, "refine": False}
        peaks, strict = (LocalMaxima(threshold_sigma=sigma, **options).peaks_of(pdp) for sigma in (4.0, 50.0))
        inner = pdp.power[:, 1:-1]
        top = (inner > pdp.power[:, :-2]) & (inner > pdp.power[:, 2:])
        expected = top & (inner >= pdp.power.max(axis=1, keepdims=True) * 10 ** (-limit / 10))
        np.testing.assert_array_equal(peaks.row_size, expected.sum(axis=1))
        np.testing.assert_array_equal(strict.range_m, peaks.range_m)


@pytest.mark.parametrize("noise", [{"snr_db": None}, {"snr_db": 20.0}])
def test_true_noise_that_is_not_known_is_refused(noise):
    """Without noise, and of measured data, which have their own beside what is added."""
    views = ring(4)
    paths = [[(10.0, 1.0)]] * 4
    seen = channel(paths, views) if noise["snr_db"] is None else response(paths, views)
    chosen = imaging_settings(noise=noise, peaks={"relative_to": "true-noise"}, grid=GRID)
    with pytest.raises(ConfigError, match=r"peaks\.relative_to = 'true-noise': the noise of these") as error:
        observe(seen, chosen)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["gaussian", "exponential", "complex"])
def test_true_noise_reaches_the_detector(kind):
    """Through the pipeline: the views that are looked at have their own noise, and few peaks are false."""
    views = ring(12)
    seen = channel([[(10.0, 1.0 + view)] for view in range(12)], views)
    chosen = imaging_settings(
        noise={"kind": kind, "snr_db": 20.0, "signal": "mean-power"}, interval_deg=60.0, grid=GRID,
        peaks={"relative_to": "true-noise", "threshold_sigma": 12.0, "dynamic_range_db": 80.0},
    )  # fmt: skip
    pdp, found = (getattr(observe(seen, chosen), name) for name in ("pdp", "peaks"))
    assert found.row_size.min() >= 1
    assert (found.power > (pdp.noise_mean + 12 * pdp.noise_sigma)[found.view]).all()
    assert np.diff(pdp.noise_sigma).min() > 0


def test_unknown_references_of_the_threshold_are_refused():
    with pytest.raises(ConfigError, match=r"peaks\.relative_to = 'noise'"):
        imaging_settings(peaks={"relative_to": "noise"})
