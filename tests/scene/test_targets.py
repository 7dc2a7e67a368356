"""What of a scene is its target: objects that the plane misses, feet for outlines, and heights that do not fit."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import shapely
import trimesh
from mesh_texts import as_obj, extruded

import mvla_sim as mv
from mvla_sim.errors import ConfigError, DataError, MvlaWarning
from mvla_sim.scene.shapes.mesh_file import MeshFile

POLYGON = mv.Polygon(vertices_m=((-2, -2), (-1, -2), (-1.5, -1)))
"""The second object of the example in the README."""
OBSTACLE = {"shape": "square", "side_m": 9.0, "height_m": 0.1, "position_m": (0, 0, 3.0)}


def at(height, **more):
    return {"trajectory": mv.Circle(radius_m=10, interval_deg=10, height_m=height), "plane_height_m": height, **more}


@pytest.fixture
def car_file(tmp_path):
    """A car that stands on z = 0, as one mesh of 4.22 × 1.76 × 1.60 m."""
    trimesh.util.concatenate(list(mv.Car().own_parts().values())).export(tmp_path / "car.ply")
    return str(tmp_path / "car.ply")


def test_an_object_that_the_plane_misses_does_not_vanish_from_the_truth():
    """It would be traced, and be no part of what the image is compared with."""
    star = mv.Star()
    with pytest.raises(ConfigError, match=(
        r"scene: plane_height_m = 0 does not cut square-1 \(2\.95 to 3\.05 m\), which would be traced and be no part "
        r"of the ground truth; move it with position_m, set outline = 'footprint', or objects\[1\]\.obstacle = true"
    )):  # fmt: skip
        mv.Scene(objects=[star, OBSTACLE])
    raised = mv.Square(side_m=2.0, position_m=(4, 4, 1.2))
    with pytest.raises(ConfigError, match=r"square-1 \(0\.2 to 2\.2 m\), .*set plane_height_m = 0\.6, which cuts all"):
        mv.Scene(objects=[star, raised])
    assert mv.Scene(objects=[star, raised], **at(0.6)).outline.area == pytest.approx(
        star.outline().union(shapely.box(3, 3, 5, 5)).area, rel=1e-6
    )


@pytest.mark.parametrize("outline", ["section", "footprint"])
def test_an_obstacle_is_traced_and_no_target(outline):
    alone = mv.Scene(objects=[mv.Star()], outline=outline)
    world = mv.Scene(objects=[mv.Star(), {**OBSTACLE, "obstacle": True}], outline=outline)
    assert [item.name for item in world.objects] == ["star-0", "square-1"]
    assert world.outline.equals(alone.outline)
    assert world.extent_m == alone.extent_m
    assert world.fingerprint() != alone.fingerprint()
    with pytest.raises(ConfigError, match="each is an obstacle; at least one must be the target"):
        mv.Scene(objects=[{**OBSTACLE, "obstacle": True}], outline=outline)


@pytest.mark.parametrize("plane", [{}, {"plane_height_m": 0.0}])
def test_a_car_on_the_default_plane_is_not_four_tyre_patches(plane, car_file):
    for shape in (mv.Car(), MeshFile(file=car_file)):
        with pytest.raises(ConfigError, match=(
            r"plane_height_m = 0.* cuts 0\.1\d+ m² of (car|mesh)-0 \(0 to 1\.6 m\), whose section at 0\.\d m has "
            r"[67]\.\d\d m²; set plane_height_m = 0\.\d and the sensor at that height, or outline = 'footprint'"
        )):  # fmt: skip
            mv.Scene(objects=[shape], **plane)
    asked = mv.Scene(objects=[mv.Car()], **at(0.1))  # wheels, on purpose
    assert len(asked.outline.geoms) == 4


def test_the_readme_example_is_refused_with_a_plane_that_works(car_file):
    car = MeshFile(file=car_file, position_m=(1.0, 0.0, 0.0), rotation_deg=30.0)
    with pytest.raises(ConfigError, match=r"plane_height_m = 0 \(the default\) cuts .*mesh-0"):
        mv.Scene(objects=[car, POLYGON])
    world = mv.Scene(objects=[car, POLYGON], **at(0.9))
    assert world.outline.area == pytest.approx(mv.Scene(objects=[car], **at(0.9)).outline.area + 0.5, rel=1e-6)


def test_what_stands_on_the_plane_with_its_whole_section_is_a_target(tmp_path):
    trimesh.creation.box(bounds=[[-2, -1, 0], [2, 1, 1]]).export(tmp_path / "box.ply")
    assert mv.Scene(objects=[MeshFile(file=str(tmp_path / "box.ply"))]).outline.area == pytest.approx(8, rel=1e-6)
    bounds = ([[-2, -1, 0.4], [2, 1, 0.8]], [[-2, -1, -1], [-1.8, 1, 0.75]])
    table = trimesh.util.concatenate([trimesh.creation.box(bounds=box) for box in bounds])
    table.export(tmp_path / "table.ply")
    with pytest.raises(ConfigError, match=r"plane_height_m = 0 \(the default\) cuts 0\.4 m² of mesh-0"):
        mv.Scene(objects=[MeshFile(file=str(tmp_path / "table.ply"))])
    legs = mv.Scene(objects=[MeshFile(file=str(tmp_path / "table.ply"))], plane_height_m=0.0)
    assert legs.outline.area == pytest.approx(0.4, rel=1e-6)


def test_a_plane_that_cuts_nothing_of_a_footprint_is_said():
    with pytest.warns(
        MvlaWarning, match=r"the imaging plane z = 0 m cuts none of the objects \(car-0 \(0 to 1\.6 m\)\)"
    ):
        mv.Scene(objects=[mv.Car()], outline="footprint")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mv.Scene(objects=[mv.Car(), mv.Square(side_m=1, position_m=(4, 4, 9))], outline="footprint", **at(0.9))


def test_a_sensor_at_another_height_than_the_plane_is_said():
    with pytest.warns(
        MvlaWarning, match=r"scene: the sensor is at z = 0 m and the imaging plane at 0\.9 m: .*set the traj"
    ):
        mv.Scene(objects=[mv.Star()], plane_height_m=0.9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mv.Scene(objects=[mv.Star()], **at(0.9))
        several = mv.Circle(radius_m=10, interval_deg=10, heights_m=(0.85, 4.0))
        mv.Scene(objects=[mv.Star()], plane_height_m=0.9, trajectory=several)


@pytest.mark.parametrize("shape", [mv.Star(), mv.Square(), mv.Cylinder(), mv.Triangle(), mv.Car()], ids=repr)
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (1.0, 2.0, 0.4)])
def test_every_object_is_where_its_position_says_whatever_the_plane(shape, place):
    """One rule: ``position_m`` is where a shape's own origin is; of a prism its middle, of a car the ground's."""
    moved = shape.model_copy(update={"position_m": place})
    low, high = mv.Scene(objects=[moved], **at(0.9)).bounds
    assert (low[2], high[2]) == pytest.approx((place[2] + (0 if shape.shape == "car" else -1), place[2] + shape.height_m
                                               - (0 if shape.shape == "car" else 1)))  # fmt: skip


def test_a_mesh_in_map_coordinates_is_told_how_to_move(tmp_path):
    ring = np.array([[-2, -0.8], [2, -0.8], [2, 0.8], [-2, 0.8]])
    vertices, faces = extruded(ring, -0.7, 0.7)
    (tmp_path / "box.obj").write_bytes(as_obj(vertices + np.array([450010.0, 5400020.0, 312.0]), faces))
    mesh = MeshFile(file=str(tmp_path / "box.obj"))
    with pytest.raises(DataError, match=(
        r"box\.obj\): its middle is at \(450010, 5400020, 312\) m, beyond 10 km from the origin: coordinates of a map\?"
        r" objects\[0\]\.position_m = \[-450010, -5400020, -312\] moves its middle to the origin"
    )):  # fmt: skip
        mv.Scene(objects=[mesh])
    moved = mv.Scene(objects=[mesh.model_copy(update={"position_m": (-450010.0, -5400020.0, -312.0)})])
    assert moved.outline.bounds == pytest.approx((-2, -0.8, 2, 0.8), abs=1e-6)
    with pytest.raises(
        DataError, match=r"square-0: its middle is at \(3000, 0, 0\) m, 2\.98\d km from the nearest sens"
    ):
        mv.Scene(objects=[mv.Square(side_m=2, position_m=(3000, 0, 0))])


def test_a_mesh_in_inches_is_told_so(tmp_path):
    trimesh.creation.box((166.0, 70.0, 60.0)).export(tmp_path / "car.stl")
    with pytest.raises(ConfigError, match=(
        r"view 0 at \(10, 0, 0\) m is inside 'mesh-0' .*; it is 166 m long: if the file is in inches set scale "
        r"= 0\.0254 \(4\.22 m\), in centimetres set scale = 0\.01 \(1\.66 m\)"
    )):  # fmt: skip
        mv.Scene(objects=[MeshFile(file=str(tmp_path / "car.stl"))])
    standing = MeshFile(file=str(tmp_path / "car.stl"), position_m=(0, 0, 31))
    with pytest.raises(DataError, match=r"does not cut the imaging plane z = 0 m; .*in inches set scale = 0\.0254"):
        mv.Scene(objects=[standing])
    trimesh.creation.box((400.0, 70.0, 60.0)).export(tmp_path / "bus.stl")
    with pytest.raises(DataError, match=r"extent is 400 m at scale = 1; .*in inches set scale = 0\.0254 \(10\.2 m\)"):
        MeshFile(file=str(tmp_path / "bus.stl")).mesh()


def test_an_open_mesh_is_told_of_the_footprint(tmp_path):
    box = trimesh.creation.box((2, 2, 2))
    box.update_faces(np.arange(len(box.faces)) > 1)
    box.export(tmp_path / "open.ply")
    mesh = MeshFile(file=str(tmp_path / "open.ply"))
    with pytest.raises(
        DataError, match=r"not watertight at the imaging plane .*or outline = 'footprint', which needs no"
    ):
        mv.Scene(objects=[mesh])
    assert mv.Scene(objects=[mesh], outline="footprint").outline.area == pytest.approx(4, rel=1e-6)
