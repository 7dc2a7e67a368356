"""A rectangle."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PositiveFloat

from mvla_sim.scene.shape import Prism

__all__ = ["Rectangle", "box"]


class Rectangle(Prism):
    """A rectangle, length along x and width along y."""

    shape: Literal["rectangle"] = "rectangle"
    length_m: PositiveFloat = Field(description="along x")
    width_m: PositiveFloat = Field(description="along y")

    def corners(self) -> ArrayLike:
        """Its four corners."""
        return box(self.length_m, self.width_m)


def box(length_m: float, width_m: float) -> NDArray[np.float64]:
    """Corners ``[4, 2]`` of a rectangle about the origin, counter-clockwise, metres."""
    x, y = length_m / 2, width_m / 2
    return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
