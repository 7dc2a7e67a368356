"""Mesh files as other programs write them, made from vertices and polygons."""

from __future__ import annotations

import json
import math
import struct

import numpy as np


def star_prism(radius=2.0, height=1.6, points=5):
    """Vertices and polygons of a star: two concave caps and quadrilaterals between them."""
    angles = np.pi / 2 + np.arange(2 * points) * np.pi / points
    inner = radius * math.sin(math.radians(18)) / math.sin(math.radians(54))
    radii = np.where(np.arange(2 * points) % 2 == 0, radius, inner)
    ring = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)
    return extruded(ring, -height / 2, height / 2)


def extruded(ring, low, high):
    """A prism over a ring ``[n, 2]``, counter-clockwise."""
    count = len(ring)
    vertices = np.concatenate([np.column_stack([ring, np.full(count, z)]) for z in (low, high)])
    caps = [list(range(count))[::-1], [k + count for k in range(count)]]
    walls = [[k, (k + 1) % count, (k + 1) % count + count, k + count] for k in range(count)]
    return vertices, caps + walls


def as_obj(vertices, faces):
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    return "\n".join([*lines, *("f " + " ".join(str(k + 1) for k in face) for face in faces), ""]).encode()


def as_off(vertices, faces):
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0", *(f"{x} {y} {z}" for x, y, z in vertices)]
    return "\n".join([*lines, *(f"{len(f)} " + " ".join(map(str, f)) for f in faces), ""]).encode()


def as_ply(vertices, faces, form="ascii"):
    """PLY of double precision; a colour on each vertex and a flag before each face's list."""
    header = (
        f"ply\nformat {form} 1.0\ncomment made by a test\nelement vertex {len(vertices)}\nproperty double x\n"
        f"property double y\nproperty double z\nproperty uchar red\nelement face {len(faces)}\nproperty uchar flag\n"
        "property list uchar int vertex_indices\nend_header\n"
    ).encode()
    if form == "ascii":
        lines = [f"{x} {y} {z} 7" for x, y, z in vertices]
        return header + "\n".join([*lines, *(f"1 {len(f)} " + " ".join(map(str, f)) for f in faces), ""]).encode()
    order = "<" if "little" in form else ">"
    rows = [struct.pack(order + "dddB", x, y, z, 7) for x, y, z in vertices]
    return header + b"".join([*rows, *(struct.pack(f"{order}BB{len(f)}i", 1, len(f), *f) for f in faces)])


POLYGON_FILES = {
    "obj": as_obj,
    "off": as_off,
    "ply": as_ply,
    "little.ply": lambda v, f: as_ply(v, f, "binary_little_endian"),
    "big.ply": lambda v, f: as_ply(v, f, "binary_big_endian"),
}


def glb(tree, *arrays):
    """A GLB file: a buffer view for each array, in order; the tree has all the rest."""
    binary = b""
    views = []
    for array in arrays:
        data = np.ascontiguousarray(array).tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data + b"\0" * (-len(data) % 4)
    tree = {"asset": {"version": "2.0"}, "bufferViews": views, "buffers": [{"byteLength": len(binary)}], **tree}
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
