"""GLB files as readers of meshes understand them: plain numbers, or a refusal where a part would be left out."""

from __future__ import annotations

import base64
import json
import struct
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError

__all__ = ["plain_glb"]

Tree = dict[str, Any]

JSON_CHUNK: Final = 0x4E4F534A
BINARY_CHUNK: Final = 0x004E4942
CODES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
FLOAT: Final = 5126
WHOLE: Final = 5125
TRIANGLES: Final = 4
FAN: Final = 6

DRACO: Final = "KHR_draco_mesh_compression"
REMEDIES: Final = {
    DRACO: "is compressed with Draco (KHR_draco_mesh_compression), which is not read; save it without compression, in "
    "Blender with 'Compression' off in the glTF export, or with 'gltf-transform copy IN.glb OUT.glb'",
    "EXT_meshopt_compression": "is compressed with meshopt (EXT_meshopt_compression), which is not read; save it "
    "without compression, as with 'gltf-transform copy IN.glb OUT.glb'",
    "EXT_mesh_gpu_instancing": "holds copies of a mesh as instances (EXT_mesh_gpu_instancing), which are not read; "
    "save each as a mesh of its own",
}
"""What is told of extensions that hold geometry, of which nothing must be left out."""
HARMLESS: Final = (
    "KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_mesh_quantization", "KHR_lights_",
    "KHR_xmp", "KHR_animation_", "EXT_lights_",
)  # fmt: skip
"""What extensions begin with that change no surface, or only how its numbers are stored."""


def plain_glb(data: bytes) -> bytes:
    """Return a GLB file whose surfaces any reader takes as they are meant.

    Positions that are stored as normalised integers (``KHR_mesh_quantization``) or as changes to others (sparse) become
    plain numbers, and fans of triangles become triangles. A file without any is returned as it is.

    Raises
    ------
    DataError
        A surface is compressed, instanced, bent by bones or morphed, or an extension is needed that is not known here.
        The message begins with a verb, to stand behind the file's name.
    ValueError, LookupError, TypeError
        The file is broken.
    """
    tree, binary = _chunks(data)
    _check(tree)
    changed = False
    for mesh in tree.get("meshes", ()):
        for primitive in mesh["primitives"]:
            changed |= _uncompressed(tree, primitive)
            changed |= _with_plain_positions(tree, binary, primitive)
            changed |= _without_fan(tree, binary, primitive)
    return _packed(tree, binary) if changed else data


def _chunks(data: bytes) -> tuple[Tree, bytes]:
    magic, version, length = struct.unpack_from("<4sII", data)
    if magic != b"glTF" or version != 2 or length > len(data):
        raise ValueError("is no whole GLB file of version 2")
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    tree = json.loads(found[JSON_CHUNK])
    if not isinstance(tree, dict):
        raise TypeError("its description is no object")
    return tree, found.get(BINARY_CHUNK, b"")


def _packed(tree: Tree, binary: bytes) -> bytes:
    text = json.dumps(tree).encode()
    chunks = [(JSON_CHUNK, text + b" " * (-len(text) % 4)), (BINARY_CHUNK, binary + b"\0" * (-len(binary) % 4))]
    body = b"".join(struct.pack("<II", len(chunk), kind) + chunk for kind, chunk in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _check(tree: Tree) -> None:
    """Refuse what a reader of plain meshes would leave out or lay elsewhere."""
    nodes = tree.get("nodes", ())
    held = {name for item in (*tree.get("bufferViews", ()), *nodes) for name in item.get("extensions", ())}
    needed = tree.get("extensionsRequired", ())
    for name in (*sorted(held & REMEDIES.keys()), *(name for name in needed if name in REMEDIES)):
        raise DataError(REMEDIES[name])
    for name in needed:
        if not str(name).startswith(HARMLESS):
            raise DataError(f"needs the extension {name}, which is not read; save it without")
    if any("mesh" in node and "skin" in node for node in nodes):
        raise DataError("has a mesh that is bent by bones (a skin), which are not read; apply them in a mesh editor")
    if any(any(item.get("weights", ())) for item in (*tree.get("meshes", ()), *nodes)):
        raise DataError("has a mesh that is morphed (weights), which is not read; apply the shape in a mesh editor")


def _uncompressed(tree: Tree, primitive: Tree) -> bool:
    """Take the plain numbers of a part that has both; refuse one that has Draco's alone."""
    if DRACO not in primitive.get("extensions", ()):
        return False
    named = [primitive["attributes"]["POSITION"], *([primitive["indices"]] if "indices" in primitive else [])]
    if any("bufferView" not in tree["accessors"][index] for index in named):
        raise DataError(REMEDIES[DRACO])
    del primitive["extensions"][DRACO]
    return True


def _with_plain_positions(tree: Tree, binary: bytes, primitive: Tree) -> bool:
    index = primitive.get("attributes", {}).get("POSITION")
    if index is None:
        return False
    accessor = tree["accessors"][index]
    if not accessor.get("normalized") and "sparse" not in accessor:
        return False
    values = _values(tree, binary, accessor)
    _replace(tree, accessor, values.astype("<f4"), FLOAT)
    return True


def _without_fan(tree: Tree, binary: bytes, primitive: Tree) -> bool:
    if primitive.get("mode", TRIANGLES) != FAN:
        return False
    if "indices" in primitive:
        ring = _values(tree, binary, tree["accessors"][primitive["indices"]]).ravel()
    else:
        ring = np.arange(tree["accessors"][primitive["attributes"]["POSITION"]]["count"])
    after = np.arange(1, len(ring) - 1)
    faces = np.stack([ring[np.zeros_like(after)], ring[after], ring[after + 1]], axis=1)
    accessor: Tree = {"type": "SCALAR"}
    _replace(tree, accessor, faces.ravel().astype("<u4"), WHOLE)
    primitive["mode"], primitive["indices"] = TRIANGLES, len(tree["accessors"])
    tree["accessors"].append(accessor)
    return True


def _values(tree: Tree, binary: bytes, accessor: Tree) -> NDArray[np.float64]:
    """What an accessor means, ``[count, width]``: normalised integers in [-1, 1] or [0, 1], sparse changes made."""
    kind, width = np.dtype(CODES[accessor["componentType"]]), WIDTHS[accessor["type"]]
    values = np.zeros((accessor["count"], width))
    if "bufferView" in accessor:
        values = _stored(tree, binary, accessor, kind, (accessor["count"], width)).astype(np.float64)
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        where = np.dtype(CODES[sparse["indices"]["componentType"]])
        rows = _stored(tree, binary, sparse["indices"], where, (sparse["count"], 1)).ravel()
        values[rows] = _stored(tree, binary, sparse["values"], kind, (sparse["count"], width))
    if accessor.get("normalized") and kind.kind in "iu":
        values = np.maximum(values / np.iinfo(kind).max, -1.0)
    return values


def _stored(tree: Tree, binary: bytes, block: Tree, kind: np.dtype[Any], shape: tuple[int, int]) -> NDArray[Any]:
    """Numbers ``[count, width]`` of a block of the file."""
    view = tree["bufferViews"][block["bufferView"]]
    uri = tree["buffers"][view["buffer"]].get("uri")
    if uri is not None and not uri.startswith("data:"):
        raise ValueError(f"its numbers are in another file, {uri!r}; save it as one GLB")
    data = binary if uri is None else base64.b64decode(uri.partition(",")[2])
    start = view.get("byteOffset", 0)
    part = data[start : start + view["byteLength"]]
    step = view.get("byteStride", kind.itemsize * shape[1])
    return np.ndarray(shape, kind, part, block.get("byteOffset", 0), (step, kind.itemsize)).copy()


def _replace(tree: Tree, accessor: Tree, values: NDArray[Any], component: int) -> None:
    """Let an accessor mean the given numbers, in a buffer of their own."""
    data = values.tobytes()
    tree.setdefault("buffers", []).append({
        "byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode(),
    })  # fmt: skip
    tree.setdefault("bufferViews", []).append({"buffer": len(tree["buffers"]) - 1, "byteLength": len(data)})
    for key in ("normalized", "sparse", "min", "max", "byteOffset"):
        accessor.pop(key, None)
    accessor |= {"bufferView": len(tree["bufferViews"]) - 1, "componentType": component, "count": len(values)}
