"""Meshes of objects: prisms, files and cars, placed in the world; where a plane cuts them, and their plan view."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from shapely.geometry.polygon import orient

from mvla_sim.errors import DataError
from mvla_sim.files import existing_file
from mvla_sim.scene.scene_settings import Car, MeshFile, ObjectSettings
from mvla_sim.scene.shapes import outline
from mvla_sim.scene.vehicle import car_parts

__all__ = ["MESH_FORMATS", "build_mesh", "build_parts", "cross_section", "footprint", "section_and_gap"]

MESH_FORMATS: Final = ("glb", "obj", "off", "ply", "stl")
"""File formats that carry a whole mesh in one file; none of them can name another file that we would follow."""

SMALLEST_M: Final = 0.05
LARGEST_M: Final = 200.0
WELD: Final = 1e-7
"""Points nearer than this share of the mesh's size are one point: single precision, as in PLY and STL, is no finer."""
NUDGE: Final = 4e-6
"""Step, as a share of the mesh's size, by which a plane through vertices moves; 0.03 mm for a target of 8 m."""


def build_mesh(settings: ObjectSettings, key: str = "object") -> trimesh.Trimesh:
    """Mesh of an object in the world, metres: its shape, scaled, turned about the vertical axis, then placed.

    Prisms are centred on their position in height, cars stand on it; mesh files keep their own origin. A car's parts
    are put into one mesh.

    Parameters
    ----------
    settings
        The object's settings.
    key
        What the object is called in messages, for example ``objects[0]``.

    Returns
    -------
    trimesh.Trimesh
        Vertices ``[n_vertex, 3]`` metres, faces ``[n_face, 3]``; neither textures nor colours.

    Raises
    ------
    ConfigError
        A polygon that is not simple.
    DataError
        A mesh file that is missing, of an unknown format, broken, empty, or of an implausible size.
    """
    return trimesh.util.concatenate(list(build_parts(settings, key).values()))


def build_parts(settings: ObjectSettings, key: str = "object") -> dict[str, trimesh.Trimesh]:
    """Meshes of an object's parts in the world, metres, as of :func:`build_mesh`.

    Returns
    -------
    dict of str to trimesh.Trimesh
        A car's parts by their names; any other object is one part without a name.
    """
    if isinstance(settings, Car):
        parts = car_parts(settings)
    elif isinstance(settings, MeshFile):
        parts = {"": _read(settings)}
    else:
        parts = {"": _prism(outline(settings, key), settings.height_m)}
    turn = trimesh.transformations.rotation_matrix(math.radians(settings.rotation_deg), [0, 0, 1])
    turn[:3, 3] = settings.position_m
    for mesh in parts.values():
        mesh.apply_transform(turn)
    return parts


def cross_section(mesh: trimesh.Trimesh, height_m: float, what: str) -> shapely.Geometry:
    """Area in which the horizontal plane z = ``height_m`` cuts a closed mesh.

    Parameters
    ----------
    mesh
        Any mesh; it need be closed only where the plane cuts it.
    height_m
        The plane's height, metres.
    what
        The mesh's name, for messages.

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
            f"x = {gap[0]:.4g} m, y = {gap[1]:.4g} m; close it in a mesh editor or set another plane_height_m"
        )
    if area.is_empty:
        low, high = mesh.bounds[:, 2]
        raise DataError(
            f"{what}: the mesh spans z = {low:.4g} to {high:.4g} m and does not cut the imaging plane "
            f"z = {height_m:g} m; move it with position_m or set plane_height_m"
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


def _prism(shape: shapely.Polygon, height_m: float) -> trimesh.Trimesh:
    """Closed prism over a simple counter-clockwise outline, from -height/2 to height/2, normals outwards.

    The caps are Delaunay triangles. Cutting ears, as is usual, leaves triangles of no area between vertices on one
    line, as a star has them; their normals are noise, and each of their edges would diffract.
    """
    ring = shapely.get_coordinates(shape.exterior)[:-1]
    count = len(ring)
    index = {tuple(point): place for place, point in enumerate(ring.tolist())}
    triangles = [orient(part) for part in shapely.constrained_delaunay_triangles(shape).geoms]
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    bottom = np.array([index[tuple(point)] for point in corners.reshape(-1, 2).tolist()]).reshape(-1, 3)
    here = np.arange(count)
    after = (here + 1) % count
    walls = [np.stack([here, after, after + count], axis=1), np.stack([here, after + count, here + count], axis=1)]
    heights = np.repeat([-height_m / 2, height_m / 2], count)
    vertices = np.column_stack([np.tile(ring, (2, 1)), heights])
    return trimesh.Trimesh(vertices, np.concatenate([bottom[:, ::-1], bottom + count, *walls]), process=False)


def _read(settings: MeshFile) -> trimesh.Trimesh:
    """Mesh of a file with z up and its scale applied, in the file's own place."""
    file = existing_file(settings.file, "mesh file")
    vertices, faces = _parse(file)
    if not len(faces):
        raise DataError(f"{file}: has no faces; a point cloud or a set of lines is no mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(f"{file}: a face uses vertex {faces.max()}; the file has {len(vertices)} vertices")
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise DataError(f"{file}: vertex {bad[0]} = {vertices[bad[0]].tolist()} is not finite ({len(bad)} such)")
    if settings.up == "y":
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    vertices = vertices * settings.scale
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()  # STL, and others at sharp edges, repeat each vertex in each face
    # Thin faces stay: taking one out tears its neighbours apart.
    mesh.update_faces((np.diff(np.sort(mesh.faces, axis=1), axis=1) > 0).all(axis=1))
    mesh.remove_unreferenced_vertices()
    if mesh.is_empty:
        raise DataError(f"{file}: none of its {len(faces)} faces has three vertices at scale = {settings.scale:g}")
    _check_size(file, float(mesh.extents.max()), settings.scale)
    return mesh


def _parse(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices ``[n, 3]`` and faces ``[n, 3]`` as they stand in a file."""
    kind = file.suffix.lower().removeprefix(".")
    if kind not in MESH_FORMATS:
        raise DataError(f"{file}: unknown mesh format '{kind}'; allowed: {', '.join(MESH_FORMATS)}")
    options: dict[str, Any] = {"skip_materials": True} if kind in ("glb", "obj") else {}
    try:
        # Bytes without a resolver: textures, material libraries and outside buffers are never looked for.
        with io.BytesIO(file.read_bytes()) as data:
            loaded = trimesh.load(data, file_type=kind, force="mesh", process=False, **options)
        vertices = np.asarray(loaded.vertices, np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(loaded, "faces", ()), np.int64).reshape(-1, 3)
    except Exception as error:  # the parsers raise whatever a broken file trips over
        # trimesh tries text where binary does not fit and then misses a module that guesses encodings
        foreign = isinstance(error, ImportError) or not str(error).strip()
        reason = "truncated, or of another format" if foreign else " ".join(str(error).split())
        raise DataError(f"{file}: is not a readable {kind.upper()} file: {reason}") from error
    return vertices, faces


def _check_size(file: Path, extent_m: float, scale: float) -> None:
    if SMALLEST_M <= extent_m <= LARGEST_M:
        return
    hint = "set scale so that it becomes metres"
    units = (("millimetres", 1e-3), ("centimetres", 1e-2), ("kilometres", 1e3), ("metres already", 1.0))
    for unit, factor in units:
        if 0.5 <= extent_m / scale * factor <= LARGEST_M / 4 and factor != scale:
            hint = f"if the file is in {unit} set scale = {factor:g}"
            break
    raise DataError(
        f"{file}: extent is {extent_m:.4g} m at scale = {scale:g}; allowed: {SMALLEST_M:g} to {LARGEST_M:g} m; {hint}"
    )
