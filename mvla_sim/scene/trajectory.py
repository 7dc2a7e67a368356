"""Where the sensor looks from: the views of a trajectory."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mvla_sim.config.scene import (
    ArcTrajectory,
    CircleTrajectory,
    LineTrajectory,
    PositionsTrajectory,
    TrajectorySettings,
    TurntableTrajectory,
    whole_turn,
)
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.files import existing_file

__all__ = ["Views", "build_views"]

COLUMNS = ("x_m", "y_m", "z_m")


@dataclass(frozen=True, eq=False)
class Views:
    """Sensor positions T_m in the target's frame, in the order they are measured.

    Attributes
    ----------
    positions_m
        ``[n_view, 3]`` float64, metres; read-only.
    angles_deg
        ``[n_view]`` float64 in [0, 360): direction from the centre to the sensor, counter-clockwise from +x; read-only.
    center_m
        Point (x, y) the angles are measured about, metres.
    """

    positions_m: NDArray[np.float64]
    angles_deg: NDArray[np.float64]
    center_m: tuple[float, float]

    def __post_init__(self) -> None:
        """Refuse shapes that do not match and values that are no positions or angles."""
        positions = np.array(self.positions_m, np.float64)
        angles = np.array(self.angles_deg, np.float64)
        if positions.ndim != 2 or positions.shape[1] != 3 or not len(positions):
            raise DataError(f"views: positions_m has shape {positions.shape}; allowed: [n_view, 3] with n_view >= 1")
        if angles.shape != (len(positions),):
            raise DataError(f"views: angles_deg has shape {angles.shape}; {len(positions)} positions need one each")
        if not np.isfinite(positions).all():
            view = int(np.flatnonzero(~np.isfinite(positions).all(axis=1))[0])
            raise DataError(f"views: position {view} = {positions[view].tolist()} is not finite")
        bad = np.flatnonzero(~((angles >= 0) & (angles < 360)))
        if len(bad):
            raise DataError(f"views: angle {bad[0]} = {angles[bad[0]]}; allowed: 0 to below 360 degrees")
        if not np.isfinite(self.center_m).all():
            raise DataError(f"views: center_m = {self.center_m} is not finite")
        for name, array in (("positions_m", positions), ("angles_deg", angles)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "center_m", (float(self.center_m[0]), float(self.center_m[1])))

    def __len__(self) -> int:
        return len(self.positions_m)

    def select(self, indices: NDArray[np.intp]) -> Views:
        """Views of the given indices ``[n]``, in that order."""
        return Views(self.positions_m[indices], self.angles_deg[indices], self.center_m)

    @property
    def closed(self) -> bool:
        """Whether the views go all the way round.

        True for three views or more whose widest gap between neighbouring angles, 0°/360° being no border, is below
        180° and at most 1.5 times the second widest.
        """
        if len(self) < 3:
            return False
        angles = np.sort(self.angles_deg)
        second, widest = np.sort(np.diff(angles, append=angles[0] + 360))[-2:]
        return bool(widest < 180 and widest <= 1.5 * second * (1 + 1e-9))


def build_views(settings: TrajectorySettings, target_center_xy: tuple[float, float], key: str = "trajectory") -> Views:
    """Views of a trajectory.

    Parameters
    ----------
    settings
        Any of the five kinds.
    target_center_xy
        Centre of the target (x, y), metres: what the angles of lines and lists of positions are measured about.
    key
        What the trajectory is called in messages.

    Raises
    ------
    ConfigError
        A position lies on the vertical line through the centre, so it has no direction.
    DataError
        The CSV file of positions cannot be used; the message names file, line and column.

    Notes
    -----
    * circle: views at start + k·interval, for one turn;
    * arc: the same up to ``stop_deg``; where the interval does not divide the arc, the last view lies before it;
    * line: evenly spaced, both ends included;
    * turntable: at step k the target has turned counter-clockwise by α = k·interval about the axis and the sensor
      stands still. In the target's frame the sensor has turned by −α about that axis, so the views run clockwise.
    """
    if isinstance(settings, CircleTrajectory | ArcTrajectory):
        angles = settings.start_deg + settings.interval_deg * np.arange(_count(settings))
        return _on_circle(settings.center_m, settings.radius_m, angles, settings.height_m)
    if isinstance(settings, TurntableTrajectory):
        return _turntable(settings, key)
    if isinstance(settings, LineTrajectory):
        return _about(np.linspace(settings.start_m, settings.stop_m, settings.views), target_center_xy, key)
    positions = _read_positions(settings.file) if settings.file is not None else settings.positions_m
    return _about(positions, target_center_xy, f"{key}.{_source(settings)}")


def _source(settings: PositionsTrajectory) -> str:
    return f"file = {settings.file}" if settings.file is not None else "positions_m"


def _count(settings: CircleTrajectory | ArcTrajectory) -> int:
    if isinstance(settings, CircleTrajectory):
        return whole_turn(settings.interval_deg)
    return math.floor((settings.stop_deg - settings.start_deg) / settings.interval_deg + 1e-9) + 1


def _wrapped(angles_deg: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Angles in [0, 360); the remainder of a tiny negative angle rounds to 360 itself."""
    rest = np.mod(angles_deg, 360.0)
    return np.where(rest >= 360.0, 0.0, rest)


def _on_circle(
    center_m: tuple[float, float], radius_m: float, angles_deg: NDArray[np.floating[Any]], height_m: float
) -> Views:
    angles = np.deg2rad(angles_deg)
    x, y = center_m[0] + radius_m * np.cos(angles), center_m[1] + radius_m * np.sin(angles)
    return Views(np.stack([x, y, np.full_like(x, height_m)], axis=1), _wrapped(angles_deg), center_m)


def _turntable(settings: TurntableTrajectory, key: str) -> Views:
    x, y = settings.sensor_m[0] - settings.axis_m[0], settings.sensor_m[1] - settings.axis_m[1]
    radius = math.hypot(x, y)
    if radius == 0:
        raise ConfigError(
            f"{key}.sensor_m = {list(settings.sensor_m)} stands on the axis; every view would be the same"
        )
    turned = settings.interval_deg * np.arange(whole_turn(settings.interval_deg))
    return _on_circle(settings.axis_m, radius, math.degrees(math.atan2(y, x)) - turned, settings.sensor_m[2])


def _about(positions_m: ArrayLike | None, center_xy: tuple[float, float], key: str) -> Views:
    positions = np.asarray(positions_m, np.float64)
    offset = positions[:, :2] - center_xy
    on_axis = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) == 0)
    if len(on_axis):
        raise ConfigError(
            f"{key}: position {on_axis[0]} = {positions[on_axis[0]].tolist()} is at no horizontal distance from the "
            f"target's centre {list(center_xy)}, so it has no direction"
        )
    return Views(positions, _wrapped(np.rad2deg(np.arctan2(offset[:, 1], offset[:, 0]))), center_xy)


def _read_positions(name: str) -> list[list[float]]:
    """Rows (x, y, z) in metres of a CSV file with the header ``x_m,y_m[,z_m]`` in any order; z defaults to 0."""
    file = existing_file(name, "positions file")
    rows: list[list[float]] = []
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            header = [column.strip() for column in next(reader, [])]
            _check_header(header, f"{file}: line 1")
            for row in reader:
                if not row:
                    continue  # a blank line
                place = f"{file}: line {reader.line_num}"
                if len(row) != len(header):
                    raise DataError(f"{place}: has {len(row)} values; the header has {len(header)} columns")
                values = {
                    column: _number(text, f"{place}, column {column}") for column, text in zip(header, row, strict=True)
                }
                rows.append([values.get(column, 0.0) for column in COLUMNS])
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{file}: is not a CSV text file: {error}") from error
    if not rows:
        raise DataError(f"{file}: has a header and no positions")
    return rows


def _check_header(header: list[str], place: str) -> None:
    for column in header:
        if column not in COLUMNS:
            raise DataError(f"{place}: unknown column '{column}'; allowed: {', '.join(COLUMNS)}")
        if header.count(column) > 1:
            raise DataError(f"{place}: column '{column}' appears {header.count(column)} times")
    for column in COLUMNS[:2]:
        if column not in header:
            raise DataError(f"{place}: missing column '{column}'; the header is x_m,y_m or x_m,y_m,z_m")


def _number(text: Any, place: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise DataError(f"{place}: '{text}' is not a number") from None
    if not math.isfinite(value):
        raise DataError(f"{place}: '{text}' is not a finite number")
    return value
