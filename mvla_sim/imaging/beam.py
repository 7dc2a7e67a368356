"""The sector that a view's antennas cover: observations are projected only within it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvla_sim.imaging.imaging_settings import BeamSettings
from mvla_sim.scene.antenna import Antenna, AntennaPattern, local_angles

__all__ = ["Beam", "build_beam"]


@dataclass(frozen=True)
class Beam:
    """Which directions off the boresight count as illuminated.

    Attributes
    ----------
    antenna
        The pattern.
    edge_db
        One-way level below the peak at which the sector ends, dB.
    """

    antenna: AntennaPattern
    edge_db: float

    def covers(self, vectors_m: NDArray[np.float64], boresights: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points at ``vectors_m`` [n, 3] from antennas of ``boresights`` [n, 3] or [3] lie in the sector."""
        azimuth, elevation = local_angles(vectors_m, boresights)
        return np.asarray(self.antenna.level_db(azimuth, elevation) >= self.edge_db, np.bool_)


def build_beam(antenna: Antenna, settings: BeamSettings) -> Beam | None:
    """Beam of a channel's antenna; None where it is omnidirectional or the edge is switched off.

    Raises
    ------
    DataError
        A pattern file that cannot be used.
    """
    pattern = antenna.pattern()
    return None if pattern is None or settings.edge_db is None else Beam(pattern, settings.edge_db)
