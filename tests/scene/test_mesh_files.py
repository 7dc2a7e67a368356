"""Mesh files as programs write them: polygons that are not convex, GLB with its own axes and ways to store numbers."""

from __future__ import annotations

import math
import struct
import warnings

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_texts import POLYGON_FILES, as_obj, as_off, extruded, glb, star_prism

from mvla_sim.errors import DataError, MvlaWarning
from mvla_sim.scene.cross_sections import cross_section, footprint
from mvla_sim.scene.shapes.mesh_file import MeshFile
from mvla_sim.scene.triangulation import PolygonMesh, triangulate
from mvla_sim.scene.world import Scene

STAR_M2 = 5 * 2.0**2 * math.sin(math.pi / 10) / math.sin(0.3 * math.pi) * math.sin(math.pi / 5)
"""Area of a star {5/2} of radius 2 m: ten triangles between neighbouring corners; 4.490 m²."""
BOX = np.array([[x, y, z] for x in (-2.0, 2.0) for y in (0.0, 1.4) for z in (-0.8, 0.8)], np.float32)
"""Corners of a box of 4 × 1.6 m, 1.4 m high along y."""
BOX_FACES = trimesh.creation.box((1, 1, 1)).faces  # the same order of corners
Y = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
POSITIONS = {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"}
INDICES = {"bufferView": 1, "componentType": 5125, "count": 36, "type": "SCALAR"}
PART = {"attributes": {"POSITION": 0}, "indices": 1}


def box_tree(**changes):
    return {**Y, "meshes": [{"primitives": [PART]}], "accessors": [POSITIONS, INDICES], **changes}


def read(tmp_path, name, data, **fields):
    (tmp_path / name).write_bytes(data)
    return MeshFile(file=str(tmp_path / name), **fields).mesh()


@pytest.mark.parametrize("kind", POLYGON_FILES)
def test_a_concave_face_covers_what_its_corners_enclose(tmp_path, kind):
    """A fan from the first corner makes 6.5 m² of the caps of a star of 4.49 m²."""
    name = f"star.{kind}"
    mesh = read(tmp_path, name, POLYGON_FILES[kind](*star_prism()))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(STAR_M2 * 1.6, rel=1e-9)
    assert mesh.area == pytest.approx(2 * STAR_M2 + 1.6 * 10 * math.dist(*star_prism()[0][:2]), rel=1e-9)
    world = Scene(objects=[MeshFile(file=str(tmp_path / name))], outline="footprint")
    assert world.outline.area == pytest.approx(STAR_M2, rel=1e-6)


def test_a_body_with_concave_sides_is_closed_at_every_height(tmp_path):
    side = [(-2.1, 0.3), (2.1, 0.3), (2.1, 0.9), (1.0, 0.9), (0.5, 1.5), (-1.2, 1.5), (-1.6, 0.9), (-2.1, 0.9)]
    vertices, faces = extruded(np.array(side), -0.85, 0.85)
    upright = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)  # the sides are the prism's caps
    faces[1] = faces[1][2:] + faces[1][:2]  # from a corner whose fan leaves the side
    mesh = read(tmp_path, "body.obj", as_obj(upright, faces))
    assert mesh.volume == pytest.approx(shapely.Polygon(side).area * 1.7, rel=1e-9)
    section = cross_section(mesh, 1.2, "body")
    assert section.bounds == pytest.approx((-1.4, -0.85, 0.75, 0.85), abs=1e-6)  # halfway up the slopes


@given(st.lists(st.tuples(st.floats(0.3, 3.0), st.floats(0.2, 1.0)), min_size=4, max_size=12), st.floats(0, 6.28))
@settings(deadline=None, max_examples=60)
def test_any_simple_polygon_in_space_keeps_its_area_and_sense(corners, turn):
    """Radii at rising angles make a polygon that is simple, and seldom convex."""
    angles = np.cumsum([step for _, step in corners])
    angles *= 2 * math.pi / (angles[-1] + 0.5)
    ring = np.array([r for r, _ in corners])[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    flat = shapely.Polygon(ring)
    if not flat.is_valid or not flat.exterior.is_ccw:  # gaps of half a turn or more
        return
    basis = trimesh.transformations.rotation_matrix(turn, [1.0, 2.0, -1.0])[:3, :3]
    points = np.column_stack([ring, np.zeros(len(ring))]) @ basis.T + [3.0, -2.0, 5.0]
    faces = triangulate(PolygonMesh(points, np.arange(len(ring)), np.array([len(ring)])))
    normals = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]) / 2
    along = normals @ basis[:, 2]
    assert (along > 0).all()
    assert along.sum() == pytest.approx(flat.area, rel=1e-9)
    assert set(faces.ravel()) == set(range(len(ring)))  # each corner is one of the surface's


def test_a_hole_that_is_bridged_stays_open_and_straight_corners_make_no_slivers():
    outer = [(0, 0, 0), (2, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)]  # a corner halfway along the first side
    inner = [(1, 1, 0), (1, 3, 0), (3, 3, 0), (3, 1, 0)]
    points = np.array(outer + inner, float)
    ring = [0, 1, 2, 3, 4, 0, 5, 6, 7, 8, 5]
    faces = triangulate(PolygonMesh(points, np.array(ring), np.array([len(ring)])))
    parts = shapely.polygons(points[faces][:, :, :2])
    assert shapely.area(parts).min() > 0.1
    assert shapely.union_all(parts).equals(shapely.Polygon(points[:5, :2], [points[5:, :2]]))
    assert shapely.area(parts).sum() == pytest.approx(12)


def test_convex_faces_are_fans_as_ever():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = triangulate(PolygonMesh(points, np.array([0, 1, 4, 0, 1, 2, 3, 3, 4]), np.array([3, 4, 2])))
    assert faces.tolist() == [[0, 1, 4], [0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("faces", [[[0, 2, 1, 3]], [[0, 1, 2, 3], [3, 0, 2, 1]]])
def test_a_face_that_crosses_itself_is_named(tmp_path, faces):
    square = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)]
    number = len(faces) - 1
    with pytest.raises(DataError, match=rf"bow\.obj: .*face {number} of 4 corners crosses itself; cut it into"):
        read(tmp_path, "bow.obj", as_obj(square, faces))


def test_obj_as_programs_write_it(tmp_path):
    """Backward numbers count from where they stand, lines are continued, and only corners matter of a face."""
    text = (
        "# made by\r\nmtllib none.mtl\r\no box\r\nv 0 0 0 1.0 0.5 0.5\r\nv 2 0 0\r\nv 2 3 0\r\nvt 0 0\r\nvn 0 0 1\r\n"
        "f -3/1/1 -2//1 -1 # the last three\r\nv 0 0 1\r\nf 1 2 \\\r\n 4\r\nl 1 2\r\nf 4/1 3/1 1/1\r\nf 2 3 4\r\n"
    )
    mesh = read(tmp_path, "t.obj", text.encode("utf-8"))
    assert len(mesh.faces) == 4
    assert abs(mesh.volume) == pytest.approx(2 * 3 / 6 * 1)
    assert read(tmp_path, "u.obj", text.replace("made by", "größe\x85\f").encode("latin-1")).is_watertight


def test_off_as_programs_write_it(tmp_path):
    vertices, faces = star_prism()
    text = as_off(vertices, faces).decode().split("\n")
    coloured = ["COFF # colours", text[1], "", *(f"{line} 255 0 0 255" for line in text[2:22]), *text[22:]]
    assert read(tmp_path, "star.off", "\n".join(coloured).encode()).volume == pytest.approx(STAR_M2 * 1.6, rel=1e-9)
    inline = " ".join(text[:2]) + "\n" + "\n".join(text[2:])
    assert read(tmp_path, "line.off", inline.encode()).is_watertight


def test_binary_stl_whose_header_begins_with_solid(tmp_path):
    box = trimesh.creation.box((4.0, 1.6, 1.4))
    rows = b"".join(struct.pack("<12fH", *normal, *corners.ravel(), 0)
                    for normal, corners in zip(box.face_normals, box.triangles, strict=True))  # fmt: skip
    mesh = read(tmp_path, "box.stl", b"solid box made by CAD".ljust(80) + struct.pack("<I", 12) + rows)
    np.testing.assert_allclose(mesh.extents, [4.0, 1.6, 1.4], rtol=1e-6)  # single precision
    two = box.copy()
    two.apply_translation([10, 0, 0])
    text = trimesh.exchange.stl.export_stl_ascii
    mesh = read(tmp_path, "two.stl", (text(box) + "\n" + text(two)).encode())
    assert mesh.volume == pytest.approx(2 * 4.0 * 1.6 * 1.4)


def test_y_is_up_in_a_glb_unless_the_scene_says_z(tmp_path):
    data = glb(box_tree(), BOX, BOX_FACES.astype("<u4"))
    with pytest.warns(MvlaWarning, match=r"box\.glb: y is taken as up, as the GLB format has it; set up = \"y\""):
        mesh = read(tmp_path, "box.glb", data)
    np.testing.assert_allclose(mesh.bounds, [[-2, -0.8, 0], [2, 0.8, 1.4]], rtol=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(read(tmp_path, "box.glb", data, up="y").bounds, mesh.bounds)
        lying = read(tmp_path, "box.glb", data, up="z")
        read(tmp_path, "box.obj", as_obj(BOX, BOX_FACES))  # z up, as ever, and nothing to say
    np.testing.assert_allclose(lying.bounds, [[-2, 0, -0.8], [2, 1.4, 0.8]], rtol=1e-6)


@pytest.mark.parametrize("kind", ["<i2", "<u2", "<i1", "<u1"])
def test_normalised_positions_are_what_they_stand_for(tmp_path, kind):
    """KHR_mesh_quantization: integers that mean -1 to 1 or 0 to 1, and a node that gives them their size."""
    code = {"<i1": 5120, "<u1": 5121, "<i2": 5122, "<u2": 5123}[kind]
    low, size = (BOX.min(axis=0), np.ptp(BOX, axis=0)) if "u" in kind else ((BOX.max(0) + BOX.min(0)) / 2, 2.0)
    rows = np.zeros((8, 4), kind)  # rows are padded to multiples of four bytes
    rows[:, :3] = np.rint((BOX - low) / size * np.iinfo(kind).max)
    tree = box_tree(
        nodes=[{"mesh": 0, "translation": low.tolist(), "scale": np.broadcast_to(size, 3).tolist()}],
        accessors=[{**POSITIONS, "componentType": code, "normalized": True}, INDICES],
        extensionsUsed=["KHR_mesh_quantization"], extensionsRequired=["KHR_mesh_quantization"],
    )  # fmt: skip
    data = glb(tree, rows, BOX_FACES.astype("<u4"))
    stride = rows.dtype.itemsize * 4
    data = glb({**tree, "bufferViews": [{"buffer": 0, "byteLength": rows.nbytes, "byteStride": stride},
                                        {"buffer": 0, "byteOffset": rows.nbytes, "byteLength": 144}]},
               rows, BOX_FACES.astype("<u4"))  # fmt: skip
    mesh = read(tmp_path, "box.glb", data, up="y")
    step = np.max(size) / np.iinfo(kind).max  # metres
    np.testing.assert_allclose(mesh.bounds, [[-2, -0.8, 0], [2, 0.8, 1.4]], atol=step)
    assert mesh.is_watertight


def test_sparse_positions_and_fans_are_read(tmp_path):
    moved = BOX.copy()
    moved[moved[:, 1] > 1] += np.float32([0, 0.6, 0])
    rows = np.flatnonzero(BOX[:, 1] > 1).astype("<u2")
    sparse = {"count": 4, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}
    tree = box_tree(accessors=[{**POSITIONS, "sparse": sparse}, INDICES])
    mesh = read(tmp_path, "box.glb", glb(tree, BOX, BOX_FACES.astype("<u4"), rows, moved[rows]), up="y")
    np.testing.assert_allclose(mesh.bounds, [[-2, -0.8, 0], [2, 0.8, 2.0]], rtol=1e-6)
    ring = np.float32([[0, 0, 0], [0, 0, 3], [1, 0, 4], [2, 0, 3], [2, 0, 0]])
    tree = {**Y, "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 6}]}],
            "accessors": [{**POSITIONS, "count": 5}]}  # fmt: skip
    assert footprint(read(tmp_path, "fan.glb", glb(tree, ring), up="y")).area == pytest.approx(7.0, rel=1e-6)


DRACO = {"KHR_draco_mesh_compression": {"bufferView": 2, "attributes": {"POSITION": 0}}}
SHORT = {**POSITIONS, "normalized": True, "componentType": 5122}
EMPTY = {"componentType": 5126, "count": 8, "type": "VEC3"}
EMPTY_INDICES = {"componentType": 5125, "count": 36, "type": "SCALAR"}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        # a compressed part beside a plain one: all or nothing
        ({"meshes": [{"primitives": [PART]}, {"primitives": [{"attributes": {"POSITION": 2}, "indices": 3,
                                                             "extensions": DRACO}]}],
          "accessors": [POSITIONS, INDICES, EMPTY, EMPTY_INDICES], "extensionsUsed": [*DRACO],
          "nodes": [{"mesh": 0}, {"mesh": 1}], "scenes": [{"nodes": [0, 1]}]}, "is compressed with Draco .*save it"),
        ({"extensionsRequired": [*DRACO]}, "is compressed with Draco"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "is compressed with meshopt"),
        ({"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]}, "holds copies of a mesh as inst"),
        ({"extensionsRequired": ["ACME_patches"]}, "needs the extension ACME_patches"),
        ({"nodes": [{"mesh": 0, "skin": 0}], "skins": [{"joints": [0]}]}, "is bent by bones"),
        ({"meshes": [{"primitives": [PART], "weights": [0.5]}]}, "is morphed"),
        ({"accessors": [{**SHORT, "count": 99}, INDICES]}, "not a readable"),
        ({"accessors": [{**POSITIONS, "sparse": {}}, INDICES]}, "not a readable GLB file"),
        ({"buffers": [{"byteLength": 240, "uri": "other.bin"}], "accessors": [SHORT, INDICES]}, "in another file"),
    ],
)  # fmt: skip
def test_a_glb_of_which_a_part_would_be_left_out_is_refused(tmp_path, changes, says):
    with pytest.raises(DataError, match=says) as caught:
        read(tmp_path, "car.glb", glb(box_tree(**changes), BOX, BOX_FACES.astype("<u4"), np.zeros(9, np.uint8)), up="y")
    assert str(caught.value).startswith(str(tmp_path / "car.glb"))
    assert "\n" not in str(caught.value)


def test_a_part_that_is_stored_both_ways_is_read(tmp_path):
    both = {"meshes": [{"primitives": [{**PART, "extensions": DRACO}]}], "extensionsUsed": [*DRACO]}
    mesh = read(tmp_path, "box.glb", glb(box_tree(**both), BOX, BOX_FACES.astype("<u4"), np.zeros(9, np.uint8)), up="y")
    assert abs(mesh.volume) == pytest.approx(4 * 1.4 * 1.6, rel=1e-6)


HEAD = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2 7\n", "face 0 uses vertex 6, counted from 0; the file has 2 vertices"),
        ("a.obj", "v 0 0 0\nf 0 1 1\n", "line 2 'f 0 1 1': vertices are numbered from 1"),
        ("a.obj", "v 0 0\n", "line 1 'v 0 0'"),
        ("a.obj", "v 0 0 x\n", "line 1 'v 0 0 x': could not convert"),
        ("a.obj", "v 0 0 0\nf a b c\n", "line 2 'f a b c'"),
        ("a.obj", "v 0 0 0\nf -2 -1 -1\n", "face 0 uses vertex -1"),
        ("a.obj", "v 0 0 0\nsurf 0 1 0 1 1 2\n", "line 2: holds curved surfaces"),
        ("a.off", "OFF BINARY\n1 1 1", "is a binary OFF file"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", "truncated: fewer lines"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1\n", "a face of 3 corners names 2"),
        ("a.off", "OFF\n1 0 0\n0 0\n", "fewer than three coordinates"),
        ("a.off", "OFF\n-3 1 0\n", "truncated"),
        ("a.ply", HEAD + FACE + "0 0 0\n1 0 0\n1 1 0\n3 0 1\n", "truncated: its 1 rows of 'face'"),
        ("a.ply", HEAD + FACE + "0 0 0\n1 0 0\n", "truncated: its 1 rows of 'face'|truncated: its 3 rows"),
        ("a.ply", HEAD + FACE + "0 0 0\n1 0 0\n1 1 0\n3 0 1 9\n", "face 0 uses vertex 9"),
        ("a.ply", HEAD + FACE + "0 0 0\n1 0 0\n1 1 0\n-3 0 1 2\n", "truncated"),
        ("a.ply", HEAD.replace("3", "99999999999") + FACE + "0 0 0\n", "truncated: its 99999999999 rows of 'vertex'"),
        ("a.ply", HEAD.replace("float z", "quad z") + FACE, "unknown line of its header: 'property quad z'"),
        ("a.ply", HEAD.replace("float z", "float w") + FACE + "0 0 0\n" * 3 + "3 0 1 2\n", "no vertices with x, y"),
        ("a.ply", HEAD.replace("ascii", "morse") + FACE, "its format is unknown; allowed: ascii, binary_little"),
        ("a.ply", HEAD, "its header does not end"),
        ("a.ply", HEAD + FACE.replace("face", "tristrips") + "0 0 0\n" * 3 + "3 0 1 2\n", "holds triangle strips"),
        ("a.ply", HEAD.replace("ascii", "binary_little_endian") + FACE + "\0" * 36 + "\x03\0\0", "truncated: its 1"),
    ],
)  # fmt: skip
def test_a_broken_file_is_told_with_its_place(tmp_path, name, content, says):
    with pytest.raises(DataError, match=says) as caught:
        read(tmp_path, name, content.encode("latin-1"))
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", [*POLYGON_FILES, "glb", "stl"])
def test_a_damaged_file_is_a_mesh_or_one_error(tmp_path, kind):
    """Bytes changed, cut and repeated at random: never another error, and never a hang."""
    if kind in POLYGON_FILES:
        data = POLYGON_FILES[kind](*star_prism())
    else:
        data = trimesh.creation.box((2, 3, 4)).export(file_type=kind)
    random = np.random.Generator(np.random.PCG64(7))
    for _ in range(40):
        damaged = bytearray(data)
        for place in random.integers(0, len(damaged), random.integers(1, 6)):
            damaged[place] = random.integers(0, 256)
        if random.random() < 0.3:
            damaged = damaged[: random.integers(1, len(damaged))]
        try:
            with np.errstate(all="ignore"):
                mesh = read(tmp_path, f"a.{kind}", bytes(damaged), **({"up": "y"} if kind == "glb" else {}))
        except DataError as error:
            assert "\n" not in str(error)  # noqa: PT017 - any error is allowed that is one line
        else:
            assert np.isfinite(mesh.vertices).all()
            assert len(mesh.faces)
