"""The sector that a view's antennas cover: observations are projected only within it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.scene.antenna import Antenna, AntennaPattern, local_angles
from mvla_sim.settings import Settings

__all__ = ["Beam", "BeamSettings", "build_beam"]


class BeamSettings(Settings):
    """Where a view's antennas reach; antennas without a pattern reach everywhere."""

    edge_db: Annotated[float, Field(lt=0)] | None = Field(
        -3.0,
        description="one-way level below the peak at which the covered sector ends, where nothing is projected any "
        "more; 'none': project everywhere",
    )


@dataclass(frozen=True, eq=False)
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
