"""A cylinder, called ``circle`` in scene files after its outline."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveFloat

from mvla_sim.scene.shape import Prism, polar

__all__ = ["Cylinder"]


class Cylinder(Prism):
    """A cylinder. A facet's centre points to the +x axis, so views at whole multiples of 360°/facets see a flash.

    Notes
    -----
    The outline is a regular polygon with its corners on the circle, turned so that the centre of facet k is seen in
    direction k·360°/facets; the facets' centres lie at r·cos(180°/facets), at 360 facets 0.15 mm inside 4 m.

    Examples
    --------
    >>> Cylinder(radius_m=4.0).nominal_extent_m
    8.0
    """

    shape: Literal["circle"] = "circle"
    radius_m: PositiveFloat = Field(4.0, description="of the circle")
    facets: Annotated[int, Field(ge=3, le=100_000, description="flat sides that stand for the round one")] = 360

    @property
    def nominal_extent_m(self) -> float:
        """The diameter."""
        return 2 * self.radius_m

    def corners(self) -> ArrayLike:
        """Ends of the facets."""
        return polar(self.radius_m, (np.arange(self.facets) + 0.5) * (360 / self.facets))
