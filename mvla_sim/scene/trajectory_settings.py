"""Settings of trajectories: where the sensor is at each view, or how the target moves before it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from mvla_sim.scene.antenna_settings import PointingSettings
from mvla_sim.settings import Settings

__all__ = [
    "ArcTrajectory",
    "CircleTrajectory",
    "LineTrajectory",
    "PosesTrajectory",
    "PositionsTrajectory",
    "TrajectorySettings",
    "TurntableTrajectory",
    "whole_turn",
]

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]
Heights = Annotated[tuple[float, ...], Field(min_length=1)] | None

Interval = Annotated[float, Field(gt=0, le=360)]


class TrajectoryBase(Settings):
    """What all trajectories have: how transmitter and receiver stand to each other, and where they point."""

    pair_separation_m: NonNegativeFloat = Field(
        0.0, description="distance between transmitter and receiver, side by side; 0: a co-located pair"
    )
    pointing: PointingSettings = PointingSettings()


class CircleTrajectory(TrajectoryBase):
    """A full circle; the interval must divide 360°."""

    kind: Literal["circle"] = "circle"
    radius_m: PositiveFloat = 10.0
    interval_deg: Interval = 1.0
    start_deg: float = 0.0
    center_m: Point2 = (0.0, 0.0)
    height_m: float = 0.0
    heights_m: Heights = Field(None, description="instead of height_m: the whole circle once at each height")

    @model_validator(mode="after")
    def _check(self) -> CircleTrajectory:
        _check_heights(self.heights_m)
        whole_turn(self.interval_deg)
        return self


class ArcTrajectory(TrajectoryBase):
    """Part of a circle, from ``start_deg`` to ``stop_deg`` inclusive."""

    kind: Literal["arc"]
    radius_m: PositiveFloat = 10.0
    start_deg: float
    stop_deg: float
    interval_deg: Interval = 1.0
    center_m: Point2 = (0.0, 0.0)
    height_m: float = 0.0

    @model_validator(mode="after")
    def _check(self) -> ArcTrajectory:
        span = self.stop_deg - self.start_deg
        if not 0 < span < 360:
            raise ValueError(f"stop_deg - start_deg = {span:g} must be above 0 and below 360; use kind = 'circle'")
        if span < self.interval_deg:
            raise ValueError(f"interval_deg = {self.interval_deg:g} is wider than the arc of {span:g}")
        return self


class LineTrajectory(TrajectoryBase):
    """Evenly spaced positions on a straight line, both ends included."""

    kind: Literal["line"]
    start_m: Point3
    stop_m: Point3
    views: Annotated[int, Field(ge=2)]

    @model_validator(mode="after")
    def _check(self) -> LineTrajectory:
        if self.start_m == self.stop_m:
            raise ValueError(f"start_m and stop_m are the same point {list(self.start_m)}")
        return self


class PositionsTrajectory(TrajectoryBase):
    """Any positions, from a CSV file or listed here.

    The file has a header ``x_m,y_m[,z_m]``; ``rx_x_m,rx_y_m[,rx_z_m]`` set receivers apart from transmitters, and
    ``azimuth_deg[,elevation_deg]`` the antennas' direction, both view by view.
    """

    kind: Literal["positions"]
    file: str | None = None
    positions_m: tuple[Point3, ...] | None = None

    @model_validator(mode="after")
    def _check(self) -> PositionsTrajectory:
        if (self.file is None) == (self.positions_m is None):
            raise ValueError("give either file or positions_m")
        if self.positions_m is not None and not self.positions_m:
            raise ValueError("positions_m is empty; give at least one position")
        return self


class TurntableTrajectory(TrajectoryBase):
    """A fixed sensor and a target that turns counter-clockwise: the same views, seen from the target's frame."""

    kind: Literal["turntable"]
    sensor_m: Point3 = (10.0, 0.0, 0.0)
    interval_deg: Interval = 1.0
    axis_m: Point2 = (0.0, 0.0)
    heights_m: Heights = Field(None, description="instead of the sensor's z: a whole turn at each height")

    @model_validator(mode="after")
    def _check(self) -> TurntableTrajectory:
        _check_heights(self.heights_m)
        whole_turn(self.interval_deg)
        return self


class PosesTrajectory(TrajectoryBase):
    """A fixed sensor and a target that drives past: its place and heading at each view.

    The file has a header ``x_m,y_m,heading_deg``: where the origin of the target's frame is, and how far that frame has
    turned counter-clockwise. Pointing is in the frame in which the sensor stands still.
    """

    kind: Literal["poses"]
    sensor_m: Point3 = (0.0, 0.0, 0.0)
    file: str | None = None
    poses: tuple[Point3, ...] | None = Field(None, description="x and y in metres, heading in degrees")

    @model_validator(mode="after")
    def _check(self) -> PosesTrajectory:
        if (self.file is None) == (self.poses is None):
            raise ValueError("give either file or poses")
        if self.poses is not None and not self.poses:
            raise ValueError("poses is empty; give at least one pose")
        return self


def _check_heights(heights_m: tuple[float, ...] | None) -> None:
    if heights_m is not None and len(set(heights_m)) < len(heights_m):
        raise ValueError(f"heights_m = {list(heights_m)} has a height twice")


def whole_turn(interval_deg: float) -> int:
    """Number of views of a full turn; raises ValueError where the interval does not divide 360°."""
    count = round(360 / interval_deg)
    if abs(count * interval_deg - 360) > 1e-6:
        raise ValueError(f"interval_deg = {interval_deg:g} does not divide 360; allowed: 360 / n for a whole n")
    return count


TrajectorySettings = Annotated[
    CircleTrajectory | ArcTrajectory | LineTrajectory | PositionsTrajectory | TurntableTrajectory | PosesTrajectory,
    Field(discriminator="kind"),
]
