"""Antennas: a level over azimuth and one over elevation, about the direction in which the antenna points.

The kinds are in :mod:`mvla_sim.scene.antennas`; whoever adds one derives it from :class:`Antenna`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.kinds import Kind, Kinds

__all__ = [
    "ANTENNAS", "AZIMUTHS_DEG", "ELEVATIONS_DEG", "STEP_DEG", "Antenna", "AntennaPattern", "PeakGain", "local_angles",
]  # fmt: skip

STEP_DEG = 0.25
AZIMUTHS_DEG = np.linspace(-180.0, 180.0, round(360 / STEP_DEG) + 1)
ELEVATIONS_DEG = np.linspace(-90.0, 90.0, round(180 / STEP_DEG) + 1)
"""Nodes of the two cuts."""

PeakGain = Annotated[
    float | None, Field(description="peak gain in dBi; by default the directivity of the pattern itself")
]

ANTENNAS: Kinds[Antenna] = Kinds("antenna", "mvla_sim.antennas", "mvla_sim.scene.antennas", key="kind")
"""All antennas by name."""


class Antenna(Kind):
    """An antenna, the same for transmitter and receiver. A setting ``file`` is relative to the file of the scene."""

    kinds: ClassVar[Kinds[Any]] = ANTENNAS
    directional: ClassVar[bool] = True
    """Whether it has a pattern; without one it is isotropic, and need not be pointed."""

    def pattern(self) -> AntennaPattern | None:
        """Its pattern; None where it is not directional. Each kind of antenna has its own.

        Raises
        ------
        DataError
            A pattern file that cannot be used.
        """
        raise NotImplementedError

    def self_contained(self) -> Antenna:
        """The same antenna without any file beside it.

        Raises
        ------
        DataError
            A pattern file that cannot be used.
        """
        return self


@dataclass(frozen=True, eq=False, repr=False)
class AntennaPattern:
    """A pattern made of its two principal cuts: level(az, el) = azimuth_db(az) + elevation_db(el), but no lower than
    the floor.

    Azimuth is measured in the plane that holds the boresight and the horizontal, elevation out of that plane. Cuts are
    linear between nodes that are 0.25° apart.

    Attributes
    ----------
    azimuth_db
        Level below the peak at azimuths −180° to 180°, ``[1441]`` float64, dB.
    elevation_db
        The same at elevations −90° to 90°, ``[721]`` float64, dB.
    floor_db
        Lowest level of the sum, dB.
    gain_dbi
        Peak gain, dBi.
    """

    azimuth_db: NDArray[np.float64]
    elevation_db: NDArray[np.float64]
    floor_db: float
    gain_dbi: float

    def __repr__(self) -> str:
        return f"AntennaPattern({self.gain_dbi:.2f} dBi, floor {self.floor_db:g} dB)"

    def level_db(self, azimuth_deg: NDArray[np.float64], elevation_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Level below the peak in directions off the boresight, dB, of the arrays' common shape."""
        level = np.interp(azimuth_deg, AZIMUTHS_DEG, self.azimuth_db)
        level = level + np.interp(elevation_deg, ELEVATIONS_DEG, self.elevation_db)
        return np.asarray(np.maximum(level, self.floor_db), np.float64)

    def amplitude(self, vectors: NDArray[np.float64], boresights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Field pattern, the square root of the gain, along ``vectors`` [n, 3] for boresights ``[n, 3]`` or ``[3]``."""
        level = self.level_db(*local_angles(vectors, boresights))
        return np.asarray(10 ** ((self.gain_dbi + level) / 20), np.float64)

    @classmethod
    def from_cuts(
        cls,
        azimuth_db: NDArray[np.float64],
        elevation_db: NDArray[np.float64],
        gain_dbi: float | None = None,
        floor_db: float | None = None,
    ) -> AntennaPattern:
        """Pattern of two cuts.

        By default the peak gain is the directivity of the pattern itself, and the floor the lowest level of the cuts.
        """
        floor = float(min(azimuth_db.min(), elevation_db.min())) if floor_db is None else floor_db
        gain = _directivity_dbi(azimuth_db, elevation_db, floor) if gain_dbi is None else gain_dbi
        return cls(azimuth_db, elevation_db, floor, gain)


def local_angles(
    vectors: NDArray[np.float64], boresights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth and elevation of ``vectors`` [n, 3] off boresights ``[n, 3]`` or ``[3]``, degrees.

    The antenna's left is horizontal, its up the cross product of boresight and left.
    """
    left, up = _frame(boresights)
    ahead = (vectors * boresights).sum(axis=-1)
    aside = (vectors * left).sum(axis=-1)
    above = (vectors * up).sum(axis=-1)
    return np.rad2deg(np.arctan2(aside, ahead)), np.rad2deg(np.arctan2(above, np.hypot(ahead, aside)))


def _frame(boresights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y, z = np.moveaxis(np.asarray(boresights, np.float64), -1, 0)
    flat = np.hypot(x, y)
    azimuth = np.arctan2(y, x)  # 0 where the boresight is vertical
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.stack([-s, c, 0 * c], axis=-1), np.stack([-z * c, -z * s, flat], axis=-1)


def _directivity_dbi(azimuth: NDArray[np.float64], elevation: NDArray[np.float64], floor_db: float) -> float:
    """10·log₁₀ of 4π over the integral of the pattern over the sphere."""
    level = np.maximum(azimuth[:-1, None] + elevation[None, :], floor_db)
    weight = np.cos(np.deg2rad(ELEVATIONS_DEG)) * np.deg2rad(STEP_DEG) ** 2
    return float(10 * np.log10(4 * np.pi / (10 ** (level / 10) * weight).sum()))
