"""Whole scenes: consistency, extents, refusals and fingerprints."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import mvla_sim as mv
from mvla_sim.channel.simulate import cache_file
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.antennas import horn
from mvla_sim.scene.shapes.cylinder import Cylinder
from mvla_sim.scene.shapes.polygon import Polygon
from mvla_sim.scene.shapes.star import Star
from mvla_sim.scene.world import Scene, SceneSettings
from mvla_sim.sweep.axes import dotted_key

pytestmark = pytest.mark.filterwarnings("ignore:.*the sensor is at z = :mvla_sim.errors.MvlaWarning")
"""Planes are moved here while the sensor stays; test_targets.py looks at what is said of that."""

SCENES = sorted((Path(__file__).parents[2] / "scenes").glob("*.toml"))
SECTION = 1e-6  # share of the area: what a cross-section may lose by joining points within 1e-7 of the size


def scene(*objects, **other):
    data = {"name": "test", "objects": list(objects) or [{"shape": "star"}], **other}
    return Scene(SceneSettings.model_validate(data), source="test.toml")


def load(name, *overrides):
    return Scene.load(next(p for p in SCENES if p.stem == name), overrides)


def test_there_are_scenes():
    assert {"circle", "square", "triangle", "star", "two-objects"} <= {p.stem for p in SCENES}


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_each_scene_file_is_consistent(path):
    world = Scene.load(path)
    assert world.name == path.stem
    x_low, y_low, x_high, y_high = world.outline.bounds
    low, high = world.bounds
    assert (low[:2] <= np.array([x_low, y_low]) + 1e-5).all()  # metres, of the section
    assert (high[:2] >= np.array([x_high, y_high]) - 1e-5).all()
    assert low[2] < world.settings.plane_height_m < high[2]
    trajectory = world.settings.trajectory
    if trajectory.kind in ("circle", "turntable"):
        turns = len(getattr(trajectory, "heights_m", None) or [0])
        assert len(world.views) == turns * round(360 / trajectory.interval_deg)
        assert world.views.closed
    distance = shapely.distance(world.outline, shapely.points(world.views.positions_m[:, :2]))
    assert distance.min() > 1  # the sensor is well outside
    corners = shapely.get_coordinates(world.outline)
    assert np.hypot(*corners.T).max() < 6  # m: within the corner of the 8 m square, 5.66 m


@pytest.mark.parametrize(
    ("name", "area", "extent"),
    [
        ("circle", 180 * 16 * math.sin(math.radians(1)), 8.0),
        ("square", 64.0, 8.0),
        ("triangle", 36 / math.sqrt(3), 4 * math.sqrt(3)),
        # the star's widest pair are two tips with one between them
        (
            "star",
            5 * 16 * math.sin(math.pi / 10) / math.sin(0.3 * math.pi) * math.sin(math.pi / 5),
            8 * math.sin(0.4 * math.pi),
        ),
        ("two-objects", 4 + 180 * 0.64 * math.sin(math.radians(1)), 2.0),
    ],
)
def test_areas_and_extents(name, area, extent):
    world = load(name)
    assert world.outline.area == pytest.approx(area, rel=SECTION)
    assert world.extent_m == pytest.approx(extent, rel=SECTION)


def test_two_objects_are_near_the_centre_and_of_other_materials():
    world = load("two-objects")
    corners = shapely.get_coordinates(world.outline)
    assert np.hypot(*corners.T).max() < 4
    assert len({o.settings.material for o in world.objects} | {"metal"}) == 3


@given(st.floats(0, 360), st.tuples(st.floats(-2, 2), st.floats(-2, 2)))
@settings(deadline=None, max_examples=20)
def test_extent_and_area_do_not_depend_on_the_place(turn, place):
    there = scene({"shape": "star", "rotation_deg": turn, "position_m": (*place, 0.0)})
    assert there.extent_m == pytest.approx(scene().extent_m, rel=SECTION)
    assert there.outline.area == pytest.approx(scene().outline.area, rel=SECTION)


def test_extent_of_a_free_shape_is_its_widest_pair_of_points():
    corners = [(0.0, 0.0), (3.0, 0.0), (3.0, 4.0), (2.0, 1.0)]
    widest = max(math.dist(a, b) for a, b in itertools.combinations(corners, 2))
    world = scene({"shape": "polygon", "vertices_m": corners})
    assert world.extent_m == pytest.approx(widest, rel=SECTION)
    far = scene(
        {"shape": "polygon", "vertices_m": corners}, {"shape": "square", "side_m": 1.0, "position_m": (-6, 0, 0)}
    )
    assert far.extent_m == world.extent_m  # the largest object's, not across objects


def test_overlapping_objects_have_one_outline():
    world = scene(
        {"shape": "rectangle", "length_m": 2.0, "width_m": 2.0},
        {"shape": "rectangle", "length_m": 2.0, "width_m": 2.0, "position_m": (1.0, 0, 0)},
    )
    assert world.outline.geom_type == "Polygon"
    assert world.outline.area == pytest.approx(6.0, rel=SECTION)


def test_object_beside_the_plane_may_be_an_obstacle():
    roof = {"shape": "rectangle", "length_m": 9.0, "width_m": 9.0, "height_m": 0.1, "position_m": (0, 0, 3.0)}
    roof["obstacle"] = True
    world = scene({"shape": "star"}, roof)
    assert world.outline.area == pytest.approx(scene().outline.area, rel=SECTION)
    assert world.extent_m == scene().extent_m
    assert world.bounds[1, 2] == pytest.approx(3.05)


def test_plane_that_cuts_nothing_is_refused_with_the_heights():
    with pytest.raises(DataError, match=r"test\.toml: star-0: the mesh spans z = -1 to 1 m .* z = 1\.5 m"):
        scene(plane_height_m=1.5)
    with pytest.raises(ConfigError, match=r"plane_height_m = 1\.5 .*star-0 \(-1 to 1 m\), square-1 \(2 to 4 m\)"):
        scene({"shape": "star"}, {"shape": "square", "position_m": (0, 0, 3.0)}, plane_height_m=1.5)


def test_names_are_filled_in_and_unique():
    world = scene({"shape": "star"}, {"shape": "circle", "name": "post"}, {"shape": "star"})
    assert [o.name for o in world.objects] == ["star-0", "post", "star-2"]
    with pytest.raises(ConfigError, match=r"objects\[1\]\.name = 'star-0' is also the name of objects\[0\]"):
        scene({"shape": "star"}, {"shape": "circle", "name": "star-0"})


def test_crossed_polygon_is_named_by_file_and_key():
    with pytest.raises(ConfigError, match=r"test\.toml: objects\[1\]\.vertices_m"):
        scene({"shape": "star"}, {"shape": "polygon", "vertices_m": [(0, 0), (2, 2), (2, 0), (0, 2)]})


@pytest.mark.parametrize(
    ("radius", "view", "place"), [(3.9, 18, r"\(3\.709, 1\.205, 0\)"), (4.0, 18, r"\(3\.804, 1\.236, 0\)")]
)
def test_sensor_inside_an_object_or_on_its_tip_is_refused(radius, view, place):
    with pytest.raises(ConfigError, match=rf"view {view} at {place} m is inside 'star-0'"):
        scene(trajectory={"kind": "circle", "radius_m": radius})


def test_sensor_in_a_notch_or_above_or_in_a_courtyard_is_outside(tmp_path):
    tip = 90.0 - 36.0  # between two tips of the star, whose inner radius is 1.53 m
    notch = [[2.0 * math.cos(math.radians(tip)), 2.0 * math.sin(math.radians(tip)), 0.0]]
    assert len(scene(trajectory={"kind": "positions", "positions_m": notch}).views) == 1
    above = [[0.5, 0.5, 1.01]]
    assert len(scene(trajectory={"kind": "positions", "positions_m": above}).views) == 1
    with pytest.raises(ConfigError, match=r"view 1 at .* is inside 'star-0'"):
        scene(trajectory={"kind": "positions", "positions_m": [*above, [0.5, 0.5, 0.99]]})
    trimesh.creation.annulus(r_min=3.0, r_max=4.0, height=2.0).export(tmp_path / "yard.ply")
    yard = {"shape": "mesh", "file": str(tmp_path / "yard.ply")}
    assert len(scene(yard, trajectory={"kind": "circle", "radius_m": 2.0}).views) == 360
    with pytest.raises(ConfigError, match=r"view 0 at .* is inside 'mesh-0'"):
        scene(yard, trajectory={"kind": "circle", "radius_m": 3.5})


def test_angles_of_listed_positions_are_about_the_targets_centre():
    square = {"shape": "square", "side_m": 2.0, "position_m": (5.0, 5.0, 0.0)}
    world = scene(square, trajectory={"kind": "positions", "positions_m": [[5, 15, 0], [-5, 5, 0], [15, 15, 2]]})
    np.testing.assert_allclose(world.views.angles_deg, [90, 180, 45], atol=1e-4)  # degrees: 1e-6 m of 10 m
    assert world.views.center_m == pytest.approx((5, 5), abs=1e-5)


def test_fingerprint_ignores_names_and_sees_everything_else():
    base = scene().fingerprint()
    assert base == scene(name="other", description="words").fingerprint()
    assert base == scene({"shape": "star", "name": "hero"}).fingerprint()
    assert len(base) == 64
    variants = [
        scene({"shape": "star", "radius_m": 4.1}),
        scene({"shape": "star", "material": "wood"}),
        scene({"shape": "star", "scattering_coefficient": 0.2}),
        scene({"shape": "star", "rotation_deg": 1.0}),
        scene({"shape": "star", "height_m": 3.0}),
        scene(trajectory={"kind": "circle", "interval_deg": 2.0}),
        scene(trajectory={"kind": "circle", "start_deg": 0.5}),
        scene(radio={"carrier_hz": 28e9}),
        scene(radio={"polarization": "H"}),
        scene(ray_tracing={"seed": 2}),
        scene(plane_height_m=0.5),
        scene({"shape": "star"}, {"shape": "star"}),
    ]
    assert len({base, *(v.fingerprint() for v in variants)}) == len(variants) + 1


@pytest.mark.parametrize("shape", [Star(), Cylinder(), Polygon(vertices_m=((0, 0), (2, 0), (0, 2)))], ids=repr)
def test_the_cache_follows_the_code_of_a_built_in_shape(shape, monkeypatch):
    """A cached channel of what a shape once was is none of what it is now."""
    first = cache_file(Scene(objects=[shape]))
    assert first == cache_file(Scene(objects=[shape]))
    corners = type(shape).corners
    monkeypatch.setattr(type(shape), "corners", lambda self: np.asarray(corners(self)) * 1.001)
    assert first != cache_file(Scene(objects=[shape]))


def test_fingerprint_follows_the_code_of_an_antenna(monkeypatch):
    first = scene(radio={"antenna": {"kind": "horn"}}).fingerprint()
    monkeypatch.setattr(horn, "HALF_POWER_DB", 3.0)
    assert first != scene(radio={"antenna": {"kind": "horn"}}).fingerprint()


def test_fingerprint_follows_a_meshs_content_and_not_its_place(tmp_path):
    def of(path):
        return scene({"shape": "mesh", "file": str(path)}).fingerprint()

    box = trimesh.creation.box((2, 3, 4))
    (tmp_path / "moved").mkdir()
    for name in ("box.ply", "moved/other.ply"):
        box.export(tmp_path / name)
    first = of(tmp_path / "box.ply")
    assert first == of(tmp_path / "moved/other.ply")
    box.vertices[0, 0] -= 0.001
    box.export(tmp_path / "box.ply")
    assert first != of(tmp_path / "box.ply")


def test_fingerprint_follows_the_positions_and_not_their_file(tmp_path):
    def of(trajectory):
        return scene(trajectory={"kind": "positions", **trajectory}).fingerprint()

    file = tmp_path / "views.csv"
    file.write_text("x_m,y_m\n10,0\n0,10\n")
    first = of({"file": str(file)})
    assert first == of({"positions_m": [[10, 0, 0], [0, 10, 0]]})
    file.write_text("x_m,y_m\n10,0\n0,10.001\n")
    assert first != of({"file": str(file)})


def test_files_are_found_beside_the_scene_and_overrides_apply(tmp_path):
    trimesh.creation.box((2, 3, 4)).export(tmp_path / "box.stl")
    (tmp_path / "views.csv").write_text("x_m,y_m\n10,0\n0,10\n")
    (tmp_path / "scene.toml").write_text(
        'name = "boxed"\n[[objects]]\nshape = "mesh"\nfile = "box.stl"\n'
        '[trajectory]\nkind = "positions"\nfile = "views.csv"\n'
    )
    world = Scene.load(tmp_path / "scene.toml", ["objects.0.scale=2"])
    assert world.outline.area == pytest.approx(24, rel=SECTION)
    assert world.extent_m == pytest.approx(math.hypot(4, 6), rel=SECTION)
    assert len(world.views) == 2


def test_a_scene_is_built_from_objects_or_plain_data_or_both():
    file = load("star")
    made = [
        mv.Scene(objects=[mv.Star(radius_m=4)], trajectory=mv.Circle(radius_m=10, start_deg=1.0), name="star"),
        mv.Scene(objects=mv.Star(radius_m=4), trajectory={"start_deg": 1.0}),
        mv.Scene({"objects": [{"shape": "star"}], "trajectory": mv.Circle(start_deg=1.0)}),
        mv.Scene({"objects": [{"shape": "star", "radius_m": np.int64(4)}]}, trajectory={"start_deg": 1.0}),
        mv.Scene(file.settings),
        mv.Scene(file.settings, objects=[mv.Star(radius_m=4)]),
    ]
    assert {world.name for world in made} == {"star", "scene"}
    start = mv.Scene(file.settings, trajectory=mv.Circle(start_deg=1.0)).fingerprint()
    assert {world.fingerprint() for world in made[:4]} == {start}
    assert {world.fingerprint() for world in made[4:]} == {file.fingerprint()}


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (
            lambda: mv.Scene(objects=[mv.Circle()]),
            "scene: objects[0]: Circle is a trajectory and is no shape; allowed: ",
        ),
        (lambda: mv.Scene(objects=[mv.Star()], trajectory=mv.Star()), "scene: trajectory: Star is a shape and is no "),
        (lambda: mv.Scene(objects=["star"]), "scene: objects[0] = 'star': is no shape; allowed: Car, Cylinder, "),
        (mv.Scene, "scene: objects: missing key"),
        (lambda: mv.Scene("star"), "scene: str is no scene; give a table or objects=[…]; for a file: Scene.load"),
        (lambda: mv.Scene(objects=[mv.Star()], radio={"carrier_hz": -1}), "scene: radio.carrier_hz = -1: "),
        (lambda: mv.Scene(objects=[mv.Star()], trajectroy=1), "scene: trajectroy: unknown key (did you mean 'traj"),
        (lambda: mv.Scene(objects=[mv.Star()], trajectory=mv.Circle(radius_m=1)), "scene: trajectory: view 0 at "),
    ],
)
def test_what_is_no_scene_is_told_in_one_line(build, says):
    with pytest.raises(mv.MvlaError) as caught:
        build()
    assert str(caught.value).startswith(says)
    assert len(str(caught.value).splitlines()) == 1
    assert isinstance(caught.value, ValueError)


def test_scenes_show_themselves_on_one_short_line():
    world = load("vehicle")
    for thing in (world, world.objects[0], world.views, world.settings, world.settings.radio.antenna.pattern()):
        assert len(str(thing).splitlines()) == 1
        assert len(str(thing)) < 450
    assert str(load("star")) == "Scene('star': 1 object, 360 views, extent 7.61 m)"
    assert str(load("star").views) == "Views(360, 10 to 10 m from (0, 0))"


def test_scenes_and_views_compare_by_identity():
    one, other = scene(), scene()
    for a, b in ((one, other), (one.views, other.views), (one.objects[0], other.objects[0])):
        assert a == a  # noqa: PLR0124 - arrays inside must not be compared
        assert a != b
        assert len({a, b}) == 2
    assert one.settings == other.settings
    assert hash(one.settings) == hash(other.settings)


def test_a_scene_may_be_called_none(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('name = "none"\ndescription = "none"\n[[objects]]\nshape = "star"\ninner_radius_m = "none"\n')
    world = Scene.load(file, ["trajectory.heights_m=none"])
    assert (world.name, world.settings.description) == ("none", "none")
    assert (world.settings.objects[0].inner_radius_m, world.settings.trajectory.heights_m) == (None, None)


@pytest.mark.parametrize("key", ["objects.0.radius_m", "scene.objects.0.radius_m"])
def test_overrides_have_the_names_of_axes(key):
    assert load("star", f"{key}=3").settings.objects[0].radius_m == 3
    assert dotted_key(key) == "scene.objects.0.radius_m"
