"""Where the antennas of each view point, and how transmitter and receiver stand to each other."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from mvla_sim.errors import ConfigError
from mvla_sim.scene.views import Views
from mvla_sim.settings import Settings

__all__ = ["PointingSettings", "directions", "pointed", "side_by_side", "unturned"]

ABOVE_M = 1e-9
"""A point at no more than this horizontal distance is above or below; coordinates of metres are rounded to 1e-15."""


class PointingSettings(Settings):
    """Where the beam points, in the frame in which the trajectory is given: of a turntable and of poses the sensor's.

    By default each view's antennas point horizontally at the trajectory's centre; of poses, at the middle of the
    target's places. ``aim_m`` is a fixed point to look at; ``azimuth_deg`` a fixed compass direction, counter-clockwise
    from +x, as of a side-looking sensor on a straight pass. A positions file with columns
    ``azimuth_deg[,elevation_deg]`` sets it view by view and wins over both.
    """

    aim_m: tuple[float, float, float] | None = Field(
        None, description="point that boresight is directed at, x, y and z; by default the centre of the trajectory"
    )
    azimuth_deg: float | None = Field(None, description="fixed direction of boresight instead")
    elevation_deg: Annotated[float, Field(gt=-90, lt=90, description="tilt above the horizontal")] = 0.0

    @model_validator(mode="after")
    def _check(self) -> PointingSettings:
        if self.aim_m is not None and (self.azimuth_deg is not None or self.elevation_deg):
            raise ValueError("aim_m fixes the direction; leave out azimuth_deg and elevation_deg")
        return self


def side_by_side(views: Views, separation_m: float) -> Views:
    """Put transmitter and receiver of each view on both sides of its position, across the way it points.

    Seen along the beam the transmitter is on the left; 0 leaves the pairs co-located.
    """
    if separation_m == 0:
        return views
    ahead = views.directions
    left = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(views))], axis=1)
    left *= separation_m / 2 / np.linalg.norm(left, axis=1, keepdims=True)
    return replace(views, positions_m=views.positions_m + left, receivers_m=views.positions_m - left)


def pointed(
    views: Views,
    settings: PointingSettings,
    key: str = "pointing",
    *,
    turned_deg: NDArray[np.float64] | None = None,
    origin_m: ArrayLike = (0.0, 0.0),
    aim_m: ArrayLike | None = None,
) -> Views:
    """Point the antennas of every view.

    Parameters
    ----------
    views
        Where they are, in the target's frame.
    settings
        Where they point.
    key
        What the settings are called in messages.
    turned_deg
        How far the target has turned counter-clockwise at each view, ``[n_view]`` degrees, where it is the sensor that
        stands still; pointing is then given in the sensor's world. None where the target stands still.
    origin_m
        Place of the target's origin in that world for each view, ``[n_view, 2]`` metres.
    aim_m
        Point ``[3]``, or one a view ``[n_view, 3]``, that is looked at by default, in the same frame as the settings;
        an elevation that is set tilts from the horizontal. None: horizontally at the views' centre.

    Raises
    ------
    ConfigError
        An antenna stands on the point it is to look at.
    """
    aim = settings.aim_m if settings.aim_m is not None else aim_m
    turned = np.zeros(len(views)) if turned_deg is None else turned_deg
    if settings.azimuth_deg is not None:
        azimuth = math.radians(settings.azimuth_deg) - np.deg2rad(turned)
    elif aim is not None:
        looked_at = np.broadcast_to(np.asarray(aim, np.float64), (len(views), 3))
        point = looked_at
        if turned_deg is not None:
            point = np.column_stack([unturned(point[:, :2] - np.asarray(origin_m), turned), point[:, 2]])
        offset = point - views.midpoints_m
        bad = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) < ABOVE_M)
        if len(bad):
            place = ", ".join(f"{c:g}" for c in looked_at[bad[0]])
            raise ConfigError(f"{key}.aim_m: view {bad[0]} stands on, above or below the point [{place}] it looks at")
        if not settings.elevation_deg:
            return replace(views, boresights=offset / np.linalg.norm(offset, axis=1, keepdims=True))
        azimuth = np.arctan2(offset[:, 1], offset[:, 0])
    elif settings.elevation_deg:
        ahead = views.directions
        azimuth = np.arctan2(ahead[:, 1], ahead[:, 0])
    else:
        return views
    return replace(views, boresights=directions(azimuth, np.full(len(views), settings.elevation_deg)))


def directions(azimuth_rad: NDArray[np.float64], elevation_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors ``[n, 3]`` of azimuths from +x counter-clockwise and elevations above the horizontal."""
    up = np.deg2rad(elevation_deg)
    return np.stack([np.cos(up) * np.cos(azimuth_rad), np.cos(up) * np.sin(azimuth_rad), np.sin(up)], axis=1)


def unturned(points: NDArray[np.float64], turned_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points ``[n, 2]`` as seen from frames that have turned by ``turned_deg`` [n]."""
    c, s = np.cos(np.deg2rad(turned_deg)), np.sin(np.deg2rad(turned_deg))
    return np.stack([c * points[:, 0] + s * points[:, 1], -s * points[:, 0] + c * points[:, 1]], axis=1)
