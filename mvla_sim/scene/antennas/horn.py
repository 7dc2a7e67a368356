"""A horn antenna."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.scene.antenna import AZIMUTHS_DEG, ELEVATIONS_DEG, Antenna, AntennaPattern, PeakGain

__all__ = ["Horn"]

HALF_POWER_DB = 10 * np.log10(2)

Beamwidth = Annotated[float, Field(ge=1, le=180)]  # patterns have nodes 0.25° apart


class Horn(Antenna):
    """A horn by its half-power beamwidths, the same for transmitter and receiver."""

    kind: Literal["horn"] = "horn"
    azimuth_beamwidth_deg: Beamwidth = Field(14.39, description="full width at half power, horizontal plane")
    elevation_beamwidth_deg: Beamwidth | None = Field(None, description="vertical plane; by default as in azimuth")
    shape: Literal["gaussian", "cosine"] = Field("gaussian", description="main lobe: Gaussian, or cos^q of the angle")
    floor_db: Annotated[float, Field(lt=0, description="level below the peak of side and back lobes")] = -40.0
    gain_dbi: PeakGain = None

    def pattern(self) -> AntennaPattern:
        """Pattern of the main lobe down to the floor.

        Notes
        -----
        With half-power beamwidth β: Gaussian, level −10·log₁₀(2)·(2θ/β)² dB; cosine, 20·q·log₁₀ cos θ dB with q such
        that it is half the power at β/2, and the floor beyond 90°.
        """
        azimuth = self._lobe(self.azimuth_beamwidth_deg, AZIMUTHS_DEG)
        elevation = self._lobe(self.elevation_beamwidth_deg or self.azimuth_beamwidth_deg, ELEVATIONS_DEG)
        return AntennaPattern.from_cuts(azimuth, elevation, self.gain_dbi, self.floor_db)

    def _lobe(self, beamwidth_deg: float, angles_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """One cut, down to the floor."""
        if self.shape == "gaussian":
            level = -HALF_POWER_DB * (2 * angles_deg / beamwidth_deg) ** 2
        else:
            exponent = HALF_POWER_DB / (-20 * np.log10(np.cos(np.deg2rad(beamwidth_deg / 2))))
            ahead = abs(angles_deg) < 90
            cosine = np.cos(np.deg2rad(np.where(ahead, angles_deg, 0.0)))
            level = np.where(ahead, 20 * exponent * np.log10(cosine), -np.inf)
        return np.asarray(np.maximum(level, self.floor_db), np.float64)
