"""An antenna by its two principal cuts."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.scene.antenna import AZIMUTHS_DEG, ELEVATIONS_DEG, Antenna, AntennaPattern

__all__ = ["PatternCuts"]


def _nodes(angles_deg: NDArray[np.float64], description: str) -> Any:
    return Field(min_length=len(angles_deg), max_length=len(angles_deg), description=description)


class PatternCuts(Antenna):
    """The two cuts of a pattern as channel files carry them, so that they do without its file."""

    kind: Literal["cuts"] = "cuts"
    azimuth_db: tuple[float, ...] = _nodes(AZIMUTHS_DEG, "level relative to boresight over azimuth, −180° to 180°")
    elevation_db: tuple[float, ...] = _nodes(ELEVATIONS_DEG, "level relative to boresight over elevation, −90° to 90°")
    gain_dbi: float = Field(description="at boresight")

    def pattern(self) -> AntennaPattern:
        """Pattern of the cuts."""
        return AntennaPattern.from_cuts(np.array(self.azimuth_db), np.array(self.elevation_db), self.gain_dbi)
