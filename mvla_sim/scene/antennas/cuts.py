"""An antenna by its two principal cuts."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from mvla_sim.scene.antenna import AZIMUTHS_DEG, ELEVATIONS_DEG, Antenna, AntennaPattern

__all__ = ["PatternCuts"]


class PatternCuts(Antenna):
    """The two cuts of a pattern as channel files carry them, so that they do without its file."""

    kind: Literal["cuts"] = "cuts"
    azimuth_db: Annotated[
        tuple[float, ...],
        Field(
            min_length=len(AZIMUTHS_DEG),
            max_length=len(AZIMUTHS_DEG),
            description="level relative to boresight over azimuth, −180° to 180°",
        ),
    ]
    elevation_db: Annotated[
        tuple[float, ...],
        Field(
            min_length=len(ELEVATIONS_DEG),
            max_length=len(ELEVATIONS_DEG),
            description="level relative to boresight over elevation, −90° to 90°",
        ),
    ]
    gain_dbi: float = Field(description="at boresight")

    def pattern(self) -> AntennaPattern:
        """Pattern of the cuts."""
        return AntennaPattern.from_cuts(np.array(self.azimuth_db), np.array(self.elevation_db), self.gain_dbi)
