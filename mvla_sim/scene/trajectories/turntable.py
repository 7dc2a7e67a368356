"""A target on a turntable."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mvla_sim.errors import ConfigError
from mvla_sim.scene.pointing import PointingSettings, pointed, side_by_side, unturned
from mvla_sim.scene.trajectory import Heights, Interval, Trajectory, views_on_circle, whole_turn
from mvla_sim.scene.views import Views

__all__ = ["Turntable", "on_turntable"]


class Turntable(Trajectory):
    """A fixed sensor and a target that turns counter-clockwise: the same views, seen from the target's frame.

    Notes
    -----
    At step k the target has turned by α = k·interval about the axis and the sensor stands still. In the target's frame
    the sensor has turned by −α about that axis, so the views run clockwise.
    """

    kind: Literal["turntable"] = "turntable"
    sensor_m: tuple[float, float, float] = Field((10.0, 0.0, 0.0), description="fixed, x, y and z")
    interval_deg: Interval = Field(1.0, description="turn of the target between views; divides 360")
    axis_m: tuple[float, float] = Field((0.0, 0.0), description="that the target turns about, x and y")
    heights_m: Heights = Field(None, description="instead of the sensor's z: a whole turn at each height")

    @model_validator(mode="after")
    def _check(self) -> Turntable:
        whole_turn(self.interval_deg)
        return self

    @property
    def turned_deg(self) -> NDArray[np.float64]:
        """How far the target has turned at each step of a turn, degrees."""
        return np.asarray(self.interval_deg * np.arange(whole_turn(self.interval_deg)), np.float64)

    def build_views(self, center_xy: tuple[float, float], key: str = "trajectory") -> Views:
        """Views in the target's frame, their angles about the axis."""
        del center_xy
        x, y = self.sensor_m[0] - self.axis_m[0], self.sensor_m[1] - self.axis_m[1]
        radius = math.hypot(x, y)
        if radius == 0:
            place = f"{key}.sensor_m = {list(self.sensor_m)}"
            raise ConfigError(f"{place} stands on the axis; every view would be the same")
        heights = self.heights_m or (self.sensor_m[2],)
        turned = self.turned_deg
        views = views_on_circle(self.axis_m, radius, math.degrees(math.atan2(y, x)) - turned, heights)
        turned = np.tile(turned, len(heights))
        return on_turntable(views, turned, self.pointing, self.pair_separation_m, f"{key}.pointing")

    def angles_in_names(self, views: Views, key: str = "trajectory") -> NDArray[np.float64]:
        """How far the target has turned."""
        del views
        if self.heights_m is not None:
            raise ConfigError(f"{key}.heights_m: one file an angle cannot hold several heights")
        return self.turned_deg


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
    aim = np.column_stack([unturned(offset, turned_deg) + axis_m, np.full(len(views), pointing.aim_m[2])])
    return side_by_side(pointed(views, PointingSettings(), key, aim_m=aim), separation_m)
