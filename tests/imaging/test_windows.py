"""Windows over the band: the Kaiser window against an independent one, and how much each broadens."""

from __future__ import annotations

import numpy as np
import pytest
from cases import channel, ring
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal.windows import kaiser
from scipy.special import i0

from mvla_sim.dsp import Window
from mvla_sim.errors import ConfigError
from mvla_sim.imaging.pdp import PdpSettings, compute_pdp
from mvla_sim.settings import parse

betas = st.floats(0, 40)


@settings(max_examples=40)
@given(st.integers(1, 400), betas)
def test_kaiser_is_scipys_at_the_same_places(count, beta):
    """Ours are centred in equal shares of the band, scipy's include both ends: every second of 2n + 1."""
    ours = Window("kaiser", beta).weights(count)
    np.testing.assert_allclose(ours, kaiser(2 * count + 1, beta)[1::2], rtol=1e-12)  # two programs for I₀


@settings(max_examples=30)
@given(betas)
def test_broadening_of_kaiser_is_its_equivalent_noise_bandwidth(beta):
    """∫w² over (∫w)² across the band; ∫ I₀(β√(1−x²)) dx from −1 to 1 is 2·sinh β/β."""
    square, _ = quad(lambda x: i0(beta * np.sqrt(1 - x * x)) ** 2, -1, 1)
    area = 2 * np.sinh(beta) / beta if beta > 1e-6 else 2.0
    # A midpoint sum of 4,096 terms: its error falls as 1/n², with a slope at the ends of β²/2 relative to the middle.
    assert Window("kaiser", beta).broadening == pytest.approx(2 * square / area**2, rel=1e-5)


@pytest.mark.parametrize(("alpha", "broadening"), [(2.0, 1.50), (2.5, 1.65), (3.0, 1.80), (3.5, 1.93)])
def test_broadening_of_kaiser_is_the_tabulated_one(alpha, broadening):
    """Harris, Proc. IEEE 66(1), 1978, table 1, β = πα; given to two digits behind the point."""
    assert Window("kaiser", np.pi * alpha).broadening == pytest.approx(broadening, abs=0.006)


def test_kaiser_of_zero_is_no_window():
    np.testing.assert_array_equal(Window("kaiser", 0.0).weights(9), np.ones(9))
    assert Window("kaiser", 0.0).broadening == 1
    paths = channel([[(10.0, 1.0), (10.2, -0.7j)]], ring(1))
    one, other = (
        compute_pdp(paths, PdpSettings(**chosen), (9.0, 11.0))
        for chosen in ({"window": "kaiser", "kaiser_beta": 0.0}, {"window": "rectangular"})
    )
    np.testing.assert_array_equal(one.power, other.power)


@settings(max_examples=20)
@given(betas, st.floats(0.5, 10))
def test_higher_beta_broadens_more(beta, more):
    assert Window("kaiser", min(beta + more, 45.0)).broadening > Window("kaiser", beta).broadening


@pytest.mark.parametrize(("beta", "sidelobe_db"), [(2.0 * np.pi, -46.0), (3.0 * np.pi, -69.0)])
def test_sidelobes_of_a_profile_fall_with_beta(beta, sidelobe_db):
    """Highest sidelobes as in Harris (-46 and -69 dB for α = 2 and 3), in the profile of one path."""
    chosen = PdpSettings(window="kaiser", kaiser_beta=beta, oversampling=16)
    pdp = compute_pdp(channel([[(10.0, 1.0)]], ring(1)), chosen, (5.0, 15.0))
    null = np.sqrt(1 + (beta / np.pi) ** 2)  # cells from the peak to the end of the main lobe
    beside = np.abs(pdp.range_m - 10.0) > null * pdp.resolution_m
    assert 10 * np.log10(pdp.power[0][beside].max()) == pytest.approx(sidelobe_db, abs=1.0)  # tabulated as whole dB
    assert pdp.broadening == Window("kaiser", beta).broadening


def test_beta_is_of_no_other_window_and_has_bounds():
    assert Window("hann", 3.0).broadening == Window("hann").broadening == 1.5
    np.testing.assert_array_equal(Window("hann", 3.0).weights(8), Window("hann").weights(8))
    for beta in (-1.0, 41.0):
        with pytest.raises(ConfigError, match=r"kaiser_beta"):
            parse(PdpSettings, {"window": "kaiser", "kaiser_beta": beta}, "test")
