"""Where the sensor looks from: the views of a trajectory."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mvla_sim.errors import ConfigError
from mvla_sim.scene.antenna_settings import PointingSettings
from mvla_sim.scene.positions import PLACE, RECEIVER, Columns, read_columns
from mvla_sim.scene.trajectory_settings import (
    ArcTrajectory,
    CircleTrajectory,
    LineTrajectory,
    PosesTrajectory,
    PositionsTrajectory,
    TrajectorySettings,
    TurntableTrajectory,
    whole_turn,
)
from mvla_sim.scene.views import Views, wrapped

__all__ = [
    "build_views",
    "on_turntable",
    "pointed",
    "side_by_side",
    "views_about",
    "views_of_columns",
    "views_on_circle",
    "views_on_turntable",
]

ABOVE_M = 1e-9
"""A point at no more than this horizontal distance is above or below; coordinates of metres are rounded to 1e-15."""


def build_views(settings: TrajectorySettings, target_center_xy: tuple[float, float], key: str = "trajectory") -> Views:
    """Views of a trajectory.

    Parameters
    ----------
    settings
        Any of the six kinds.
    target_center_xy
        Centre of the target (x, y), metres: what the angles of lines, poses and lists of positions are measured about.
    key
        What the trajectory is called in messages.

    Raises
    ------
    ConfigError
        A position lies on the vertical line through the centre, so it has no direction, or an antenna on what it is to
        point at.
    DataError
        A CSV file cannot be used; the message names file, line and column.

    Notes
    -----
    * circle: views at start + k·interval, for one turn, or one turn at each of several heights;
    * arc: the same up to ``stop_deg``; where the interval does not divide the arc, the last view lies before it;
    * line: evenly spaced, both ends included;
    * turntable: at step k the target has turned counter-clockwise by α = k·interval about the axis and the sensor
      stands still. In the target's frame the sensor has turned by −α about that axis, so the views run clockwise;
    * poses: at each view the origin of the target's frame is at (x, y) and has turned by its heading; the views are the
      sensor as seen from that frame.

    The positions of a trajectory are those of the sensor; where transmitter and receiver are apart, their middle.
    """
    if isinstance(settings, CircleTrajectory | ArcTrajectory):
        heights = getattr(settings, "heights_m", None) or (settings.height_m,)
        angles = settings.start_deg + settings.interval_deg * np.arange(_count(settings))
        views = views_on_circle(settings.center_m, settings.radius_m, angles, heights)
        return _equipped(views, settings, key)
    if isinstance(settings, TurntableTrajectory):
        turned = np.asarray(settings.interval_deg * np.arange(whole_turn(settings.interval_deg)), np.float64)
        heights = settings.heights_m or (settings.sensor_m[2],)
        views = views_on_turntable(settings.sensor_m, settings.axis_m, turned, heights, key)
        turned = np.tile(turned, len(heights))
        return on_turntable(views, turned, settings.pointing, settings.pair_separation_m, f"{key}.pointing")
    if isinstance(settings, PosesTrajectory):
        return _from_poses(settings, target_center_xy, key)
    if isinstance(settings, LineTrajectory):
        line = np.linspace(settings.start_m, settings.stop_m, settings.views)
        return _equipped(views_about(line, target_center_xy, key), settings, key)
    if settings.file is None:
        views = views_about(settings.positions_m, target_center_xy, f"{key}.positions_m")
        return _equipped(views, settings, key)
    return _from_file(settings, settings.file, target_center_xy, f"{key}.file = {settings.file}")


def views_on_circle(
    center_m: tuple[float, float],
    radius_m: float,
    angles_deg: NDArray[np.floating[Any]],
    heights_m: tuple[float, ...] = (0.0,),
) -> Views:
    """Views at the given angles ``[n]`` of a circle, all of them once at each height, metres and degrees."""
    angles = np.tile(np.asarray(angles_deg, np.float64), len(heights_m))
    z = np.repeat(np.asarray(heights_m, np.float64), len(angles_deg))
    turn = np.deg2rad(angles)
    x, y = center_m[0] + radius_m * np.cos(turn), center_m[1] + radius_m * np.sin(turn)
    return Views(np.stack([x, y, z], axis=1), wrapped(angles), center_m)


def views_on_turntable(
    sensor_m: tuple[float, float, float],
    axis_m: tuple[float, float],
    turned_deg: NDArray[np.floating[Any]],
    heights_m: tuple[float, ...],
    key: str = "trajectory",
) -> Views:
    """Views of a fixed sensor onto a target that has turned counter-clockwise by ``turned_deg`` ``[n]``.

    Raises
    ------
    ConfigError
        The sensor stands on the axis.
    """
    x, y = sensor_m[0] - axis_m[0], sensor_m[1] - axis_m[1]
    radius = math.hypot(x, y)
    if radius == 0:
        raise ConfigError(f"{key}.sensor_m = {list(sensor_m)} stands on the axis; every view would be the same")
    return views_on_circle(axis_m, radius, math.degrees(math.atan2(y, x)) - turned_deg, heights_m)


def views_about(positions_m: ArrayLike | None, center_xy: tuple[float, float], key: str) -> Views:
    """Views at any positions ``[n, 3]``, their angles measured about a centre.

    Raises
    ------
    ConfigError
        A position is at no horizontal distance from the centre.
    """
    positions = np.asarray(positions_m, np.float64)
    offset = positions[:, :2] - center_xy
    on_axis = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) == 0)
    if len(on_axis):
        raise ConfigError(
            f"{key}: position {on_axis[0]} = {positions[on_axis[0]].tolist()} is at no horizontal distance from the "
            f"target's centre {list(center_xy)}, so it has no direction"
        )
    return Views(positions, wrapped(np.rad2deg(np.arctan2(offset[:, 1], offset[:, 0]))), center_xy)


def side_by_side(views: Views, separation_m: float) -> Views:
    """Put transmitter and receiver of each view on both sides of its position, across the way it points.

    Seen along the beam the transmitter is on the left; 0 leaves the pairs co-located.
    """
    if separation_m == 0:
        return views
    ahead = views.directions
    left = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(views))], axis=1)
    left *= separation_m / 2 / np.linalg.norm(left, axis=1, keepdims=True)
    return replace(views, positions_m=views.positions_m + left, receivers_m=views.positions_m - left)


def pointed(
    views: Views,
    settings: PointingSettings,
    key: str = "pointing",
    *,
    turned_deg: NDArray[np.float64] | None = None,
    origin_m: ArrayLike = (0.0, 0.0),
    aim_m: ArrayLike | None = None,
) -> Views:
    """Point the antennas of every view.

    Parameters
    ----------
    views
        Where they are, in the target's frame.
    settings
        Where they point.
    key
        What the settings are called in messages.
    turned_deg
        How far the target has turned counter-clockwise at each view, ``[n_view]`` degrees, where it is the sensor that
        stands still; pointing is then given in the sensor's world. None where the target stands still.
    origin_m
        Place of the target's origin in that world for each view, ``[n_view, 2]`` metres.
    aim_m
        Point ``[3]``, or one a view ``[n_view, 3]``, that is looked at by default, in the same frame as the settings;
        an elevation that is set tilts from the horizontal. None: horizontally at the views' centre.

    Raises
    ------
    ConfigError
        An antenna stands on the point it is to look at.
    """
    aim = settings.aim_m if settings.aim_m is not None else aim_m
    turned = np.zeros(len(views)) if turned_deg is None else turned_deg
    if settings.azimuth_deg is not None:
        azimuth = math.radians(settings.azimuth_deg) - np.deg2rad(turned)
    elif aim is not None:
        looked_at = np.broadcast_to(np.asarray(aim, np.float64), (len(views), 3))
        point = looked_at
        if turned_deg is not None:
            point = np.column_stack([_unturned(point[:, :2] - np.asarray(origin_m), turned), point[:, 2]])
        offset = point - views.midpoints_m
        bad = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) < ABOVE_M)
        if len(bad):
            place = ", ".join(f"{c:g}" for c in looked_at[bad[0]])
            raise ConfigError(f"{key}.aim_m: view {bad[0]} stands on, above or below the point [{place}] it looks at")
        if not settings.elevation_deg:
            return replace(views, boresights=offset / np.linalg.norm(offset, axis=1, keepdims=True))
        azimuth = np.arctan2(offset[:, 1], offset[:, 0])
    elif settings.elevation_deg:
        ahead = views.directions
        azimuth = np.arctan2(ahead[:, 1], ahead[:, 0])
    else:
        return views
    return replace(views, boresights=_directions(azimuth, np.full(len(views), settings.elevation_deg)))


def _directions(azimuth_rad: NDArray[np.float64], elevation_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    up = np.deg2rad(elevation_deg)
    return np.stack([np.cos(up) * np.cos(azimuth_rad), np.cos(up) * np.sin(azimuth_rad), np.sin(up)], axis=1)


def _unturned(points: NDArray[np.float64], turned_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points ``[n, 2]`` as seen from frames that have turned by ``turned_deg`` [n]."""
    c, s = np.cos(np.deg2rad(turned_deg)), np.sin(np.deg2rad(turned_deg))
    return np.stack([c * points[:, 0] + s * points[:, 1], -s * points[:, 0] + c * points[:, 1]], axis=1)


def _equipped(views: Views, settings: Any, key: str) -> Views:
    """Point the antennas of a moving sensor, then set transmitter and receiver apart."""
    return side_by_side(pointed(views, settings.pointing, f"{key}.pointing"), settings.pair_separation_m)


def on_turntable(
    views: Views, turned_deg: NDArray[np.float64], pointing: PointingSettings, separation_m: float, key: str
) -> Views:
    """Equip views of a target that has turned by ``turned_deg`` [n_view] about the views' centre.

    Antennas and aim stand still in the world; the axis is one point of it and of the target's frame.
    """
    axis_m = views.center_m
    if pointing.aim_m is None:
        return side_by_side(pointed(views, pointing, key, turned_deg=turned_deg), separation_m)
    offset = np.tile(np.asarray(pointing.aim_m[:2]) - axis_m, (len(views), 1))
    aim = np.column_stack([_unturned(offset, turned_deg) + axis_m, np.full(len(views), pointing.aim_m[2])])
    return side_by_side(pointed(views, PointingSettings(), key, aim_m=aim), separation_m)


def _from_poses(settings: PosesTrajectory, center_xy: tuple[float, float], key: str) -> Views:
    place = f"{key}.poses"
    if settings.file is not None:
        place = f"{key}.file = {settings.file}"
        numbers, _ = read_columns(settings.file, "poses file", ("x_m", "y_m", "heading_deg"))
        poses = np.column_stack([numbers["x_m"], numbers["y_m"], numbers["heading_deg"]])
    else:
        poses = np.asarray(settings.poses, np.float64)
    seen = _unturned(np.asarray(settings.sensor_m[:2]) - poses[:, :2], poses[:, 2])
    positions = np.column_stack([seen, np.full(len(poses), settings.sensor_m[2])])
    views = views_about(positions, center_xy, place)
    aim = (*poses[:, :2].mean(axis=0), settings.sensor_m[2])
    views = pointed(
        views, settings.pointing, f"{key}.pointing", turned_deg=poses[:, 2], origin_m=poses[:, :2], aim_m=aim
    )
    return side_by_side(views, settings.pair_separation_m)


def _from_file(settings: PositionsTrajectory, name: str, center_xy: tuple[float, float], key: str) -> Views:
    numbers, _ = read_columns(name, "positions file", PLACE[:2], (PLACE[2], *RECEIVER, "azimuth_deg", "elevation_deg"))
    return views_of_columns(numbers, center_xy, settings.pointing, settings.pair_separation_m, key)


def views_of_columns(
    numbers: Columns, center_xy: tuple[float, float], pointing: PointingSettings, separation_m: float, key: str
) -> Views:
    """Views of a table of positions, with receivers and directions where it has them.

    Raises
    ------
    ConfigError
        Columns that contradict the settings or lack a partner, or a position above the centre.
    """
    count = len(numbers["x_m"])
    zero = np.zeros(count)
    transmitters = np.column_stack([numbers.get(column, zero) for column in PLACE])
    if ("rx_x_m" in numbers) != ("rx_y_m" in numbers) or ("rx_z_m" in numbers and "rx_x_m" not in numbers):
        raise ConfigError(f"{key}: receivers need both rx_x_m and rx_y_m")
    if "elevation_deg" in numbers and "azimuth_deg" not in numbers:
        raise ConfigError(f"{key}: elevation_deg needs azimuth_deg")
    receivers = None
    if "rx_x_m" in numbers:
        if separation_m:
            raise ConfigError(f"{key}: has receivers of its own; leave out pair_separation_m = {separation_m:g}")
        receivers = np.column_stack([numbers["rx_x_m"], numbers["rx_y_m"], numbers.get("rx_z_m", transmitters[:, 2])])
    middle = transmitters if receivers is None else (transmitters + receivers) / 2
    views = replace(views_about(middle, center_xy, key), positions_m=transmitters, receivers_m=receivers)
    if "azimuth_deg" in numbers:
        elevation = numbers.get("elevation_deg", zero)
        steep = np.flatnonzero(abs(elevation) > 90)
        if len(steep):
            raise ConfigError(
                f"{key}: elevation_deg of position {steep[0]} = {elevation[steep[0]]:g}; allowed: -90 to 90 degrees"
            )
        boresights = _directions(np.deg2rad(numbers["azimuth_deg"]), elevation)
        views = replace(views, boresights=boresights)
    else:
        views = pointed(views, pointing, f"{key}: pointing")
    return views if receivers is not None else side_by_side(views, separation_m)


def _count(settings: CircleTrajectory | ArcTrajectory) -> int:
    if isinstance(settings, CircleTrajectory):
        return whole_turn(settings.interval_deg)
    return math.floor((settings.stop_deg - settings.start_deg) / settings.interval_deg + 1e-9) + 1
