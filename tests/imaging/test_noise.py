"""Noise: the SNR that is asked for, in every convention, and the same draw whatever comes later."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import noise_of, random_channel, ring
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.dsp import Window
from mvla_sim.errors import ConfigError
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.pdp import PdpSettings, compute_pdp
from mvla_sim.streams import stream

VIEWS = 40


@pytest.fixture(scope="module")
def clean():
    """Profiles of 40 views whose power grows from view to view."""
    cir = random_channel(1, ring(VIEWS))
    gain = cir.gain * np.repeat(np.linspace(1, 5, VIEWS), cir.row_size).astype(np.float32)
    return compute_pdp(dataclasses.replace(cir, gain=gain), PdpSettings(), (6.0, 14.0))


def mean_square(values):
    return (np.abs(values) ** 2).mean(axis=1)


@pytest.mark.parametrize("snr_db", [-10.0, 0.0, 20.0])
@pytest.mark.parametrize("reference", ["view", "all"])
@pytest.mark.parametrize("kind", ["gaussian", "exponential", "complex"])
def test_realised_snr_is_the_one_asked_for(clean, kind, reference, snr_db):
    """Signal and noise power per view: of the PDP, or of the complex amplitude for complex noise."""
    noisy = noise_of(snr_db=snr_db, kind=kind, reference=reference).add(clean)
    if kind == "complex":
        signal, noise = mean_square(clean.amplitude), mean_square(noisy.amplitude - clean.amplitude)
        np.testing.assert_array_equal(noisy.power, np.abs(noisy.amplitude) ** 2)
        kurtosis = 2.0  # E|n|⁴/(E|n|²)² of circular normal noise
    else:
        signal, noise = mean_square(clean.power), mean_square(noisy.power - clean.power)
        assert noisy.amplitude is None
        kurtosis = {"gaussian": 3.0, "exponential": 6.0}[kind]
    signal = signal if reference == "view" else np.full(VIEWS, signal.mean())
    ratio = signal / noise / 10 ** (snr_db / 10)
    samples = clean.power.shape[1]
    if (
        kind == "complex"
    ):  # of the window's spectrum W², so neighbours are alike: (Σ W²)²/(K Σ W⁴) of B·T are independent
        weights = Window("hann").weights(4096)
        samples *= (weights**2).mean() ** 2 / (weights**4).mean() / clean.oversampling
    spread = np.sqrt((kurtosis - 1) / samples)  # of a mean square of so many samples
    assert np.abs(ratio - 1).max() < 5 * spread
    assert abs(ratio.mean() - 1) < 5 * spread / np.sqrt(VIEWS) + spread**2  # 1/noise is biased by its variance


def test_gaussian_noise_has_zero_mean_and_exponential_noise_none_below_zero(clean):
    samples = clean.power.size
    settings_ = {"snr_db": 0.0, "reference": "all"}
    normal = noise_of(kind="gaussian", **settings_).add(clean).power - clean.power
    assert abs(normal.mean()) < 5 * normal.std() / np.sqrt(samples)
    assert normal.min() < 0
    power = noise_of(kind="exponential", **settings_).add(clean).power - clean.power
    assert power.min() >= -1e-12  # rounding of the difference
    assert power.std() == pytest.approx(power.mean(), rel=5 * np.sqrt(2 / samples) + 0.01)  # an exponential's


@pytest.mark.parametrize("kind", ["gaussian", "exponential", "complex"])
def test_noise_is_reproducible_and_follows_the_seed(clean, kind):
    one, again, other = (noise_of(kind=kind, seed=s).add(clean).power for s in (7, 7, 8))
    np.testing.assert_array_equal(one, again)
    assert (one != other).mean() > 0.99


def test_views_draw_from_streams_of_their_own(clean):
    noise = noise_of(snr_db=0.0).add(clean).power - clean.power
    correlation = np.corrcoef(noise)[np.triu_indices(VIEWS, 1)]
    assert np.abs(correlation).max() < 6 / np.sqrt(noise.shape[1])  # 780 pairs of independent rows


@pytest.mark.parametrize("kind", ["gaussian", "exponential", "complex"])
def test_first_views_draw_the_same_however_many_follow(clean, kind):
    """Streams are named by a view's index; with the SNR by view, a shorter file has the same noise."""
    short = noise_of(kind=kind).add(clean.select(np.arange(10))).power
    np.testing.assert_array_equal(short, noise_of(kind=kind).add(clean).power[:10])


@settings(max_examples=20)
@given(st.integers(0, 2**40), st.lists(st.integers(0, 1000), min_size=1, max_size=3))
def test_streams_are_named(seed, key):
    first = stream(seed, *key).standard_normal(4)
    np.testing.assert_array_equal(first, stream(seed, *key).standard_normal(4))
    assert not np.array_equal(first, stream(seed, *key, 0).standard_normal(4))
    assert not np.array_equal(first, stream(seed + 1, *key).standard_normal(4))


def test_without_snr_nothing_changes(clean):
    assert noise_of(snr_db=None).add(clean) is clean


def test_view_without_signal_has_no_noise_by_view_and_the_common_noise_by_all(clean):
    power = clean.power.copy()
    power[3] = 0
    silent = dataclasses.replace(clean, power=power)
    assert (noise_of(reference="view").add(silent).power[3] == 0).all()
    assert (noise_of(reference="all").add(silent).power[3] != 0).all()


def test_complex_noise_needs_amplitudes(clean):
    with pytest.raises(ConfigError, match=r"noise\.kind = 'complex'"):
        noise_of(kind="complex").add(dataclasses.replace(clean, amplitude=None))


def test_complex_noise_is_the_same_whatever_the_oversampling():
    """The noise's band is the signal's: read at every 1/B its mean power is the same for any oversampling. White noise
    at the oversampled rate has that too, but not this: between those samples it would not be smooth."""
    cir = random_channel(1, ring(VIEWS))
    for oversampling in (2, 8):
        clean = compute_pdp(cir, PdpSettings(oversampling=oversampling), (6.0, 14.0))
        noisy = noise_of(snr_db=0.0, kind="complex").add(clean)
        noise = noisy.amplitude - clean.amplitude
        neighbours = (noise[:, 1:] * noise[:, :-1].conj()).real.mean() / (np.abs(noise) ** 2).mean()
        lag = 1 / oversampling
        weights = Window("hann").weights(4096) ** 2
        band = (np.arange(4096) + 0.5) / 4096 - 0.5
        expected = (weights * np.cos(2 * np.pi * band * lag)).sum() / weights.sum()
        assert neighbours == pytest.approx(expected, abs=0.05)  # over 1,000 independent cells


SIGNALS = ("mean-square", "mean-power", "peak-power")
KINDS = ("gaussian", "exponential", "complex")


def told(power, kind, signal, reference, ratio):
    """Level of the noise by the conventions' formulas: σ of Gaussian noise, mean of the others' power, ``[n_view]``."""
    if signal == "peak-power":
        level = power.max(axis=1) if reference == "view" else np.full(VIEWS, power.max())
    elif signal == "mean-power" or kind == "complex":
        level = power.mean(axis=1) if reference == "view" else np.full(VIEWS, power.mean())
    else:
        square = (power**2).mean(axis=1) if reference == "view" else np.full(VIEWS, (power**2).mean())
        return np.sqrt(square / ratio / (2 if kind == "exponential" else 1))
    return level / ratio


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("reference", ["view", "all"])
@pytest.mark.parametrize("kind", KINDS)
def test_level_of_the_noise_is_the_conventions_formula(clean, kind, reference, signal):
    """What the profiles say was added is the formula, and what was added has that mean and that deviation."""
    noisy = noise_of(snr_db=10.0, kind=kind, reference=reference, signal=signal).add(clean)
    level = told(clean.power, kind, signal, reference, 10.0)
    np.testing.assert_allclose(noisy.noise_sigma, level, rtol=1e-12)
    np.testing.assert_allclose(noisy.noise_mean, 0 * level if kind == "gaussian" else level, rtol=1e-12)
    added = np.abs(noisy.amplitude - clean.amplitude) ** 2 if kind == "complex" else noisy.power - clean.power
    samples = clean.power.size
    if kind == "complex":
        samples /= 2 * clean.oversampling  # Hann's noise is alike over two cells
    in_levels = added / level[:, None]
    mean = 0.0 if kind == "gaussian" else 1.0
    assert in_levels.mean() == pytest.approx(mean, abs=5 / np.sqrt(samples))
    assert in_levels.std() == pytest.approx(1.0, abs=5 * np.sqrt(2 / samples))  # an exponential's own: kurtosis 9


def test_mean_square_and_mean_power_of_an_amplitude_are_one(clean):
    one, other = (noise_of(kind="complex", signal=signal).add(clean).power for signal in SIGNALS[:2])
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", KINDS)
def test_clipping_sets_what_is_negative_to_zero_and_nothing_else(clean, kind):
    free, clipped = (noise_of(snr_db=0.0, kind=kind, clip=clip).add(clean) for clip in (False, True))
    np.testing.assert_array_equal(clipped.power, np.where(free.power < 0, 0, free.power))
    assert (free.power < 0).any() == (kind == "gaussian")
    np.testing.assert_array_equal(clipped.noise_sigma, free.noise_sigma)


def test_selected_views_take_their_noise_with_them(clean):
    noisy, taken = noise_of(kind="exponential").add(clean), np.array([7, 2, 2])
    some = noisy.select(taken)
    np.testing.assert_array_equal(some.noise_mean, noisy.noise_mean[taken])
    np.testing.assert_array_equal(some.noise_sigma, noisy.noise_sigma[taken])
    assert clean.select(taken).noise_mean is None


def test_unknown_conventions_are_refused():
    for settings_, words in (({"signal": "power"}, "noise.signal = 'power'"), ({"clip": "yes"}, "noise.clip = 'yes'")):
        with pytest.raises(ConfigError, match=words) as error:
            imaging_settings(noise=settings_)
        assert "\n" not in str(error.value)
