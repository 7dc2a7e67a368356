"""The car: its parts, how a scene holds them, and the plan view that is its ground truth."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from shapely import affinity

from mvla_sim.errors import ConfigError, DataError, MvlaWarning
from mvla_sim.scene.cross_sections import cross_section, footprint, section_and_gap
from mvla_sim.scene.shapes.car import RUBBER, Car
from mvla_sim.scene.shapes.cylinder import Cylinder
from mvla_sim.scene.shapes.mesh_file import MeshFile
from mvla_sim.scene.shapes.polygon import Polygon
from mvla_sim.scene.shapes.square import Square
from mvla_sim.scene.shapes.star import Star
from mvla_sim.scene.world import Scene, SceneSettings
from mvla_sim.settings import parse

pytestmark = pytest.mark.filterwarnings("ignore:.*the sensor is at z = :mvla_sim.errors.MvlaWarning")
"""Planes are moved here while the sensor stays; test_targets.py looks at what is said of that."""

VEHICLE = Path(__file__).parents[2] / "scenes" / "vehicle.toml"
CAR = Car()
SIZES = [
    CAR,
    Car(length_m=3.0, width_m=1.4, height_m=2.4),  # the wheels are small for its height
    Car(length_m=6.0, width_m=2.4, height_m=1.2),
    Car(length_m=3.0, width_m=2.4, height_m=1.2),
]
METAL = ["body", "roof", "mirror-left", "mirror-right"]
WHEELS = ["wheel-front-left", "wheel-front-right", "wheel-rear-left", "wheel-rear-right"]
EXACT = 1e-6  # share of the area: points nearer than 1e-7 of the size are one, on a perimeter of a few sizes
ROUNDING = 1e-12  # metres, of a few operations on numbers of a few metres

sizes = pytest.mark.parametrize("car", SIZES, ids=lambda c: f"{c.length_m:g}x{c.width_m:g}x{c.height_m:g}")


def difference(one, other):
    """Area that belongs to just one of two shapes, as a share of the first's."""
    return one.symmetric_difference(other).area / one.area


def joined(parts):
    return trimesh.util.concatenate(list(parts))


def settings_of(*objects, **other):
    return {"name": "test", "objects": list(objects) or [{"shape": "car"}], "plane_height_m": 0.9, **other}


def scene(*objects, **other):
    return Scene(SceneSettings.model_validate(settings_of(*objects, **other)), source="test.toml")


@sizes
def test_it_fills_its_box_exactly_and_the_mirrors_stick_out(car):
    parts = car.own_parts()
    rest = joined(mesh for name, mesh in parts.items() if not name.startswith("mirror"))
    low = [-car.length_m / 2, -car.width_m / 2, 0.0]
    high = [car.length_m / 2, car.width_m / 2, car.height_m]
    np.testing.assert_allclose(rest.bounds, [low, high], atol=ROUNDING)
    for side, name in ((1, "mirror-left"), (-1, "mirror-right")):
        reach = side * parts[name].bounds[:, 1]
        assert reach.max() == pytest.approx(car.width_m / 2 + 0.12, abs=ROUNDING)
        assert reach.min() < car.width_m / 2  # held by the door
    assert parts["mirror-left"].centroid[2] / car.height_m == pytest.approx(1.0 / 1.6, rel=0.05)


@sizes
def test_each_part_is_closed_with_its_normals_outwards(car):
    parts = car.own_parts()
    assert list(parts) == ["body", "cabin", "roof", *WHEELS, "mirror-left", "mirror-right"]
    for mesh in parts.values():
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        assert mesh.area_faces.min() > 1e-3  # m²: no slivers, whose normals would be noise
    assert 400 <= sum(len(mesh.faces) for mesh in parts.values()) <= 600


def test_its_volume_is_that_of_a_car():
    volumes = {name: mesh.volume for name, mesh in CAR.own_parts().items()}
    box = CAR.length_m * CAR.width_m * CAR.height_m
    assert 0.5 < sum(volumes.values()) / box < 0.65  # the parts overlap by little
    assert volumes["body"] > volumes["cabin"] > 1.0 > volumes["roof"]
    polygon = 12 / 2 * math.sin(2 * math.pi / 12)  # area of the 12-gon in the unit circle
    np.testing.assert_allclose([volumes[name] for name in WHEELS], polygon * 0.335**2 * 0.21, rtol=1e-9)


@sizes
def test_left_and_right_are_alike(car):
    parts = car.own_parts()
    for name in ("body", "cabin", "roof"):
        low, high = parts[name].bounds[:, 2]
        for height in np.linspace(low, high, 7)[1:-1]:
            area, gap = section_and_gap(parts[name], float(height))
            assert gap is None
            assert difference(area, affinity.scale(area, 1, -1, origin=(0, 0))) < EXACT
    for name in ("wheel-front", "wheel-rear", "mirror"):
        left, right = parts[f"{name}-left"], parts[f"{name}-right"]
        np.testing.assert_array_equal(right.vertices, left.vertices * [1, -1, 1])


@sizes
def test_the_windows_end_inside_the_sheet_metal(car):
    """Where a window's rim is open to the air, its cap would be a roof or a floor of glass."""
    parts = car.own_parts()
    low, high = parts["cabin"].bounds[:, 2]
    for height, holder in ((low + 1e-4, "body"), (high - 1e-4, "roof")):
        rim, _ = section_and_gap(parts["cabin"], height)
        around, _ = section_and_gap(parts[holder], height)
        assert around.contains(rim)


def test_the_doors_are_upright_at_nine_tenths_of_a_metre():
    body = CAR.own_parts()["body"]
    for axis, side, reach in ((1, 1, 2.0), (1, -1, 2.0), (0, 1, 0.8), (0, -1, 0.8)):
        facing = body.triangles[side * body.face_normals[:, axis] > 1 - 1e-12].reshape(-1, 3)
        across = np.ptp(facing[:, 1 - axis])
        assert across > reach  # metres: of 4.22 m of length, of 1.76 m of width
        assert facing[:, 2].min() < 0.8
        assert facing[:, 2].max() > 0.91
    section, _ = section_and_gap(body, 0.9)
    assert section.bounds[1::2] == pytest.approx((-0.88, 0.88), abs=1e-6)


def test_it_stands_on_its_wheels_with_its_bonnet_in_front():
    parts = CAR.own_parts()
    for name in WHEELS:
        vertices = parts[name].vertices
        assert np.sum(vertices[:, 2] < ROUNDING) == 4  # a flat of the 12 sides
        assert abs(parts[name].centroid[1]) + 0.21 / 2 < CAR.width_m / 2
    assert parts["wheel-front-left"].centroid[0] > 0 > parts["wheel-rear-left"].centroid[0]
    assert parts["wheel-front-left"].centroid[1] > 0
    assert parts["body"].bounds[0, 2] == pytest.approx(0.20)
    glass = parts["cabin"].bounds
    assert CAR.length_m / 2 - glass[1, 0] > 1.0  # bonnet
    assert glass[0, 0] + CAR.length_m / 2 < 0.2  # tailgate
    assert parts["body"].bounds[1, 2] < 0.7 * CAR.height_m


def test_turning_and_moving_it_takes_every_part_along():
    placed = CAR.model_copy(update={"rotation_deg": 90.0, "position_m": (5.0, -2.0, 0.3)}).parts()
    for name, mesh in CAR.own_parts().items():
        x, y, z = mesh.vertices.T
        np.testing.assert_allclose(placed[name].vertices, np.column_stack([5 - y, -2 + x, 0.3 + z]), atol=ROUNDING)
    np.testing.assert_allclose(CAR.mesh().bounds, [[-2.11, -1.0, 0.0], [2.11, 1.0, 1.6]], atol=ROUNDING)


def test_a_prism_is_one_part_without_a_name():
    assert list(Square().parts()) == [""]


def test_a_scene_gives_each_part_its_material():
    world = scene(
        {"shape": "square", "side_m": 1.0, "position_m": (5, 0, 0)},
        {"shape": "car", "thickness_m": 0.02, "glass_thickness_m": 0.004, "scattering_coefficient": 0.3},
    )
    parts = {item.name.removeprefix("car-1-"): item for item in world.objects[1:]}
    assert world.objects[0].name == "square-0"
    assert list(parts) == list(CAR.own_parts())
    assert [item.index for item in world.objects] == [0] + [1] * 9
    for name, item in parts.items():
        thickness = 0.004 if name == "cabin" else 0.02
        material = "metal" if name in METAL else "glass" if name == "cabin" else RUBBER
        assert (item.settings.material, item.settings.thickness_m) == (material, thickness)
        assert item.settings.scattering_coefficient == 0.3


def test_its_materials_can_be_set():
    own = {"relative_permittivity": 2.5}
    world = scene({"shape": "car", "name": "van", "material": "wood", "glass": own, "tyres": "concrete"})
    found = {item.name: item.settings.material for item in world.objects}
    assert found["van-body"] == found["van-roof"] == found["van-mirror-left"] == "wood"
    assert found["van-cabin"].relative_permittivity == 2.5
    assert found["van-wheel-rear-right"] == "concrete"


def test_fingerprint_sees_size_materials_and_the_mesh_itself(monkeypatch):
    worlds = [
        scene(),
        scene({"shape": "car", "length_m": 4.3}),
        scene({"shape": "car", "glass_thickness_m": 0.004}),
        scene({"shape": "car", "tyres": "wood"}),
        scene(outline="footprint"),
    ]
    found = {world.fingerprint() for world in worlds}
    assert len(found) == len(worlds)
    assert scene({"shape": "car", "name": "other"}).fingerprint() in found

    own_parts = Car.own_parts

    def other_parts(car, key):
        parts = own_parts(car, key)
        parts["roof"].vertices[0, 2] += 1e-3
        return parts

    monkeypatch.setattr(Car, "own_parts", other_parts)
    assert scene().fingerprint() not in found


def test_names_of_parts_are_unique_too():
    post = {"shape": "circle", "radius_m": 0.1, "position_m": (4, 0, 0.5), "name": "car-body"}
    with pytest.raises(
        ConfigError, match=r"objects\[1\]\.name = 'car-body': 'car-body' is also a name in objects\[0\]"
    ):
        scene({"shape": "car", "name": "car"}, post)
    with pytest.raises(ConfigError, match=r"objects\[1\]\.name = 'car': 'car-body' is also a name in objects\[0\]"):
        scene(post, {"shape": "car", "name": "car"})
    with pytest.raises(ConfigError, match=r"objects\[1\]\.name = 'car' is also the name of objects\[0\]"):
        scene({"shape": "car", "name": "car"}, {"shape": "car", "name": "car"})


def test_its_section_is_that_of_the_parts_the_plane_cuts():
    body = cross_section(CAR.own_parts()["body"], 0.9, "body")
    doors = scene()
    assert difference(body, doors.outline) < EXACT
    windows = scene(plane_height_m=1.3)
    assert windows.outline.bounds[2] < 1.0
    assert windows.extent_m < doors.extent_m < math.hypot(CAR.length_m, CAR.width_m)
    wheels = scene(plane_height_m=0.1)
    assert len(wheels.outline.geoms) == 4
    assert wheels.extent_m > 2.58  # the whole car's, not a wheel's


def test_a_plane_that_misses_it_is_refused_with_its_height():
    with pytest.raises(
        ConfigError, match=r"test\.toml: plane_height_m = 2 cuts none of the objects \(car-0 \(0 to 1\.6 m\)"
    ):
        scene(plane_height_m=2.0)


def test_a_sensor_inside_it_is_refused():
    with pytest.raises(ConfigError, match=r"view 1 at \(0, 0, 1.2\) m is inside 'car-0-cabin'"):
        scene(trajectory={"kind": "positions", "positions_m": [[9.0, 0, 1.2], [0, 0, 1.2]]})


@pytest.mark.parametrize(
    ("key", "value"),
    [("length_m", 12.0), ("width_m", 1.0), ("height_m", 0.5), ("glass_thickness_m", 0.0), ("tyres", "rubber")],
)
def test_a_setting_out_of_bounds_is_named(key, value):
    with pytest.raises(ConfigError, match=rf"scene: objects\[0\]\.{key} = '?{value}"):
        parse(SceneSettings, settings_of({"shape": "car", key: value}), "scene")


def test_its_footprint_is_its_plan_view():
    world = Scene.load(VEHICLE)
    assert world.outline.geom_type == "Polygon"
    assert not world.outline.interiors
    np.testing.assert_allclose(world.outline.bounds, [-2.11, -1.0, 2.11, 1.0], atol=1e-6)
    plan = world.outline.area
    assert 0.9 < plan / (CAR.length_m * CAR.width_m) < 1.0  # the corners are round
    mirrors = world.outline.difference(shapely.box(-3, -0.88, 3, 0.88))
    assert len(mirrors.geoms) == 2
    assert mirrors.area == pytest.approx(2 * 0.12 * 0.102, rel=1e-4)  # m²: 0.094 m wide at the door, 0.11 m outside
    for item in world.objects:
        assert world.outline.buffer(1e-5).contains(shapely.MultiPoint(item.mesh.vertices[:, :2]))
    assert CAR.length_m < world.extent_m < math.hypot(CAR.length_m, CAR.width_m)
    assert world.views.center_m == pytest.approx((0, 0), abs=1e-6)


def test_a_footprint_turns_and_moves_with_the_car():
    there = scene({"shape": "car", "rotation_deg": 33.0, "position_m": (1.0, 2.0, -0.5)}, outline="footprint")
    expected = affinity.translate(affinity.rotate(Scene.load(VEHICLE).outline, 33.0, origin=(0, 0)), 1.0, 2.0)
    assert difference(expected, there.outline) < EXACT
    assert there.extent_m == pytest.approx(Scene.load(VEHICLE).extent_m, rel=EXACT)


def test_a_footprint_needs_no_plane_and_holds_what_is_above_it():
    star, roof = {"shape": "star"}, {"shape": "square", "side_m": 4.0, "position_m": (5, 0, 3)}
    with pytest.warns(MvlaWarning, match=r"the imaging plane z = 20 m cuts none of the objects"):
        world = scene(star, roof, plane_height_m=20.0, outline="footprint")
    expected = Star().outline().union(shapely.box(3, -2, 7, 2))
    assert difference(expected, world.outline) < EXACT
    assert world.extent_m == pytest.approx(8 * math.sin(0.4 * math.pi), rel=EXACT)
    assert scene({"shape": "circle"}, outline="footprint").extent_m == 8.0  # nominal, as for a section


@pytest.mark.parametrize("turn", [0.0, 33.3])
@pytest.mark.parametrize(
    "shape",
    [
        Cylinder(facets=36),
        Square(),
        Star(),
        Polygon(vertices_m=((0.0, 0.0), (5.0, 0.0), (5.0, 1.0), (1.0, 1.0), (1.0, 4.0), (0.0, 4.0))),
    ],
    ids=lambda s: s.shape,
)
def test_the_footprint_of_a_prism_is_its_section(shape, turn):
    mesh = shape.model_copy(update={"rotation_deg": turn}).mesh()
    plan = footprint(mesh)
    assert difference(cross_section(mesh, 0.0, "prism"), plan) < EXACT
    assert len(plan.exterior.coords) == len(shape.outline().exterior.coords)


def test_the_footprint_of_a_slanted_box_covers_both_ends():
    mesh = trimesh.creation.box(bounds=[[0, 0, 0], [2, 1, 3]])
    mesh.vertices[:, 0] += mesh.vertices[:, 2]
    mesh.vertices[:, 1] += mesh.vertices[:, 2]
    expected = shapely.MultiPoint([(0, 0), (2, 0), (0, 1), (2, 1), (3, 3), (5, 3), (3, 4), (5, 4)]).convex_hull
    assert difference(expected, footprint(mesh)) < EXACT
    assert difference(shapely.box(1, 1, 3, 2), cross_section(mesh, 1.0, "slanted")) < EXACT


def test_the_footprint_of_a_ball_is_its_silhouette():
    plan = footprint(trimesh.creation.icosphere(subdivisions=4, radius=2.0))
    # triangles of sides s of at most 2 m / 2^4·1.1 are inside the ball by s²/(6r) ≈ 1.6e-3 m at most, 0.8e-3 of r
    assert plan.area == pytest.approx(4 * math.pi, rel=1.6e-3)
    assert plan.area < 4 * math.pi
    assert not plan.interiors


def test_holes_of_a_footprint_are_those_that_are_seen_through():
    tube = trimesh.creation.annulus(r_min=1.0, r_max=2.0, height=1.0, sections=64)
    assert len(footprint(tube).interiors) == 1
    lid = trimesh.creation.box(bounds=[[-1.5, -1.5, 3.0], [1.5, 1.5, 3.1]])
    assert not footprint(joined([tube, lid])).interiors
    crack = 1e-8  # metres: below single precision at 4 m
    halves = [
        trimesh.creation.box(bounds=[[-2, -1, 0], [0, 1, 1]]),
        trimesh.creation.box(bounds=[[crack, -1, 0], [2, 1, 1]]),
    ]
    assert difference(shapely.box(-2, -1, 2, 1), footprint(joined(halves))) < EXACT
    assert footprint(joined(halves)).geom_type == "Polygon"


def test_what_is_only_upright_has_no_footprint(tmp_path):
    sheet = trimesh.Trimesh([[0, 0, -1], [1, 0.3, -1], [0.5, 0.15, 1]], [[0, 1, 2]])
    assert footprint(sheet).is_empty
    sheet.export(tmp_path / "sheet.ply")
    upright = MeshFile(file=str(tmp_path / "sheet.ply")).model_dump()
    with pytest.raises(DataError, match=r"test\.toml: outline = 'footprint': no object has a face"):
        scene(upright, outline="footprint")
    assert difference(Star().outline(), scene(upright, {"shape": "star"}, outline="footprint").outline) < EXACT
