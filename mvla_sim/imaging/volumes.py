"""Images for programs that show volumes and surfaces: VTK for ParaView, PLY for mesh viewers."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from matplotlib import colormaps
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError, DataError, check_argument
from mvla_sim.files import as_path, atomic_output
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image

__all__ = ["EXPORT_SUFFIXES", "Surface", "export_image", "exposed_faces"]

EXPORT_SUFFIXES = (".ply", ".vtk")
SCORE_MAP = "inferno"
"""Perceptually uniform colour map of a surface's faces, from score 0 to the image's largest."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The faces of occupied voxels that no other occupied voxel hides: a closed surface of squares.

    Every edge has as many faces on its one side as on its other: two, or four where voxels touch along an edge only.
    """

    vertices_m: NDArray[np.float64]  # corners, each listed once, ``[n_vertex, 3]`` metres
    squares: NDArray[np.intp]  # vertices of each face, counter-clockwise seen from outside, ``[n_face, 4]``
    normals: NDArray[np.float64]  # outward unit normal of each face, ``[n_face, 3]``
    voxels: NDArray[np.intp]  # flat index of the voxel that each face belongs to, ``[n_face]``

    @property
    def triangles(self) -> NDArray[np.intp]:
        """Each face as two triangles, one after the other, ``[2·n_face, 3]`` indices of vertices."""
        return np.asarray(self.squares[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), np.intp)


def exposed_faces(occupied: NDArray[np.bool_], grid: VoxelGrid) -> Surface:
    """Surface of the voxels of a binary image ``[nz, ny, nx]``; the grid's border hides no face.

    Raises DataError where the image has another shape than the grid.
    """
    if occupied.shape != grid.shape:
        raise DataError(f"surface: occupied has shape {occupied.shape}, the grid {grid.shape}")
    mask = np.asarray(occupied, bool)
    count = tuple(n + 1 for n in grid.shape)  # of lattice points along z, y, x
    stride = {"z": count[1] * count[2], "y": count[2], "x": 1}
    squares, normals, voxels = [], [], []
    for axis, (name, first, second) in enumerate((("z", "x", "y"), ("y", "z", "x"), ("x", "y", "z"))):
        # first × second points along the axis, so this round of corners faces up it, and the reverse down.
        around = np.array([0, stride[first], stride[first] + stride[second], stride[second]])
        for up in (True, False):
            index = np.nonzero(mask & ~_neighbour(mask, axis, up=up))
            corner = np.ravel_multi_index(index, count) + (stride[name] if up else 0)
            squares.append(corner[:, None] + (around if up else around[::-1]))
            normal = np.zeros(3)
            normal[2 - axis] = 1 if up else -1
            normals.append(np.broadcast_to(normal, (corner.size, 3)))
            voxels.append(np.ravel_multi_index(index, grid.shape))
    points = np.concatenate(squares)
    used = np.zeros(count, bool)
    used.flat[points.ravel()] = True
    number = np.cumsum(used.ravel()) - 1
    place = np.stack(np.nonzero(used)[::-1], axis=-1)
    return Surface(
        vertices_m=grid.bounds_m()[0] + grid.spacing_m * place,
        squares=np.asarray(number[points], np.intp),
        normals=np.concatenate(normals),
        voxels=np.concatenate(voxels),
    )


def export_image(image: Image, path: str | os.PathLike[str]) -> Path:
    """Write an image for other programs, in the format of the file's suffix.

    * ``.vtk``: the whole image, for ParaView: legacy VTK, binary, structured points with the cell arrays ``score``,
      ``support`` (degrees) and ``occupied`` (0 or 1), the last two where the image has them. Lengths are in metres.
    * ``.ply``: the surface of the occupied voxels, for any mesh viewer: exposed faces as triangles in metres, coloured
      by score from 0 to the image's largest.

    Parameters
    ----------
    image
        The image.
    path
        The file; an older one is replaced once the new one is complete.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError
        The suffix is neither.
    DataError
        A surface of an image without a binary image, or of one without a voxel.
    OutputError
        The file cannot be written.
    """
    check_argument("image", image, Image, "see reconstruct")
    target = as_path(path)
    suffix = target.suffix.lower()
    if suffix not in EXPORT_SUFFIXES:
        given = f"suffix '{target.suffix}'" if target.suffix else "no suffix"
        raise ConfigError(f"{target}: an exported image with {given}; allowed: {', '.join(EXPORT_SUFFIXES)}")
    data = _vtk(image) if suffix == ".vtk" else _ply(image, target)
    with atomic_output(target) as temporary:
        temporary.write_bytes(data)
    return target


def _neighbour(mask: NDArray[np.bool_], axis: int, *, up: bool) -> NDArray[np.bool_]:
    """Whether the next voxel up or down an axis is occupied, ``[nz, ny, nx]``; False beyond the grid."""
    return np.roll(np.pad(mask, 1), -1 if up else 1, axis)[1:-1, 1:-1, 1:-1]


def _vtk(image: Image) -> bytes:
    """Legacy VTK: a header in ASCII, and after each array's header its values, x fastest, big-endian."""
    grid = image.grid
    lower, _ = grid.bounds_m()
    # One line of at most 255 characters; the method's name comes from a file.
    title = " ".join(f"mvla-sim image, {image.method}, {image.n_view} views".split())[:255]
    header = [
        "# vtk DataFile Version 3.0",
        title,
        "BINARY",
        "DATASET STRUCTURED_POINTS",
        "DIMENSIONS " + " ".join(str(count + 1) for count in grid.counts),
        "ORIGIN " + " ".join(repr(float(value)) for value in lower),
        "SPACING " + " ".join([repr(float(grid.spacing_m))] * 3),
        f"CELL_DATA {grid.size}",
    ]
    parts = ["\n".join(header).encode("ascii", "replace")]
    arrays: list[tuple[str, str, NDArray[np.float32] | NDArray[np.bool_] | None, str]] = [
        ("score", "float", image.score, ">f4"),
        ("support", "float", image.support_deg, ">f4"),
        ("occupied", "unsigned_char", image.occupied, "u1"),
    ]
    for name, kind, values, dtype in arrays:
        if values is not None:
            parts.append(f"\nSCALARS {name} {kind} 1\nLOOKUP_TABLE default\n".encode("ascii"))
            parts.append(values.astype(dtype).tobytes())
    return b"".join([*parts, b"\n"])


def _ply(image: Image, target: Path) -> bytes:
    """Binary PLY of the occupied voxels' surface."""
    if image.occupied is None:
        raise DataError(f"{target}: a surface needs a binary image, and this image has none; give thresholds")
    surface = exposed_faces(image.occupied, image.grid)
    if not surface.voxels.size:
        raise DataError(f"{target}: no voxel is occupied, so there is no surface; give lower thresholds")
    largest = float(image.score.max())
    shade = image.score.ravel()[surface.voxels] / (largest if largest > 0 else 1.0)
    colors = colormaps[SCORE_MAP](shade, bytes=True)
    mesh = trimesh.Trimesh(
        surface.vertices_m, surface.triangles, face_colors=np.repeat(colors, 2, axis=0), process=False
    )
    return bytes(mesh.export(file_type="ply", vertex_normal=False))
