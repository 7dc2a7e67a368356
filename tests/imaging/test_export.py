"""Exported images say in other programs' formats what the image says."""

from __future__ import annotations

import dataclasses
import itertools
import time

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from matplotlib import colormaps

from mvla_sim.errors import ConfigError, DataError, OutputError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.volumes import EXPORT_SUFFIXES, SCORE_MAP, export_image, exposed_faces

GRID = VoxelGrid((1.0, -2.0, 0.5), (5, 4, 3), 0.125)  # every corner is a binary fraction, exact in single precision


def make_image(grid=GRID, occupied=None, support=True, **changes):
    rng = np.random.default_rng(0)
    score = rng.random(grid.shape).astype(np.float32)
    angle = rng.uniform(0, 360, grid.shape).astype(np.float32)
    image = Image(score, angle if support else None, grid, "mvla-gr", 36, occupied=occupied)
    return dataclasses.replace(image, **changes)


def block(grid=GRID, z=slice(0, 3), y=slice(1, 3), x=slice(1, 5)):
    mask = np.zeros(grid.shape, bool)
    mask[z, y, x] = True
    return mask


@st.composite
def masks(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    grid = VoxelGrid((0.5, -1.0, 2.0), tuple(int(n) for n in rng.integers(1, 7, 3)), 0.1)
    return rng.random(grid.shape) < rng.choice([0.1, 0.5, 0.9]), grid


# --- the surface ---


def six_neighbours(mask):
    """Each exposed face as (z, y, x, axis, way), one voxel after the other."""
    for place in zip(*np.nonzero(mask), strict=True):
        for axis, way in itertools.product(range(3), (-1, 1)):
            other = list(place)
            other[axis] += way
            inside = 0 <= other[axis] < mask.shape[axis]
            if not (inside and mask[tuple(other)]):
                yield (*(int(n) for n in place), axis, way)


@given(case=masks())
def test_a_face_for_each_side_that_meets_no_occupied_voxel(case):
    mask, grid = case
    surface = exposed_faces(mask, grid)
    expected = sorted(six_neighbours(mask))
    assert len(surface.squares) == len(expected)
    z, y, x = np.unravel_index(surface.voxels, grid.shape)
    axis = 2 - np.abs(surface.normals).argmax(axis=1)
    found = zip(z, y, x, axis, surface.normals.sum(axis=1), strict=True)
    assert sorted(tuple(int(n) for n in face) for face in found) == expected
    # half a voxel from the voxel's centre along the normal, a voxel wide
    corners = surface.vertices_m[surface.squares]
    middle = grid.centers(surface.voxels) + surface.normals * grid.spacing_m / 2
    np.testing.assert_allclose(corners.mean(axis=1), middle, atol=1e-12)  # metres, of rounding
    sides = np.linalg.norm(np.diff(corners, axis=1, append=corners[:, :1]), axis=2)
    np.testing.assert_allclose(sides, grid.spacing_m, atol=1e-12)


@given(case=masks())
def test_the_surface_is_closed_faces_outwards_and_lists_each_corner_once(case):
    mask, grid = case
    surface = exposed_faces(mask, grid)
    assert len(np.unique(np.round(surface.vertices_m / grid.spacing_m, 6), axis=0)) == len(surface.vertices_m)
    assert np.array_equal(np.unique(surface.triangles), np.arange(len(surface.vertices_m)))
    edges = np.concatenate([surface.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    forth, back = (np.sort(edges @ [1 << 20, 1]), np.sort(edges[:, ::-1] @ [1 << 20, 1]))
    np.testing.assert_array_equal(forth, back)  # each edge is passed as often one way as the other
    a, b, c = surface.vertices_m[surface.triangles].transpose(1, 0, 2)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6  # divergence theorem; negative if turned inside out
    assert volume == pytest.approx(mask.sum() * grid.spacing_m**3, abs=1e-9)
    normals = np.cross(b - a, c - a) / grid.spacing_m**2
    np.testing.assert_allclose(normals, np.repeat(surface.normals, 2, axis=0), atol=1e-12)


def test_masks_of_another_shape_are_refused():
    with pytest.raises(DataError, match=r"occupied has shape \(2, 2\), the grid \(3, 4, 5\)"):
        exposed_faces(np.ones((2, 2), bool), GRID)


# --- PLY ---


def test_a_solid_block_comes_back_as_it_is(tmp_path):
    mask = block()
    file = export_image(make_image(occupied=mask), tmp_path / "block.ply")
    assert file == tmp_path / "block.ply"
    mesh = trimesh.load(file, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    lower = GRID.bounds_m()[0]
    corners = lower + 0.125 * np.array([[1, 1, 0], [5, 3, 3]])
    np.testing.assert_array_equal(mesh.bounds, corners)
    assert mesh.volume == pytest.approx(mask.sum() * 0.125**3, rel=1e-12)
    assert len(mesh.faces) == 2 * 2 * (4 * 2 + 4 * 3 + 2 * 3)
    assert len(mesh.vertices) == 5 * 3 * 4 - 3 * 1 * 2  # lattice points of the block, without those inside it


def test_two_blocks_are_two_bodies_and_volumes_add_up(tmp_path):
    mask = block(x=slice(0, 2), z=slice(0, 1)) | block(x=slice(3, 5), z=slice(1, 3))
    mesh = trimesh.load(export_image(make_image(occupied=mask), tmp_path / "two.PLY"), process=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 2 + 2
    assert mesh.volume == pytest.approx(mask.sum() * 0.125**3, rel=1e-12)


def test_a_cavity_is_not_filled(tmp_path):
    grid = VoxelGrid((0.0, 0.0, 0.0), (3, 3, 3), 0.25)
    mask = np.ones(grid.shape, bool)
    mask[1, 1, 1] = False
    mesh = trimesh.load(export_image(make_image(grid, mask), tmp_path / "hollow.ply"), process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(26 * 0.25**3, rel=1e-12)


def test_faces_are_coloured_by_their_voxels_score(tmp_path):
    mask = block()
    image = make_image(occupied=mask)
    surface = exposed_faces(mask, GRID)
    mesh = trimesh.load(export_image(image, tmp_path / "a.ply"), process=False)
    expected = colormaps[SCORE_MAP](image.score.ravel()[surface.voxels] / image.score.max(), bytes=True)
    np.testing.assert_array_equal(mesh.visual.face_colors, np.repeat(expected, 2, axis=0))
    flat = make_image(occupied=mask, score=np.zeros(GRID.shape, np.float32))
    dark = trimesh.load(export_image(flat, tmp_path / "dark.ply"), process=False)
    assert (dark.visual.face_colors == colormaps[SCORE_MAP](0.0, bytes=True)).all()


def test_a_surface_needs_voxels(tmp_path):
    with pytest.raises(DataError, match=r"a\.ply: a surface needs a binary image.*give thresholds"):
        export_image(make_image(), tmp_path / "a.ply")
    with pytest.raises(DataError, match=r"a\.ply: no voxel is occupied"):
        export_image(make_image(occupied=np.zeros(GRID.shape, bool)), tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())


def test_a_large_volume_takes_no_loop():
    grid = VoxelGrid((0.0, 0.0, 1.0), (120, 80, 60), 0.05)  # 576,000 voxels
    mask = np.random.default_rng(1).random(grid.shape) < 0.05
    start = time.process_time()
    surface = exposed_faces(mask, grid)
    assert time.process_time() - start < 2  # 0.1 s on an idle core; a loop over its 29,000 voxels takes longer
    assert len(surface.squares) > 100_000


# --- VTK ---

VTK_TYPES = {"float": ">f4", "unsigned_char": ">u1"}


def read_vtk(file):
    """Read legacy VTK structured points with cell arrays, as "VTK File Formats" (Kitware) lays them down."""
    data = file.read_bytes()
    at = 0

    def line():
        nonlocal at
        end = data.index(b"\n", at)
        text, at = data[at:end].decode("ascii"), end + 1
        return text

    assert line() == "# vtk DataFile Version 3.0"
    title = line()
    assert len(title) < 256
    assert line() == "BINARY"
    assert line().split() == ["DATASET", "STRUCTURED_POINTS"]
    head = {}
    for kind, number in (("DIMENSIONS", int), ("ORIGIN", float), ("SPACING", float)):
        word, *values = line().split()
        assert word == kind
        head[kind] = tuple(number(value) for value in values)
    word, count = line().split()
    assert word == "CELL_DATA"
    assert int(count) == np.prod([n - 1 for n in head["DIMENSIONS"]])
    arrays = {}
    while at < len(data):
        word, name, kind, components = line().split()
        assert (word, components) == ("SCALARS", "1")
        assert line() == "LOOKUP_TABLE default"
        arrays[name] = np.frombuffer(data, VTK_TYPES[kind], int(count), at)
        at += arrays[name].nbytes
        assert line() == ""
    return title, head, arrays


@pytest.mark.parametrize("support", [True, False])
@pytest.mark.parametrize("binary", [True, False])
def test_vtk_holds_every_array_there_is_cell_by_cell(tmp_path, support, binary):
    image = make_image(occupied=block() if binary else None, support=support)
    title, head, arrays = read_vtk(export_image(image, tmp_path / "a.vtk"))
    assert title == "mvla-sim image, mvla-gr, 36 views"
    assert head == {"DIMENSIONS": (6, 5, 4), "ORIGIN": tuple(GRID.bounds_m()[0]), "SPACING": (0.125,) * 3}
    assert list(arrays) == ["score", *["support"] * support, *["occupied"] * binary]
    for name, values in (("score", image.score), ("support", image.support_deg), ("occupied", image.occupied)):
        if values is not None:
            np.testing.assert_array_equal(arrays[name], values.ravel())
    # cells count x first: the centre of cell n is that of voxel n
    nx, ny, _ = GRID.counts
    n = np.arange(GRID.size)
    cell = np.stack([n % nx, n // nx % ny, n // (nx * ny)], axis=-1)
    centers = np.array(head["ORIGIN"]) + np.array(head["SPACING"]) * (cell + 0.5)
    np.testing.assert_allclose(centers, GRID.centers(), atol=1e-12)  # metres, of rounding


def test_numbers_in_the_header_keep_every_digit(tmp_path):
    grid = VoxelGrid((0.1, -0.7, 1e-9), (3, 2, 1), 0.005)
    _, head, _ = read_vtk(export_image(make_image(grid), tmp_path / "a.vtk"))
    assert head["ORIGIN"] == tuple(grid.bounds_m()[0])
    assert head["SPACING"] == (0.005,) * 3


def test_a_strange_method_does_not_break_the_header(tmp_path):
    image = make_image(method="own\nBINARY Θ " + "x" * 300)
    title, head, _ = read_vtk(export_image(image, tmp_path / "a.vtk"))
    assert title.startswith("mvla-sim image, own BINARY ? xxx")
    assert head["DIMENSIONS"] == (6, 5, 4)


# --- files ---


@pytest.mark.parametrize("suffix", EXPORT_SUFFIXES)
def test_writing_again_gives_the_same_bytes_and_leaves_nothing_else(tmp_path, suffix):
    file = tmp_path / f"a{suffix}"
    file.write_text("older")
    image = make_image(occupied=block())
    before = export_image(image, str(file)).read_bytes()
    assert export_image(image, file).read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(("name", "given"), [("a.stl", r"suffix '\.stl'"), ("a", "no suffix"), ("a.vti", r"\.vti")])
def test_other_formats_are_refused(tmp_path, name, given):
    with pytest.raises(ConfigError, match=rf"{name}: an exported image with .*{given}.*; allowed: \.ply, \.vtk"):
        export_image(make_image(occupied=block()), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(OutputError, match="gone"):
        export_image(make_image(), tmp_path / "gone" / "a.vtk")
