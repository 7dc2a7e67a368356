"""Background and reference: levels against closed forms and scikit-rf, subtraction under drift, cables taken out."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import skrf
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.references import (
    ReferenceSettings,
    calibrate,
    echo_gain,
    find_peak,
    range_profile,
    subtract_background,
)
from mvla_sim.constants import SPEED_OF_LIGHT, delay_to_range, range_to_delay
from mvla_sim.dsp import Window
from mvla_sim.errors import ConfigError, DataError

START, STEP, COUNT = 34.5e9, 7.5e6, 401
FREQUENCY = START + STEP * np.arange(COUNT)
CARRIER = 36e9
POST = 1e-3
FARTHEST = SPEED_OF_LIGHT / (2 * STEP)  # 19.99 m
CELL = SPEED_OF_LIGHT / (2 * COUNT * STEP)  # 5 cm


def echo(range_m, gain=1.0):
    """Sweep of a point echo."""
    return gain * np.exp(-2j * np.pi * FREQUENCY * range_to_delay(range_m))


def db(amplitude):
    return 20 * np.log10(abs(amplitude))


def noise(rng, sigma, shape):
    return sigma / np.sqrt(2) * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))


def leaking(rng, views=6, sigma=0.0, leak=1e-2, phases=True):
    """Views of a target at 9.1 m beside a post at 12.3 m that never moves, and the background; with leakage at 0.4 m.

    Returns the views, the background, the target alone as each view's phase turns it, and each view's phase against the
    background's, as a factor.
    """
    turn = np.exp(1j * rng.uniform(0, 2 * np.pi, views + 1) * phases)[:, None]
    static = echo(0.4, leak) + echo(12.3, POST)
    target = echo(9.1, 1e-4 * np.exp(1j * rng.uniform(0, 6, (views, 1))))
    sweeps = np.vstack([target + static, static[None]]) * turn + noise(rng, sigma, (views + 1, COUNT))
    return sweeps[:-1], sweeps[-1], target * turn[:-1], turn[:-1, 0] / turn[-1, 0]


hann = Window("hann").weights


# --- levels ------------------------------------------------------------------------------------------------------


@settings(max_examples=40, derandomize=True)
@given(st.floats(0.2, 19.7), st.floats(-120, 20), st.floats(-3, 3))
def test_an_echo_peaks_with_its_gain_at_its_range(range_m, level_db, phase):
    gain = 10 ** (level_db / 20) * np.exp(1j * phase)
    delay, amplitude = find_peak(echo(range_m, gain), START, STEP)
    assert delay_to_range(delay) == pytest.approx(range_m, abs=1e-6)  # a search to 1e-5 of a sample of 1.2 cm
    assert amplitude == pytest.approx(abs(gain), rel=1e-9)  # flat there: errors of 1e-6 m count squared
    profile, step_m = range_profile(echo(range_m, gain), START, STEP)
    nearest = round(range_m / step_m)
    assert abs(abs(profile).argmax() - nearest) <= 1
    # half a sample off the peak, an eighth of a cell, Hann loses 0.1 dB
    assert db(abs(profile).max()) == pytest.approx(db(gain), abs=0.15)


def test_the_profile_holds_the_echoes_phase_too():
    """At a sample h = g, whatever the carrier: an echo that lies on one is returned as it is."""
    step_m = range_profile(echo(1.0), START, STEP)[1]
    for sample in (3, 500, 900):
        profile = range_profile(echo(sample * step_m, 2 - 1j), START, STEP)[0]
        assert profile[sample] == pytest.approx(2 - 1j, abs=1e-9)


def test_levels_follow_the_window_as_scikit_rf_has_it():
    """Against scikit-rf's band-pass transform of the same sweep.

    ``Network.impulse_response(window, n=N, bandpass=True)`` is fftshift(ifft(w·S, N)), neither divided by the window's
    sum nor multiplied by N. So ours is N/Σw times theirs, and theirs peaks at |g|·Σw/N: with N = K and no window at
    |g|, with Hann 6 dB lower, with zeros appended lower still. Its delays are 1/(N·Δf) apart (scikit-rf's issue #860)
    and centred on 0, so that those of the second half of 1/Δf appear negative.
    ``Network.windowed(normalize=True)``, behind ``s_time``, divides by Σ|w·S|/Σ|S| instead. For one echo that is the
    window's mean, as ours; of several close ones it depends on how they beat: two equal ones a cell apart, in phase in
    mid-band, come out at 3/4, 2.5 dB too low. A window by name is scipy's periodic one, half a frequency off the middle
    of the band, which shifts the phase but not the peak; its level shift in ``time_gate`` (#1399), and what a gate does
    to the ends of the band (#757), are of no concern here, for nothing is gated and turned back.
    """
    gain = 0.3 - 0.2j
    step_m = range_profile(echo(1.0), START, STEP)[1]
    sweep = echo(600 * step_m, gain)
    network = skrf.Network(f=FREQUENCY, f_unit="Hz", s=sweep)
    profile = range_profile(sweep, START, STEP)[0]
    length, weights = len(profile), hann(COUNT)

    time, theirs = network.impulse_response(window=hann, n=length, bandpass=True)
    theirs = np.fft.ifftshift(theirs) * length / weights.sum()
    np.testing.assert_allclose(abs(theirs), abs(profile), atol=1e-12)
    axis = np.mod(np.fft.ifftshift(time), 1 / STEP)
    np.testing.assert_allclose(delay_to_range(axis), step_m * np.arange(length), atol=1e-9)
    assert abs(theirs).max() == pytest.approx(abs(gain), rel=1e-12)

    # scipy's periodic Hann: the same level at the peak
    periodic = network.impulse_response(window="hann", n=length, bandpass=True)[1]
    assert abs(periodic).max() * length / (COUNT / 2) == pytest.approx(abs(gain), rel=1e-9)

    # normalised by the data: right for one echo, on a sample of its own axis of K delays
    near = echo(7 * CELL, gain)
    alone = skrf.Network(f=FREQUENCY, f_unit="Hz", s=near).windowed(window=hann, normalize=True)
    assert abs(np.fft.ifft(alone.s[:, 0, 0])).max() == pytest.approx(abs(gain), rel=1e-9)
    pair = near + echo(8 * CELL, gain * np.exp(2j * np.pi * CARRIER * range_to_delay(CELL)))  # add up in mid-band
    both = skrf.Network(f=FREQUENCY, f_unit="Hz", s=pair).windowed(window=hann, normalize=True)
    ours = np.fft.ifft(pair * hann(COUNT)) * COUNT / weights.sum()
    assert db(np.fft.ifft(both.s[:, 0, 0])[7] / ours[7]) == pytest.approx(db(3 / 4), abs=0.01)


def test_closed_forms_of_reference_targets():
    wavelength = SPEED_OF_LIGHT / CARRIER
    assert echo_gain("plate", 5.0, None, CARRIER) == pytest.approx(wavelength / (4 * np.pi * 10.0))  # its mirror image
    # far away: the radar equation with the cross-section πa²
    far, radius = 1e4, 0.15
    radar = np.sqrt(wavelength**2 * np.pi * radius**2 / ((4 * np.pi) ** 3 * far**4))
    assert echo_gain("sphere", far, radius, CARRIER) == pytest.approx(radar, rel=2 * radius / far)
    # a huge sphere is a plate
    assert echo_gain("sphere", 5.0, 1e9, CARRIER) == pytest.approx(echo_gain("plate", 5.0, None, CARRIER), rel=1e-7)
    # a mirror of focal length a/2: image a·R/(a + 2R) behind the surface, seen again from R before it
    image = radius * 5.0 / (radius + 2 * 5.0)
    assert echo_gain("sphere", 5.0, radius, CARRIER) == pytest.approx(
        wavelength / (4 * np.pi) / 5.0 * image / (image + 5.0)
    )
    with pytest.raises(ConfigError, match="radius_m"):
        echo_gain("sphere", 5.0, None, CARRIER)


# --- background --------------------------------------------------------------------------------------------------


def test_aligned_subtraction_without_noise():
    """What is left of the post and of the phase error is the target's side lobe in the gate: 168 cells off, Hann.

    Its side lobes fall by 18 dB an octave from −31 dB at 2.5 cells: −31 − 18·log₂(168/2.5) = −140 dB of the target, and
    the target is 40 dB below the leakage.
    """
    sweeps, background, target, _ = leaking(np.random.default_rng(0))
    found = subtract_background(sweeps, background, START, STEP, (0.2, 0.7))
    aligned, residual = found.response, found.residual_db
    assert abs(aligned - target).max() < 1e-6 * abs(target).max()
    assert (residual < -120).all()
    assert abs(aligned - target).max() < 1e-7 * POST

    as_they_are = subtract_background(sweeps, background, START, STEP)
    assert np.isnan(as_they_are.residual_db).all()
    assert db(abs(as_they_are.response - target).max() / POST) > 0  # random phases: nothing is gained


def test_coherent_sweeps_need_no_gate():
    sweeps, background, target, _ = leaking(np.random.default_rng(1), phases=False)
    np.testing.assert_allclose(subtract_background(sweeps, background, START, STEP).response, target, atol=1e-17)


def test_aligned_subtraction_under_noise():
    """Noise 20 dB below the leakage in each frequency point: 20 + 10·log₁₀(K/1.5) = 44 dB in the profile.

    Two sweeps have it, half of it turns the phase: φ is off by 1/√SNR = −44 dB as a rule, thrice that at worst. So what
    never changes falls by 34 dB or more; the target stays within four times the noise of two sweeps in the profile.
    In the gate that noise is left: 42 samples of 2·1.5σ²/K each, over six samples' worth of leakage, −33 dB.
    """
    rng = np.random.default_rng(2)
    sigma = 1e-3
    sweeps, background, target, turn = leaking(rng, views=24, sigma=sigma)
    less = subtract_background(sweeps, background, START, STEP, (0.2, 0.7))
    aligned = less.response
    spread = 4 * np.sqrt(2) * sigma * np.sqrt(1.5 / COUNT)
    step_m = range_profile(sweeps[0], START, STEP)[1]
    beside = slice(round(8.6 / step_m), round(9.6 / step_m))
    found = np.array([np.vdot(background, was - now) for was, now in zip(sweeps, aligned, strict=True)])
    assert db(found / abs(found) - turn).max() < -34
    for view in range(24):
        now, clean = (range_profile(h, START, STEP)[0][beside] for h in (aligned[view], target[view]))
        assert abs(now - clean).max() < spread
    assert less.residual_db.mean() == pytest.approx(-33, abs=1)


def test_cables_move_the_gate():
    """Gates are in ranges as measured: with 20 ns of cable the leakage is at 3.4 m."""
    sweeps, background, target, _ = leaking(np.random.default_rng(3))
    cable = np.exp(-2j * np.pi * FREQUENCY * 20e-9)
    shift = delay_to_range(20e-9)
    aligned = subtract_background(sweeps * cable, background * cable, START, STEP, (shift + 0.2, shift + 0.7)).response
    assert abs(aligned - target * cable).max() < 1e-6 * abs(target).max()


def test_gates_and_shapes_are_checked():
    sweeps, background, _, _ = leaking(np.random.default_rng(0))
    with pytest.raises(ConfigError, match=r"align_m = \[0.2, 20.5\] m: beyond the unambiguous range .* = 19.99 m"):
        subtract_background(sweeps, background, START, STEP, (0.2, 20.5))
    with pytest.raises(DataError, match="background has 9 frequencies, the views have 401"):
        subtract_background(sweeps, background[:9], START, STEP, (0.2, 0.5))
    with pytest.raises(DataError, match="nothing in common"):
        subtract_background(sweeps, 0 * background, START, STEP, (0.2, 0.5))
    subtract_background(sweeps, background, START, STEP, (0.3, 0.301))  # narrower than a sample
    subtract_background(sweeps, background, START, STEP, (0.0, FARTHEST))


# --- reference ---------------------------------------------------------------------------------------------------


def reference(**changes):
    return ReferenceSettings(**({"file": "r.s2p", "kind": "sphere", "range_m": 5.0, "radius_m": 0.15} | changes))


@settings(max_examples=25, derandomize=True)
@given(st.floats(0, 60e-9), st.floats(-60, 40), st.integers(0, 2**32 - 1), st.booleans())
def test_cable_delay_and_gain_are_taken_out(cable_s, gain_db, seed, plate):
    """With noise 30 dB below the echo in each point, 54 dB in the profile: range to 1 mm, level to 0.1 dB."""
    rng = np.random.default_rng(seed)
    chosen = reference(kind="plate", radius_m=None) if plate else reference()
    chain = 10 ** (gain_db / 20) * np.exp(-2j * np.pi * FREQUENCY * cable_s)
    level = echo_gain(chosen.kind, 5.0, chosen.radius_m, CARRIER)
    phase = np.exp(1j * rng.uniform(0, 6, 2))
    sphere = (echo(5.0, level) + noise(rng, level * 10**-1.5, COUNT)) * chain * phase[0]
    target = echo(7.7, 1e-4)
    views = np.stack([target * chain * phase[1]] * 2)
    found = calibrate(views, sphere, chosen, START, STEP)
    assert delay_to_range(found.delay_offset_s - cable_s) == pytest.approx(0, abs=1e-3)
    assert 20 * np.log10(found.gain_correction) == pytest.approx(-gain_db, abs=0.1)
    where, amplitude = find_peak(found.response[1], START, STEP)
    assert delay_to_range(where) == pytest.approx(7.7, abs=1e-3)
    assert db(amplitude) == pytest.approx(-80, abs=0.1)


def test_without_noise_the_calibration_is_exact():
    chain = 3.0 * np.exp(-2j * np.pi * FREQUENCY * 17.3e-9)
    level = echo_gain("sphere", 5.0, 0.15, CARRIER)
    target = np.stack([echo(7.7, 1e-4), echo(8.8, 1e-5j)])
    found = calibrate(target * chain, echo(5.0, level) * chain, reference(), START, STEP)
    assert delay_to_range(found.delay_offset_s - 17.3e-9) == pytest.approx(0, abs=1e-6)
    assert found.gain_correction == pytest.approx(1 / 3, rel=1e-8)
    np.testing.assert_allclose(abs(found.response), abs(target), rtol=1e-8)


def test_a_gate_chooses_among_echoes():
    level = echo_gain("sphere", 5.0, 0.15, CARRIER)
    sweep = echo(5.0, level) + echo(0.3, 100 * level) + echo(11.0, 2 * level)
    views = np.zeros((1, COUNT), np.complex128)
    for gate, offset_m in (((4.0, 6.0), 0.0), ((9.0, 15.0), 6.0), (None, -4.7)):
        delay = calibrate(views, sweep, reference(gate_m=gate), START, STEP).delay_offset_s
        assert delay_to_range(delay) == pytest.approx(offset_m, abs=1e-3)  # side lobes of the others, below −100 dB


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"gate_m": (1.0, 21.0)}, ConfigError, r"gate_m = \[1.0, 21.0\] m: beyond the unamb.* = 19.99 m of"),
        ({"range_m": 25.0}, ConfigError, r"reference.range_m = 25 m: beyond the unambiguous range"),
        ({"gate_m": (2.0, 4.98)}, DataError, r"gate_m = \[2.0, 4.98\]: no echo .* has its peak there"),
        ({"gate_m": (5.02, 9.0)}, DataError, "the level rises to beyond the gate"),
        ({"gate_m": (12.0, 18.0)}, DataError, "no echo of the reference stands 15 dB above the median"),
    ],
)  # fmt: skip
def test_references_that_do_not_serve_are_refused(changes, error, match):
    rng = np.random.default_rng(0)
    sweep = echo(5.0, 1e-3) + noise(rng, 1e-4, COUNT)
    with pytest.raises(error, match=match):
        calibrate(sweep[None], sweep, reference(**changes), START, STEP)


def test_noise_alone_and_silence_are_no_reference():
    views = np.ones((1, COUNT), np.complex128)
    rng = np.random.default_rng(0)
    for sweep in (*(noise(rng, 1.0, COUNT) for _ in range(200)), np.zeros(COUNT, np.complex128)):
        with pytest.raises(DataError, match="all ranges: no echo of the reference stands"):
            calibrate(views, sweep, reference(), START, STEP)
    with pytest.raises(DataError, match="reference has 9 frequencies"):
        calibrate(views, np.ones(9, np.complex128), reference(), START, STEP)


def test_no_warning_where_nothing_is_left():
    sweeps = np.stack([echo(0.4)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        residual = subtract_background(sweeps, sweeps[0], START, STEP, (0.2, 0.7)).residual_db
    assert (residual < -200).all()  # rounding
