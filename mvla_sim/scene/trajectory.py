"""Where the sensor looks from: a trajectory and its views. The kinds are in :mod:`mvla_sim.scene.trajectories`.

Whoever adds one derives it from :class:`Trajectory` and makes its views with the functions of this module.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, Field, NonNegativeFloat

from mvla_sim.errors import ConfigError
from mvla_sim.kinds import Kind, Kinds
from mvla_sim.scene.pointing import PointingSettings, pointed, side_by_side
from mvla_sim.scene.views import Views, wrapped

__all__ = ["TRAJECTORIES", "Heights", "Interval", "Trajectory", "views_about", "views_on_circle", "whole_turn"]

TRAJECTORIES: Kinds[Trajectory] = Kinds(
    "trajectory", "mvla_sim.trajectories", "mvla_sim.scene.trajectories", key="kind", default="circle"
)
"""All trajectories by name."""


class Trajectory(Kind):
    """What all trajectories have: how transmitter and receiver stand to each other, and where they point.

    Positions are those of the sensor; where transmitter and receiver are apart, their middle. A setting called ``file``
    is relative to the file of the scene.
    """

    kinds: ClassVar[Kinds[Any]] = TRAJECTORIES

    pair_separation_m: NonNegativeFloat = Field(
        0.0, description="distance between transmitter and receiver, side by side; 0: a co-located pair"
    )
    pointing: PointingSettings = PointingSettings()

    def build_views(self, center_xy: tuple[float, float], key: str = "trajectory") -> Views:
        """Views of the trajectory; each kind has its own.

        Parameters
        ----------
        center_xy
            Centre of the target (x, y), metres: what the angles of lines, poses and lists of positions are measured
            about.
        key
            What the trajectory is called in messages.

        Raises
        ------
        ConfigError
            A position lies on the vertical line through the centre, so it has no direction, or an antenna on what it is
            to point at.
        DataError
            A CSV file cannot be used; the message names file, line and column.
        """
        raise NotImplementedError

    def angles_in_names(self, views: Views, key: str = "trajectory") -> NDArray[np.float64]:
        """Angle, degrees, that a laboratory writes into the name of each view's file, ``[n_view]``.

        Raises
        ------
        ConfigError
            Views at one angle differ, so an angle cannot name one.
        """
        del key
        return views.angles_deg

    def equipped(self, views: Views, key: str) -> Views:
        """Point the antennas of a moving sensor, then set transmitter and receiver apart."""
        return side_by_side(pointed(views, self.pointing, f"{key}.pointing"), self.pair_separation_m)


def whole_turn(interval_deg: float) -> int:
    """Number of views of a full turn; raises ValueError where the interval does not divide 360°."""
    count = round(360 / interval_deg)
    if abs(count * interval_deg - 360) > 1e-6:
        raise ValueError(f"interval_deg = {interval_deg:g} does not divide 360; allowed: 360 / n for a whole n")
    return count


def _distinct(heights_m: tuple[float, ...]) -> tuple[float, ...]:
    if len(set(heights_m)) < len(heights_m):
        raise ValueError(f"heights_m = {list(heights_m)} has a height twice")
    return heights_m


Interval = Annotated[float, Field(gt=0, le=360)]
Heights = Annotated[tuple[float, ...], Field(min_length=1), AfterValidator(_distinct)] | None


def views_on_circle(
    center_m: tuple[float, float],
    radius_m: float,
    angles_deg: NDArray[np.floating[Any]],
    heights_m: tuple[float, ...] = (0.0,),
) -> Views:
    """Views at the given angles ``[n]`` of a circle, all of them once at each height, metres and degrees."""
    angles = np.tile(np.asarray(angles_deg, np.float64), len(heights_m))
    z = np.repeat(np.asarray(heights_m, np.float64), len(angles_deg))
    turn = np.deg2rad(angles)
    x, y = center_m[0] + radius_m * np.cos(turn), center_m[1] + radius_m * np.sin(turn)
    return Views(np.stack([x, y, z], axis=1), wrapped(angles), center_m)


def views_about(positions_m: ArrayLike | None, center_xy: tuple[float, float], key: str) -> Views:
    """Views at any positions ``[n, 3]``, their angles measured about a centre.

    Raises
    ------
    ConfigError
        A position is at no horizontal distance from the centre.
    """
    positions = np.asarray(positions_m, np.float64)
    offset = positions[:, :2] - center_xy
    on_axis = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) == 0)
    if len(on_axis):
        raise ConfigError(
            f"{key}: position {on_axis[0]} = {positions[on_axis[0]].tolist()} is at no horizontal distance from the "
            f"target's centre {list(center_xy)}, so it has no direction"
        )
    return Views(positions, wrapped(np.rad2deg(np.arctan2(offset[:, 1], offset[:, 0]))), center_xy)
