"""Signal processing that all stages share, against sums written out."""

from __future__ import annotations

import numpy as np
import pytest

from mvla_sim.dsp import Window, noise_level, path_spectrum, range_profiles

STEP_HZ, COUNT = 7.5e6, 37


@pytest.mark.parametrize("count", [1, 2, 36, 37, 301])
def test_a_spectrum_is_the_sum_over_its_paths(count):
    rng = np.random.default_rng(0)
    gain = (rng.standard_normal(9) + 1j * rng.standard_normal(9)).astype(np.complex64)
    delay = rng.uniform(0, 2e-7, 9)
    lowest = -1.4e9
    plain = [sum(g * np.exp(-2j * np.pi * (lowest + k * 1e7) * t) for g, t in zip(gain, delay, strict=True))
             for k in range(count)]  # fmt: skip
    # phases of up to 2π·600 carry 600 times the rounding of float64
    np.testing.assert_allclose(path_spectrum(gain, delay, lowest, 1e7, count), plain, rtol=0, atol=1e-11)
    assert not path_spectrum(gain[:0], delay[:0], lowest, 1e7, count).any()


@pytest.mark.parametrize("lowest", [None, 4600.0, 0.0])
def test_a_profile_is_the_sum_over_its_frequencies(lowest):
    rng = np.random.default_rng(1)
    spectra = rng.standard_normal((2, 3, COUNT)) + 1j * rng.standard_normal((2, 3, COUNT))
    weights, length, places = Window("blackman").weights(COUNT), 64, np.array([0, 5, 63, 64, 130])
    first = -(COUNT - 1) / 2 if lowest is None else lowest
    kernel = np.exp(2j * np.pi * (first + np.arange(COUNT))[:, None] * places / length)
    found = range_profiles(spectra, weights, length, places, lowest)
    np.testing.assert_allclose(found, (spectra * weights) @ kernel / weights.sum(), rtol=0, atol=1e-10)
    np.testing.assert_array_equal(found[1, 2], range_profiles(spectra[1, 2], weights, length, places, lowest))


def test_spectrum_and_profile_undo_each_other():
    """An echo's gain stands at its delay, whatever the window: the two are one convention."""
    length, place, gain = 4 * COUNT, 50, 0.3 - 0.2j
    delay = place / (length * STEP_HZ)
    spectrum = path_spectrum(np.array([gain]), np.array([delay]), -(COUNT - 1) / 2 * STEP_HZ, STEP_HZ, COUNT)
    for window in ("rectangular", "hann", "kaiser"):
        profile = range_profiles(spectrum, Window(window).weights(COUNT), length, np.arange(length))
        assert abs(profile).argmax() == place
        assert profile[place] == pytest.approx(gain, rel=1e-12)


def test_noise_is_judged_by_medians():
    rng = np.random.default_rng(2)
    power = rng.normal(3.0, 0.5, (4, 20001))
    power[:, ::100] += 1e6  # echoes, which a mean would follow
    level, sigma = noise_level(power)
    np.testing.assert_allclose(level, 3.0, atol=0.02)  # 1.25·0.5/√20000 = 0.004, and 1 % of echoes
    np.testing.assert_allclose(sigma, 0.5, atol=0.03)
