"""A full circle about the target."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from mvla_sim.scene.trajectory import Heights, Interval, Trajectory, views_on_circle, whole_turn
from mvla_sim.scene.views import Views

__all__ = ["Circle"]


class Circle(Trajectory):
    """A full circle; the interval must divide 360°. Views are at start + k·interval, for one turn a height."""

    kind: Literal["circle"] = "circle"
    radius_m: PositiveFloat = Field(10.0, description="from the centre to the sensor")
    interval_deg: Interval = Field(1.0, description="between views; divides 360")
    start_deg: float = Field(0.0, description="azimuth of the first view")
    center_m: tuple[float, float] = Field((0.0, 0.0), description="of the circle, x and y")
    height_m: float = Field(0.0, description="z of the sensor")
    heights_m: Heights = Field(None, description="instead of height_m: the whole circle once at each height")

    @model_validator(mode="after")
    def _check(self) -> Circle:
        whole_turn(self.interval_deg)
        return self

    def build_views(self, center_xy: tuple[float, float], key: str = "trajectory") -> Views:
        """Views on the circle, their angles about its own centre."""
        del center_xy
        angles = self.start_deg + self.interval_deg * np.arange(whole_turn(self.interval_deg))
        return self.equipped(
            views_on_circle(self.center_m, self.radius_m, angles, self.heights_m or (self.height_m,)), key
        )
