"""Surfaces in PLY files, text or binary, with faces of any number of corners."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.scene.triangulation import PolygonMesh

__all__ = ["read_ply"]

TYPES: Final = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
    "int64": "q", "uint64": "Q", "float16": "e",
}  # fmt: skip
"""Codes of ``struct``, which are those of NumPy where a byte order is given too, by the format's names."""
FORMATS: Final = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
FACE_LISTS: Final = ("vertex_indices", "vertex_index")
Ragged = tuple[NDArray[np.float64], NDArray[np.int64]]
"""All values of a list property one after the other, and how many each row has."""


@dataclass
class _Element:
    """A table of the file: its properties as (name, code, code of the list's length or None)."""

    name: str
    rows: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)


def read_ply(data: bytes) -> PolygonMesh:
    """Read the vertices and faces of a PLY file; all its other properties are not looked at.

    Raises
    ------
    ValueError
        The header is broken or of an unknown format, or the file is shorter than it says.
    """
    order, elements, place = _header(data)
    words = data[place:].split() if not order else []
    found: dict[str, dict[str, Ragged]] = {}
    at = 0 if not order else place
    for element in elements:
        if order:
            found[element.name], at = _binary(data, at, order, element)
        else:
            found[element.name], at = _text(words, at, element)
    vertex, face = found.get("vertex", {}), found.get("face", {})
    if any(axis not in vertex for axis in "xyz"):
        raise ValueError("has no vertices with x, y and z")
    if "tristrips" in found:
        raise ValueError("holds triangle strips; save it with faces")
    corners, counts = next((face[name] for name in FACE_LISTS if name in face), (np.empty(0), np.empty(0, np.int64)))
    vertices = np.stack([vertex[axis][0] for axis in "xyz"], axis=1)
    return PolygonMesh(vertices, corners.astype(np.int64), counts)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Byte order (empty for text), tables in order, and where the data begin."""
    if not data.startswith(b"ply"):
        raise ValueError("does not begin with 'ply'")
    end = data.find(b"end_header")
    stop = min((p for p in (data.find(b"\n", end), data.find(b"\r", end)) if p >= 0), default=-1)
    if end < 0 or stop < 0:
        raise ValueError("its header does not end")
    stop += 2 if data[stop : stop + 2] == b"\r\n" else 1
    order, elements = None, list[_Element]()
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        match line.split():
            case ["format", kind, *_]:
                order = FORMATS.get(kind)
            case ["element", name, rows]:
                elements.append(_Element(name, int(rows)))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= TYPES.keys():
                elements[-1].properties.append((name, TYPES[kind], TYPES[length]))
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties.append((name, TYPES[kind], None))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"unknown line of its header: '{line[:60]}'")
    if order is None:
        raise ValueError(f"its format is unknown; allowed: {', '.join(FORMATS)}")
    if any(element.rows < 0 for element in elements):
        raise ValueError("a number of rows is negative")
    return order, elements, stop


def _binary(data: bytes, at: int, order: str, element: _Element) -> tuple[dict[str, Ragged], int]:
    """Columns of a table, and where the next one begins."""
    if not element.rows or not element.properties:
        return {name: (np.empty(0), np.empty(0, np.int64)) for name, _, _ in element.properties}, at
    lengths = _row(data, at, order, element)[0]
    kind = np.dtype([
        item
        for place, (_, code, length) in enumerate(element.properties)
        for item in (
            [(f"value{place}", order + code)] if length is None
            else [(f"length{place}", order + length), (f"value{place}", order + code, (lengths[place],))]
        )
    ])  # fmt: skip
    end = at + element.rows * kind.itemsize
    if end <= len(data):
        table = np.frombuffer(data[at:end], kind)
        listed = [place for place, item in enumerate(element.properties) if item[2] is not None]
        if all((table[f"length{place}"] == lengths[place]).all() for place in listed):
            return {
                name: (table[f"value{place}"].astype(np.float64).ravel(), np.full(element.rows, lengths[place]))
                for place, (name, _, _) in enumerate(element.properties)
            }, end
    values: list[list[Any]] = [[] for _ in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    for _ in range(element.rows):  # lists of different lengths
        sizes, row, at = _row(data, at, order, element)
        for place, size in enumerate(sizes):
            values[place] += row[place]
            counts[place].append(size)
    return _columns(element, values, counts), at


def _row(data: bytes, at: int, order: str, element: _Element) -> tuple[list[int], list[tuple[Any, ...]], int]:
    """How many values each property of a row has, these, and where the next row begins."""
    sizes, row = [], []
    try:
        for _, code, length in element.properties:
            size = 1
            if length is not None:
                size = int(struct.unpack_from(order + length, data, at)[0])
                at += struct.calcsize(length)
                if not 0 <= size <= len(data):
                    raise ValueError(f"truncated or damaged: a list of {size} values")
            row.append(struct.unpack_from(f"{order}{size}{code}", data, at))
            at += size * struct.calcsize(code)
            sizes.append(size)
    except struct.error as error:
        raise ValueError(f"truncated: its {element.rows} rows of '{element.name}' are not all there") from error
    return sizes, row, at


def _text(words: list[bytes], at: int, element: _Element) -> tuple[dict[str, Ragged], int]:
    """Columns of a table of text, and which word is the next one."""
    width = len(element.properties)
    short = ValueError(f"truncated: its {element.rows} rows of '{element.name}' are not all there")
    if element.rows > len(words):
        raise short
    if all(length is None for _, _, length in element.properties):
        end = at + element.rows * width
        if end > len(words):
            raise short
        table = np.array(words[at:end], np.float64).reshape(element.rows, width)
        ones = np.ones(element.rows, np.int64)
        return {name: (table[:, place], ones) for place, (name, _, _) in enumerate(element.properties)}, end
    values: list[list[Any]] = [[] for _ in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    for _ in range(element.rows):
        for place, (_, _, length) in enumerate(element.properties):
            size = 1
            if length is not None:
                size, at = int(words[at]) if at < len(words) else len(words) + 1, at + 1
            if size < 0 or at + size > len(words):
                raise short
            values[place] += words[at : at + size]
            counts[place].append(size)
            at += size
    return _columns(element, values, counts), at


def _columns(element: _Element, values: list[list[Any]], counts: list[list[int]]) -> dict[str, Ragged]:
    return {
        name: (np.array(values[place], np.float64), np.array(counts[place], np.int64))
        for place, (name, _, _) in enumerate(element.properties)
    }
