"""Part of a circle."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from mvla_sim.scene.trajectory import Interval, Trajectory, views_on_circle
from mvla_sim.scene.views import Views

__all__ = ["Arc"]


class Arc(Trajectory):
    """Part of a circle, from ``start_deg`` to ``stop_deg`` inclusive.

    Where the interval does not divide the arc, the last view lies before its end.
    """

    kind: Literal["arc"] = "arc"
    radius_m: PositiveFloat = Field(10.0, description="from the centre to the sensor")
    start_deg: float = Field(description="azimuth of the first view")
    stop_deg: float = Field(description="azimuth of the last view, if the interval meets it")
    interval_deg: Interval = Field(1.0, description="between views")
    center_m: tuple[float, float] = Field((0.0, 0.0), description="of the circle, x and y")
    height_m: float = Field(0.0, description="z of the sensor")

    @model_validator(mode="after")
    def _check(self) -> Arc:
        span = self.stop_deg - self.start_deg
        if not 0 < span < 360:
            raise ValueError(f"stop_deg - start_deg = {span:g} must be above 0 and below 360; use kind = 'circle'")
        if span < self.interval_deg:
            raise ValueError(f"interval_deg = {self.interval_deg:g} is wider than the arc of {span:g}")
        return self

    def build_views(self, center_xy: tuple[float, float], key: str = "trajectory") -> Views:
        """Views on the arc, their angles about the circle's own centre."""
        del center_xy
        count = math.floor((self.stop_deg - self.start_deg) / self.interval_deg + 1e-9) + 1
        angles = self.start_deg + self.interval_deg * np.arange(count)
        return self.equipped(views_on_circle(self.center_m, self.radius_m, angles, (self.height_m,)), key)
