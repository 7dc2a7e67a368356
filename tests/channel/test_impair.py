"""Impairments of a channel: each does to delays, gains and positions what physics says, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.impairments import ImpairmentSettings, assumed_views, impair, impair_channel, remaining_views
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import SPEED_OF_LIGHT, range_to_delay
from mvla_sim.errors import ConfigError
from mvla_sim.scene.views import Views

GATE = (5.0, 15.0)
EVERY = {
    "position_error_m": 0.01,
    "timing_offset_s": 1e-9,
    "timing_jitter_s": 1e-9,
    "random_phase": True,
    "clutter_paths": 5.0,
}


def ring(count, radius_m=10.0):
    angles = 360 / count * np.arange(count)
    turn = np.deg2rad(angles)
    return Views(np.stack([radius_m * np.cos(turn), radius_m * np.sin(turn), 0 * turn], axis=1), angles, (0.0, 0.0))


def channel(n_view=8, paths=3, **fields):
    """Paths at 9, 10, 11, … m of falling gain in every view, none in the last."""
    size = np.full(n_view, paths)
    size[-1] = 0
    ranges = np.tile(9.0 + np.arange(paths), n_view - 1)
    gains = np.tile(0.5 ** np.arange(paths), n_view - 1) * np.exp(1j * np.arange(ranges.size))
    return Cir(
        gains.astype(np.complex64), range_to_delay(ranges), np.ones(ranges.size, np.uint8),
        np.zeros((ranges.size, 3), np.float32), size, views=ring(n_view), carrier_hz=36e9, bandwidth_hz=3e9,
        **({"extent_m": 4.0} | fields),
    )  # fmt: skip


def impaired(cir, **values):
    return impair(cir, ImpairmentSettings(**values), GATE)


def same(one, other, *names):
    return all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in names)


PATHS = ("gain", "delay_s", "interaction", "first_point_m", "row_size")


def test_nothing_happens_by_default():
    cir = channel()
    assert ImpairmentSettings().acting == ()
    assert ImpairmentSettings().of_channel(3) is None
    assert same(impaired(cir), cir, *PATHS)
    assert impaired(cir).views is cir.views


def test_a_position_error_moves_the_views_and_leaves_the_paths():
    cir = channel(4000)
    wrong = impaired(cir, position_error_m=0.02)
    assert same(wrong, cir, *PATHS)
    error = wrong.views.positions_m - cir.views.positions_m
    assert error[:, :2].std(axis=0) == pytest.approx(0.02, rel=0.05)
    assert error[:, :2].mean(axis=0) == pytest.approx(0, abs=4 * 0.02 / np.sqrt(4000))
    assert np.corrcoef(error[:, 0], error[:, 1])[0, 1] == pytest.approx(0, abs=4 / np.sqrt(4000))
    assert not error[:, 2].any()
    seen = np.arctan2(wrong.views.positions_m[:, 1], wrong.views.positions_m[:, 0])
    np.testing.assert_allclose(np.cos(seen - np.deg2rad(wrong.views.angles_deg)), 1)


def test_a_larger_error_is_the_same_one_scaled_and_a_views_own():
    few, many = ring(6), ring(12).select(np.arange(6))
    small = assumed_views(few, ImpairmentSettings(position_error_m=0.001)).positions_m - few.positions_m
    large = assumed_views(few, ImpairmentSettings(position_error_m=0.01)).positions_m - few.positions_m
    np.testing.assert_allclose(large, 10 * small, atol=1e-14)
    others = assumed_views(many, ImpairmentSettings(position_error_m=0.01)).positions_m - many.positions_m
    np.testing.assert_allclose(others, large, atol=1e-14)


def test_the_receiver_of_a_pair_moves_with_its_transmitter_and_boresights_stay():
    views = ring(5)
    ahead = -views.positions_m / 10
    pairs = Views(views.positions_m, views.angles_deg, (0, 0), views.positions_m + np.array([0, 0, 0.2]), ahead)
    seen = assumed_views(pairs, ImpairmentSettings(position_error_m=0.05))
    assert not np.array_equal(seen.positions_m, pairs.positions_m)
    np.testing.assert_allclose(seen.receivers_m - seen.positions_m, np.tile([0, 0, 0.2], (5, 1)), atol=1e-12)
    np.testing.assert_allclose(seen.boresights, ahead)


def test_a_timing_offset_shifts_every_delay_and_keeps_the_phase():
    cir = channel()
    for offset in (2e-9, -2e-9):
        late = impaired(cir, timing_offset_s=offset)
        np.testing.assert_allclose(late.delay_s - cir.delay_s, offset, rtol=1e-6)
        np.testing.assert_allclose(late.range_m - cir.range_m, offset * SPEED_OF_LIGHT / 2, rtol=1e-6)
        assert same(late, cir, "gain", "row_size")


def test_jitter_is_one_gaussian_delay_a_view():
    cir = channel(4001)
    late = impaired(cir, timing_jitter_s=1e-10)
    delays = (late.delay_s - cir.delay_s).reshape(4000, 3)
    np.testing.assert_allclose(delays, delays[:, :1].repeat(3, axis=1), atol=1e-20)
    assert delays[:, 0].std() == pytest.approx(1e-10, rel=0.05)
    assert delays[:, 0].mean() == pytest.approx(0, abs=4e-10 / np.sqrt(4000))


def test_a_random_phase_is_one_angle_a_view_uniform_over_the_circle():
    cir = channel(4001)
    turned = impaired(cir, random_phase=True)
    ratio = (turned.gain / cir.gain).reshape(4000, 3)
    np.testing.assert_allclose(np.abs(ratio), 1, rtol=1e-5)
    np.testing.assert_allclose(ratio, ratio[:, :1].repeat(3, axis=1), rtol=1e-5)
    phases = np.angle(ratio[:, 0])
    for order in (1, 2, 3):
        assert abs(np.exp(1j * order * phases).mean()) < 4 / np.sqrt(4000)
    assert same(turned, cir, "delay_s", "row_size")


def test_clutter_is_a_poisson_number_of_echoes_of_exponential_power_over_the_gate():
    cir = channel(1001)
    seen = impaired(cir, clutter_paths=20.0, clutter_db=-7.0)
    added = seen.row_size - cir.row_size
    assert added[:-1].mean() == pytest.approx(20, rel=0.03)
    assert added[:-1].var() == pytest.approx(20, rel=0.2)  # as of a Poisson number
    assert added[-1] == 0  # relative to nothing
    false = np.isnan(seen.first_point_m[:, 0])
    assert false.sum() == added.sum()
    assert not seen.interaction[false].any()
    ranges = seen.range_m[false]
    assert (ranges >= GATE[0]).all()
    assert (ranges <= GATE[1]).all()
    assert np.histogram(ranges, 10, GATE)[0] == pytest.approx(ranges.size / 10, rel=0.15)
    power = np.abs(seen.gain[false].astype(complex)) ** 2
    assert power.mean() == pytest.approx(10**-0.7, rel=0.03)
    assert power.std() == pytest.approx(power.mean(), rel=0.05)  # as of an exponential one
    assert abs(np.mean(seen.gain[false])) < 0.02
    true = ~false
    assert all(np.array_equal(getattr(seen, n)[true], getattr(cir, n)) for n in PATHS[:4])  # in their order


def test_clutter_follows_each_views_strongest_path():
    cir = channel(400)
    scale = np.repeat(np.where(np.arange(400) < 200, 1.0, 10.0), cir.row_size).astype(np.float32)
    louder = replace(cir, gain=cir.gain * scale)
    seen = impaired(louder, clutter_paths=20.0, clutter_db=0.0)
    view = np.repeat(np.arange(400), seen.row_size)
    false = np.isnan(seen.first_point_m[:, 0])
    quiet, loud = (np.mean(np.abs(seen.gain[false & part]) ** 2) for part in (view < 200, view >= 200))
    assert loud / quiet == pytest.approx(100, rel=0.15)


@pytest.mark.parametrize("name", EVERY)
def test_the_same_seed_is_the_same_realisation_and_another_one_is_not(name):
    cir = channel()
    first, again, other = (impaired(cir, **{name: EVERY[name]}, seed=seed) for seed in (1, 1, 2))
    assert same(first, again, *PATHS)
    assert np.array_equal(first.views.positions_m, again.views.positions_m)
    alike = same(first, other, *PATHS) and np.array_equal(first.views.positions_m, other.views.positions_m)
    assert alike == (name == "timing_offset_s")


@pytest.mark.parametrize("name", EVERY)
def test_each_impairment_draws_from_a_stream_of_its_own(name):
    """What one does is the same with all the others on and off."""
    cir = channel(20)
    alone, together = impaired(cir, **{name: EVERY[name]}), impaired(cir, **EVERY)
    others = impaired(cir, **{k: v for k, v in EVERY.items() if k != name})
    false = {id(c): np.isnan(c.first_point_m[:, 0]) for c in (alone, together, others)}
    true = {id(c): ~false[id(c)] for c in (alone, together, others)}
    if name == "position_error_m":
        assert np.array_equal(alone.views.positions_m, together.views.positions_m)
    elif name == "clutter_paths":
        assert np.array_equal(alone.delay_s[false[id(alone)]], together.delay_s[false[id(together)]])
        np.testing.assert_allclose(alone.gain[false[id(alone)]], together.gain[false[id(together)]], rtol=1e-5)
    elif name == "random_phase":
        turn = together.gain[true[id(together)]] / others.gain[true[id(others)]]
        np.testing.assert_allclose(turn, alone.gain / cir.gain, rtol=1e-5)
    else:
        late = together.delay_s[true[id(together)]] - others.delay_s[true[id(others)]]
        np.testing.assert_allclose(late, alone.delay_s - cir.delay_s, atol=1e-22)


@pytest.mark.parametrize("values", [{"timing_offset_s": -1e-7}, {"timing_jitter_s": 1e-6}])
def test_a_delay_below_zero_is_refused(values):
    with pytest.raises(ConfigError, match=f"impairments.{next(iter(values))} = .*none may be below 0") as raised:
        impaired(channel(), **values)
    assert "\n" not in str(raised.value)


def measured(kind):
    views = ring(4)
    if kind == "components":
        return Components(
            np.full(4, 9.0), np.ones(4), np.ones(4, np.int64), views=views, carrier_hz=36e9, bandwidth_hz=3e9
        )
    return FrequencyResponse(np.ones((4, 11), complex), 35e9, 2e8, views=views)


@pytest.mark.parametrize("kind", ["components", "frequency responses"])
@pytest.mark.parametrize("name", ["timing_offset_s", "timing_jitter_s", "random_phase", "clutter_paths"])
def test_measured_channels_refuse_impairments_of_paths_by_name(kind, name):
    with pytest.raises(ConfigError, match=f"impairments.{name} = .*needs traced paths.*{kind}") as raised:
        impair_channel(measured(kind), ImpairmentSettings(**{name: EVERY[name]}), GATE)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("kind", ["components", "frequency responses"])
def test_measured_channels_take_a_position_error(kind):
    found = impair_channel(measured(kind), ImpairmentSettings(position_error_m=0.01), GATE)
    assert type(found) is type(measured(kind))
    assert np.ptp(found.views.positions_m - ring(4).positions_m) > 0


def test_what_acts_on_a_channel_is_all_that_tells_channels_apart():
    """Seeds of impairments that draw nothing, and views that are lost later, make no other channel."""
    of = lambda noise_seed=0, **values: ImpairmentSettings(**values).of_channel(noise_seed)  # noqa: E731
    assert of(missing_share=0.5, blocked_sector_deg=(0, 90), seed=3, clutter_db=3.0) is None
    assert of(1, timing_offset_s=1e-9) == of(2, timing_offset_s=1e-9, missing_share=0.5)
    assert of(1, random_phase=True) != of(2, random_phase=True)
    assert of(1, random_phase=True, seed=7) == of(2, random_phase=True, seed=7, clutter_db=3.0)
    assert of(clutter_paths=1, clutter_db=3.0) != of(clutter_paths=1)


@pytest.mark.parametrize(
    ("sector", "lost"),
    [
        ((40.0, 60.0), [4, 5]),
        ((350.0, 10.0), [35, 0]),
        ((0.0, 350.0), list(range(35))),
        ((90.0, 90.0), []),
        ((41.0, 49.0), []),
        ((360.0, 20.0), [0, 1]),
    ],
)
def test_a_blocked_sector_takes_exactly_its_views(sector, lost):
    left = remaining_views(ring(36), np.arange(36), ImpairmentSettings(blocked_sector_deg=sector))
    assert sorted({*range(36)} - {*left.tolist()}) == sorted(lost)


def test_missing_views_are_an_exact_share_and_nested():
    views, chosen = ring(72), np.arange(1, 72, 2)
    left = {
        share: {*remaining_views(views, chosen, ImpairmentSettings(missing_share=share, seed=5)).tolist()}
        for share in (0.0, 0.25, 0.5, 0.9)
    }
    assert [len(left[share]) for share in left] == [36, 27, 18, 4]
    assert left[0.0] > left[0.25] > left[0.5] > left[0.9]
    other = remaining_views(views, chosen, ImpairmentSettings(missing_share=0.5, seed=6))
    assert {*other.tolist()} != left[0.5]
    both = remaining_views(views, chosen, ImpairmentSettings(missing_share=0.5, seed=5, blocked_sector_deg=(0.0, 90.0)))
    assert {*both.tolist()} == {view for view in left[0.5] if views.angles_deg[view] >= 90}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"missing_share": 1.0}, "missing_share = 1.0: none of the 8"),
        ({"blocked_sector_deg": (0.0, 360.0)}, r"blocked_sector_deg = \[0.0, 360.0\]: none of the 8"),
        ({"missing_share": 0.5, "blocked_sector_deg": (0.0, 350.0)}, "missing_share = 0.5, blocked_sector_deg"),
    ],
)
def test_all_views_lost_is_one_line(values, said):
    with pytest.raises(ConfigError, match=said) as raised:
        remaining_views(ring(8), np.arange(8), ImpairmentSettings(**values))
    assert "\n" not in str(raised.value)
