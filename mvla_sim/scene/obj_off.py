"""Surfaces in text files: Wavefront OBJ and Geomview OFF, with faces of any number of corners."""

from __future__ import annotations

import re

import numpy as np

from mvla_sim.scene.triangulation import PolygonMesh

__all__ = ["read_obj", "read_off"]


def read_obj(data: bytes) -> PolygonMesh:
    """Read the vertices and faces of an OBJ file; materials, normals, textures, lines and points are not looked at.

    Raises
    ------
    ValueError
        A line is broken, a face names a vertex that there is not, or there are curved surfaces.
    """
    text = data.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    vertices: list[list[float]] = []
    corners: list[int] = []
    counts: list[int] = []
    for number, line in enumerate(text.split("\n"), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices.append([float(words[1]), float(words[2]), float(words[3])])
            elif words[0] == "f":
                corners += [_from_zero(int(word.partition("/")[0]), len(vertices)) for word in words[1:]]
                counts.append(len(words) - 1)
        except (ValueError, IndexError) as error:
            raise ValueError(f"line {number} '{line.strip()[:60]}': {error}") from error
        if words[0] in ("surf", "curv2"):
            raise ValueError(f"line {number}: holds curved surfaces ({words[0]}); export polygons")
    return _mesh(vertices, corners, counts)


def _from_zero(index: int, so_far: int) -> int:
    if index == 0:
        raise ValueError("vertices are numbered from 1, or backwards from -1")
    return index - 1 if index > 0 else so_far + index


def read_off(data: bytes) -> PolygonMesh:
    """Read the vertices and faces of an OFF file in text, also with normals, colours or textures.

    Raises
    ------
    ValueError
        It is of another kind, a line is broken, or lines are missing.
    """
    lines = [line.partition("#")[0].strip() for line in data.decode("latin-1").splitlines()]
    lines = [line for line in lines if line]
    header = re.match(r"(?:ST)?C?N?OFF\b(.*)", lines[0] if lines else "")
    if header is None or "BINARY" in header[1].upper():
        raise ValueError("does not begin with OFF" if header is None else "is a binary OFF file; save it as text")
    rest = [header[1].strip(), *lines[1:]] if header[1].strip() else lines[1:]
    sizes = [int(word) for word in rest[0].split()] if rest else []
    if len(sizes) < 2 or min(sizes) < 0 or len(rest) < 1 + sizes[0] + sizes[1]:
        raise ValueError("truncated: fewer lines than its numbers of vertices and faces say")
    vertices = [[float(word) for word in line.split()[:3]] for line in rest[1 : 1 + sizes[0]]]
    corners: list[int] = []
    counts: list[int] = []
    for line in rest[1 + sizes[0] : 1 + sizes[0] + sizes[1]]:
        words = line.split()
        counts.append(int(words[0]))
        named = [int(word) for word in words[1 : 1 + counts[-1]]]
        if counts[-1] < 0 or len(named) < counts[-1]:
            raise ValueError(f"a face of {counts[-1]} corners names {len(named)}: '{line[:60]}'")
        corners += named
    return _mesh(vertices, corners, counts)


def _mesh(vertices: list[list[float]], corners: list[int], counts: list[int]) -> PolygonMesh:
    if any(len(vertex) != 3 for vertex in vertices):
        raise ValueError("a vertex has fewer than three coordinates")
    return PolygonMesh(
        np.array(vertices, np.float64).reshape(-1, 3), np.array(corners, np.int64), np.array(counts, np.int64)
    )
