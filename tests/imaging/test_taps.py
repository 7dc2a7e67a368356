"""How paths become samples and add up: nearest samples, sums of powers, and sums by hand in float64."""

from __future__ import annotations

import numpy as np
import pytest
from cases import BANDWIDTH, RESOLUTION, channel, random_channel, response, ring, scatterers
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.constants import delay_to_range
from mvla_sim.dsp import Window
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import GridSettings, VoxelGrid
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.noises.complex_gaussian import ComplexNoise
from mvla_sim.imaging.pdp import PdpSettings, compute_pdp, frequency_count
from mvla_sim.imaging.pipeline import observe, reconstruct
from mvla_sim.imaging.tomography import LinearModel

WINDOWS = ("rectangular", "hann", "hamming", "blackman", "kaiser")
ONE = ring(1)
GATE = (8.0, 12.0)
SMALL = {"grid.size_m": [2.0, 2.0, 0.0], "grid.spacing_m": 0.1, "noise.snr_db": None}


def pdp_of(cir, gate=GATE, **options):
    return compute_pdp(cir, PdpSettings(**options), gate)


def pulse(window, pdp, range_m):
    """p(τ_l − τ) of a path at a range, ``[n_range]``, as the sum over the band that defines it."""
    count = frequency_count(pdp.power.shape[1], pdp.oversampling)
    weights = Window(window).weights(count)
    offset = BANDWIDTH / count * (np.arange(count) - (count - 1) / 2)
    delay = (pdp.range_m - range_m) / RESOLUTION / BANDWIDTH
    return np.exp(2j * np.pi * np.outer(delay, offset)) @ weights / weights.sum()


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("oversampling", [1, 2, 5])
def test_sum_of_powers_is_that_by_hand(window, oversampling):
    """One sample per 1/B too, where the spectrum of |p|² is wider than the axis can hold."""
    cir = random_channel(3, ring(2), paths=6, low_m=8.2, high_m=11.8)
    pdp = pdp_of(cir, sum="powers", window=window, oversampling=oversampling)
    assert pdp.amplitude is None
    for view in range(2):
        rows = cir.rows(view)
        expected = sum(
            abs(g) ** 2 * np.abs(pulse(window, pdp, r)) ** 2
            for g, r in zip(cir.gain[rows].astype(complex), cir.range_m[rows], strict=True)
        )
        # Sums of some thousand terms in double precision, with powers of phases.
        assert np.abs(pdp.power[view] - expected).max() <= 1e-11 * expected.max()
    assert (pdp.power >= 0).all()


@pytest.mark.parametrize("window", WINDOWS)
def test_powers_of_an_isolated_path_are_those_of_its_amplitudes(window):
    cir = channel([[(10.013, 0.3 + 0.4j)]], ONE)
    one, other = (pdp_of(cir, sum=s, window=window) for s in ("powers", "amplitudes"))
    assert np.abs(one.power - other.power).max() <= 1e-12 * 0.25
    assert one.broadening == other.broadening


def test_two_paths_add_by_power_whatever_their_phases():
    """In one place they cancel or add up to four times one's power as amplitudes, and make twice it as powers."""
    for phase, together in ((0.0, 4.0), (np.pi / 2, 2.0), (np.pi, 0.0)):
        cir = channel([[(10.0, 1.0), (10.0, np.exp(1j * phase))]], ONE)
        for kernel in ("band-limited", "nearest"):
            amplitudes, powers = (pdp_of(cir, kernel=kernel, sum=s) for s in ("amplitudes", "powers"))
            assert amplitudes.power.max() == pytest.approx(together, abs=1e-6)  # gains are complex64
            assert powers.power.max() == pytest.approx(2.0, rel=1e-6)


@settings(max_examples=30)
@given(st.floats(8.5, 11.5), st.floats(1e-6, 10), st.integers(1, 16), st.sampled_from(["amplitudes", "powers"]))
def test_a_path_is_in_the_nearest_sample_alone(range_m, gain, oversampling, added):
    cir = channel([[(range_m, gain * 1j)]], ONE)
    pdp = pdp_of(cir, kernel="nearest", sum=added, oversampling=oversampling, window="blackman")
    assert pdp.step_m == pytest.approx(RESOLUTION / oversampling, rel=1e-12)
    (place,) = np.flatnonzero(pdp.power[0])
    assert abs(pdp.range_m[place] - range_m) <= pdp.step_m / 2 * (1 + 1e-9)
    assert pdp.power[0, place] == pytest.approx(gain**2, rel=1e-6)  # complex64
    assert pdp.broadening == 1


def test_nearest_samples_are_those_of_a_loop():
    """Several views, some not asked for and one without paths; paths beyond the axis are left out."""
    cir = random_channel(5, ring(4), paths=50, low_m=7.0, high_m=13.0)
    only = np.array([1, 3])
    for added in ("amplitudes", "powers"):
        pdp = compute_pdp(cir, PdpSettings(kernel="nearest", sum=added, oversampling=2), GATE, only)
        expected = np.zeros(pdp.power.shape, complex)
        for row, view in enumerate(only):
            for k in range(cir.row_start[view], cir.row_start[view + 1]):
                place = round((delay_to_range(cir.delay_s[k]) - pdp.start_m) / pdp.step_m)
                if 0 <= place < pdp.power.shape[1]:
                    gain = complex(cir.gain[k])
                    expected[row, place] += abs(gain) ** 2 if added == "powers" else gain
        found = pdp.amplitude if added == "amplitudes" else pdp.power
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
        assert expected.any(axis=1).all()


def test_taps_of_sinc_are_one_sample_per_bandwidth_without_a_window():
    cir = channel([[(10.02, 1.0), (9.7, 0.5j)]], ONE)
    pdp = pdp_of(cir, window="rectangular", oversampling=1)
    cells = (pdp.range_m[:, None] - cir.range_m) / RESOLUTION
    # The band's frequencies are finite in number: sin(πx)/(K sin(πx/K)) instead of sinc, 1 % off far out.
    assert np.abs(pdp.amplitude[0] - np.sinc(cells) @ cir.gain).max() < 0.02


def test_complex_noise_of_taps_is_white():
    """No window shapes it; one sample per 1/B is independent of its neighbour."""
    cir = channel([[(10.0, 1.0)]] * 200, ring(200))
    noisy = ComplexNoise(snr_db=-20.0).add(pdp_of(cir, kernel="nearest", oversampling=1))
    noise = noisy.amplitude[:, :30]
    lagged = (noise[:, 1:] * noise[:, :-1].conj()).mean() / (np.abs(noise) ** 2).mean()
    assert abs(lagged) < 0.04  # three standard deviations of a mean over 5800
    hann = ComplexNoise(snr_db=-20.0).add(pdp_of(cir, oversampling=1)).amplitude[:, :30]
    assert abs((hann[:, 1:] * hann[:, :-1].conj()).mean() / (np.abs(hann) ** 2).mean()) > 0.5


def test_model_of_tomography_has_the_kernel_of_the_profiles():
    cir = channel([[(10.0, 1.0)]], ONE)
    grid = VoxelGrid.from_settings(GridSettings(size_m=(1.0, 1.0, 0.0), spacing_m=0.1))
    wide, one = (LinearModel(grid, ONE, pdp_of(cir, kernel=kernel)).taps for kernel in ("band-limited", "nearest"))
    assert wide.size > 4
    assert one.tolist() == [1.0]


@pytest.mark.parametrize("given", [{"kernel": "nearest"}, {"sum": "powers"}, {"kernel": "nearest", "sum": "powers"}])
def test_images_of_points_are_where_they_are(given):
    cir = scatterers([[0.5, -0.3, 0.0]], ring(36))
    image = reconstruct(cir, pdp=given, **SMALL)
    best = image.grid.centers()[image.score.ravel().argmax()]
    assert np.linalg.norm(best - [0.5, -0.3, 0.0]) < 0.15


def test_what_needs_phases_refuses_powers():
    cir = channel([[(10.0, 1.0)]], ONE)
    powers = {"pdp": {"sum": "powers"}}
    with pytest.raises(ConfigError) as error:
        observe(cir, noise={"kind": "complex"}, **powers)
    assert str(error.value) == (
        "pdp.sum = 'powers': leaves no phase, which noise.kind = 'complex' needs; use pdp.sum = 'amplitudes'"
    )
    assert observe(cir, noise={"kind": "complex", "snr_db": None}, **powers).pdp.power.any()
    with pytest.raises(ConfigError, match=r"^pdp\.sum = 'powers': leaves no phase, which method = 'bp-coherent' needs"):
        reconstruct(cir, method="bp-coherent", **powers, **SMALL)
    with pytest.raises(ConfigError, match=r"^pdp\.kernel = 'nearest': .*, which bp-coherent needs; use pdp\.kernel"):
        reconstruct(cir, method="bp-coherent", pdp={"kernel": "nearest"}, **SMALL)


@pytest.mark.parametrize(("key", "value"), [("kernel", "nearest"), ("sum", "powers")])
def test_frequency_responses_have_neither(key, value):
    swept = response([[(10.0, 1.0)]], ONE)
    with pytest.raises(
        ConfigError, match=rf"^pdp\.{key} = '{value}': needs traced paths, and this file holds measured"
    ):
        reconstruct(swept, pdp={key: value}, **SMALL)


def test_a_gate_without_a_path_is_refused_and_says_where_they_are():
    cir = channel([[(20.0, 1.0)]], ONE)
    for options in ({"kernel": "nearest"}, {"sum": "powers"}):
        with pytest.raises(
            DataError, match=r"gate of 8\.00 to 12\.00 m; they lie from 20\.00 to 20\.00 m, the nearest 8"
        ):
            pdp_of(cir, **options)


@pytest.mark.parametrize(("key", "value"), [("kernel", "sinc"), ("sum", "power")])
def test_bad_values_are_refused(key, value):
    with pytest.raises(ConfigError) as error:
        imaging_settings(**{f"pdp.{key}": value})
    assert f"pdp.{key} = '{value}'" in str(error.value)
    assert "\n" not in str(error.value)
