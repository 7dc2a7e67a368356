"""Prisms, mesh files and cross-sections."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.cross_sections import cross_section, section_and_gap
from mvla_sim.scene.shapes.cylinder import Cylinder
from mvla_sim.scene.shapes.mesh_file import MeshFile
from mvla_sim.scene.shapes.polygon import Polygon
from mvla_sim.scene.shapes.rectangle import Rectangle
from mvla_sim.scene.shapes.square import Square
from mvla_sim.scene.shapes.star import Star
from mvla_sim.scene.shapes.triangle import Triangle

SHAPES = [
    Cylinder(),
    Cylinder(facets=3),
    Square(),
    Rectangle(length_m=3, width_m=0.5),
    Triangle(),
    Star(),
    Polygon(vertices_m=((0.0, 0.0), (5.0, 0.0), (5.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0))),
]
EXACT = 1e-6  # share of the area: points nearer than 1e-7 of the size are one, on a perimeter of a few sizes


def difference(one, other):
    """Area that belongs to just one of two shapes, as a share of the first's."""
    return one.symmetric_difference(other).area / one.area


def moved(shape, **changes):
    return shape.model_copy(update=changes)


def write(mesh, path):
    data = mesh.export(file_type=path.suffix[1:])
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def box(lower, upper):
    return trimesh.creation.box(bounds=[lower, upper])


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.shape)
def test_prism_is_closed_and_centred_with_its_volume(shape):
    mesh = moved(shape, height_m=3.0).mesh()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 1e-6  # m²; the thinnest here is a circle's: a triangle over two facets of 7 cm
    assert mesh.volume == pytest.approx(3 * shape.outline().area, rel=1e-9)  # positive: normals point outwards
    np.testing.assert_allclose(mesh.bounds[:, 2], [-1.5, 1.5], rtol=1e-12)


@pytest.mark.parametrize("height", [0.0, 0.3, 1.0, -1.0], ids=lambda h: f"z={h}")
@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.shape)
def test_prism_is_cut_to_its_outline_even_along_its_faces(shape, height):
    section = cross_section(shape.mesh(), height, "prism")
    assert difference(shape.outline(), section) < EXACT
    corners = len(shape.outline().exterior.coords)
    assert corners <= len(section.exterior.coords) < 1.3 * corners + 1  # walls' diagonals would double them


@given(st.floats(-720, 720), st.tuples(*[st.floats(-20, 20)] * 2), st.sampled_from(SHAPES))
@settings(deadline=None, max_examples=30)
def test_turning_and_moving_the_object_turns_and_moves_the_section(turn, place, shape):
    placed = moved(shape, rotation_deg=turn, position_m=(*place, 0.25))
    expected = affinity.translate(affinity.rotate(shape.outline(), turn, origin=(0, 0)), *place)
    assert difference(expected, cross_section(placed.mesh(), 0.0, "prism")) < EXACT


def test_a_star_turned_by_a_fifth_of_a_turn_is_the_same():
    star = SHAPES[5]
    sections = [cross_section(moved(star, rotation_deg=a).mesh(), 0.0, "star") for a in (0.0, 72.0, 36.0)]
    assert difference(sections[0], sections[1]) < EXACT
    assert difference(sections[0], sections[2]) > 0.1


@pytest.mark.parametrize("height", [0.0, 1e-9, 0.7])  # an icosphere has a ring of vertices at z = 0
def test_sphere_is_cut_to_a_circle(height):
    section = cross_section(trimesh.creation.icosphere(subdivisions=5, radius=2.0), height, "sphere")
    # chords of at most 2 m / 2^5·1.1 are below the circle by s²/(8r) ≈ 3e-4 m, so the area is short by at most 5e-4
    assert section.area == pytest.approx(math.pi * (4 - height**2), rel=1e-3)
    assert section.area <= math.pi * (4 - height**2)
    assert not section.interiors


def test_a_ring_inside_a_ring_is_a_hole_and_one_inside_that_is_solid():
    tube = trimesh.creation.annulus(r_min=1.0, r_max=2.0, height=1.0, sections=64)
    nested = trimesh.util.concatenate([tube, trimesh.creation.box((0.5, 0.5, 1.0))])
    one = cross_section(tube, 0.1, "tube")
    assert len(one.interiors) == 1
    two = cross_section(nested, 0.1, "nested")
    assert two.geom_type == "MultiPolygon"
    assert two.area == pytest.approx(one.area + 0.25, rel=1e-6)


def test_parts_that_cross_are_one():
    mesh = trimesh.util.concatenate([box([0, 0, -1], [2, 1, 1]), box([1, 0.5, -1], [3, 2, 1])])
    section = cross_section(mesh, 0.0, "parts")
    expected = shapely.box(0, 0, 2, 1).union(shapely.box(1, 0.5, 3, 2))
    assert difference(expected, section) < EXACT


def test_parts_with_a_wall_in_common_are_one():
    mesh = trimesh.util.concatenate([box([0, 0, -1], [1, 1, 1]), box([1, 0, -1], [2, 1, 1])])
    assert difference(shapely.box(0, 0, 2, 1), cross_section(mesh, 0.0, "parts")) < EXACT


def test_a_mesh_in_single_precision_with_repeated_vertices_is_closed():
    mesh = moved(SHAPES[0], rotation_deg=33.3, position_m=(1.1, -2.2, 0.0)).mesh()
    loose = trimesh.Trimesh(
        mesh.triangles.reshape(-1, 3).astype(np.float32), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False
    )
    jitter = np.random.default_rng(5).uniform(-2e-7, 2e-7, loose.vertices.shape)  # one float32 step at 4 m
    loose.vertices = loose.vertices + jitter
    for height in (0.0, 1.0, -1.0):
        assert difference(cross_section(mesh, 0.0, "sharp"), cross_section(loose, height, "loose")) < 1e-5


def test_open_mesh_is_refused_only_where_it_is_open():
    mesh = box([0, 0, 0], [2, 2, 2]).subdivide()
    low = mesh.triangles_center[:, 2] < 1
    wall = np.isclose(mesh.triangles_center[:, 0], 2)
    mesh.update_faces(~(low & wall))
    with pytest.raises(DataError, match=r"thing: .*not watertight at the imaging plane z = 0.5 m.*open at x = "):
        cross_section(mesh, 0.5, "thing")
    assert difference(shapely.box(0, 0, 2, 2), cross_section(mesh, 1.5, "thing")) < EXACT


def test_a_lone_sheet_is_open():
    sheet = trimesh.Trimesh([[0, 0, -1], [1, 0, -1], [0.5, 0, 1]], [[0, 1, 2]])
    with pytest.raises(DataError, match="not watertight"):
        cross_section(sheet, 0.0, "sheet")


@pytest.mark.parametrize("height", [1.5, -4.0])
def test_a_plane_beside_the_mesh_is_refused_with_both_heights(height):
    with pytest.raises(DataError, match=rf"post: the mesh spans z = -1 to 1 m .*plane z = {height:g} m"):
        cross_section(SHAPES[2].mesh(), height, "post")
    area, gap = section_and_gap(SHAPES[2].mesh(), height)
    assert area.is_empty
    assert gap is None


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb", "off"])
def test_a_file_comes_back_scaled_turned_and_placed(tmp_path, suffix):
    star = moved(SHAPES[5], radius_m=4000.0, height_m=2000.0).mesh()
    file = write(star, tmp_path / f"star.{suffix}")
    placed = MeshFile(file=str(file), up="z", scale=1e-3, rotation_deg=25.0, position_m=(1.0, 2.0, 0.5))
    mesh = placed.mesh()
    expected = moved(SHAPES[5], rotation_deg=25.0, position_m=(1.0, 2.0, 0.5)).mesh()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(expected.volume, rel=1e-5)  # single precision in STL and GLB
    np.testing.assert_allclose(mesh.bounds, expected.bounds, atol=1e-5)  # metres, as above
    sections = [cross_section(m, 0.0, suffix) for m in (expected, mesh)]
    assert difference(*sections) < 1e-5


def test_up_axis_y_becomes_z_without_mirroring(tmp_path):
    # an L-shaped foot, 3 m high along the file's y; x stays x, what is towards the viewer (+z) goes to -y
    corners = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0))
    upright = Polygon(vertices_m=corners, height_m=3.0).mesh()
    lying = upright.copy()
    lying.vertices = np.stack([upright.vertices[:, 0], upright.vertices[:, 2], -upright.vertices[:, 1]], axis=1)
    assert lying.volume > 0  # a turn, no reflection
    file = write(lying, tmp_path / "foot.ply")
    mesh = MeshFile(file=str(file), up="y").mesh()
    np.testing.assert_allclose(mesh.bounds, upright.bounds, atol=1e-6)  # PLY holds single precision
    sections = [cross_section(m, 0.0, "foot") for m in (upright, mesh)]
    assert difference(*sections) < 1e-5


def test_a_file_in_millimetres_is_told_so(tmp_path):
    file = write(trimesh.creation.box((4220, 1800, 1500)), tmp_path / "car.stl")
    with pytest.raises(DataError, match=r"car\.stl: extent is 4220 m .*in millimetres set scale = 0\.001"):
        MeshFile(file=str(file)).mesh()
    assert MeshFile(file=str(file), scale=1e-3).mesh().extents.max() == pytest.approx(4.22)


def test_a_file_in_metres_scaled_down_is_told_so(tmp_path):
    file = write(trimesh.creation.box((4.2, 1.8, 1.5)), tmp_path / "car.ply")
    with pytest.raises(DataError, match=r"extent is 0\.0042 m at scale = 0\.001.*metres already set scale = 1"):
        MeshFile(file=str(file), scale=1e-3).mesh()


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("gone.ply", None, "no such mesh file"),
        ("empty.stl", b"", "is empty"),
        ("car.step", b"ISO-10303-21;", r"unknown mesh format 'step'; allowed: glb, obj, off, ply, stl"),
        ("car.gltf", b"{}", "unknown mesh format 'gltf'"),
        ("none", b"x", "unknown mesh format ''"),
        ("noise.ply", b"garbage", "not a readable PLY file"),
        ("noise.glb", b"garbage garbage garbage", "not a readable GLB file"),
        ("noise.off", b"garbage", "not a readable OFF file"),
        ("noise.stl", b"garbage", "no faces"),
        ("points.obj", OBJ.encode(), "no faces"),
        ("nan.obj", (OBJ.replace("0 0 1", "0 nan 1") + "f 1 2 3\nf 1 2 4\n").encode(), r"vertex 3 .*not finite"),
        ("index.obj", (OBJ + "f 1 2 9\n").encode(), "index.obj"),
        ("flat.obj", (OBJ + "f 1 1 2\n").encode(), "none of its 1 faces"),
    ],
)
def test_an_unusable_file_is_named(tmp_path, name, content, says):
    file = tmp_path / name
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(DataError, match=says) as caught:
        MeshFile(file=str(file)).mesh()
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_truncated_file_is_named(tmp_path, suffix, share):
    file = write(SHAPES[5].mesh(), tmp_path / f"star.{suffix}")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DataError, match=rf"star\.{suffix}"):
        MeshFile(file=str(file)).mesh()


def test_files_that_a_mesh_names_are_never_opened(tmp_path):
    (tmp_path / "bait.mtl").mkdir()  # opening a folder fails
    faces = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    file = tmp_path / "tetra.obj"
    file.write_text(f"mtllib bait.mtl\nmtllib /etc/hostname\nusemtl bait\n{OBJ}{faces}")
    assert MeshFile(file=str(file)).mesh().volume == pytest.approx(1 / 6)


def test_a_crossed_polygon_is_named_by_its_key():
    crossed = Polygon(vertices_m=((0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0)))
    with pytest.raises(ConfigError, match=r"objects\[1\]\.vertices_m"):
        crossed.mesh("objects[1]")
