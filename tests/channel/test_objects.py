"""Channels in memory: rows and selections, what is refused, how they compare and print."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from channel_scenes import random_cir, ring_views
from kinds_of_channel import EVERY_KIND, MAKERS, name_of, random_components, random_response, views_of

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import SPEED_OF_LIGHT, delay_to_range
from mvla_sim.errors import DataError

every_kind = pytest.mark.parametrize("kind", EVERY_KIND, ids=name_of)


@every_kind
def test_a_channel_equals_itself_and_can_be_a_key(kind):
    channel, other = MAKERS[kind](), MAKERS[kind]()
    assert channel == channel  # noqa: PLR0124 - it is what raised
    assert channel != other
    assert {channel: 1, other: 2}[channel] == 1


@every_kind
def test_a_channel_prints_in_one_short_line(kind):
    text = repr(MAKERS[kind](0, 72, config={"name": "x" * 999}))
    assert text.startswith(f"{kind.__name__}(72 views, ")
    assert len(text) < 160
    assert "\n" not in text
    assert "D = 4 m" in text
    assert "nan" not in repr(MAKERS[kind](extent_m=float("nan")))


@every_kind
def test_selection_takes_whole_views_in_the_order_given(kind):
    channel = MAKERS[kind](1, 6, views=views_of(6))
    taken = np.array([4, 0, 3])  # view 3 has no path or component
    some = channel.select(taken)
    np.testing.assert_array_equal(some.views.angles_deg, channel.views.angles_deg[taken])
    np.testing.assert_array_equal(some.views.receivers_m, channel.views.receivers_m[taken])
    np.testing.assert_array_equal(some.views.boresights, channel.views.boresights[taken])
    for field in {item.field for item in kind.VARIABLES} - {"frequency_hz", "row_size"}:
        for new, old in enumerate(taken):
            first, second = (
                getattr(c, field)[n if kind is FrequencyResponse else c.rows(n)]
                for c, n in ((some, new), (channel, old))
            )
            np.testing.assert_array_equal(first, second)
    if kind is not FrequencyResponse:
        np.testing.assert_array_equal(some.row_size, channel.row_size[taken])
        assert channel.select(np.array([3])).row_start.tolist() == [0, 0]
    assert channel.select(np.zeros(1, np.intp)).n_view == 1


def test_rows_begin_where_the_ones_before_end():
    cir = random_cir(count=6)
    assert cir.row_start[0] == 0
    assert cir.row_start[-1] == cir.gain.size
    np.testing.assert_array_equal(np.diff(cir.row_start), cir.row_size)
    for view in range(6):
        np.testing.assert_array_equal(np.flatnonzero(cir.row_index == view), np.arange(cir.gain.size)[cir.rows(view)])
    assert cir.elements(np.zeros(0, np.intp)).size == 0
    np.testing.assert_array_equal(cir.range_m, delay_to_range(cir.delay_s))


def test_axis_and_what_follows_from_it():
    response = random_response(points=401)
    assert response.n_view == 5
    np.testing.assert_allclose(response.frequency_hz, np.linspace(34.5e9, 37.5e9, 401), rtol=1e-15)
    assert response.carrier_hz == 36e9
    assert response.bandwidth_hz == 401 * 7.5e6  # each frequency an equal share
    assert response.unambiguous_range_m == pytest.approx(SPEED_OF_LIGHT / 15e6)
    assert dataclasses.replace(response, start_hz=35.5e9).carrier_hz == 37e9


def test_phase_per_view_turns_gains_and_nothing_else():
    cir = random_cir()
    phase = np.linspace(-3, 3, cir.n_view)
    turned = cir.with_phases(phase)
    np.testing.assert_allclose(np.abs(turned.gain), np.abs(cir.gain), rtol=3e-7)  # complex64
    for view in range(cir.n_view):
        angle = np.angle(turned.gain[cir.rows(view)] / cir.gain[cir.rows(view)])
        np.testing.assert_allclose(angle, phase[view], atol=1e-6)  # complex64
    np.testing.assert_array_equal(turned.delay_s, cir.delay_s)
    response = random_response()
    turned = response.with_phases(phase)
    np.testing.assert_allclose(turned.response, response.response * np.exp(1j * phase)[:, None], rtol=1e-15)
    assert turned.views is response.views


INCONSISTENT = {
    Cir: [
        ("delay_s", np.zeros(1), "lengths"),
        ("interaction", np.zeros(1, np.uint8), "lengths"),
        ("first_point_m", np.zeros((1, 3), np.float32), "first_point_m has shape"),
        ("row_size", np.zeros(1, np.int64), "entries for 5 views"),
        ("row_size", np.array([-1, 1, 0, 0, 0]), "adds up"),
        ("views", ring_views(3), "entries for 3 views"),
        ("carrier_hz", 0.0, "must be above 0"),
        ("bandwidth_hz", float("nan"), "must be above 0"),
    ],
    FrequencyResponse: [
        ("response", np.zeros((5, 1), np.complex128), r"shape \(5, 1\); allowed: \[n_view, n_frequency >= 2\]"),
        ("response", np.zeros(5, np.complex128), "shape"),
        ("response", np.zeros((4, 9), np.complex128), "4 responses for 5 views"),
        ("response", np.full((5, 9), np.nan + 0j), r"not finite \(45 such\)"),
        ("views", ring_views(3), "5 responses for 3 views"),
        ("step_hz", 0.0, "the step must be > 0"),
        ("step_hz", -1e6, "the step must be > 0"),
        ("step_hz", float("nan"), "the step must be > 0"),
        ("start_hz", float("inf"), "start inf Hz"),
        ("start_hz", -36e9, "must be above 0"),
    ],
    Components: [
        ("range_m", np.zeros(1), "1 ranges"),
        ("power", np.zeros(1), "1 powers"),
        ("row_size", np.zeros(5, np.int64), "row_size adds up to 0"),
        ("views", ring_views(3), "row_size has 5 entries for 3 views"),
        ("carrier_hz", 0.0, "must be above 0"),
        ("bandwidth_hz", float("nan"), "must be above 0"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "name", "value", "match"), [(kind, *case) for kind in EVERY_KIND for case in INCONSISTENT[kind]]
)
def test_inconsistent_objects_are_refused(kind, name, value, match):
    with pytest.raises(DataError, match=match):
        dataclasses.replace(MAKERS[kind](), **{name: value})


@pytest.mark.parametrize("make", [random_cir, random_components])
def test_a_negative_row_is_refused_though_the_sum_is_right(make):
    channel = make()
    rows = channel.row_size.copy()
    rows[[0, 2]] = rows[0] + 1, -1
    with pytest.raises(DataError, match="row_size"):
        dataclasses.replace(channel, row_size=rows)
