"""The projector again, in plain float64 NumPy and loops: slow, and meant to be obviously right.

Sums over views are those of :mod:`mvla_sim.bench.numpy_twin`; here is what no benchmark needs.
"""

from __future__ import annotations

import numpy as np

from mvla_sim.bench.numpy_twin import backprojection, distances, score, supports

__all__ = [
    "backprojection", "direction_width", "direction_widths", "distances", "ends", "levels_db", "score",
    "support_width", "support_widths", "supports",
]  # fmt: skip


def ends(views):
    """Where the antennas of each view are, ``[n_view, 3]``, or pairs ``[n_view, 2, 3]``: what ``distances`` takes."""
    if views.receivers_m is None:
        return views.positions_m
    return np.stack([views.positions_m, views.receivers_m], axis=1)


def level_db(antenna, vectors_m, boresight):
    """Level of an antenna below its peak along vectors ``[n, 3]``, dB, by plain trigonometry.

    The vectors are first turned about the vertical until the boresight's azimuth is 0, then tipped about the antenna's
    left until its elevation is 0 too; azimuth and elevation can then be read off.
    """
    x, y, z = np.asarray(vectors_m, np.float64).T
    turn = np.arctan2(boresight[1], boresight[0])
    x, y = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    tip = np.arctan2(boresight[2], np.hypot(boresight[0], boresight[1]))
    x, z = x * np.cos(tip) + z * np.sin(tip), z * np.cos(tip) - x * np.sin(tip)
    azimuth = np.degrees(np.arctan2(y, x))
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    sum_of_cuts = _cut(antenna.azimuth_db, azimuth, 180) + _cut(antenna.elevation_db, elevation, 90)
    return np.where(sum_of_cuts < antenna.floor_db, antenna.floor_db, sum_of_cuts)


def _cut(levels_db, angle_deg, last_deg):
    """Level between the evenly spaced nodes −last … last of a cut."""
    place = (angle_deg + last_deg) / (2 * last_deg) * (len(levels_db) - 1)
    node = np.minimum(place.astype(int), len(levels_db) - 2)
    return levels_db[node] + (place - node) * (levels_db[node + 1] - levels_db[node])


def levels_db(points_m, views, antenna, boresights):
    """Level at which the weaker antenna of each view sees each point, ``[n_view, n]`` dB.

    A view covers a point where that is at or above the edge.
    """
    rows = [
        [level_db(antenna, points_m - end, boresight) for end in np.reshape(pair, (-1, 3))]
        for pair, boresight in zip(ends(views), boresights, strict=True)
    ]
    return np.min(rows, axis=1)


def direction_width(angles_deg, supported, covered, closed):
    """Θ of one voxel by directions: all views of one angle are one, which supports if any of its views does.

    Directions from which no view covers the voxel are left out of the list. Θ is the last minus the first angle of the
    longest run of consecutive directions that are left; on a closed trajectory runs cross 0°/360°, and where all that
    are left support, it is 360° minus the smallest gap between neighbours, and 0 where only one is left. On an open one
    the list begins behind the widest gap between any two views' angles, whether they cover the voxel or not.
    """
    names = np.unique(angles_deg)
    first = 0 if closed else np.argmax(np.diff(names, prepend=names[-1] - 360))
    left = []
    for name in np.roll(names, -first):
        views = np.asarray(angles_deg) == name
        if covered[views].any():
            left.append((name if name >= names[first] else name + 360, (supported & covered)[views].any()))
    if len(left) < 2:
        return 0.0
    if closed and all(hit for _, hit in left):
        around = [angle for angle, _ in left]
        return 360 - min(np.diff([*around, around[0] + 360]))
    runs = left + [(angle + 360, hit) for angle, hit in left] if closed else left
    widest, begin = 0.0, None
    for angle, hit in runs:
        begin = None if not hit else angle if begin is None else begin
        widest = max(widest, 0.0 if begin is None else angle - begin)
    return widest


def direction_widths(angles_deg, b, c, closed):
    """Θ_n of every voxel from supports b and covers c, both ``[n_view, n]``; equal columns are looked at once."""
    columns, inverse = np.unique(np.concatenate([b, c]).T, axis=0, return_inverse=True)
    count = len(b)
    widths = np.array([direction_width(angles_deg, col[:count], col[count:], closed) for col in columns])
    return widths[inverse.ravel()]


def support_width(angles_deg, supported, closed):
    """Θ of one voxel: width of the longest run of consecutive supporting views, by trying every run.

    Views are in rising order along the trajectory; on a closed one a run may go on past the last view.
    """
    count = len(angles_deg)
    widest = 0.0
    for first in range(count):
        if not supported[first]:
            continue
        for length in range(1, count + 1):
            last = first + length - 1
            if last >= count and not closed:
                break
            if not supported[last % count]:
                break
            widest = max(widest, angles_deg[last % count] + 360 * (last // count) - angles_deg[first])
    return widest


def support_widths(angles_deg, b, closed):
    """Θ_n of every voxel from b ``[n_view, n]``; equal columns are looked at once."""
    columns, inverse = np.unique(b.T, axis=0, return_inverse=True)
    widths = np.array([support_width(angles_deg, column, closed) for column in columns])
    return widths[inverse.ravel()]
