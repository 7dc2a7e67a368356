"""A measured antenna pattern."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.errors import DataError
from mvla_sim.scene.antenna import AZIMUTHS_DEG, ELEVATIONS_DEG, Antenna, AntennaPattern, PeakGain
from mvla_sim.scene.antennas.cuts import PatternCuts
from mvla_sim.scene.columns import read_columns

__all__ = ["PatternFile"]


class PatternFile(Antenna):
    """A measured pattern: a CSV file with columns ``angle_deg,azimuth_db[,elevation_db]``, one cut a plane."""

    kind: Literal["file"] = "file"
    file: str = Field(description="CSV file of the pattern's cuts, beside the scene file")
    gain_dbi: PeakGain = None

    def pattern(self) -> AntennaPattern:
        """Pattern of the file, which is read once: a channel keeps it though the file is edited or gone."""
        return self._read

    @cached_property
    def _read(self) -> AntennaPattern:
        return AntennaPattern.from_cuts(*_read_cuts(self.file), self.gain_dbi)

    def self_contained(self) -> PatternCuts:
        """Its cuts, to 0.001 dB."""
        pattern = self.pattern()
        azimuth, elevation = (np.round(cut, 3).tolist() for cut in (pattern.azimuth_db, pattern.elevation_db))
        return PatternCuts(azimuth_db=azimuth, elevation_db=elevation, gain_dbi=pattern.gain_dbi)


def _read_cuts(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cuts of a pattern file relative to their peak; without an elevation cut the azimuth one serves for both."""
    numbers = read_columns(name, "antenna pattern file", ("angle_deg", "azimuth_db"), ("elevation_db",)).numbers
    angles = numbers["angle_deg"]
    order = np.argsort(angles)
    angles = angles[order]
    if len(angles) < 2 or (np.diff(angles) <= 0).any():
        raise DataError(f"{name}: angle_deg needs at least two different angles, each once")
    if angles[0] < -180 or angles[-1] > 180:
        raise DataError(f"{name}: angle_deg goes from {angles[0]:g} to {angles[-1]:g}; allowed: -180 to 180 degrees")
    if not angles[0] < 0 < angles[-1]:
        raise DataError(f"{name}: angle_deg goes from {angles[0]:g} to {angles[-1]:g}; 0 must lie between")
    cuts = []
    for column, nodes in (("azimuth_db", AZIMUTHS_DEG), ("elevation_db", ELEVATIONS_DEG)):
        level = numbers.get(column, numbers["azimuth_db"])[order]
        level = level - level.max()
        outside = level.min()  # what was not measured is taken as low as the lowest that was
        cuts.append(np.interp(nodes, angles, level, left=outside, right=outside))
    return cuts[0], cuts[1]
