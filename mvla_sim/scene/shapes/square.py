"""A square."""

from __future__ import annotations

from typing import Literal

from numpy.typing import ArrayLike
from pydantic import Field, PositiveFloat

from mvla_sim.scene.shape import Prism
from mvla_sim.scene.shapes.rectangle import box

__all__ = ["Square"]


class Square(Prism):
    """A square with sides along x and y.

    Examples
    --------
    >>> Square(side_m=2.0).outline().area
    4.0
    """

    shape: Literal["square"] = "square"
    side_m: PositiveFloat = Field(8.0, description="length of a side")

    @property
    def nominal_extent_m(self) -> float:
        """The side."""
        return self.side_m

    def corners(self) -> ArrayLike:
        """Its four corners."""
        return box(self.side_m, self.side_m)
