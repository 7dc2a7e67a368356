"""Views of every kind of trajectory, and files of positions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.config.scene import (
    ArcTrajectory,
    CircleTrajectory,
    LineTrajectory,
    PositionsTrajectory,
    TurntableTrajectory,
)
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.trajectory import Views, build_views

ORIGIN = (0.0, 0.0)
ROUNDING = 1e-12  # metres, of coordinates of some tens of metres
coordinates = st.floats(-20, 20)
intervals = st.sampled_from([360 / n for n in (3, 4, 7, 12, 36, 90, 360)])


def directions(views):
    offset = views.positions_m[:, :2] - views.center_m
    return np.rad2deg(np.arctan2(offset[:, 1], offset[:, 0]))


def apart(one, other):
    """Differences of angles in degrees, across 0°/360°."""
    return np.abs((np.asarray(one) - other + 180) % 360 - 180)


@given(st.floats(0.5, 50), intervals, st.floats(-1000, 1000), st.tuples(coordinates, coordinates), coordinates)
@settings(deadline=None, max_examples=50)
def test_circle(radius, interval, start, center, height):
    kind = CircleTrajectory(radius_m=radius, interval_deg=interval, start_deg=start, center_m=center, height_m=height)
    views = build_views(kind, (99.0, 99.0))
    assert len(views) == round(360 / interval)
    offset = views.positions_m - [*center, height]
    np.testing.assert_allclose(np.hypot(offset[:, 0], offset[:, 1]), radius, atol=ROUNDING * 10)
    assert (views.positions_m[:, 2] == height).all()
    assert apart(directions(views), views.angles_deg).max() < 1e-9  # degrees, of rounding at 0.5 m
    assert apart(views.angles_deg[0], start) < 1e-9
    assert apart(np.diff(views.angles_deg), interval).max() < 1e-9
    assert views.center_m == center
    assert views.closed


def test_angles_of_a_dense_circle_are_exactly_whole_degrees():
    np.testing.assert_array_equal(build_views(CircleTrajectory(), ORIGIN).angles_deg, np.arange(360.0))


def test_an_angle_just_below_zero_is_zero_and_never_360():
    views = build_views(CircleTrajectory(start_deg=-1e-17), ORIGIN)
    assert views.angles_deg[0] == 0


@pytest.mark.parametrize(
    ("start", "stop", "interval", "last"),
    [(0, 90, 1, 90), (-30, 30, 0.1, 30), (350, 380, 7, 378), (0, 10, 10, 10), (0, 0.3, 0.1, 0.3)],
)
def test_arc_includes_its_end_where_the_interval_reaches_it(start, stop, interval, last):
    views = build_views(ArcTrajectory(kind="arc", start_deg=start, stop_deg=stop, interval_deg=interval), ORIGIN)
    assert len(views) == round((last - start) / interval) + 1
    assert apart(views.angles_deg[-1], last) < 1e-9
    assert apart(directions(views), views.angles_deg).max() < 1e-9
    assert not views.closed


@given(st.floats(0, 360), st.integers(4, 300), st.floats(0.1, 350))
@settings(deadline=None, max_examples=50)
def test_whether_views_close_does_not_depend_on_where_zero_is(start, count, span):
    interval = span / (count - 1)
    arc = ArcTrajectory(kind="arc", start_deg=start, stop_deg=start + span * (1 + 1e-9), interval_deg=interval)
    views = build_views(arc, ORIGIN)
    expected = 360 - span <= 1.5 * interval and 360 - span < 180
    if abs((360 - span) - 1.5 * interval) > 1e-6:
        assert views.closed == expected


def test_closed_examples():
    def closed(*angles):
        positions = np.zeros((len(angles), 3))
        return Views(positions, np.array(angles, float), ORIGIN).closed

    assert closed(0, 120, 240)
    assert closed(240, 0, 120)
    assert not closed(0, 180)
    assert not closed(0, 90, 180)  # half a turn
    assert not closed(0, 170, 175)  # one gap of 185°: nothing is seen from behind
    assert not closed(350, 0, 10)  # an arc across 0°, with its widest gap elsewhere
    assert not closed(5, 5, 5)


@given(st.tuples(coordinates, coordinates, coordinates), st.tuples(coordinates, coordinates, coordinates))
@settings(deadline=None, max_examples=50)
def test_line(start, stop):
    center = (30.0, 30.0)  # beside every such line
    if start == stop:
        return
    views = build_views(LineTrajectory(kind="line", start_m=start, stop_m=stop, views=5), center)
    np.testing.assert_allclose(views.positions_m[[0, -1]], [start, stop], atol=ROUNDING)
    np.testing.assert_allclose(np.diff(views.positions_m, 2, axis=0), 0, atol=10 * ROUNDING)  # evenly spaced
    assert apart(directions(views), views.angles_deg).max() < 1e-9
    assert views.center_m == center


def test_line_over_the_centre_has_a_view_without_direction():
    line = LineTrajectory(kind="line", start_m=(-5, 1, 3), stop_m=(5, 1, 3), views=11)
    with pytest.raises(ConfigError, match=r"trajectory: position 5 = \[0.0, 1.0, 3.0\] .*no horizontal distance"):
        build_views(line, (0.0, 1.0))


@given(
    st.tuples(coordinates, coordinates, coordinates),
    st.tuples(coordinates, coordinates),
    intervals,
    st.tuples(coordinates, coordinates, coordinates),
)
@settings(deadline=None, max_examples=50)
def test_turntable_equals_turning_the_target(sensor, axis, interval, point):
    """Distances from the fixed sensor to a point that turns are those from the views to the point at rest."""
    if sensor[:2] == axis:
        return
    views = build_views(
        TurntableTrajectory(kind="turntable", sensor_m=sensor, interval_deg=interval, axis_m=axis), ORIGIN
    )
    alpha = np.deg2rad(interval * np.arange(len(views)))
    x, y = point[0] - axis[0], point[1] - axis[1]
    turned = np.stack(
        [
            axis[0] + x * np.cos(alpha) - y * np.sin(alpha),  # counter-clockwise
            axis[1] + x * np.sin(alpha) + y * np.cos(alpha),
            np.full_like(alpha, point[2]),
        ],
        axis=1,
    )
    measured = np.linalg.norm(turned - np.asarray(sensor), axis=1)
    np.testing.assert_allclose(np.linalg.norm(views.positions_m - point, axis=1), measured, atol=1e-10)  # metres
    assert views.center_m == axis
    assert views.closed


def test_turntable_views_run_clockwise_from_the_sensor():
    views = build_views(TurntableTrajectory(kind="turntable", interval_deg=90.0), ORIGIN)
    np.testing.assert_allclose(views.angles_deg, [0, 270, 180, 90])
    np.testing.assert_allclose(views.positions_m[1], [0, -10, 0], atol=ROUNDING)


def test_turntable_sensor_on_the_axis_is_refused():
    with pytest.raises(ConfigError, match=r"trajectory\.sensor_m = \[1.0, 2.0, 3.0\]"):
        build_views(TurntableTrajectory(kind="turntable", sensor_m=(1, 2, 3), axis_m=(1, 2)), ORIGIN)


def from_file(path):
    return build_views(PositionsTrajectory(kind="positions", file=str(path)), ORIGIN)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x_m,y_m\n1,2\n-3,4.5e0\n", [[1, 2, 0], [-3, 4.5, 0]]),
        ("x_m,y_m,z_m\n1,2,3\n", [[1, 2, 3]]),
        ("z_m, y_m ,x_m\r\n3,2,1\r\n", [[1, 2, 3]]),
        ("\ufeffx_m,y_m\n 1 ,2\n\n3,4\n\n", [[1, 2, 0], [3, 4, 0]]),
    ],
)
def test_positions_file(tmp_path, text, expected):
    file = tmp_path / "views.csv"
    file.write_bytes(text.encode())
    views = from_file(file)
    np.testing.assert_array_equal(views.positions_m, expected)
    listed = build_views(
        PositionsTrajectory(kind="positions", positions_m=tuple(tuple(map(float, p)) for p in expected)), ORIGIN
    )
    np.testing.assert_array_equal(listed.angles_deg, views.angles_deg)
    assert apart(directions(views), views.angles_deg).max() < 1e-9


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "no such positions file"),
        (b"", "is empty"),
        (b"x_m,y_m\n", "header and no positions"),
        (b"1,2\n3,4\n", "line 1: unknown column '1'; allowed: x_m, y_m, z_m"),
        (b"x_m,z_m\n1,2\n", "line 1: missing column 'y_m'"),
        (b"x_m,y_m,z\n1,2,3\n", "line 1: unknown column 'z'"),
        (b"x_m,y_m,x_m\n1,2,3\n", "column 'x_m' appears 2 times"),
        (b"x_m,y_m\n1,2\n3,four\n", "line 3, column y_m: 'four' is not a number"),
        (b"x_m,y_m\n1,2\n\n,4\n", "line 4, column x_m: '' is not a number"),
        (b"x_m,y_m\nnan,2\n", "line 2, column x_m: 'nan' is not a finite number"),
        (b"x_m,y_m\n1,inf\n", "line 2, column y_m"),
        (b"x_m,y_m\n1,2,3\n", "line 2: has 3 values; the header has 2"),
        (b"x_m,y_m\n1,2\n3\n", "line 3: has 1 values"),
        (b"x_m;y_m\n1;2\n", "unknown column 'x_m;y_m'"),
        (b"x_m,y_m\n\xff\xfe,2\n", "not a CSV text file"),
        (b'x_m,y_m\n"1,2\n', "not a CSV text file"),
        (b"x_m,y_m\n1,2\n0,0\n", r"position 1 = \[0.0, 0.0, 0.0\].*no horizontal distance"),
    ],
)
def test_positions_file_errors_name_file_line_and_column(tmp_path, content, says):
    file = tmp_path / "views.csv"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises((DataError, ConfigError), match=says) as caught:
        from_file(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("positions", "angles", "says"),
    [
        (np.zeros((0, 3)), np.zeros(0), "n_view >= 1"),
        (np.zeros((2, 2)), np.zeros(2), r"shape \(2, 2\)"),
        (np.zeros((2, 3)), np.zeros(3), r"shape \(3,\)"),
        (np.array([[0, 0, 0], [math.nan, 0, 0]]), np.zeros(2), "position 1 "),
        (np.zeros((2, 3)), np.array([0, 360.0]), "angle 1 = 360"),
        (np.zeros((2, 3)), np.array([math.nan, 0]), "angle 0 = nan"),
        (np.zeros((2, 3)), np.array([1, -1e-9]), "angle 1 "),
    ],
)
def test_views_validate_themselves(positions, angles, says):
    with pytest.raises(DataError, match=says):
        Views(positions, angles, ORIGIN)


def test_views_are_read_only_and_keep_their_own_copy():
    positions = np.ones((2, 3))
    views = Views(positions, np.zeros(2), ORIGIN)
    positions[0] = 7
    assert views.positions_m[0, 0] == 1
    with pytest.raises(ValueError, match="read-only"):
        views.positions_m[0, 0] = 5


@given(st.permutations(range(12)), st.integers(1, 12))
@settings(deadline=None, max_examples=50)
def test_selected_views_keep_order_and_angles(order, count):
    views = build_views(CircleTrajectory(interval_deg=30.0), ORIGIN)
    chosen = views.select(np.array(order[:count]))
    np.testing.assert_array_equal(chosen.angles_deg, 30.0 * np.array(order[:count]))
    assert apart(directions(chosen), chosen.angles_deg).max() < 1e-9
