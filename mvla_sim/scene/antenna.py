"""Antenna patterns: a level over azimuth and one over elevation, about the direction in which the antenna points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.scene.antenna_settings import AntennaSettings, Horn, Omni, PatternCuts, PatternFile
from mvla_sim.scene.positions import read_columns

__all__ = ["STEP_DEG", "Antenna", "build_antenna", "local_angles", "self_contained"]

STEP_DEG = 0.25
HALF_POWER_DB = 10 * np.log10(2)
AZIMUTHS_DEG = np.linspace(-180.0, 180.0, round(360 / STEP_DEG) + 1)
ELEVATIONS_DEG = np.linspace(-90.0, 90.0, round(180 / STEP_DEG) + 1)


@dataclass(frozen=True, eq=False)
class Antenna:
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

    def level_db(self, azimuth_deg: NDArray[np.float64], elevation_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Level below the peak in directions off the boresight, dB, of the arrays' common shape."""
        level = np.interp(azimuth_deg, AZIMUTHS_DEG, self.azimuth_db)
        level = level + np.interp(elevation_deg, ELEVATIONS_DEG, self.elevation_db)
        return np.asarray(np.maximum(level, self.floor_db), np.float64)

    def amplitude(self, vectors: NDArray[np.float64], boresights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Field pattern, the square root of the gain, along ``vectors`` [n, 3] for boresights ``[n, 3]`` or ``[3]``."""
        level = self.level_db(*local_angles(vectors, boresights))
        return np.asarray(10 ** ((self.gain_dbi + level) / 20), np.float64)


def build_antenna(settings: AntennaSettings) -> Antenna | None:
    """Build the pattern of a settings block; None for an omnidirectional antenna.

    Raises
    ------
    DataError
        A pattern file that cannot be used.

    Notes
    -----
    Horn, with half-power beamwidth β: Gaussian, level −10·log₁₀(2)·(2θ/β)² dB; cosine, 20·q·log₁₀ cos θ dB with q such
    that it is half the power at β/2, and the floor beyond 90°.
    """
    if isinstance(settings, Omni):
        return None
    if isinstance(settings, PatternCuts):
        azimuth, elevation = np.array(settings.azimuth_db), np.array(settings.elevation_db)
        return Antenna(azimuth, elevation, float(min(azimuth.min(), elevation.min())), settings.gain_dbi)
    if isinstance(settings, Horn):
        vertical = settings.elevation_beamwidth_deg or settings.azimuth_beamwidth_deg
        azimuth = _lobe(settings, settings.azimuth_beamwidth_deg, AZIMUTHS_DEG)
        elevation = _lobe(settings, vertical, ELEVATIONS_DEG)
        floor = settings.floor_db
    else:
        azimuth, elevation = _read_cuts(settings.file)
        floor = float(min(azimuth.min(), elevation.min()))
    gain = settings.gain_dbi if settings.gain_dbi is not None else _directivity_dbi(azimuth, elevation, floor)
    return Antenna(azimuth, elevation, floor, gain)


def self_contained(settings: AntennaSettings) -> AntennaSettings:
    """Replace a pattern file by its cuts, to 0.001 dB; any other antenna stays as it is.

    Raises
    ------
    DataError
        A pattern file that cannot be used.
    """
    pattern = build_antenna(settings) if isinstance(settings, PatternFile) else None
    if pattern is None:
        return settings
    cuts = (tuple(np.round(cut, 3).tolist()) for cut in (pattern.azimuth_db, pattern.elevation_db))
    return PatternCuts(kind="cuts", azimuth_db=next(cuts), elevation_db=next(cuts), gain_dbi=pattern.gain_dbi)


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


def _lobe(settings: Horn, beamwidth_deg: float, angles_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """One cut of a horn, down to its floor."""
    if settings.shape == "gaussian":
        level = -HALF_POWER_DB * (2 * angles_deg / beamwidth_deg) ** 2
    else:
        exponent = HALF_POWER_DB / (-20 * np.log10(np.cos(np.deg2rad(beamwidth_deg / 2))))
        ahead = abs(angles_deg) < 90
        cosine = np.cos(np.deg2rad(np.where(ahead, angles_deg, 0.0)))
        level = np.where(ahead, 20 * exponent * np.log10(cosine), -np.inf)
    return np.asarray(np.maximum(level, settings.floor_db), np.float64)


def _read_cuts(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cuts of a pattern file relative to their peak; without an elevation cut the azimuth one serves for both."""
    numbers, _ = read_columns(name, "antenna pattern file", ("angle_deg", "azimuth_db"), ("elevation_db",))
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


def _directivity_dbi(azimuth: NDArray[np.float64], elevation: NDArray[np.float64], floor_db: float) -> float:
    """10·log₁₀ of 4π over the integral of the pattern over the sphere."""
    level = np.maximum(azimuth[:-1, None] + elevation[None, :], floor_db)
    weight = np.cos(np.deg2rad(ELEVATIONS_DEG)) * np.deg2rad(STEP_DEG) ** 2
    return float(10 * np.log10(4 * np.pi / (10 ** (level / 10) * weight).sum()))
