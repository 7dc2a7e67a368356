"""Polygons in space cut into triangles, whether they are convex or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

__all__ = ["PolygonMesh", "triangulate"]

FLAT: Final = 1e-9
"""A polygon whose triangles are below this share of its squared length is a line, and stays one."""
SAME: Final = 1e-6
"""How far the triangles' area may be from the polygon's, as a share of it: rounding."""


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """A surface of polygons of any number of corners, as files hold it.

    Attributes
    ----------
    vertices
        ``[n_vertex, 3]``, in the file's unit.
    corners
        Vertices of all faces one after the other, from 0, ``[n_corner]``.
    counts
        How many of them each face has, ``[n_face]``.
    """

    vertices: NDArray[np.float64]
    corners: NDArray[np.int64]
    counts: NDArray[np.int64]

    def __post_init__(self) -> None:
        """Refuse faces of vertices that there are not."""
        bad = np.flatnonzero((self.corners < 0) | (self.corners >= len(self.vertices)))
        if len(bad):
            face = int(np.searchsorted(np.cumsum(self.counts), bad[0], side="right"))
            raise ValueError(
                f"face {face} uses vertex {self.corners[bad[0]]}, counted from 0; the file has {len(self.vertices)} "
                "vertices"
            )


def triangulate(mesh: PolygonMesh) -> NDArray[np.int64]:
    """Cut every face into triangles of its own corners, ``[n_triangle, 3]``, with the face's sense of rotation.

    Faces of fewer than three corners are left out.

    Raises
    ------
    ValueError
        A face crosses itself, so that what it covers is not defined.

    Notes
    -----
    A convex face is a fan from its first corner. Any other is seen along its normal (Newell's) and cut by a constrained
    Delaunay triangulation, which uses each corner; one that touches itself along a bridge, as a face with a hole is
    written, keeps the hole.
    """
    starts = np.concatenate([[0], np.cumsum(mesh.counts)[:-1]]).astype(np.int64)
    found = [np.empty((0, 3), np.int64)]
    for count in np.unique(mesh.counts[mesh.counts >= 3]):
        faces = np.flatnonzero(mesh.counts == count)
        rings = mesh.corners[starts[faces][:, None] + np.arange(count)]  # [n, count]
        convex = np.ones(len(rings), bool) if count == 3 else _convex(mesh.vertices[rings])
        fan = np.array([[0, k, k + 1] for k in range(1, count - 1)])
        found.append(rings[convex][:, fan].reshape(-1, 3))
        found += [
            _cut(ring, mesh.vertices, int(face)) for ring, face in zip(rings[~convex], faces[~convex], strict=True)
        ]
    return np.concatenate(found)


def _convex(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which polygons ``[n, k, 3]`` turn left at every corner, once round, as seen against their normal."""
    normal = _normals(points)
    sides = np.roll(points, -1, axis=1) - points
    turns = np.einsum("nkj,nj->nk", np.cross(sides, np.roll(sides, -1, axis=1)), normal)
    left = (turns > FLAT * np.einsum("nj,nj->n", normal, normal)[:, None]).all(axis=1)
    # A star polygon turns left at every corner too, but more than once round: then a fan overlaps itself.
    fan = np.cross(points[:, 1:-1] - points[:, :1], points[:, 2:] - points[:, :1])
    left &= (np.einsum("nkj,nj->nk", fan, normal) >= 0).all(axis=1)
    flat = np.linalg.norm(fan, axis=2).max(axis=1) <= FLAT * np.einsum("nkj,nkj->n", sides, sides)
    return np.asarray(left | flat, bool)


def _normals(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Newell's normals of polygons ``[n, k, 3]``, each twice as long as its polygon is large."""
    from_first = points - points[:, :1]  # or large coordinates would eat the digits
    return np.asarray(np.cross(from_first, np.roll(from_first, -1, axis=1)).sum(axis=1), np.float64)


def _cut(ring: NDArray[np.int64], vertices: NDArray[np.float64], face: int) -> NDArray[np.int64]:
    """Triangles ``[n, 3]`` of one polygon that is not convex."""
    points = vertices[ring]
    if not np.isfinite(points).all():
        return np.stack([ring[[0, k, k + 1]] for k in range(1, len(ring) - 1)])  # told as such by who looks at vertices
    crossed = ValueError(f"face {face} of {len(ring)} corners crosses itself; cut it into triangles in a mesh editor")
    normal = _normals(points[None])[0]
    if np.linalg.norm(normal) <= FLAT * np.ptp(points, axis=0).max() ** 2:
        raise crossed
    normal /= np.linalg.norm(normal)
    across = np.cross(normal, np.eye(3)[np.argmin(abs(normal))])
    across /= np.linalg.norm(across)
    flat = (points - points[0]) @ np.stack([across, np.cross(normal, across)], axis=1)
    places = {tuple(point): int(vertex) for point, vertex in zip(flat.tolist(), ring.tolist(), strict=True)}
    shape = shapely.Polygon(flat)
    area = shape.area if shape.is_valid else abs(_signed_area(flat))
    if not shape.is_valid:
        shape = shapely.make_valid(shape, method="structure", keep_collapsed=False)
    triangles = [orient(part) for part in shapely.constrained_delaunay_triangles(shape).geoms]
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    cut = sum(part.area for part in triangles)
    if abs(cut - area) > SAME * area or any(tuple(point) not in places for point in corners.reshape(-1, 2).tolist()):
        raise crossed
    return np.array([places[tuple(point)] for point in corners.reshape(-1, 2).tolist()], np.int64).reshape(-1, 3)


def _signed_area(ring: NDArray[np.float64]) -> float:
    x, y = ring.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)
