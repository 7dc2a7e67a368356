"""Views with receivers of their own and boresights: what they hold, where pairs stand, and where antennas point."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.pointing import PointingSettings, side_by_side
from mvla_sim.scene.trajectories.arc import Arc
from mvla_sim.scene.trajectories.circle import Circle
from mvla_sim.scene.trajectories.line import Line
from mvla_sim.scene.trajectories.positions import Positions
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import Scene, SceneSettings
from mvla_sim.settings import parse

ORIGIN = (0.0, 0.0)
ROUNDING = 1e-12  # metres of coordinates of some tens of metres; and of unit vectors
coordinates = st.floats(-20, 20)
angles = st.floats(-400, 400)
CIRCLE = {"radius_m": 5.0, "interval_deg": 30.0, "center_m": (1.0, -2.0), "height_m": 1.5}


def circle(pointing=None, **values):
    kind = Circle(**(CIRCLE | values), pointing=PointingSettings(**(pointing or {})))
    return kind.build_views((99.0, 99.0))


def plain(count=3, **fields):
    turn = 2 * np.pi * np.arange(count) / count
    positions = 4 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    return Views(positions, np.rad2deg(turn), ORIGIN, **fields)


# What views hold.


def test_views_without_receivers_or_boresights_are_colocated_and_look_at_the_centre():
    views = circle()
    assert views.receivers_m is None
    assert views.boresights is None
    np.testing.assert_array_equal(views.midpoints_m, views.positions_m)
    offset = np.array([1.0, -2.0, 1.5]) - views.positions_m
    np.testing.assert_allclose(views.directions, offset / 5, atol=ROUNDING)


def test_pair_looks_from_its_middle_at_the_centre():
    views = plain(receivers_m=plain().positions_m + np.array([0, 2, 1]))
    np.testing.assert_allclose(views.midpoints_m, views.positions_m + np.array([0, 1, 0.5]), atol=ROUNDING)
    towards = -views.midpoints_m * [1, 1, 0]
    np.testing.assert_allclose(views.directions, towards / np.linalg.norm(towards, axis=1, keepdims=True))


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"receivers_m": np.zeros((2, 3))}, "receivers_m has 2 entries; 3 positions need one each"),
        ({"receivers_m": np.zeros((3, 2))}, r"receivers_m has shape \(3, 2\)"),
        ({"receivers_m": np.full((3, 3), np.nan)}, "receiver 0 .*not finite"),
        ({"boresights": np.tile([1.0, 0, 0], (4, 1))}, "boresights has 4 entries"),
        ({"boresights": np.array([[1.0, 0, 0], [0, 1, np.inf], [1, 0, 0]])}, "boresight 1 .*not finite"),
        ({"boresights": np.array([[1.0, 0, 0], [0, 0, 0], [1, 0, 0]])}, "boresight 1 has length 0; .*unit"),
        ({"boresights": np.array([[1.0, 0, 0], [1, 0, 0], [1, 0.01, 0]])}, "boresight 2 has length 1.00005"),
    ],
)
def test_views_refuse_receivers_and_boresights_that_are_none(fields, says):
    with pytest.raises(DataError, match=says):
        plain(**fields)


def test_boresights_are_made_exactly_unit_and_everything_is_read_only():
    given_ = np.tile([0.6, 0.8 + 5e-7, 0.0], (3, 1))
    views = plain(boresights=given_, receivers_m=np.ones((3, 3)))
    np.testing.assert_allclose(np.linalg.norm(views.boresights, axis=1), 1, rtol=1e-15)
    given_[:] = 0
    assert views.boresights[0, 0] > 0
    for array in (views.boresights, views.receivers_m):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 5


def test_view_above_the_centre_needs_a_boresight():
    above = np.array([[0.0, 0, 5], [3, 0, 5]])
    with pytest.raises(DataError, match=r"view 0 stands above the centre.*give boresights"):
        _ = Views(above, np.zeros(2), ORIGIN).directions
    down = np.tile([0.0, 0, -1], (2, 1))
    np.testing.assert_array_equal(Views(above, np.zeros(2), ORIGIN, boresights=down).directions, down)


@settings(max_examples=30)
@given(st.permutations(range(12)), st.integers(1, 12))
def test_selection_keeps_receivers_and_boresights_with_their_positions(order, count):
    views = circle({"elevation_deg": -20.0}, pair_separation_m=0.4)
    taken = np.array(order[:count])
    chosen = views.select(taken)
    for name in ("positions_m", "receivers_m", "boresights", "midpoints_m", "directions"):
        np.testing.assert_array_equal(getattr(chosen, name), getattr(views, name)[taken])


# Pairs side by side.


@settings(max_examples=60)
@given(st.floats(0.01, 5), st.floats(0.5, 20), st.tuples(coordinates, coordinates), st.floats(-80, 80), angles)
def test_pair_stands_on_both_sides_of_its_position(separation, radius, center, elevation, start):
    """Middle, distance, across the beam, level, and the transmitter on the left as seen along the beam."""
    values = {"radius_m": radius, "center_m": center, "start_deg": start}
    views = circle({"elevation_deg": elevation}, pair_separation_m=separation, **values)
    alone = circle({"elevation_deg": elevation}, **values)
    np.testing.assert_allclose(views.midpoints_m, alone.positions_m, atol=ROUNDING * 10)
    across = views.positions_m - views.receivers_m
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), separation, rtol=1e-9)  # coordinates of 40 m
    np.testing.assert_allclose((across * views.directions).sum(axis=1), 0, atol=ROUNDING * 10)
    assert (across[:, 2] == 0).all()
    left = np.cross([0, 0, 1], views.directions)
    np.testing.assert_allclose((across * left).sum(axis=1), separation * np.cos(np.deg2rad(elevation)), rtol=1e-9)
    np.testing.assert_array_equal(views.angles_deg, alone.angles_deg)
    np.testing.assert_allclose(views.directions, alone.directions, atol=1e-9)  # a middle is rounded, 0.5 m from centre


def test_transmitter_is_on_the_left_of_a_beam_to_the_north():
    kind = Line(
        kind="line", start_m=(-1, -3, 0), stop_m=(1, -3, 0), views=3, pair_separation_m=0.5,
        pointing=PointingSettings(azimuth_deg=90.0),
    )  # fmt: skip
    views = kind.build_views(ORIGIN)
    np.testing.assert_allclose(views.positions_m[:, 0], [-1.25, -0.25, 0.75], atol=ROUNDING)
    np.testing.assert_allclose(views.receivers_m[:, 0], [-0.75, 0.25, 1.25], atol=ROUNDING)


def test_separation_zero_is_a_colocated_pair():
    views = circle()
    assert side_by_side(views, 0.0) is views
    assert circle(pair_separation_m=0.0).receivers_m is None


def test_every_kind_of_moving_sensor_takes_pairs_and_pointing():
    equip = {"pair_separation_m": 0.3, "pointing": PointingSettings(elevation_deg=-10.0)}
    kinds = [
        Circle(interval_deg=90.0, **equip),
        Arc(start_deg=0, stop_deg=30, interval_deg=10, **equip),
        Line(start_m=(3, 0, 0), stop_m=(3, 4, 0), views=4, **equip),
        Positions(positions_m=((3.0, 0.0, 0.0), (3.0, 1.0, 0.0)), **equip),
    ]
    for kind in kinds:
        views = kind.build_views(ORIGIN)
        np.testing.assert_allclose(np.linalg.norm(views.positions_m - views.receivers_m, axis=1), 0.3, rtol=1e-9)
        np.testing.assert_allclose(views.boresights[:, 2], np.sin(np.deg2rad(-10)), rtol=1e-9)
        towards = -views.midpoints_m[:, :2]
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        np.testing.assert_allclose(views.boresights[:, :2], np.cos(np.deg2rad(10)) * towards, atol=1e-9)


# Pointing of a sensor that moves.


@settings(max_examples=40)
@given(angles, st.floats(-89, 89))
def test_fixed_azimuth_is_one_direction_for_all(azimuth, elevation):
    views = circle({"azimuth_deg": azimuth, "elevation_deg": elevation})
    x, y, z = views.boresights.T
    assert np.ptp(views.boresights, axis=0).max() == 0
    np.testing.assert_allclose(np.hypot(x, y), np.cos(np.deg2rad(elevation)), atol=ROUNDING)
    np.testing.assert_allclose(z, np.sin(np.deg2rad(elevation)), atol=ROUNDING)
    off = np.rad2deg(np.arctan2(y, x)) - azimuth
    np.testing.assert_allclose((off + 180) % 360, 180, atol=1e-9)  # degrees


@settings(max_examples=40)
@given(st.tuples(coordinates, coordinates, coordinates), st.sampled_from([0.0, 0.6]))
def test_aim_is_looked_at_from_the_middle_of_every_view(aim, separation):
    offset = np.array(aim) - circle().positions_m
    assume(np.hypot(offset[:, 0], offset[:, 1]).min() > 1e-3)
    views = circle({"aim_m": aim}, pair_separation_m=separation)
    distance = np.linalg.norm(offset, axis=1, keepdims=True)
    np.testing.assert_allclose(views.midpoints_m + distance * views.boresights, np.tile(aim, (12, 1)), atol=1e-11)


def test_aim_below_a_view_is_refused_with_view_and_point():
    says = r"trajectory\.pointing\.aim_m: view 0 stands on, above or below the point \[6, -2, 0\] it looks at"
    with pytest.raises(ConfigError, match=says) as caught:
        circle({"aim_m": (6.0, -2.0, 0.0)})
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="aim_m fixes the direction"):
        PointingSettings(aim_m=(0, 0, 0), elevation_deg=5.0)


@pytest.mark.parametrize("which", [0, 1])
def test_neither_antenna_of_a_pair_may_be_inside_an_object(which, tmp_path):
    inside, outside = "0.5,0.5", "5,1"
    file = tmp_path / "views.csv"
    pair = (inside, outside) if which == 0 else (outside, inside)
    file.write_text(f"x_m,y_m,rx_x_m,rx_y_m\n5,0,5,1\n{','.join(pair)}\n")
    data = {
        "name": "test",
        "objects": [{"shape": "square", "side_m": 2.0}],
        "trajectory": {"kind": "positions", "file": str(file)},
    }
    called = ("transmitter", "receiver")[which]
    with pytest.raises(ConfigError, match=rf"{called} of view 1 at \(0\.5, 0\.5, 0\) m is inside 'square-0'"):
        Scene(parse(SceneSettings, data, "test"))


def test_fingerprint_follows_receivers_and_boresights():
    def fingerprint(**trajectory):
        data = {
            "name": "test",
            "objects": [{"shape": "square", "side_m": 2.0}],
            "trajectory": {"kind": "circle", "interval_deg": 30.0, **trajectory},
        }
        return Scene(parse(SceneSettings, data, "test")).fingerprint()

    kinds = [
        {},
        {"pair_separation_m": 0.2},
        {"pair_separation_m": 0.3},
        {"pointing": {"azimuth_deg": 10.0}},
        {"pointing": {"elevation_deg": 10.0}},
        {"heights_m": [0.0, 0.5]},
    ]
    assert len({fingerprint(**kind) for kind in kinds}) == len(kinds)
    assert fingerprint(heights_m=[0.0]) == fingerprint()
