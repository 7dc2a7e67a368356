"""A straight line."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from mvla_sim.scene.trajectory import Trajectory, views_about
from mvla_sim.scene.views import Views

__all__ = ["Line"]


class Line(Trajectory):
    """Evenly spaced positions on a straight line, both ends included."""

    kind: Literal["line"] = "line"
    start_m: tuple[float, float, float] = Field(description="first view, x, y and z")
    stop_m: tuple[float, float, float] = Field(description="last view, x, y and z")
    views: Annotated[int, Field(ge=2, description="number of views, evenly spaced, both ends included")]

    @model_validator(mode="after")
    def _check(self) -> Line:
        if self.start_m == self.stop_m:
            raise ValueError(f"start_m and stop_m are the same point {list(self.start_m)}")
        return self

    def build_views(self, center_xy: tuple[float, float], key: str = "trajectory") -> Views:
        """Views on the line, their angles about the target's centre."""
        return self.equipped(views_about(np.linspace(self.start_m, self.stop_m, self.views), center_xy, key), key)
