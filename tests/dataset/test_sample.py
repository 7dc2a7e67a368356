"""Samples: a function of seed and number alone, within their distributions, and never on top of each other."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pytest
import shapely
from campaigns import EVERY_FAMILY, of_family, tiny, write

from mvla_sim.dataset.campaign import SPLITS, CampaignSettings, load_campaign
from mvla_sim.dataset.families import random_polygon, smooth_outline
from mvla_sim.dataset.sample import check_room, draw_sample, family_of, split_of, splits_of
from mvla_sim.dataset.shard import occupancy_of
from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.scene.world import Scene
from mvla_sim.settings import parse


def test_any_order_and_any_company_give_the_same_sample(tmp_path):
    campaign = tiny(tmp_path)
    forwards = [draw_sample(campaign, k) for k in range(10)]
    assert [draw_sample(campaign, k) for k in reversed(range(10))] == forwards[::-1]
    assert len({scene.model_dump_json() for scene in forwards}) == 10
    more = tiny(tmp_path, "samples=1000", "samples_per_shard=7", "split.train=0.3", "split.test=0.5")
    assert [draw_sample(more, k) for k in range(10)] == forwards  # neither how many nor how they are cut
    assert draw_sample(tiny(tmp_path, "seed=8"), 0) != forwards[0]


def test_another_process_draws_the_same(tmp_path):
    program = (
        "import sys; from mvla_sim.dataset.campaign import load_campaign;"
        "from mvla_sim.dataset.sample import draw_sample, split_of\n"
        "c = load_campaign(sys.argv[1])\n"
        "for k in (9, 3): print(split_of(c, k), draw_sample(c, k).model_dump_json())"
    )
    campaign = tiny(tmp_path)
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path / "tiny.toml")],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert done.stdout.splitlines() == [
        f"{split_of(campaign, k)} {draw_sample(campaign, k).model_dump_json()}" for k in (9, 3)
    ]


@pytest.mark.parametrize("shape", EVERY_FAMILY)
def test_objects_keep_their_distances_and_their_bounds(shape):
    campaign = of_family(shape)
    low, high = VoxelGrid.from_settings(campaign.grid).bounds_m()
    counts = set()
    for k in range(12):
        settings = draw_sample(campaign, k)
        scene = Scene(settings)  # refuses sensors inside objects, and outlines that cross themselves
        counts.add(len(settings.objects))
        areas = shapely.get_parts(scene.outline)
        assert len(areas) == len(settings.objects)
        for number, area in enumerate(areas):
            x0, y0, x1, y1 = area.bounds
            assert min(x0 - low[0], y0 - low[1], high[0] - x1, high[1] - y1) >= 0
            assert all(area.distance(other) >= 0.2 - 1e-5 for other in areas[:number])
        corners = shapely.get_coordinates(scene.outline)
        assert np.hypot(*corners.T).max() < 10 - 0.5
    assert counts == {1, 2, 3}


@pytest.mark.parametrize("shape", EVERY_FAMILY)
def test_sizes_are_those_asked_for(shape):
    """``size_m`` is the extent D where the paper gives one, else the diameter of the circle about the centre."""
    family = {"name": "f", "shape": shape, "size_m": 2.0, **EVERY_FAMILY[shape]}
    campaign = parse(CampaignSettings, {"name": "c", "samples": 5, "families": [family]}, "test")
    for k in range(5):
        scene = Scene(draw_sample(campaign, k))
        if shape in ("circle", "square", "triangle"):
            assert scene.extent_m == pytest.approx(2.0, abs=1e-5)  # the altitude of a triangle is rounded
        elif shape == "rectangle":
            assert scene.settings.objects[0].length_m == 2.0
        else:
            radius = np.hypot(*shapely.get_coordinates(scene.outline).T).max()
            assert radius == pytest.approx(1.0, abs=2e-6)  # coordinates are rounded to six decimals


def test_outlines_are_simple_and_of_the_radii_promised():
    random = np.random.default_rng(0)
    for _ in range(300):
        roughness = random.uniform(0, 0.95)
        for ring in (
            random_polygon(random, int(random.integers(3, 30)), roughness),
            smooth_outline(random, int(random.integers(2, 20)), roughness, 100),
        ):
            shape = shapely.Polygon(ring)
            assert shape.is_valid
            assert shape.exterior.is_ccw
            assert shape.contains(shapely.Point(0, 0))
            radius = np.hypot(*ring.T)
            assert radius.max() == pytest.approx(1)
            assert radius.min() >= (1 - roughness) / (1 + roughness) - 1e-9


def test_draws_follow_their_distributions():
    """Of 2000 draws; three standard deviations of a mean of uniform values are 0.019 of the interval's width."""
    family = {
        "name": "f", "shape": "star", "size_m": {"min": 1.0, "max": 3.0}, "points": {"min": 5, "max": 8},
        "inner_ratio": 0.5, "material": {"choices": ["metal", "wood"], "weights": [3, 1]},
    }  # fmt: skip
    other = {"name": "g", "shape": "circle", "size_m": 1, "weight": 3.0}
    data = {"name": "c", "samples": 2000, "families": [family, other], "grid": {"spacing_m": 0.5}}
    campaign = parse(CampaignSettings, data, "test")
    families = Counter(family_of(campaign, k).name for k in range(2000))
    assert families["g"] / 2000 == pytest.approx(0.75, abs=0.03)
    alone = parse(CampaignSettings, data | {"families": [family]}, "test")
    objects = [draw_sample(alone, k).objects[0] for k in range(2000)]
    assert np.mean([item.radius_m for item in objects]) == pytest.approx(1.0, abs=0.019)
    points = Counter(item.points for item in objects)
    assert sorted(points) == [5, 6, 7, 8]
    assert all(isinstance(item.points, int) for item in objects)
    assert max(points.values()) - min(points.values()) < 150  # of 500 each, five standard deviations of a difference
    assert Counter(item.material for item in objects)["metal"] / 2000 == pytest.approx(0.75, abs=0.03)
    assert len({draw_sample(alone, k).ray_tracing.seed for k in range(100)}) == 100


@pytest.mark.filterwarnings("ignore:.*the sensor is at z = :mvla_sim.errors.MvlaWarning")  # heights are drawn
@pytest.mark.parametrize("kind", ["circle", "turntable", "arc"])
def test_trajectories(tmp_path, kind):
    more = ["trajectory.span_deg={min=90,max=180}", "trajectory.start_deg={min=0,max=90}"] if kind == "arc" else []
    campaign = tiny(tmp_path, f'trajectory.kind="{kind}"', "trajectory.pair_separation_m={choices=[0, 0.2]}",
                    "trajectory.height_m={min=0,max=0.5}", "grid.center_m=[1, 2, 0.5]", *more)  # fmt: skip
    apart = set()
    for k in range(10):
        views = Scene(draw_sample(campaign, k)).views
        assert views.center_m == (1.0, 2.0)
        distance = np.hypot(*(views.midpoints_m[:, :2] - [1.0, 2.0]).T)
        assert 5.0 - 1e-9 <= distance.min() == pytest.approx(distance.max())
        assert 0.5 <= views.positions_m[0, 2] <= 1.0
        apart.add(views.receivers_m is not None)
    assert apart == {True, False}


@pytest.mark.parametrize(
    ("samples", "counts"), [(10, (5, 2, 3)), (11, (6, 2, 3)), (1, (1, 0, 0)), (999, (499, 200, 300))]
)
def test_splits_have_exact_shares(tmp_path, samples, counts):
    campaign = tiny(tmp_path, f"samples={samples}")
    found = splits_of(campaign)
    assert tuple(found[name].size for name in SPLITS) == counts
    assert sorted(np.concatenate(list(found.values()))) == list(range(samples))
    assert all(split_of(campaign, int(k)) == name for name in SPLITS for k in found[name][:5])
    if samples == 999:
        assert not np.array_equal(found["train"], np.arange(499))  # shuffled
        other = tiny(tmp_path, "samples=999", "seed=8")
        assert not np.array_equal(found["train"], splits_of(other)["train"])


def test_no_room_is_one_line_that_names_sample_and_family(tmp_path):
    campaign = tiny(tmp_path, "families.1.objects=9", "families.1.weight=1e9", "families.1.size_m=3")
    with pytest.raises(
        ConfigError, match=r"tiny: sample 3: family 'blobs': no room for 9 objects after 30 draws"
    ) as told:
        draw_sample(campaign, 3)
    assert "\n" not in str(told.value)
    near = tiny(tmp_path, "trajectory.radius_m=1.2", "families.1.weight=1e9", "families.1.size_m=2")
    with pytest.raises(ConfigError, match="no room for 1 object after"):
        draw_sample(near, 0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (("families.0.size_m=7", "families.0.objects=1"), "tiny: family 'boxes': no room for 1 object after 30 draws"),
        (("families.1.objects=100", "families.1.weight=1e-9"), "tiny: family 'blobs': no room for 100 objects"),
        (("trajectory.radius_m=1.2", "families.1.size_m=2"), "tiny: family 'blobs': no room"),
        (("families.0.x_m=1e300",), "tiny: family 'boxes': no room"),
    ],
)
def test_a_family_that_never_finds_room_is_told_at_once(tmp_path, settings, message):
    """Also one that no sample happens to be of; what has room in part is let through."""
    began = time.process_time()
    with pytest.raises(ConfigError, match=message) as told:
        check_room(tiny(tmp_path, *settings))
    assert "\n" not in str(told.value)
    assert time.process_time() - began < 20
    check_room(tiny(tmp_path, "families.1.objects={choices=[1, 9]}"))


def test_shapes_that_cannot_be_drawn_name_their_family(tmp_path):
    family = {"name": "blunt", "shape": "star", "size_m": 1, "inner_ratio": 1 - 1e-9}
    campaign = parse(CampaignSettings, {"name": "c", "samples": 1, "families": [family]}, "test")
    with pytest.raises(ConfigError, match=r"^c: family 'blunt': Star: inner_radius_m = 0\.5 must be below"):
        check_room(campaign)


@pytest.mark.parametrize("shape", ["star", "polygon", "smooth", "square"])
def test_the_occupancy_is_that_of_concave_outlines_and_of_several_objects(shape):
    """Against every voxel's square and centre, one by one; inside without the contour is what the outline covers."""
    campaign = of_family(shape, grid={"size_m": [8.0, 7.0, 0.0], "spacing_m": 0.25, "center_m": [0.5, -0.5, 0.0]})
    grid = VoxelGrid.from_settings(campaign.grid)
    nx, ny, _ = grid.counts
    xs, ys, _ = grid.axes()
    for k in range(4):
        scene = Scene(draw_sample(campaign, k))
        found = occupancy_of(scene.outline, grid)
        assert found.shape == (ny, nx)
        for iy, ix in np.ndindex(ny, nx):
            x, y = xs[ix], ys[iy]
            met = shapely.box(x - 0.125, y - 0.125, x + 0.125, y + 0.125).intersects(scene.outline.boundary)
            covered = scene.outline.intersects(shapely.Point(x, y))
            assert found[iy, ix] == (3 if met else 1 if covered else 0), (k, ix, iy)
        alone = [occupancy_of(area, grid) for area in shapely.get_parts(scene.outline)]
        assert np.array_equal(np.bitwise_or.reduce(alone), found)


def test_samples_that_do_not_exist(tmp_path):
    campaign = tiny(tmp_path)
    for draw in (draw_sample, split_of, family_of):
        for k in (-1, 10):
            with pytest.raises(ConfigError, match=rf"sample {k}: there is none; allowed: 0 to 9"):
                draw(campaign, k)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("samples=0", r"samples = 0: should be greater"),
        ("sample=3", r"sample: unknown key \(did you mean 'samples'\?\)"),
        ("families.0.size_m.mx=2", r"families\[0\]\.size_m\.mx: unknown key \(did you mean 'max'\?\)"),
        ("families.0.size_m={choices=[1], weight=[2]}", r"size_m\.weight: unknown key \(did you mean 'weights'"),
        ("families.0.size_m={choices=[1, -1]}", r"families\[0\]\.size_m: -1 is outside .* allowed: at least 0\.001"),
        ("families.0.size_m={min=2, max=1}", r"families\[0\]\.size_m: min = 2 must be below max = 1"),
        ("families.0.size_m={choices=[]}", r"size_m\.choices: .*at least 1 item"),
        ("families.0.size_m={choices=[1, 2], weights=[1]}", r"weights has 1 entries for 2 choices"),
        ('families.0.size_m="large"', r"families\[0\]\.size_m = 'large': should be a valid number"),
        ("families.0.size_m=99", r"families\[0\]\.size_m is at least 99; the grid's diagonal is 7\.2"),
        ("families.0.size_m={choices=[1, 2], weights=[0, 0]}", r"size_m\.weights\[0\] = 0.*: should be greater than 0"),
        ("families.0.size_m={choices=[1, 2], weights=[1e308, 1e308]}", r"weights\[0\] = 1e\+308: should be less"),
        ("families.0.weight=0", r"families\[0\]\.weight = 0: should be greater than 0"),
        ("families.0.weight=-1", r"families\[0\]\.weight = -1: should be greater than 0"),
        ("families.0.x_m={min=-1e308, max=1e308}", r"min = -1e\+308 and max = 1e\+308 are too far apart"),
        ("families.0.x_m=nan", r"families\[0\]\.x_m"),
        ("families.0.objects=1.5", r"families\[0\]\.objects = 1\.5: should be a valid integer"),
        ("families.0.objects={min=0, max=2}", r"families\[0\]\.objects: 0 is outside .* at least 1"),
        ('families.0.material="gold"', r"families\[0\]\.material = 'gold': should be 'concrete'"),
        ('families.0.material={choices=["gold"]}', r"families\[0\]\.material\.choices\[0\] = 'gold'"),
        ("families.0.scattering_coefficient=1.5", r"scattering_coefficient = 1\.5: .* at most 1"),
        ("families.0.points=5", r"families\[0\]\.points: unknown key; allowed: height_m"),
        ('families.0.shape="blob"', r"families\[0\]: tag 'blob' .* 'circle', 'square'"),
        ('families.0.name="blobs"', r"families\[1\]\.name = 'blobs' is used twice"),
        ("trajectory.interval_deg=7", r"interval_deg = 7 does not divide 360"),
        ("trajectory.interval_deg={min=1, max=2}", r"trajectory\.interval_deg\.min: unknown key"),
        ("trajectory.radius_m=-1", r"trajectory\.radius_m = -1: .* above 0"),
        ("split.train=0.6", r"split: train \+ validation \+ test = 1\.1"),
        ("grid.size_m=[6, 4, 1]", r"grid\.size_m = .*z must be 0"),
        ("grid.spacing_m=1e-5", r"grid\.spacing_m = 1e-05 makes 2\.4e\+11 voxels"),
        ("ray_tracing.seed=5", r"ray_tracing\.seed = 5: every sample draws its own"),
        ('radio.antenna={kind="file", file="x.csv"}', r"radio\.antenna\.kind = 'file': a campaign is one file"),
        ('licence="a\\nb"', r"licence = "),
    ],
)  # fmt: skip
def test_bad_campaigns_are_one_line(tmp_path, setting, message):
    with pytest.raises(ConfigError, match=message) as told:
        tiny(tmp_path, setting)
    assert str(told.value).startswith(f"{tmp_path / 'tiny.toml'}: ")
    assert "\n" not in str(told.value)


def test_settings_survive_their_own_json(tmp_path):
    campaign = load_campaign(write(tmp_path))
    assert parse(CampaignSettings, json.loads(campaign.model_dump_json()), "copy") == campaign
    assert campaign.digest() == tiny(tmp_path, "description=other", "licence=MIT").digest()
    assert campaign.digest() != tiny(tmp_path, "seed=8").digest()


def test_a_campaign_without_alignment_is_what_it_was_before_there_was_one(tmp_path):
    """Datasets carry their campaign's digest; those built before must stay readable."""
    campaign = tiny(tmp_path)
    assert "align" not in campaign.identity()["grid"]
    others = [campaign.model_copy(update={"grid": campaign.grid.model_copy(update={"align": align})})
              for align in ("edges", "centers")]  # fmt: skip
    assert len({one.digest() for one in (campaign, *others)}) == 3
