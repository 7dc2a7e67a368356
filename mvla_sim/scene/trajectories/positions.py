"""Any positions, listed or in a file."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from mvla_sim.errors import ConfigError
from mvla_sim.scene.columns import PLACE, RECEIVER, Columns, read_columns
from mvla_sim.scene.pointing import PointingSettings, directions, pointed, side_by_side
from mvla_sim.scene.trajectory import Trajectory, views_about
from mvla_sim.scene.views import Views

__all__ = ["Positions", "read_positions", "views_of_columns"]


class Positions(Trajectory):
    """Any positions, from a CSV file or listed here.

    The file has a header ``x_m,y_m[,z_m]``; ``rx_x_m,rx_y_m[,rx_z_m]`` set receivers apart from transmitters, and
    ``azimuth_deg[,elevation_deg]`` the antennas' direction, both view by view.
    """

    kind: Literal["positions"] = "positions"
    file: str | None = Field(None, description="CSV file of positions, beside the scene file")
    positions_m: tuple[tuple[float, float, float], ...] | None = Field(
        None, description="positions, x, y and z each, instead of a file"
    )

    @model_validator(mode="after")
    def _check(self) -> Positions:
        if (self.file is None) == (self.positions_m is None):
            raise ValueError("give either file or positions_m")
        if self.positions_m is not None and not self.positions_m:
            raise ValueError("positions_m is empty; give at least one position")
        return self

    def build_views(self, center_xy: tuple[float, float], key: str = "trajectory") -> Views:
        """Views at the positions, their angles about the target's centre."""
        if self.file is None:
            return self.equipped(views_about(self.positions_m, center_xy, f"{key}.positions_m"), key)
        place = f"{key}.file = {self.file}"
        return views_of_columns(read_positions(self.file), center_xy, self.pointing, self.pair_separation_m, place)


def read_positions(file: str) -> Columns:
    """Columns of a positions file by name.

    Raises
    ------
    DataError
        The file cannot be used; the message names file, line and column.
    """
    more = (PLACE[2], *RECEIVER, "azimuth_deg", "elevation_deg")
    return read_columns(file, "positions file", PLACE[:2], more).numbers


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
        boresights = directions(np.deg2rad(numbers["azimuth_deg"]), elevation)
        views = replace(views, boresights=boresights)
    else:
        views = pointed(views, pointing, f"{key}: pointing")
    return views if receivers is not None else side_by_side(views, separation_m)
