"""Power delay profiles: levels, widths, gate, and two routes to the same numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import BANDWIDTH, RESOLUTION, channel, random_channel, response, ring
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.cir import Cir
from mvla_sim.constants import range_to_delay
from mvla_sim.dsp import Window
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.pdp import PdpSettings, compute_pdp, gate_for

WINDOWS = ("rectangular", "hann", "hamming", "blackman", "kaiser")
ONE = ring(1)
ROUNDING = 1e-11  # relative to the largest value: sums of some thousand double-precision terms with powers of phases


def pdp_of(paths, gate=(8.0, 12.0), **options):
    return compute_pdp(channel([paths], ONE), PdpSettings(**options), gate)


def at(profile, range_m):
    """Value of a real profile at a range, by a local fit of a parabola through the three nearest samples."""
    position = (range_m - profile.start_m) / profile.step_m
    k = round(position)
    return np.polyval(np.polyfit([-1, 0, 1], profile.power[0, k - 1 : k + 2], 2), position - k)


@settings(max_examples=30)
@given(st.sampled_from(WINDOWS), st.floats(8.5, 11.5), st.floats(1e-6, 10), st.integers(4, 16))
def test_isolated_path_peaks_at_its_power_and_range(window, range_m, gain, oversampling):
    pdp = pdp_of([(range_m, gain)], window=window, oversampling=oversampling)
    best = pdp.power[0].argmax()
    assert abs(pdp.range_m[best] - range_m) <= 0.51 * pdp.step_m  # the nearest sample, or its equal neighbour
    # A parabola through samples a quarter of ΔR apart misses the top of the sharpest lobe (no window) by under 0.5 %.
    assert at(pdp, range_m) == pytest.approx(gain**2, rel=0.01)
    # Between samples the lobe may fall from its top by no more than at half a sample: (π/8)²/3 = 5 % at 4 samples.
    assert 0.94 * gain**2 < pdp.power.max() < gain**2 * (1 + 1e-6)  # complex64 gain


@pytest.mark.parametrize("window", WINDOWS)
def test_level_does_not_depend_on_oversampling(window):
    """Shared samples of the axis have shared values: 1, 2, 4 and 8 samples a cell."""
    cir = random_channel(1, ring(2))
    finest = compute_pdp(cir, PdpSettings(window=window, oversampling=8), (8.0, 12.0))
    for oversampling in (1, 2, 4):
        pdp = compute_pdp(cir, PdpSettings(window=window, oversampling=oversampling), (8.0, 12.0))
        stride = 8 // oversampling
        first = round((pdp.start_m - finest.start_m) / finest.step_m)
        taken = np.arange(pdp.power.shape[1]) * stride + first
        inside = (taken >= 0) & (taken < finest.power.shape[1])
        # The numbers of frequencies differ a little with the axis' length, and so do the far sidelobes.
        error = np.abs(pdp.power[:, inside] - finest.power[:, taken[inside]]).max()
        assert error < 0.02 * finest.power.max()
        assert inside.sum() > 70


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("oversampling", [1, 4])
def test_equals_the_direct_transform(window, oversampling):
    """The O(P·K) sum over paths and frequencies of the definition, with a window from its textbook formula."""
    views, gate = ring(3), (8.0, 12.0)
    cir = random_channel(2, views, low_m=8.0, high_m=12.0)
    pdp = compute_pdp(cir, PdpSettings(window=window, oversampling=oversampling), gate)
    samples = pdp.power.shape[1] + 2 * 16 * oversampling  # gate and a margin of 16 cells on both sides
    count = int(np.ceil(samples / oversampling))
    frequency = (np.arange(count) - (count - 1) / 2) * BANDWIDTH / count
    weights = Window(window).weights(count)
    for view in range(3):
        delay, gain = cir.delay_s[cir.rows(view)], cir.gain[cir.rows(view)].astype(complex)
        spectrum = weights * (gain * np.exp(-2j * np.pi * frequency[:, None] * delay)).sum(axis=1)
        tau = range_to_delay(pdp.range_m)
        expected = (spectrum * np.exp(2j * np.pi * frequency * tau[:, None])).sum(axis=1) / weights.sum()
        error = np.abs(pdp.amplitude[view] - expected).max()
        assert error < ROUNDING * np.abs(expected).max()
    np.testing.assert_array_equal(pdp.power, pdp.amplitude.real**2 + pdp.amplitude.imag**2)


@pytest.mark.parametrize("window", WINDOWS)
def test_energy_of_a_path_is_its_broadening(window):
    """Parseval: ∫P dτ·B of one path is the window's equivalent noise bandwidth times its power."""
    pdp = pdp_of([(10.0, 2.0)], gate=(2.0, 18.0), window=window)
    energy = pdp.power.sum() * pdp.step_m / RESOLUTION / 4.0
    # Without a window the sidelobes fall as 1/x² in power, and 2/(π²·160) = 0.13 % lies outside the gate.
    assert energy == pytest.approx(Window(window).broadening, rel=2e-3)


@pytest.mark.parametrize(
    ("window", "broadening"), [("rectangular", 1), ("hann", 1.5), ("hamming", 1.363), ("blackman", 1.727)]
)
def test_windows_are_the_textbook_ones(window, broadening):
    weights = Window(window).weights(4096)
    assert Window(window).broadening == pytest.approx(broadening, abs=1e-3)  # as in Harris, Proc. IEEE 66(1), 1978
    assert 4096 * (weights**2).sum() / weights.sum() ** 2 == pytest.approx(Window(window).broadening, rel=1e-3)
    np.testing.assert_allclose(weights, weights[::-1], atol=1e-12)  # symmetric about the carrier
    assert weights.max() == pytest.approx(1, abs=1e-5)  # 4096 samples miss the middle by half a step


def test_paths_in_one_cell_add_coherently():
    together = pdp_of([(10.0, 1.0), (10.0, 1.0)]).power.max()
    opposed = pdp_of([(10.0, 1.0), (10.0, -1.0)]).power.max()
    alone = pdp_of([(10.0, 1.0)]).power.max()
    assert together == pytest.approx(4 * alone, rel=1e-9)
    assert opposed < 1e-20


@pytest.mark.parametrize("outside", [2.0, 7.0, 7.5, 12.5, 13.0, 16.0, 20.0, 30.0, 52.0])
def test_path_outside_the_gate_does_not_alias_into_it(outside):
    """Of one path off the gate nothing is seen inside but Hann's sidelobes, which fall as 1/(πx(x² − 1))."""
    pdp = pdp_of([(10.0, 1e-6), (outside, 1.0)])
    cells = np.abs(pdp.range_m - outside) / RESOLUTION
    # The axis is 32 cells longer than the gate and paths over 8 cells off the gate are left out, so the transform's
    # images of a path are at least 24 cells away.
    envelope = sum((1 / (np.pi * x * (x**2 - 1))) ** 2 for x in (cells, 24.0)) * 2  # two that add, in power
    off = np.abs(pdp.range_m - 10.0) > 4 * RESOLUTION
    assert (pdp.power[0] <= envelope + 4e-12)[off].all()


def test_axis_covers_the_gate_with_both_ends():
    """Also where they fall on samples: a voxel at the very end is still between two samples."""
    for gate in ((8.0, 12.0), (8.001, 11.999), (10.0, 10.0), (0.0, 3.0)):
        pdp = compute_pdp(channel([[(max(gate[0], 1.0), 1.0)]], ONE), PdpSettings(), gate)
        assert pdp.start_m <= gate[0] - 1e-9 or pdp.start_m == 0
        assert pdp.range_m[-1] > gate[1] + 1e-9
        assert pdp.start_m > gate[0] - 2.001 * pdp.step_m  # no more than a spare sample
        assert pdp.power.shape[1] >= 3


def test_view_without_paths_is_zero():
    pdp = compute_pdp(channel([[(10.0, 1.0)], [], [(30.0, 1.0)]], ring(3)), PdpSettings(), (8.0, 12.0))
    assert pdp.power[0].max() > 0.9
    assert (pdp.power[1:] == 0).all()


def test_gate_without_any_path_says_where_they_are():
    with pytest.raises(DataError, match=r"8\.00 to 12\.00 m; they lie .* 20\.00 .* 30\.00 m"):
        pdp_of([(20.0, 1.0), (30.0, 1.0)])
    empty = channel([[]], ONE)
    with pytest.raises(DataError, match="there are none"):
        compute_pdp(empty, PdpSettings(), (8.0, 12.0))


def test_phase_per_view_changes_nothing():
    cir = random_channel(3, ring(6))
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, 6)
    reference = compute_pdp(cir, PdpSettings(), (7.0, 13.0)).power
    exact = cir.gain.astype(np.complex128) * np.exp(1j * np.repeat(phase, cir.row_size))
    turned = compute_pdp(dataclasses.replace(cir, gain=exact), PdpSettings(), (7.0, 13.0)).power
    assert np.abs(turned - reference).max() < ROUNDING * reference.max()
    stored = compute_pdp(cir.with_phases(phase), PdpSettings(), (7.0, 13.0)).power
    # Turned gains are stored as complex64 again: 6e-8 of each path's amplitude, of which 40 add up.
    assert np.abs(stored - reference).max() < 1e-6 * reference.max()


def test_views_are_independent():
    cir = random_channel(4, ring(6))
    taken = np.array([5, 0, 2])
    whole = compute_pdp(cir, PdpSettings(), (8.0, 12.0)).select(taken)
    part = compute_pdp(cir.select(taken), PdpSettings(), (8.0, 12.0))
    np.testing.assert_array_equal(whole.power, part.power)
    np.testing.assert_array_equal(whole.amplitude, part.amplitude)
    assert isinstance(cir.select(taken), Cir)


# Frequency responses, as a network analyser sweeps them.


def paths_of(cir):
    """(range, gain) of each path of every view."""
    return [list(zip(cir.range_m[r], cir.gain[r], strict=True)) for r in (cir.rows(m) for m in range(cir.n_view))]


@pytest.mark.parametrize("window", ["hann", "blackman"])
@pytest.mark.parametrize("oversampling", [1, 4])
def test_swept_responses_have_the_profiles_of_the_paths_they_are_made_of(window, oversampling):
    """Two routes, complex amplitudes included. The transforms differ in their number of frequencies K alone, and so in
    how far away the images of a path are: K cells. For paths in a gate of 80 cells that is 33 or more with the K = 113
    of the paths' own transform, where sidelobes that fall as 1/(πx³) are below 9·10⁻⁶ of the path."""
    cir = random_channel(5, ring(3), low_m=8.0, high_m=12.0)
    swept = response(paths_of(cir), cir.views, count=1001)
    chosen = PdpSettings(window=window, oversampling=oversampling)
    one, other = (compute_pdp(c, chosen, (8.0, 12.0)) for c in (cir, swept))
    assert (one.window, one.oversampling) == (other.window, other.oversampling)
    for name in ("start_m", "step_m", "resolution_m"):  # the band is K times a K-th of itself
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-12)
    total = np.abs(cir.gain).reshape(3, -1).sum(axis=1, keepdims=True)
    assert (np.abs(one.amplitude - other.amplitude) < 2e-5 * total).all()  # images on both sides
    np.testing.assert_array_equal(other.power, other.amplitude.real**2 + other.amplitude.imag**2)


@settings(max_examples=30)
@given(st.sampled_from(WINDOWS), st.floats(1.0, 48.0), st.floats(1e-6, 10), st.integers(4, 16), st.integers(1000, 1003))
def test_isolated_echo_of_a_sweep_peaks_at_its_power_and_range(window, range_m, gain, oversampling, count):
    """|g|² at the right range, near or far, whatever the phase and the number of points."""
    swept = response([[(range_m, gain * np.exp(2j))]], ONE, count=count)
    gate = (range_m - 0.7, range_m + 0.6)
    pdp = compute_pdp(swept, PdpSettings(window=window, oversampling=oversampling), gate)
    assert abs(pdp.range_m[pdp.power[0].argmax()] - range_m) <= 0.51 * pdp.step_m
    assert at(pdp, range_m) == pytest.approx(gain**2, rel=0.01)  # a parabola, as above


def test_sweep_has_the_resolution_of_its_band():
    swept = response([[(10.0, 1.0)]], ONE, count=501, bandwidth_hz=BANDWIDTH / 2)
    pdp = compute_pdp(swept, PdpSettings(), (8.0, 12.0))
    assert pdp.resolution_m == pytest.approx(2 * RESOLUTION)
    half = pdp.power[0] > 0.5 * pdp.power[0].max()
    # Hann's main lobe is 1.44 cells wide at half power; counted in samples of a quarter of a cell.
    assert half.sum() * pdp.step_m == pytest.approx(1.44 * 2 * RESOLUTION, abs=pdp.step_m)


def test_gate_beyond_the_unambiguous_range_is_refused_with_the_points_that_reach_it():
    """200 points over the band fold at 10 m; 240 are needed for 12 m, and are enough."""
    said = r"200 frequencies .* MHz apart give an unambiguous range of 10\.00 m; for 12\.00 m sweep at least 240 points"
    few, enough = (response([[(9.0, 1.0)]], ONE, count=count) for count in (200, 240))
    with pytest.raises(ConfigError, match=rf"^pdp\.gate_m = \[8, 12\]: {said}") as set_:
        compute_pdp(few, PdpSettings(gate_m=(8.0, 12.0)), (8.0, 12.0))
    with pytest.raises(DataError, match=rf"^the grid is seen at ranges of 8\.00 to 12\.00 m; {said}") as default:
        compute_pdp(few, PdpSettings(), (8.0, 12.0))
    for caught in (set_, default):
        assert "\n" not in str(caught.value)
    limit = few.unambiguous_range_m
    assert compute_pdp(few, PdpSettings(), (8.0, limit)).power.max() == pytest.approx(1, rel=1e-6)  # 9 m is a sample
    assert compute_pdp(enough, PdpSettings(gate_m=(8.0, 12.0)), (8.0, 12.0)).power.max() == pytest.approx(1, rel=1e-6)


def test_echo_beyond_the_unambiguous_range_folds_back():
    """Which is why such gates are refused: at 13 m it looks like one at 3 m."""
    folded = response([[(13.0, 1.0)]], ONE, count=200)
    pdp = compute_pdp(folded, PdpSettings(), (1.0, 9.0))
    assert pdp.range_m[pdp.power[0].argmax()] == pytest.approx(3.0, abs=0.51 * pdp.step_m)


def test_phase_per_view_of_a_sweep_changes_nothing():
    cir = random_channel(6, ring(4))
    swept = response(paths_of(cir), cir.views)
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, 4)
    one, other = (compute_pdp(c, PdpSettings(), (7.0, 13.0)).power for c in (swept, swept.with_phases(phase)))
    assert np.abs(one - other).max() < ROUNDING * one.max()


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_default_gate_of_pairs_holds_every_bistatic_range(seed):
    rng = np.random.default_rng(seed)
    views = dataclasses.replace(ring(4), receivers_m=rng.uniform(-15, 15, (4, 3)))
    grid = VoxelGrid((0.2, 0.1, 0.0), (9, 8, 3), 0.5)
    near, far = gate_for(grid, views, PdpSettings())
    there, back = (np.linalg.norm(grid.centers()[:, None] - e, axis=2) for e in (views.positions_m, views.receivers_m))
    assert near <= ((there + back) / 2).min()
    assert far >= ((there + back) / 2).max()
    assert gate_for(grid, views, PdpSettings(gate_m=(1.0, 2.0))) == (1.0, 2.0)
