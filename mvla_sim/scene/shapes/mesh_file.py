"""A mesh read from a file."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat

from mvla_sim.errors import DataError, MvlaWarning
from mvla_sim.files import existing_file
from mvla_sim.scene.glb import plain_glb
from mvla_sim.scene.obj_off import read_obj, read_off
from mvla_sim.scene.ply import read_ply
from mvla_sim.scene.shape import Shape
from mvla_sim.scene.triangulation import PolygonMesh, triangulate

__all__ = ["MESH_FORMATS", "MeshFile"]

MESH_FORMATS: Final = ("glb", "obj", "off", "ply", "stl")
"""File formats that carry a whole mesh in one file; none of them can name another file that we would follow."""

POLYGONS: Final[Mapping[str, Callable[[bytes], PolygonMesh]]] = {"obj": read_obj, "off": read_off, "ply": read_ply}
"""Readers of the formats whose faces may have any number of corners; trimesh cuts those as if all were convex."""

SMALLEST_M: Final = 0.05
LARGEST_M: Final = 200.0
LIKELY_M: Final = (0.5, 20.0)
"""Sizes that a target is likely to have."""
UNITS: Final = {
    "millimetres": 1e-3, "inches": 0.0254, "centimetres": 1e-2, "feet": 0.3048, "kilometres": 1e3, "metres already": 1.0
}  # fmt: skip
"""Metres of the units that a file may be in."""


class MeshFile(Shape):
    """A mesh read from a file (PLY, OBJ, STL, GLB, …), scaled, turned and placed; metres after scaling."""

    shape: Literal["mesh"] = "mesh"
    file: str = Field(description="PLY, OBJ, STL, GLB or OFF, beside the scene file")
    scale: PositiveFloat = Field(1.0, description="metres per unit of the file")
    up: Literal["z", "y"] | None = Field(
        None, description="which axis of the file points up; by default y in GLB, as that format has it, else z"
    )

    def own_parts(self, key: str = "object") -> dict[str, trimesh.Trimesh]:
        """Mesh of the file with z up and its scale applied, in the file's own place."""
        del key
        file = existing_file(self.file, "mesh file")
        vertices, faces = _parse(file)
        if not len(faces):
            raise DataError(f"{file}: has no faces; a point cloud or a set of lines is no mesh")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise DataError(f"{file}: a face uses vertex {faces.max()}; the file has {len(vertices)} vertices")
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if len(bad):
            raise DataError(f"{file}: vertex {bad[0]} = {vertices[bad[0]].tolist()} is not finite ({len(bad)} such)")
        if self.up is None and file.suffix.lower() == ".glb":
            warnings.warn(
                f'{file}: y is taken as up, as the GLB format has it; set up = "y" to confirm, or up = "z"',
                MvlaWarning,
                stacklevel=2,
            )
        if (self.up or ("y" if file.suffix.lower() == ".glb" else "z")) == "y":
            vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
        vertices = vertices * self.scale
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        mesh.merge_vertices()  # STL, and others at sharp edges, repeat each vertex in each face
        # Thin faces stay: taking one out tears its neighbours apart.
        mesh.update_faces((np.diff(np.sort(mesh.faces, axis=1), axis=1) > 0).all(axis=1))
        mesh.remove_unreferenced_vertices()
        if mesh.is_empty:
            raise DataError(f"{file}: none of its {len(faces)} faces has three vertices at scale = {self.scale:g}")
        _check_size(file, float(mesh.extents.max()), self.scale)
        return {"": mesh}

    def likely_units(self, extent_m: float) -> str:
        """In which unit the file may be if a mesh of this size is too large, as an advice; empty for likely sizes."""
        return _likely_units(extent_m, self.scale) if extent_m > LIKELY_M[1] else ""


def _parse(file: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices ``[n, 3]`` and faces ``[n, 3]`` as they stand in a file."""
    kind = file.suffix.lower().removeprefix(".")
    if kind not in MESH_FORMATS:
        raise DataError(f"{file}: unknown mesh format '{kind}'; allowed: {', '.join(MESH_FORMATS)}")
    data = file.read_bytes()
    try:
        if kind in POLYGONS:
            mesh = POLYGONS[kind](data)
            return mesh.vertices, triangulate(mesh)
        options: dict[str, Any] = {"skip_materials": True} if kind == "glb" else {}
        # Bytes without a resolver: textures, material libraries and outside buffers are never looked for.
        with io.BytesIO(plain_glb(data) if kind == "glb" else data) as stream:
            loaded = trimesh.load(stream, file_type=kind, force="mesh", process=False, **options)
        vertices = np.asarray(loaded.vertices, np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(loaded, "faces", ()), np.int64).reshape(-1, 3)
    except DataError as error:
        raise DataError(f"{file}: {error}") from error
    except Exception as error:  # the parsers raise whatever a broken file trips over
        # trimesh tries text where binary does not fit and then misses a module that guesses encodings
        foreign = isinstance(error, ImportError | LookupError) or not str(error).strip()
        reason = "truncated, or of another format" if foreign else " ".join(str(error).split())
        raise DataError(f"{file}: is not a readable {kind.upper()} file: {reason}") from error
    return vertices, faces


def _check_size(file: Path, extent_m: float, scale: float) -> None:
    if not SMALLEST_M <= extent_m <= LARGEST_M:
        hint = _likely_units(extent_m, scale) or "set scale so that it becomes metres"
        raise DataError(
            f"{file}: extent is {extent_m:.4g} m at scale = {scale:g}; allowed: {SMALLEST_M:g} to {LARGEST_M:g} m; "
            f"{hint}"
        )


def _likely_units(extent_m: float, scale: float) -> str:
    """Units in which the file may be, with the scale and size that follow; empty where none makes it plausible."""
    sizes = {unit: (factor, extent_m / scale * factor) for unit, factor in UNITS.items() if factor != scale}
    likely = [
        f"in {unit} set scale = {factor:g} ({size:.3g} m)"
        for unit, (factor, size) in sizes.items()
        if LIKELY_M[0] <= size <= LIKELY_M[1]
    ]
    return f"if the file is {', '.join(likely)}" if likely else ""
