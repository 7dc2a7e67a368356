"""Where a plane cuts a mesh, and what it covers as seen from above."""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mvla_sim.errors import DataError

__all__ = ["cross_section", "distance_inside", "footprint", "section_and_gap"]

WELD: Final = 1e-7
"""Points nearer than this share of the mesh's size are one point: single precision, as in PLY and STL, is no finer."""
NUDGE: Final = 4e-6
"""Step, as a share of the mesh's size, by which a plane through vertices moves; 0.03 mm for a target of 8 m."""


def cross_section(mesh: trimesh.Trimesh, height_m: float, what: str, hint: str = "") -> shapely.Geometry:
    """Area in which the horizontal plane z = ``height_m`` cuts a closed mesh.

    Parameters
    ----------
    mesh
        Any mesh; it need be closed only where the plane cuts it.
    height_m
        The plane's height, metres.
    what
        The mesh's name, for messages.
    hint
        What else may help, behind a message.

    Returns
    -------
    shapely.Polygon or shapely.MultiPolygon
        Coordinates (x, y) in metres; rings inside rings are holes.

    Raises
    ------
    DataError
        The plane misses the mesh, or the mesh is open there.

    Notes
    -----
    A plane through vertices or along faces has no well-defined section. It is moved by up to 8 steps of
    ``NUDGE`` × the mesh's size, upwards first, to where it is farthest from every vertex. A plane along the top
    face of a box thus yields the box.
    """
    area, gap = section_and_gap(mesh, height_m)
    if gap is not None:
        raise DataError(
            f"{what}: the mesh is not watertight at the imaging plane z = {height_m:g} m: its section is open at "
            f"x = {gap[0]:.4g} m, y = {gap[1]:.4g} m; close it in a mesh editor, set another plane_height_m, "
            f"or outline = 'footprint', which needs no closed mesh{hint}"
        )
    if area.is_empty:
        low, high = mesh.bounds[:, 2]
        raise DataError(
            f"{what}: the mesh spans z = {low:.4g} to {high:.4g} m and does not cut the imaging plane "
            f"z = {height_m:g} m; move it with position_m or set plane_height_m{hint}"
        )
    return area


def section_and_gap(mesh: trimesh.Trimesh, height_m: float) -> tuple[shapely.Geometry, tuple[float, float] | None]:
    """Area enclosed by a mesh at a height, empty where there is none, and a point (x, y) where its section is open.

    Parameters
    ----------
    mesh
        Any mesh.
    height_m
        The plane's height, metres.

    Returns
    -------
    area : shapely.Polygon or shapely.MultiPolygon
        Coordinates (x, y) in metres; possibly empty.
    gap : tuple of float or None
        Where a line of the section ends without another going on, metres; None if all of it is closed.
    """
    size = float(np.linalg.norm(mesh.extents))
    segments = _welded(_segments(mesh, _clear_height(mesh, height_m, size)), WELD * size)
    if not len(segments):
        return shapely.Polygon(), None
    # Parts of a mesh may cross each other: the union puts a node at each crossing.
    lines = shapely.unary_union(shapely.linestrings(segments))
    _, cuts, dangles, _ = shapely.polygonize_full([lines])
    gap = None
    for loose in (dangles, cuts):
        if gap is None and not loose.is_empty:
            x, y = shapely.get_coordinates(loose)[0]
            gap = (float(x), float(y))
    area = shapely.build_area(lines).simplify(WELD * size)  # most points on straight lines are no corners
    return (area if area.area > (WELD * size) ** 2 else shapely.Polygon()), gap


def distance_inside(mesh: trimesh.Trimesh, height_m: float, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of points ``[n, 2]`` to the area that a mesh encloses at a height, ``[n]`` metres; 0 inside it."""
    area, _ = section_and_gap(mesh, height_m)
    return np.asarray(shapely.distance(area, shapely.points(points)), np.float64)


def footprint(mesh: trimesh.Trimesh) -> shapely.Geometry:
    """Area that a mesh covers as seen from above.

    Parameters
    ----------
    mesh
        Any mesh, also an open one, or one of several parts.

    Returns
    -------
    shapely.Polygon or shapely.MultiPolygon
        Coordinates (x, y) in metres; empty if no face is seen from above.

    Notes
    -----
    The union of the projected triangles, less those that are thinner than ``WELD`` × the mesh's size, as upright ones
    are but for rounding. Cracks thinner than twice that are closed, so a hole is one that is really seen through.
    """
    width = WELD * float(np.linalg.norm(mesh.extents))
    corners = np.asarray(mesh.vertices)[:, :2][np.asarray(mesh.faces)]  # [n_face, 3, 2]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.hypot(sides[..., 0], sides[..., 1]).max(axis=1, initial=0.0)
    doubled = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    area = shapely.union_all(shapely.polygons(corners[doubled > width * longest]))
    closed = area.buffer(width, join_style="mitre").buffer(-width, join_style="mitre")
    return closed.simplify(width)


def _clear_height(mesh: trimesh.Trimesh, height_m: float, size: float) -> float:
    """Return the height itself, or the nearby one that is farthest from every vertex if one lies in the plane."""
    heights = np.unique(mesh.vertices[:, 2])
    clearance = _distance_to_nearest(heights, np.array([height_m]))[0]
    if clearance > NUDGE / 4 * size:
        return height_m
    steps = np.array([1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6, -6, 7, -7, 8, -8])  # upwards wins a tie
    tried = height_m + NUDGE * size * steps
    tried = tried[(tried > heights[0]) & (tried < heights[-1])]
    if not len(tried):
        return height_m
    apart = np.minimum(_distance_to_nearest(heights, tried), NUDGE / 2 * size)
    return float(tried[np.argmax(apart)])


def _distance_to_nearest(heights: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    index = np.clip(np.searchsorted(heights, points), 1, max(1, len(heights) - 1))
    above = heights[np.minimum(index, len(heights) - 1)]
    return np.asarray(np.minimum(abs(points - heights[index - 1]), abs(points - above)), np.float64)


def _segments(mesh: trimesh.Trimesh, height_m: float) -> NDArray[np.float64]:
    """Segments ``[n, 2, 2]`` in metres in which the plane cuts the mesh's triangles.

    Faces that share an edge get the same point on it, bit for bit: it is always computed from the edge's lower end.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    above = vertices[:, 2] >= height_m
    cut = faces[above[faces].any(axis=1) & ~above[faces].all(axis=1)]
    edges = cut[:, [[0, 1], [1, 2], [2, 0]]]  # [n_cut, 3, 2]
    crossing = above[edges[..., 0]] != above[edges[..., 1]]  # two of each triangle's three
    edges = edges[crossing]
    low, high = np.where(above[edges[:, :1]], edges[:, ::-1], edges).T
    share = (height_m - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
    points = vertices[low, :2] + share[:, None] * (vertices[high, :2] - vertices[low, :2])
    return np.asarray(points.reshape(-1, 2, 2), np.float64)


def _welded(segments: NDArray[np.float64], tolerance_m: float) -> NDArray[np.float64]:
    """Make end points nearer than the tolerance one point; drop segments of no length and repeated ones."""
    points, place = np.unique(segments.reshape(-1, 2), axis=0, return_inverse=True)
    pairs = cKDTree(points).query_pairs(tolerance_m, output_type="ndarray") if len(points) else np.empty((0, 2), int)
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    _, group = connected_components(links, directed=False)
    _, first = np.unique(group, return_index=True)
    ends = np.sort(group[place.reshape(-1, 2)], axis=1)
    ends = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
    return np.asarray(points[first][ends], np.float64)
