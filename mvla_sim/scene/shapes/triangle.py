"""An equilateral triangle."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveFloat

from mvla_sim.scene.shape import Prism

__all__ = ["Triangle"]


class Triangle(Prism):
    """An equilateral triangle by its altitude, centroid at its position, one tip towards +y."""

    shape: Literal["triangle"] = "triangle"
    altitude_m: PositiveFloat = Field(6.0, description="of the equilateral triangle")

    @property
    def nominal_extent_m(self) -> float:
        """The side."""
        return self.altitude_m * 2 / math.sqrt(3)

    def corners(self) -> ArrayLike:
        """The tip lies at two thirds of the altitude."""
        side, low = self.nominal_extent_m, -self.altitude_m / 3
        return np.array([[-side / 2, low], [side / 2, low], [0.0, 2 * self.altitude_m / 3]])
