"""Thresholds from the image alone, for data without a truth."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat
from scipy.spatial import ConvexHull, QhullError

from mvla_sim.errors import DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.thresholds import ThresholdRule, Thresholds, rank_order

__all__ = ["AutomaticThresholds"]

_SPOTS: Final = {
    1: lambda width: 3 * width,
    2: lambda width: np.pi * (3 * width) ** 2,
    3: lambda width: 4 / 3 * np.pi * (4.5 * width) ** 3,
}
"""Voxels of the smallest contour, by dimensions: half as wide again as a disc or ball that is all outline.

A bright spot is smaller, and there is no line to be found in it. An interval has two ends.
"""


class AutomaticThresholds(ThresholdRule):
    """Retain a contour's worth of voxels.

    A contour of length L is seen as a line of the width w, 1.2·ΔR by default, so it covers the area w·L. L is not
    known, but what is retained tells it: the perimeter of its convex hull. So p is the smallest at which the retained
    area is w times the perimeter of the hull of what is retained; a disc of radius 3w at least, for what is smaller is
    no line. In three dimensions a volume is w times the hull's surface, in one w at each end. T_θ is 20°, and so two
    neighbouring views at least; half the largest Θ where that is less. Width and T_θ were chosen on circle, square and
    triangle.
    """

    rule: Literal["auto"] = "auto"
    width: PositiveFloat = Field(1.2, description="width of a contour in the image, in resolution cells ΔR")
    least_support_deg: NonNegativeFloat = Field(20.0, description="T_θ, degrees, or half the largest Θ if that is less")

    def thresholds(
        self, score: NDArray[Any], support_deg: NDArray[Any] | None, grid: VoxelGrid, resolution_m: float | None = None
    ) -> Thresholds:
        """Choose p and T_θ; see :meth:`ThresholdRule.thresholds`.

        What is not above 0 is never retained or, where nothing is above 0 (as of logarithms), what is lowest. ΔR counts
        as a voxel at least, and as one where it is not known.

        Raises
        ------
        DataError
            The image is the same everywhere, so that there is nothing to choose; or not finite.
        """
        flat = np.asarray(score).ravel()
        for name, values in (("score", flat), ("angular support", support_deg)):
            if values is not None and not np.isfinite(values).all():
                raise DataError(f"threshold = 'auto': the {name} is not finite everywhere; give top_percent instead")
        if flat.max() == flat.min():
            raise DataError("threshold = 'auto': the image is the same everywhere; give top_percent instead")
        order = rank_order(flat)
        support = 0.0
        passing = flat[order] > (0 if flat.max() > 0 else flat.min())
        if support_deg is not None:
            theta = np.asarray(support_deg).ravel()[order]
            support = min(self.least_support_deg, float(theta[passing].max()) / 2)
            passing &= theta >= support
        ranks = np.flatnonzero(passing)
        places = np.stack(np.unravel_index(order[ranks], grid.shape), axis=1)[:, np.array(grid.shape) > 1]
        width = self.width * max(resolution_m or 0.0, grid.spacing_m) / grid.spacing_m
        count = min(ranks.size, round(_SPOTS[places.shape[1] or 1](width)))
        while count < ranks.size:  # the hull only grows, so no count up to the one its perimeter asks for can do
            asked = min(ranks.size, round(width * _perimeter(places[:count])))
            if asked <= count:
                break
            count = asked
        return Thresholds(100 * (int(ranks[count - 1]) + 1) / flat.size, support)


def _perimeter(places: NDArray[np.intp]) -> float:
    """Perimeter, or surface, of the convex hull of voxels ``[n, dimensions]``, in spacings; of an interval its ends, 2.

    Flat ones have two sides: a line twice its length, a plane twice its area.
    """
    dimensions = places.shape[1]
    if dimensions < 2:
        return 2.0
    try:
        return float(ConvexHull(places).area)
    except QhullError:  # too few, or all on a line or in a plane
        pass
    offset = places - places.mean(axis=0)
    flat = offset @ np.linalg.svd(offset, full_matrices=False)[2][: dimensions - 1].T
    try:
        return 2 * float(ConvexHull(flat).volume)
    except (QhullError, ValueError):  # on a line, or one-dimensional
        return 2 * float(np.ptp(flat[:, 0]))
