"""Views of every kind of trajectory, and files of positions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.pointing import PointingSettings
from mvla_sim.scene.trajectories.arc import Arc
from mvla_sim.scene.trajectories.circle import Circle
from mvla_sim.scene.trajectories.line import Line
from mvla_sim.scene.trajectories.poses import Poses
from mvla_sim.scene.trajectories.positions import Positions
from mvla_sim.scene.trajectories.turntable import Turntable
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import SceneSettings
from mvla_sim.settings import parse

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
    kind = Circle(radius_m=radius, interval_deg=interval, start_deg=start, center_m=center, height_m=height)
    views = kind.build_views((99.0, 99.0))
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
    np.testing.assert_array_equal(Circle().build_views(ORIGIN).angles_deg, np.arange(360.0))


def test_an_angle_just_below_zero_is_zero_and_never_360():
    views = Circle(start_deg=-1e-17).build_views(ORIGIN)
    assert views.angles_deg[0] == 0


@pytest.mark.parametrize(
    ("start", "stop", "interval", "last"),
    [(0, 90, 1, 90), (-30, 30, 0.1, 30), (350, 380, 7, 378), (0, 10, 10, 10), (0, 0.3, 0.1, 0.3)],
)
def test_arc_includes_its_end_where_the_interval_reaches_it(start, stop, interval, last):
    views = Arc(start_deg=start, stop_deg=stop, interval_deg=interval).build_views(ORIGIN)
    assert len(views) == round((last - start) / interval) + 1
    assert apart(views.angles_deg[-1], last) < 1e-9
    assert apart(directions(views), views.angles_deg).max() < 1e-9
    assert not views.closed


@given(st.floats(0, 360), st.integers(4, 300), st.floats(0.1, 350))
@settings(deadline=None, max_examples=50)
def test_whether_views_close_does_not_depend_on_where_zero_is(start, count, span):
    interval = span / (count - 1)
    arc = Arc(start_deg=start, stop_deg=start + span * (1 + 1e-9), interval_deg=interval)
    views = arc.build_views(ORIGIN)
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
    views = Line(start_m=start, stop_m=stop, views=5).build_views(center)
    np.testing.assert_allclose(views.positions_m[[0, -1]], [start, stop], atol=ROUNDING)
    np.testing.assert_allclose(np.diff(views.positions_m, 2, axis=0), 0, atol=10 * ROUNDING)  # evenly spaced
    assert apart(directions(views), views.angles_deg).max() < 1e-9
    assert views.center_m == center


def test_line_over_the_centre_has_a_view_without_direction():
    line = Line(start_m=(-5, 1, 3), stop_m=(5, 1, 3), views=11)
    with pytest.raises(ConfigError, match=r"trajectory: position 5 = \[0.0, 1.0, 3.0\] .*no horizontal distance"):
        line.build_views((0.0, 1.0))


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
    views = Turntable(sensor_m=sensor, interval_deg=interval, axis_m=axis).build_views(ORIGIN)
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
    views = Turntable(interval_deg=90.0).build_views(ORIGIN)
    np.testing.assert_allclose(views.angles_deg, [0, 270, 180, 90])
    np.testing.assert_allclose(views.positions_m[1], [0, -10, 0], atol=ROUNDING)


def test_turntable_sensor_on_the_axis_is_refused():
    with pytest.raises(ConfigError, match=r"trajectory\.sensor_m = \[1.0, 2.0, 3.0\]"):
        Turntable(sensor_m=(1, 2, 3), axis_m=(1, 2)).build_views(ORIGIN)


# The sensor stands still and the target moves: the same geometry, seen from the target's frame.


def turned(points, angle_deg, about=(0.0, 0.0)):
    """Points ``[n, 3]`` turned counter-clockwise about a vertical axis, by one angle or one each."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    x, y = points[:, 0] - about[0], points[:, 1] - about[1]
    return np.stack([about[0] + c * x - s * y, about[1] + s * x + c * y, points[:, 2]], axis=1)


def turntable(sensor=(10.0, 0.0, 0.0), axis=(0.0, 0.0), pointing=None, **values):
    pointing = PointingSettings(**(pointing or {}))
    kind = Turntable(sensor_m=sensor, axis_m=axis, pointing=pointing, **values)
    return kind.build_views((99.0, 99.0))


def elevation(pointing, sensor):
    """Elevation of the beam in the world, degrees."""
    if "aim_m" not in pointing:
        return pointing.get("elevation_deg", 0.0)
    x, y, z = np.subtract(pointing["aim_m"], sensor)
    return math.degrees(math.atan2(z, math.hypot(x, y)))


pointings = st.one_of(
    st.just({}),
    st.builds(lambda up: {"elevation_deg": up}, st.floats(-60, 60)),
    st.builds(lambda az, up: {"azimuth_deg": az, "elevation_deg": up}, st.floats(-180, 180), st.floats(-60, 60)),
    st.builds(lambda x, y, z: {"aim_m": (x, y, z)}, coordinates, coordinates, coordinates),
)


@settings(max_examples=60)
@given(
    st.tuples(coordinates, coordinates, coordinates),
    st.tuples(coordinates, coordinates),
    st.sampled_from([0.0, 0.7]),
    pointings,
)
def test_turntable_seen_in_the_world_is_one_pair_that_stands_still(sensor, axis, separation, pointing):
    """Turned back with the target, positions and boresights are the same at every view: where the sensor stands, and
    where it was told to point."""
    assume(math.hypot(sensor[0] - axis[0], sensor[1] - axis[1]) > 0.1)
    aim = pointing.get("aim_m", (*axis, sensor[2]))
    assume(math.hypot(aim[0] - sensor[0], aim[1] - sensor[1]) > 0.1)
    views = turntable(sensor, axis, pointing, interval_deg=30.0, pair_separation_m=separation)
    alpha = 30.0 * np.arange(12)
    ahead = turned(views.directions, alpha)
    np.testing.assert_allclose(turned(views.midpoints_m, alpha, axis), np.tile(sensor, (12, 1)), atol=1e-11)
    np.testing.assert_allclose(ahead, np.tile(ahead[0], (12, 1)), atol=1e-11)  # from 0.1 m and more
    if "azimuth_deg" in pointing:
        expected = np.deg2rad(pointing["azimuth_deg"])
    else:
        expected = np.arctan2(aim[1] - sensor[1], aim[0] - sensor[0])
    assert apart(np.rad2deg(np.arctan2(ahead[0, 1], ahead[0, 0])), np.rad2deg(expected)) < 1e-8
    up = elevation(pointing, sensor)
    assert np.rad2deg(np.arcsin(ahead[0, 2])) == pytest.approx(up, abs=1e-8)
    if separation:
        across = turned(views.positions_m - views.receivers_m, alpha)
        np.testing.assert_allclose(across, np.tile(across[0], (12, 1)), atol=1e-11)
        assert np.linalg.norm(across[0]) == pytest.approx(separation)


@pytest.mark.parametrize("separation", [0.0, 0.5])
@pytest.mark.parametrize("elevation", [0.0, -15.0])
def test_turntable_is_the_circle_taken_clockwise(separation, elevation):
    axis, height = (1.0, 2.0), 0.7
    pointing = PointingSettings(elevation_deg=elevation)
    circle = Circle(
        radius_m=5.0, center_m=axis, height_m=height, start_deg=90.0, interval_deg=20.0, pointing=pointing,
        pair_separation_m=separation,
    )  # fmt: skip
    one = circle.build_views(ORIGIN).select(-np.arange(18))
    sensor = (1.0, 7.0, height)
    other = turntable(sensor, axis, {"elevation_deg": elevation}, interval_deg=20.0, pair_separation_m=separation)
    np.testing.assert_allclose(one.positions_m, other.positions_m, atol=ROUNDING * 10)
    np.testing.assert_allclose(one.directions, other.directions, atol=ROUNDING * 10)
    assert apart(one.angles_deg, other.angles_deg).max() < 1e-9
    assert (one.receivers_m is None) == (other.receivers_m is None) == (separation == 0)
    if separation:
        np.testing.assert_allclose(one.receivers_m, other.receivers_m, atol=ROUNDING * 10)


def test_aim_of_a_turntable_that_a_sensor_stands_under_is_refused():
    with pytest.raises(ConfigError, match=r"pointing\.aim_m: view 0 stands on, above or below the point \["):
        turntable((3.0, 4.0, 1.0), (0.5, 0.25), {"aim_m": (3.0, 4.0, 2.0)}, interval_deg=40.0)


headings = st.floats(-400, 400)
poses = st.lists(st.tuples(coordinates, coordinates, headings), min_size=1, max_size=6)


def driven(poses, sensor=(0.0, 0.0, 0.0), pointing=None, center=ORIGIN, **values):
    pointing = PointingSettings(**(pointing or {}))
    kind = Poses(sensor_m=sensor, poses=poses, pointing=pointing, **values)
    return kind.build_views(center)


@settings(max_examples=60)
@given(poses, st.tuples(coordinates, coordinates, coordinates), st.sampled_from([0.0, 0.7]), pointings)
def test_poses_seen_in_the_world_are_one_pair_that_stands_still(poses, sensor, separation, pointing):
    """Taken along with the target to its places, positions and boresights are the same at every view."""
    places = np.array(poses)
    aim = pointing.get("aim_m", (*places[:, :2].mean(axis=0), sensor[2]))
    assume(math.hypot(aim[0] - sensor[0], aim[1] - sensor[1]) > 0.1)
    assume(np.hypot(*(places[:, :2] - sensor[:2]).T).min() > 0.1)
    views = driven(poses, sensor, pointing, pair_separation_m=separation)
    origin = np.column_stack([places[:, :2], np.zeros(len(places))])
    back = turned(views.midpoints_m, places[:, 2]) + origin
    ahead = turned(views.directions, places[:, 2])
    np.testing.assert_allclose(back, np.tile(sensor, (len(poses), 1)), atol=1e-11)
    if "azimuth_deg" in pointing:
        expected = np.deg2rad(pointing["azimuth_deg"])
    else:
        expected = np.arctan2(aim[1] - sensor[1], aim[0] - sensor[0])
    assert apart(np.rad2deg(np.arctan2(ahead[:, 1], ahead[:, 0])), np.rad2deg(expected)).max() < 1e-8
    up = elevation(pointing, sensor)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(ahead[:, 2])), up, atol=1e-8)
    if separation:
        across = turned(views.positions_m - views.receivers_m, places[:, 2])
        np.testing.assert_allclose(across, np.tile(across[0], (len(poses), 1)), atol=1e-11)
        np.testing.assert_allclose(np.linalg.norm(across, axis=1), separation, rtol=1e-9)


@pytest.mark.parametrize("separation", [0.0, 0.5])
def test_target_that_drives_past_is_a_sensor_that_flies_past(separation):
    """Straight on without turning: the sensor moves the other way at the same distance, looking aside."""
    aside = {"azimuth_deg": 90.0, "elevation_deg": -10.0}
    places = [(x, 6.0, 0.0) for x in np.linspace(-4, 4, 9)]
    center = (0.2, 0.1)
    one = driven(places, (0.0, 0.0, 2.0), aside, center, pair_separation_m=separation)
    line = Line(
        kind="line", start_m=(4, -6, 2), stop_m=(-4, -6, 2), views=9, pair_separation_m=separation,
        pointing=PointingSettings(**aside),
    )  # fmt: skip
    other = line.build_views(center)
    assert one.center_m == other.center_m == center
    for name in ("positions_m", "angles_deg", "boresights", "midpoints_m"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-11)
    assert (one.receivers_m is None) == (separation == 0)


def test_target_that_turns_on_the_spot_is_a_turntable():
    one = driven([(0.0, 0.0, a) for a in np.arange(0.0, 360.0, 30.0)], (7.0, 1.0, 0.5))
    other = turntable((7.0, 1.0, 0.5), interval_deg=30.0)
    np.testing.assert_allclose(one.positions_m, other.positions_m, atol=ROUNDING * 10)
    np.testing.assert_allclose(one.directions, other.directions, atol=ROUNDING * 10)
    assert one.closed


def test_pose_on_the_sensor_has_no_direction():
    with pytest.raises(ConfigError, match=r"trajectory\.poses: position 1 = \[0\.0, 0\.0, 1\.0\].*no horizontal"):
        driven([(4.0, 0.0, 0.0), (2.0, 1.0, 90.0)], (2.0, 1.0, 1.0))


def test_poses_file(tmp_path):
    file = tmp_path / "drive.csv"
    file.write_text("heading_deg,x_m,y_m\n10,-4,5\n15.5,0,5.5\n20,4,6\n")
    read = Poses(sensor_m=(0, 0, 1), file=str(file)).build_views(ORIGIN)
    listed = driven([(-4.0, 5.0, 10.0), (0.0, 5.5, 15.5), (4.0, 6.0, 20.0)], (0, 0, 1))
    np.testing.assert_array_equal(read.positions_m, listed.positions_m)
    np.testing.assert_array_equal(read.directions, listed.directions)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "no such poses file"),
        ("x_m,y_m,heading_deg\n", "a header and no poses"),
        ("x_m,y_m\n1,2\n", "line 1: missing column 'heading_deg'"),
        ("x_m,y_m,z_m,heading_deg\n1,2,0,0\n", "line 1: unknown column 'z_m'"),
        ("x_m,y_m,heading_deg\n1,2,0\n1,2,north\n", "line 3, column heading_deg: 'north' is not a number"),
        ("x_m,y_m,heading_deg\n1,2,0\n0,0,0\n", r"position 1 = \[0\.0, 0\.0, 0\.0\].*no horizontal distance"),
    ],
)
def test_poses_file_errors_name_file_line_and_column(tmp_path, content, says):
    file = tmp_path / "drive.csv"
    if content is not None:
        file.write_text(content)
    with pytest.raises((DataError, ConfigError), match=says) as caught:
        Poses(file=str(file)).build_views(ORIGIN)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


# Several heights.


@pytest.mark.parametrize("kind", ["circle", "turntable"])
def test_each_height_is_a_whole_turn(kind):
    heights = (0.5, -1.0, 3.0)
    equip = {"interval_deg": 45.0, "pair_separation_m": 0.4}

    def build(**values):
        if kind == "circle":
            pointing = PointingSettings(aim_m=(0.1, 0.2, 0.3))
            return Circle(start_deg=10.0, pointing=pointing, **equip, **values).build_views(ORIGIN)
        low = values.pop("height_m", 0.0)
        return turntable((9.0, 2.0, low), (0.5, 0.0), {"aim_m": (0.1, 0.2, 0.3)}, **equip, **values)

    views = build(heights_m=heights)
    assert len(views) == 24
    assert views.closed
    for number, height in enumerate(heights):
        one, alone = views.select(np.arange(8) + 8 * number), build(height_m=height)
        assert (one.positions_m[:, 2] == height).all()
        np.testing.assert_array_equal(one.angles_deg, alone.angles_deg)  # to the bit: they are shared directions
        for name in ("positions_m", "receivers_m", "boresights"):
            np.testing.assert_allclose(getattr(one, name), getattr(alone, name), rtol=0, atol=ROUNDING * 10)


def test_a_height_twice_and_none_at_all_are_refused():
    for kind in (Circle, Turntable):
        with pytest.raises(ValueError, match="has a height twice"):
            kind(heights_m=(1.0, 0.0, 1.0))
        with pytest.raises(ValueError, match="at least 1"):
            kind(heights_m=())


# Files of positions.


def from_file(path, pointing=None, **values):
    pointing = PointingSettings(**(pointing or {}))
    return Positions(file=str(path), pointing=pointing, **values).build_views(ORIGIN)


def test_file_may_set_receivers_and_directions_view_by_view(tmp_path):
    file = tmp_path / "views.csv"
    file.write_text(
        "rx_y_m,x_m,rx_x_m,y_m,azimuth_deg,elevation_deg\n1,5,5.5,0,180,0\n2,4,3,4,-90,30\n3,-4,-3,-4,45,-90\n"
    )
    views = from_file(file, {"azimuth_deg": 7.0})  # the file's own directions win
    np.testing.assert_array_equal(views.positions_m, [[5, 0, 0], [4, 4, 0], [-4, -4, 0]])
    np.testing.assert_array_equal(views.receivers_m, [[5.5, 1, 0], [3, 2, 0], [-3, 3, 0]])
    np.testing.assert_allclose(views.boresights[:2], [[-1, 0, 0], [0, -np.sqrt(0.75), 0.5]], atol=ROUNDING)
    np.testing.assert_allclose(views.boresights[2], [0, 0, -1], atol=ROUNDING)
    angles = np.rad2deg(np.arctan2(views.midpoints_m[:, 1], views.midpoints_m[:, 0]))
    assert apart(views.angles_deg, angles).max() < 1e-9


def test_receivers_of_a_file_have_their_transmitters_heights_unless_it_says_others(tmp_path):
    file = tmp_path / "views.csv"
    file.write_text("x_m,y_m,z_m,rx_x_m,rx_y_m\n5,0,2,5,1\n")
    np.testing.assert_array_equal(from_file(file).receivers_m, [[5, 1, 2]])
    file.write_text("x_m,y_m,z_m,rx_x_m,rx_y_m,rx_z_m\n5,0,2,5,1,-1\n")
    np.testing.assert_array_equal(from_file(file).receivers_m, [[5, 1, -1]])


def test_directions_of_a_file_put_its_pairs_across_the_beam(tmp_path):
    file = tmp_path / "views.csv"
    file.write_text("x_m,y_m,azimuth_deg\n5,0,90\n5,2,0\n")
    views = from_file(file, pair_separation_m=1.0)
    np.testing.assert_allclose(views.positions_m, [[4.5, 0, 0], [5, 2.5, 0]], atol=ROUNDING)
    np.testing.assert_allclose(views.receivers_m, [[5.5, 0, 0], [5, 1.5, 0]], atol=ROUNDING)


@pytest.mark.parametrize(
    ("content", "values", "says"),
    [
        ("x_m,y_m,rx_x_m\n5,0,5\n", {}, "receivers need both rx_x_m and rx_y_m"),
        ("x_m,y_m,rx_y_m\n5,0,5\n", {}, "receivers need both rx_x_m and rx_y_m"),
        ("x_m,y_m,rx_z_m\n5,0,5\n", {}, "receivers need both rx_x_m and rx_y_m"),
        ("x_m,y_m,elevation_deg\n5,0,5\n", {}, "elevation_deg needs azimuth_deg"),
        ("x_m,y_m,azimuth_deg,elevation_deg\n5,0,5,0\n5,0,5,95\n", {}, "elevation_deg of position 1 = 95; .*-90 to 90"),
        ("x_m,y_m,azimuth_deg\n5,0,5\n5,0,east\n", {}, "line 3, column azimuth_deg: 'east' is not a number"),
        ("x_m,y_m,rx_x_m,rx_y_m\n5,0,5,\n", {}, "line 2, column rx_y_m: '' is not a number"),
        ("x_m,y_m,rx_x_m,rx_y_m\n5,0,5,nan\n", {}, "line 2, column rx_y_m: 'nan' is not a finite"),
        ("x_m,y_m,rx_x_m,rx_y_m\n5,0,5,1\n", {"pair_separation_m": 0.5}, "leave out pair_separation_m = 0.5"),
        ("x_m,y_m,rx_x_m,rx_y_m\n5,0,-5,0\n", {}, r"position 0 = \[0\.0, 0\.0, 0\.0\].*no horizontal distance"),
        ("x_m,y_m,heading_deg\n5,0,5\n", {}, "line 1: unknown column 'heading_deg'; allowed: x_m, y_m, z_m, rx_x_m"),
    ],
)
def test_columns_that_do_not_fit_are_refused_in_one_line_with_the_file(tmp_path, content, values, says):
    file = tmp_path / "views.csv"
    file.write_text(content)
    with pytest.raises((DataError, ConfigError), match=says) as caught:
        from_file(file, **values)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("trajectory", "says"),
    [
        ({"kind": "poses"}, "either file or poses"),
        ({"kind": "poses", "poses": []}, "poses is empty"),
        ({"kind": "poses", "poses": [[1.0, 2.0]]}, r"trajectory\.poses"),
        ({"kind": "circle", "pair_separation_m": -0.1}, r"trajectory\.pair_separation_m"),
        ({"kind": "circle", "pointing": {"elevation_deg": 90.0}}, r"trajectory\.pointing\.elevation_deg"),
        ({"kind": "arc", "start_deg": 0.0, "stop_deg": 90.0, "heights_m": [0.0]}, r"trajectory\.heights_m"),
    ],
)
def test_settings_that_are_no_trajectory_are_refused(trajectory, says):
    with pytest.raises(ConfigError, match=says):
        parse(SceneSettings, {"name": "a", "objects": [{"shape": "square"}], "trajectory": trajectory}, "test")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x_m,y_m\n1,2\n-3,4.5e0\n", [[1, 2, 0], [-3, 4.5, 0]]),
        ("x_m,y_m,z_m\n1,2,3\n", [[1, 2, 3]]),
        ("z_m, y_m ,x_m\r\n3,2,1\r\n", [[1, 2, 3]]),
        ("\ufeffx_m,y_m\n 1 ,2\n\n3,4\n\n", [[1, 2, 0], [3, 4, 0]]),
        ("X [m];Y [m]\r\n1,5;2\r\n", [[1.5, 2, 0]]),
        ("sep=\t\nx_m\ty_m\tt_s\t\n1\t2\t9\t\n", [[1, 2, 0]]),
        ("# x_m y_m z_m\n1.0e+00 2.0 3.0\n", [[1, 2, 3]]),
    ],
)
def test_positions_file(tmp_path, text, expected):
    file = tmp_path / "views.csv"
    file.write_bytes(text.encode())
    views = from_file(file)
    np.testing.assert_array_equal(views.positions_m, expected)
    listed = Positions(positions_m=tuple(tuple(map(float, p)) for p in expected)).build_views(ORIGIN)
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
        (b"x_m,y_m\n1,2,3\n", "line 2: has 3 values, decimal commas included; the header has 2"),
        (b"x_m,y_m\n1,2\n3\n", "line 3: has 1 values"),
        (b"x_m:y_m\n1:2\n", "unknown column 'x_m:y_m'"),
        (b"x_m;y_m\n1;2;3\n", "line 2: has 3 values; the header has 2"),
        (b"x_m,y_m\n\xff\xfe,2\n", "line 2, column x_m: 'ÿþ' is not a number"),
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
    views = Circle(interval_deg=30.0).build_views(ORIGIN)
    chosen = views.select(np.array(order[:count]))
    np.testing.assert_array_equal(chosen.angles_deg, 30.0 * np.array(order[:count]))
    assert apart(directions(chosen), chosen.angles_deg).max() < 1e-9
