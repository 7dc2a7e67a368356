"""Synthetic campaigns: the right sum of the right parts, the same for one seed, and back again through the files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from channel_scenes import random_cir, ring_views
from skrf.io.touchstone import Touchstone

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.readers.touchstone import TouchstoneFolder, read_folder
from mvla_sim.channel.readers.touchstone_files import read_touchstone
from mvla_sim.channel.references import (
    BackgroundSettings,
    ReferenceSettings,
    calibrate,
    echo_gain,
    find_peak,
    subtract_background,
)
from mvla_sim.channel.synthesis import EchoSettings, SynthesisSettings, synthesize, write_sweeps
from mvla_sim.constants import delay_to_range, range_to_delay
from mvla_sim.errors import ConfigError, DataError, OutputError
from mvla_sim.scene.antennas.horn import Horn

CLEAN = 300.0
"""dB; noise of 1e-15 of the target."""


def chosen(**changes):
    return SynthesisSettings(**({"points": 301, "snr_db": CLEAN, "random_phase": False} | changes))


def point_cir(ranges_m=(6.0,), level_db=-90.0, views=4):
    """One echo a view and range."""
    count = views * len(ranges_m)
    return Cir(
        np.full(count, 10 ** (level_db / 20), np.complex64),
        range_to_delay(np.tile(np.asarray(ranges_m, np.float64), views)), np.zeros(count, np.uint8),
        np.full((count, 3), np.nan, np.float32), np.full(views, len(ranges_m), np.int64), views=ring_views(views),
        carrier_hz=36e9, bandwidth_hz=3e9,
    )  # fmt: skip


def plain_sum(cir, view, frequency_hz):
    """Σ g_i exp(−j2π(f − f_c)τ_i), path by path."""
    total = np.zeros(len(frequency_hz), np.complex128)
    for gain, delay in zip(cir.gain[cir.rows(view)], cir.delay_s[cir.rows(view)], strict=True):
        total += complex(gain) * np.exp(-2j * np.pi * (frequency_hz - cir.carrier_hz) * delay)
    return total


def plain_echo(range_m, gain_db, frequency_hz):
    return 10 ** (gain_db / 20) * np.exp(-2j * np.pi * frequency_hz * 2 * range_m / 299_792_458)


@pytest.mark.parametrize("points", [301, 302, 1601])
def test_axis_and_sum_are_those_of_the_channel(points):
    cir = random_cir(3, extent_m=2.0, provenance={"from": "here"}, config={"name": "that"})
    campaign = synthesize(cir, chosen(points=points))
    sweeps = campaign.sweeps
    frequency = np.linspace(34.5e9, 37.5e9, points)
    np.testing.assert_allclose(sweeps.frequency_hz, frequency, rtol=1e-15)
    assert (campaign.sweeps.start_hz, campaign.sweeps.step_hz) == (34.5e9, 3e9 / (points - 1))
    assert sweeps.carrier_hz == pytest.approx(36e9)
    leakage = plain_echo(0.3, -55.0, frequency)
    for view in range(cir.n_view):
        # 1e-9: phases of 1e4 rad in double precision, and noise of −300 dB
        np.testing.assert_allclose(sweeps.response[view], plain_sum(cir, view, frequency) + leakage, atol=1e-9)
    np.testing.assert_allclose(campaign.background, leakage, atol=1e-9)
    assert campaign.reference is None
    assert sweeps.views is cir.views
    assert sweeps.extent_m == 2
    assert sweeps.provenance == {"from": "here"}
    assert sweeps.config["name"] == "that"
    assert SynthesisSettings(**sweeps.config["synthesis"]) == chosen(points=points)


def test_parts_come_in_the_order_of_the_hardware():
    """Echoes before the cable, which delays and amplifies everything."""
    cir = point_cir()
    echoes = (EchoSettings(range_m=8.0, gain_db=-80), EchoSettings(range_m=3.0, gain_db=-70))
    parts = {"echoes": echoes, "leakage": EchoSettings(range_m=0.5, gain_db=-60), "reference_range_m": 5.0}
    campaign = synthesize(cir, chosen(cable_delay_s=20e-9, system_gain_db=12.0, **parts))
    frequency = campaign.sweeps.frequency_hz
    static = sum(plain_echo(r, g, frequency) for r, g in ((8, -80), (3, -70), (0.5, -60)))
    sphere = plain_echo(5.0, 20 * np.log10(echo_gain("sphere", 5.0, 0.15, 36e9)), frequency)
    chain = 10**0.6 * np.exp(-2j * np.pi * frequency * 20e-9)
    for got, part in (
        (campaign.sweeps.response[2], plain_sum(cir, 2, frequency)),
        (campaign.background, 0.0),
        (campaign.reference, sphere),
    ):
        np.testing.assert_allclose(got, (part + static) * chain, atol=1e-14)


def test_reference_is_seen_through_the_same_antennas():
    horn = Horn()
    cir = replace(point_cir(), antenna=horn)
    bare, seen = (synthesize(c, chosen(reference_range_m=5.0)) for c in (point_cir(), cir))
    ratio = (seen.reference - seen.background) / (bare.reference - bare.background)
    np.testing.assert_allclose(20 * np.log10(abs(ratio)), 2 * horn.pattern().gain_dbi, atol=1e-6)


@pytest.mark.parametrize("snr_db", [-10.0, 0.0, 20.0])
def test_noise_is_white_circular_and_as_strong_as_asked(snr_db):
    """36 views of 1601 points: the power's spread is 1/√57636 = 0.4 %, 0.02 dB; correlations likewise."""
    cir = point_cir((6.0, 7.1), views=36)
    noisy, clean = (synthesize(cir, chosen(points=1601, snr_db=s)).sweeps.response for s in (snr_db, CLEAN))
    background = synthesize(cir, chosen(points=1601, snr_db=snr_db)).background
    noise = noisy - clean
    target = np.stack([plain_sum(cir, v, np.linspace(34.5e9, 37.5e9, 1601)) for v in range(36)])
    power = np.mean(abs(noise) ** 2)
    assert 10 * np.log10(np.mean(abs(target) ** 2) / power) == pytest.approx(snr_db, abs=0.1)
    assert abs(np.mean(noise**2)) < 0.02 * power  # circular
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1].conj())) < 0.02 * power  # white
    assert abs(np.mean(noise[1:] * noise[:-1].conj())) < 0.02 * power  # another one each view
    assert np.var(noise.real) == pytest.approx(power / 2, rel=0.03)
    empty = background - plain_echo(0.3, -55.0, np.linspace(34.5e9, 37.5e9, 1601))
    assert np.mean(abs(empty) ** 2) == pytest.approx(power, rel=0.1)  # one sweep: 2.5 %


def test_phases_are_one_a_sweep_and_do_not_touch_the_noise():
    cir = point_cir(views=64)
    still, turned = (synthesize(cir, chosen(snr_db=20, reference_range_m=5.0, random_phase=p)) for p in (False, True))
    pairs = [*zip(turned.sweeps.response, still.sweeps.response, strict=True)]
    pairs += [(turned.background, still.background), (turned.reference, still.reference)]
    phases = np.array([(a / b) for a, b in pairs])
    np.testing.assert_allclose(phases, phases[:, :1] * np.ones(301), atol=1e-12)
    np.testing.assert_allclose(abs(phases), 1, atol=1e-12)
    assert len(set(np.angle(phases[:, 0]).round(6))) == 66
    assert abs(phases[:, 0].mean()) < 3 / np.sqrt(66)  # uniform


def test_one_seed_gives_one_campaign_whatever_else_is_swept():
    cir = random_cir(1, 6)
    noisy = chosen(snr_db=10, random_phase=True, reference_range_m=5.0)
    one, again = synthesize(cir, noisy), synthesize(cir, noisy)
    np.testing.assert_array_equal(one.sweeps.response, again.sweeps.response)
    np.testing.assert_array_equal(one.background, again.background)
    np.testing.assert_array_equal(one.reference, again.reference)
    without = synthesize(cir, noisy.model_copy(update={"reference_range_m": None}))
    np.testing.assert_array_equal(one.sweeps.response, without.sweeps.response)
    np.testing.assert_array_equal(one.background, without.background)
    other = synthesize(cir, noisy.model_copy(update={"seed": 1}))
    assert abs(one.background - other.background).min() > 0
    assert abs(one.sweeps.response - other.sweeps.response).min() > 0


def test_channels_that_cannot_be_swept_are_refused():
    with pytest.raises(ConfigError, match=r"synthesis.points = 100: echoes at delays of 4e-08 s fold at 1/Δf"):
        synthesize(point_cir((6.0,)), chosen(points=100))
    least = 300 * 6.0 / (299_792_458 / 2 / 3e9 * 300)
    synthesize(point_cir((6.0,)), chosen(points=int(np.ceil(least)) + 2))
    for far in (
        {"cable_delay_s": 70e-9},
        {"reference_range_m": 16.0},
        {"echoes": (EchoSettings(range_m=16, gain_db=-80),)},
        {"leakage": EchoSettings(range_m=16, gain_db=-80)},
    ):
        with pytest.raises(ConfigError, match="fold at"):
            synthesize(point_cir((6.0,)), chosen(**far))
    silent = replace(point_cir(), gain=np.zeros(4, np.complex64))
    for cir in (silent, point_cir(()), point_cir(level_db=-np.inf)):
        with pytest.raises(DataError, match="no view of the channel has an echo"):
            synthesize(cir, chosen())


# --- files -------------------------------------------------------------------------------------------------------


def test_files_hold_the_sweeps_exactly(tmp_path):
    campaign = synthesize(random_cir(2, 5), chosen(snr_db=15, reference_range_m=5.0))
    angles = [0.0, 10.0, 20.5, 100.0, -5.0]
    files = write_sweeps(campaign, tmp_path / "made", "car", angles)
    assert [file.name for file in files] == [
        "car_000.0deg.s2p", "car_010.0deg.s2p", "car_020.5deg.s2p", "car_100.0deg.s2p", "car_-05.0deg.s2p",
        "background.s2p", "reference.s2p",
    ]  # fmt: skip
    assert sorted(files) == sorted((tmp_path / "made").iterdir())
    channels = [*campaign.sweeps.response, campaign.background, campaign.reference]
    for file, channel in zip(files, channels, strict=True):
        s = Touchstone(file).s
        np.testing.assert_array_equal(s[:, 1, 0], channel)
        np.testing.assert_array_equal(s[:, 0, 1], channel)
        for port in (0, 1):
            assert abs(s[:, port, port].mean()) == pytest.approx(0.1, abs=0.05)
            assert np.ptp(s[:, port, port].real) > 0
        assert (s[:, 0, 0] != s[:, 1, 1]).all()
    assert write_sweeps(campaign, tmp_path / "made", "car", angles) == files  # again over its own


@pytest.mark.parametrize(
    ("angles", "names"),
    [
        ([0, 11.25, 22.5], ["x_000.00deg.s2p", "x_011.25deg.s2p", "x_022.50deg.s2p"]),
        ([-0.0, 1 / 3, 359.9], ["x_000.000000deg.s2p", "x_000.333333deg.s2p", "x_359.900000deg.s2p"]),
        ([10.000000001, 20, 30], ["x_010.0deg.s2p", "x_020.0deg.s2p", "x_030.0deg.s2p"]),
    ],
)
def test_names_say_the_whole_angle(tmp_path, angles, names):
    campaign = synthesize(point_cir(views=3), chosen(points=201))
    assert [file.name for file in write_sweeps(campaign, tmp_path, "x", angles)] == [*names, "background.s2p"]
    read = read_folder(TouchstoneFolder(background=BackgroundSettings(file=str(tmp_path / "background.s2p"))), tmp_path)
    np.testing.assert_allclose(read.angles_deg, angles, atol=1e-6)


def test_what_cannot_be_written_is_refused_before_anything_is(tmp_path):
    campaign = synthesize(point_cir(views=3), chosen(points=201))
    for angles, match in (
        ([0, 10, 10], "views 1 and 2 are both at 10°"),
        ([0, 10, 360], "views 0 and 2 are both at 360°"),
        ([-10, 0, 350], "views 0 and 2"),
        ([0, 1e-8, 1], "views 0 and 1"),
        ([0, 10], "3 finite angles"),
        ([0, 10, np.nan], "3 finite angles"),
    ):
        with pytest.raises(DataError, match=match):
            write_sweeps(campaign, tmp_path, "x", angles)
    for prefix in ("", "../x", "a/b", "a\\b", ".", "..", ".x"):
        with pytest.raises(ConfigError, match="prefix = "):
            write_sweeps(campaign, tmp_path, prefix, [0, 1, 2])
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "x_003.0deg.s2p").write_text("an older view")
    with pytest.raises(OutputError, match=r"holds other sweeps, such as x_003.0deg.s2p"):
        write_sweeps(campaign, tmp_path, "x", [0, 1, 2])
    with pytest.raises(OutputError, match="cannot be written"):
        write_sweeps(campaign, tmp_path / "x_003.0deg.s2p", "x", [0, 1, 2])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_campaign_leads_back_to_the_channel(tmp_path, seed):
    """Phases, leakage, a post, noise, 23 ns of cable and 17 dB of gain: ranges to 1 mm, levels to 0.1 dB.

    Noise lies 45 dB below the target, 24 dB below the sphere, and 10·log₁₀(601/1.5) = 26 dB lower in the profile: the
    sphere's level, with the noise of two sweeps, is known to 10^(−47/20)/√2 = 0.3 %, 0.03 dB. The post, 12 dB above the
    target, falls by the phase's error: leakage is 80 dB above the noise and 106 in the profile, so into the noise.
    """
    cir = point_cir((6.0,), level_db=-90.0, views=5)
    campaign = synthesize(
        cir,
        SynthesisSettings(
            points=601, snr_db=45, seed=seed, cable_delay_s=23e-9, system_gain_db=17.0, reference_range_m=4.0,
            echoes=(EchoSettings(range_m=9.0, gain_db=-78.0),),
        ),
    )  # fmt: skip
    write_sweeps(campaign, tmp_path, "car", cir.views.angles_deg)
    sweeps = TouchstoneFolder(
        background=BackgroundSettings(file=str(tmp_path / "background.s2p"), align_m=(3.5, 4.1)),
        reference=ReferenceSettings(
            file=str(tmp_path / "reference.s2p"), kind="sphere", range_m=4.0, radius_m=0.15, gate_m=(7.0, 8.0)
        ),
    )
    swept = read_folder(sweeps, tmp_path)
    start, step, response = swept.start_hz, swept.step_hz, swept.response
    np.testing.assert_allclose(swept.angles_deg, cir.views.angles_deg)
    assert len(swept.files) == 5
    background = read_touchstone(sweeps.background.file).response
    gate = sweeps.background.align_m
    echoes = subtract_background(response, background, start, step, gate)
    sphere = subtract_background(read_touchstone(sweeps.reference.file).response[None], background, start, step, gate)
    scaled = calibrate(echoes.response, sphere.response[0], sweeps.reference, start, step)
    result, gain = scaled.response, scaled.gain_correction
    assert (echoes.residual_db < -40).all()
    assert delay_to_range(scaled.delay_offset_s - 23e-9) == pytest.approx(0, abs=1e-3)
    assert 20 * np.log10(gain) == pytest.approx(-17, abs=0.1)
    for view in range(5):
        where, amplitude = find_peak(result[view], start, step)
        assert delay_to_range(where) == pytest.approx(6.0, abs=1e-3)
        assert 20 * np.log10(amplitude) == pytest.approx(-90, abs=0.1)
        post = find_peak(response[view] * gain, start, step, (9.0 + 3.4, 9.0 + 3.5))[1]
        assert 20 * np.log10(post) == pytest.approx(-78, abs=0.1)
        profile = abs(np.fft.ifft(result[view] * np.hanning(601), 2404)) * 2404 / 300
        beyond = profile[round(8.5 / (15 / 2404 * 2)) :]  # 8.5 m to the unambiguous 30 m
        assert 20 * np.log10(beyond.max()) < -90 - 45 - 26 + 3 + 12  # two sweeps' noise, its peaks
