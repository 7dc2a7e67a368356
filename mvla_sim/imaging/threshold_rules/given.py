"""Thresholds as they are given."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.thresholds import ThresholdRule, Thresholds

__all__ = ["GivenThresholds"]


class GivenThresholds(ThresholdRule):
    """The top p per cent of all voxels, of which those with Θ ≥ T_θ are kept (``eq:joint_thresholding_new``)."""

    rule: Literal["given"] = "given"
    top_percent: Annotated[float, Field(gt=0, le=100, description="p, per cent of all voxels")] = 1.0
    min_support_deg: Annotated[float, Field(ge=0, le=360, description="T_θ, degrees")] = 0.0

    def thresholds(
        self, score: NDArray[Any], support_deg: NDArray[Any] | None, grid: VoxelGrid, resolution_m: float | None
    ) -> Thresholds:
        """The same for every image."""
        del score, support_deg, grid, resolution_m
        return Thresholds(self.top_percent, self.min_support_deg)
