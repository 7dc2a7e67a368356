"""A target that drives past a fixed sensor."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from mvla_sim.scene.columns import read_columns
from mvla_sim.scene.pointing import pointed, side_by_side, unturned
from mvla_sim.scene.trajectory import Trajectory, views_about
from mvla_sim.scene.views import Views

__all__ = ["Poses"]


class Poses(Trajectory):
    """A fixed sensor and a target that drives past: its place and heading at each view.

    The file has a header ``x_m,y_m,heading_deg``: where the origin of the target's frame is, and how far that frame has
    turned counter-clockwise. Pointing is in the frame in which the sensor stands still.
    """

    kind: Literal["poses"] = "poses"
    sensor_m: tuple[float, float, float] = Field((0.0, 0.0, 0.0), description="in the frame of what moves, x, y and z")
    file: str | None = Field(None, description="CSV file of the poses instead, beside the scene file")
    poses: tuple[tuple[float, float, float], ...] | None = Field(
        None, description="x and y in metres, heading in degrees"
    )

    @model_validator(mode="after")
    def _check(self) -> Poses:
        if (self.file is None) == (self.poses is None):
            raise ValueError("give either file or poses")
        if self.poses is not None and not self.poses:
            raise ValueError("poses is empty; give at least one pose")
        return self

    def build_views(self, center_xy: tuple[float, float], key: str = "trajectory") -> Views:
        """The sensor as seen from the target's frame at each pose, its angles about the target's centre."""
        place = f"{key}.poses"
        if self.file is not None:
            place = f"{key}.file = {self.file}"
            numbers = read_columns(self.file, "poses file", ("x_m", "y_m", "heading_deg")).numbers
            poses = np.column_stack([numbers["x_m"], numbers["y_m"], numbers["heading_deg"]])
        else:
            poses = np.asarray(self.poses, np.float64)
        seen = unturned(np.asarray(self.sensor_m[:2]) - poses[:, :2], poses[:, 2])
        positions = np.column_stack([seen, np.full(len(poses), self.sensor_m[2])])
        views = pointed(
            views_about(positions, center_xy, place),
            self.pointing,
            f"{key}.pointing",
            turned_deg=poses[:, 2],
            origin_m=poses[:, :2],
            aim_m=(*poses[:, :2].mean(axis=0), self.sensor_m[2]),
        )
        return side_by_side(views, self.pair_separation_m)
