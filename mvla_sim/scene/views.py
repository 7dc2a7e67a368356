"""The views of a sensor: where its antennas are, and where they point."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError

__all__ = ["SAME_HEIGHT_M", "Views", "wrapped"]

SAME_HEIGHT_M: Final = 0.1
"""A sensor this near to a plane is in it: seen from 10 m, ranges in it then differ by 0.5 mm."""

UNIT = 1e-6
"""How far a boresight's length may be from 1; it is then made 1."""


@dataclass(frozen=True, eq=False, repr=False)
class Views:
    """Sensor positions T_m in the target's frame, in the order they are measured.

    Attributes
    ----------
    positions_m
        Transmitters, which are the receivers too where pairs are co-located; ``[n_view, 3]`` float64, metres;
        read-only.
    angles_deg
        ``[n_view]`` float64 in [0, 360): direction from the centre to the sensor (to the middle of a pair),
        counter-clockwise from +x; read-only.
    center_m
        Point (x, y) the angles are measured about, metres.
    receivers_m
        Receivers, ``[n_view, 3]`` float64, metres; None where each stands at its transmitter. The range of a point p
        is then bistatic, (|p − T_m| + |p − R_m|)/2.
    boresights
        Unit vectors along which both antennas of a view point, ``[n_view, 3]`` float64; None: horizontally at the
        centre.
    """

    positions_m: NDArray[np.float64]
    angles_deg: NDArray[np.float64]
    center_m: tuple[float, float]
    receivers_m: NDArray[np.float64] | None = None
    boresights: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Refuse shapes that do not match and values that are no positions, angles or directions."""
        positions = _points(self.positions_m, "positions_m", "position")
        angles = np.array(self.angles_deg, np.float64)
        if angles.shape != (len(positions),):
            raise DataError(f"views: angles_deg has shape {angles.shape}; {len(positions)} positions need one each")
        bad = np.flatnonzero(~((angles >= 0) & (angles < 360)))
        if len(bad):
            raise DataError(f"views: angle {bad[0]} = {angles[bad[0]]}; allowed: 0 to below 360 degrees")
        if not np.isfinite(self.center_m).all():
            raise DataError(f"views: center_m = {self.center_m} is not finite")
        fields = {"positions_m": positions, "angles_deg": angles}
        if self.receivers_m is not None:
            fields["receivers_m"] = _points(self.receivers_m, "receivers_m", "receiver")
        if self.boresights is not None:
            directions = _points(self.boresights, "boresights", "boresight")
            length = np.linalg.norm(directions, axis=1, keepdims=True)
            wrong = np.flatnonzero(abs(length - 1) > UNIT)
            if len(wrong):
                raise DataError(
                    f"views: boresight {wrong[0]} has length {length[wrong[0], 0]:g}; boresights must be unit vectors"
                )
            fields["boresights"] = directions / length
        for name, array in fields.items():
            if len(array) != len(positions):
                raise DataError(f"views: {name} has {len(array)} entries; {len(positions)} positions need one each")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "center_m", (float(self.center_m[0]), float(self.center_m[1])))

    def __len__(self) -> int:
        return len(self.positions_m)

    def __repr__(self) -> str:
        (x, y), away = self.center_m, self.midpoints_m[:, :2] - self.center_m
        distance = np.hypot(away[:, 0], away[:, 1])
        pairs = "" if self.receivers_m is None else ", transmitters apart from receivers"
        return f"Views({len(self)}, {distance.min():.4g} to {distance.max():.4g} m from ({x:g}, {y:g}){pairs})"

    def select(self, indices: NDArray[np.intp]) -> Views:
        """Views of the given indices ``[n]``, in that order."""
        return Views(
            self.positions_m[indices],
            self.angles_deg[indices],
            self.center_m,
            None if self.receivers_m is None else self.receivers_m[indices],
            None if self.boresights is None else self.boresights[indices],
        )

    @property
    def midpoints_m(self) -> NDArray[np.float64]:
        """Middle between transmitter and receiver of each view, ``[n_view, 3]`` metres."""
        return self.positions_m if self.receivers_m is None else (self.positions_m + self.receivers_m) / 2

    @property
    def directions(self) -> NDArray[np.float64]:
        """Where each view's antennas point, ``[n_view, 3]``: its boresight, or else horizontally at the centre."""
        if self.boresights is not None:
            return self.boresights
        towards = np.zeros((len(self), 3))
        towards[:, :2] = self.center_m - self.midpoints_m[:, :2]
        length = np.linalg.norm(towards, axis=1, keepdims=True)
        if (length == 0).any():
            view = int(np.flatnonzero(length == 0)[0])
            raise DataError(f"views: view {view} stands above the centre, so it cannot point at it; give boresights")
        return np.asarray(towards / length, np.float64)

    @functools.cached_property
    def closed(self) -> bool:
        """Whether the views go all the way round.

        True for three views or more whose widest gap between neighbouring angles, 0°/360° being no border, is below
        180° and at most 1.5 times the second widest.
        """
        if len(self) < 3:
            return False
        angles = np.sort(self.angles_deg)
        second, widest = np.sort(np.diff(angles, append=angles[0] + 360))[-2:]
        return bool(widest < 180 and widest <= 1.5 * second * (1 + 1e-9))


def wrapped(angles_deg: NDArray[np.floating]) -> NDArray[np.float64]:
    """Angles in [0, 360); the remainder of a tiny negative angle rounds to 360 itself."""
    rest = np.mod(angles_deg, 360.0)
    return np.where(rest >= 360.0, 0.0, rest)


def _points(values: NDArray[np.float64], name: str, one: str) -> NDArray[np.float64]:
    """Copy of ``[n_view, 3]`` finite numbers, n_view at least 1."""
    points = np.array(values, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise DataError(f"views: {name} has shape {points.shape}; allowed: [n_view, 3] with n_view >= 1")
    if not np.isfinite(points).all():
        view = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise DataError(f"views: {one} {view} = {points[view].tolist()} is not finite")
    return points
