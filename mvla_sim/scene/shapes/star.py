"""A star polygon."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveFloat, model_validator

from mvla_sim.scene.shape import Prism, polar

__all__ = ["Star"]


class Star(Prism):
    """A star polygon, one tip towards +y; the inner radius defaults to that of {n/2}, for n = 5 r·sin18°/sin54°.

    Notes
    -----
    The inner radius of {n/2} is r·cos(2π/n)/cos(π/n).
    """

    shape: Literal["star"] = "star"
    points: Annotated[int, Field(ge=3, le=1000, description="number of tips")] = 5
    radius_m: PositiveFloat = Field(4.0, description="from the centre to a tip")
    inner_radius_m: PositiveFloat | None = Field(
        None, description="from the centre to a notch; by default that of the regular star polygon"
    )

    @model_validator(mode="after")
    def _check(self) -> Star:
        if self.inner_radius_m is None and self.points < 5:
            raise ValueError(f"points = {self.points} has no {{n/2}} star polygon; give inner_radius_m")
        if self.inner_radius_m is not None and self.inner_radius_m >= self.radius_m:
            raise ValueError(f"inner_radius_m = {self.inner_radius_m} must be below radius_m = {self.radius_m}")
        return self

    def corners(self) -> ArrayLike:
        """Outer and inner corners in turn, from the tip."""
        count = self.points
        inner = self.inner_radius_m
        if inner is None:
            inner = self.radius_m * math.cos(2 * math.pi / count) / math.cos(math.pi / count)
        radii = np.where(np.arange(2 * count) % 2 == 0, self.radius_m, inner)
        return polar(radii, 90 + np.arange(2 * count) * (180 / count))
