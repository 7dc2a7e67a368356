"""Which thresholds the oracle tries: bounds and steps of p and T_θ."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator

from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.settings import Settings

__all__ = ["ScanSettings"]

SAME = 1e-9  # relative; a bound that falls on a whole number of voxels or steps holds it whatever the rounding


class ScanSettings(Settings):
    """The pairs (p, T_θ) among which the oracle finds the least Chamfer distance; by default all that there are.

    The paper scans p and T_θ "over their admissible ranges" and gives neither bounds nor steps. Without them the search
    is exact over every p and every T_θ. A bound leaves it exact over what lies within: a person who looks for an
    outline does not try to keep half of the image. A step makes it the loop over a few values that a script would run;
    of pairs that are equally good it is the first, with the smallest T_θ and then the smallest p, as ever.

    p may be bounded as an area as well, for a per cent of the voxels means another area on another grid: that of the
    top-p% set before the angular test, as voxels times spacing². In several layers it is the sum of all layers'.
    """

    max_percent: Annotated[float, Field(gt=0, le=100)] | None = Field(
        None, description="largest p, per cent of all voxels; by default all"
    )
    max_area_m2: PositiveFloat | None = Field(
        None, description="the same as an area of voxels, in place of max_percent"
    )
    step_percent: Annotated[float, Field(ge=1e-4, le=100)] | None = Field(
        None, description="p is a multiple of it; by default every number of voxels"
    )
    max_support_deg: Annotated[float, Field(ge=0, le=360)] | None = Field(
        None, description="largest T_θ; by default all values of the image"
    )
    support_step_deg: Annotated[float, Field(ge=1e-3, le=360)] | None = Field(
        None, description="T_θ is 0 or a multiple of it; by default every value of the image"
    )

    @model_validator(mode="after")
    def _check(self) -> ScanSettings:
        if self.max_percent is not None and self.max_area_m2 is not None:
            raise ValueError("scan.max_percent and scan.max_area_m2 both bound p; keep one")
        if self.max_percent is not None and self.step_percent is not None and self.step_percent > self.max_percent:
            raise ValueError(
                f"scan.step_percent = {self.step_percent:g} is above scan.max_percent = {self.max_percent:g}, "
                "so there is no p"
            )
        return self

    @property
    def every_support(self) -> bool:
        """Whether every T_θ is tried."""
        return self.max_support_deg is None and self.support_step_deg is None

    @property
    def bounds_area(self) -> bool:
        """Whether p is bounded, in per cent or as an area."""
        return self.max_percent is not None or self.max_area_m2 is not None

    def largest_count(self, grid: VoxelGrid) -> int:
        """Most voxels that a top-p% set within the bounds has, whatever the step.

        Raises
        ------
        ConfigError
            The bound holds no voxel of this grid, or less than one step.
        """
        if self.max_area_m2 is not None:
            count = self.max_area_m2 / grid.spacing_m**2
            bound, allowed = f"max_area_m2 = {self.max_area_m2:g}", f"{grid.spacing_m**2:g} m²"
        elif self.max_percent is not None:
            count = self.max_percent / 100 * grid.size
            bound, allowed = f"max_percent = {self.max_percent:g}", f"{100 / grid.size:.3g} %"
        else:
            return grid.size
        count = int(np.floor(count * (1 + SAME)))
        if count < 1:
            raise ConfigError(f"evaluation.scan.{bound}: is below one voxel of the grid; must be at least {allowed}")
        if self.max_area_m2 is not None and self.step_percent is not None:
            step = max(1, round(self.step_percent / 100 * grid.size))
            if step > count:
                raise ConfigError(
                    f"evaluation.scan.{bound}: is below one step of {self.step_percent:g} %; must be at least "
                    f"{step * grid.spacing_m**2:g} m²"
                )
        return min(count, grid.size)

    def counts(self, grid: VoxelGrid) -> tuple[NDArray[np.intp], NDArray[np.float64]] | None:
        """Sizes n of the top-p% sets that are tried, ascending, and the smallest p of each; None for every n in bounds.

        Raises
        ------
        ConfigError
            The bound holds no voxel of this grid, or less than one step.
        """
        largest = self.largest_count(grid)
        if self.step_percent is None:
            return None
        steps = np.arange(1, 1 + int(100 / self.step_percent * (1 + SAME)))
        percent = np.minimum(np.round(self.step_percent * steps, 12), 100.0)
        count = np.maximum(1, np.rint(percent / 100 * grid.size)).astype(np.intp)  # as top_count
        inside = count <= largest if self.max_percent is None else percent <= self.max_percent * (1 + SAME)
        count, first = np.unique(count[inside], return_index=True)
        return count, percent[inside][first]

    def supports(self, support_deg: NDArray[Any]) -> NDArray[Any]:
        """T_θ that are tried for an image of these Θ, ``[n]`` degrees, ascending and 0 first."""
        if self.support_step_deg is None:
            tried = np.unique(np.append(np.zeros(1, support_deg.dtype), support_deg))
        else:
            count = int(support_deg.max() / self.support_step_deg * (1 + SAME))
            tried = np.round(self.support_step_deg * np.arange(count + 1), 12)
        return tried if self.max_support_deg is None else tried[tried <= self.max_support_deg * (1 + SAME)]
