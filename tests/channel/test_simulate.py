"""The cache and the resuming of simulations, with a tracer that only counts."""

from __future__ import annotations

import json

import numpy as np
import pytest
from channel_scenes import build, ring
from kinds_of_channel import same

from mvla_sim.channel import simulate as module
from mvla_sim.channel.cir import Cir
from mvla_sim.channel.raytrace import ViewPaths
from mvla_sim.channel.simulate import SimulationInterruptedError, cache_file, simulate
from mvla_sim.errors import DataError
from mvla_sim.scene.world import Scene

TARGET = [{"shape": "square", "side_m": 2.0}]


class Tracer:
    """Stands in for the ray tracer: paths that depend on the position alone; counts, and stops where it is told."""

    traced: int
    asked: list[tuple]
    stop_at: int | None
    error: type[BaseException]

    def __init__(self, scene):
        self.scene = scene

    def trace(self, position_m, _label="view", *, receiver_m=None, boresight=None):
        if Tracer.traced == Tracer.stop_at:
            raise Tracer.error("stop")
        Tracer.traced += 1
        Tracer.asked.append((position_m, receiver_m, boresight))
        rng = np.random.default_rng(int(1e6 + 1e3 * (position_m @ [1.0, 7.0, 3.0])))
        count = int(rng.integers(1, 5))
        gain = (rng.standard_normal(count) + 1j).astype(np.complex64)
        points = rng.standard_normal((count, 3)).astype(np.float32)
        return ViewPaths(gain, rng.uniform(1e-8, 2e-8, count), np.ones(count, np.uint8), points)


@pytest.fixture(autouse=True)
def _fake(monkeypatch, tmp_path):
    monkeypatch.setenv("MVLA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(module, "ViewTracer", Tracer)
    monkeypatch.setattr(Tracer, "traced", 0, raising=False)
    monkeypatch.setattr(Tracer, "asked", [], raising=False)
    monkeypatch.setattr(Tracer, "stop_at", None, raising=False)
    monkeypatch.setattr(Tracer, "error", KeyboardInterrupt, raising=False)


def scene(**changes):
    return build(TARGET, ring(30.0), **changes)


def without_time(cir):
    return {key: value for key, value in cir.provenance.items() if key != "created"}


def test_second_run_traces_nothing(monkeypatch):
    first = simulate(scene())
    assert Tracer.traced == 12

    def never(*_):
        raise AssertionError("the tracer was built although the cache holds this scene")

    monkeypatch.setattr(module, "ViewTracer", never)
    same(first, simulate(scene()))


def test_equal_scene_of_another_name_is_found_and_keeps_its_own_name():
    first = scene()
    simulate(first)
    renamed = Scene(first.settings.model_copy(update={"name": "renamed"}))
    assert simulate(renamed).config["name"] == "renamed"
    assert Tracer.traced == 12


def test_everything_that_decided_the_data_is_in_it():
    cir = simulate(scene())
    assert cir.extent_m == 2.0
    assert cir.outline.area == pytest.approx(4.0)
    assert cir.config["ray_tracing"]["seed"] == 1
    assert cir.provenance["program"].startswith("mvla-sim")
    json.dumps([dict(cir.config), dict(cir.provenance)])


@pytest.mark.parametrize(
    "changed",
    [
        {"seed": 2},
        {"diffuse_rays": 7000},
        {"max_depth": 2},
        {"launch": "sphere"},
        {"diffraction": False},
    ],
)
def test_changed_solver_setting_misses(changed):
    simulate(scene())
    simulate(scene(**changed))
    assert Tracer.traced == 24


def test_changed_geometry_or_views_miss():
    scenes = [
        scene(),
        build([TARGET[0] | {"side_m": 2.1}], ring(30.0)),
        build([TARGET[0] | {"rotation_deg": 1.0}], ring(30.0)),
        build([TARGET[0] | {"scattering_coefficient": 0.2}], ring(30.0)),
        build(TARGET, ring(15.0)),
        build(TARGET, ring(30.0, radius_m=7.0)),
    ]
    assert len({cache_file(one) for one in scenes}) == len(scenes)


def test_changed_pair_pointing_or_antenna_misses():
    horn = {"antenna": {"kind": "horn"}}
    turned = ring(30.0) | {"pointing": {"elevation_deg": 5.0}}
    scenes = [
        scene(),
        build(TARGET, ring(30.0) | {"pair_separation_m": 0.2}),
        build(TARGET, ring(30.0), horn),
        build(TARGET, turned, horn),
        build(TARGET, turned, {"antenna": horn["antenna"] | {"floor_db": -30.0}}),
    ]
    assert len({cache_file(one) for one in scenes}) == len(scenes)


def test_tracer_is_asked_for_each_views_own_pair_and_direction():
    simulate(scene())
    assert all(receiver is None and boresight is None for _, receiver, boresight in Tracer.asked)
    Tracer.asked.clear()
    pairs = build(TARGET, ring(30.0) | {"pair_separation_m": 0.2}, {"antenna": {"kind": "horn"}})
    cir = simulate(pairs)
    positions, receivers, boresights = (np.array(column) for column in zip(*Tracer.asked, strict=True))
    np.testing.assert_array_equal(positions, pairs.views.positions_m)
    np.testing.assert_array_equal(receivers, pairs.views.receivers_m)
    np.testing.assert_array_equal(boresights, pairs.views.directions)
    np.testing.assert_array_equal(cir.views.receivers_m, pairs.views.receivers_m)
    assert cir.antenna == pairs.settings.radio.antenna
    same(cir, Cir.load(cache_file(pairs)))


def test_moved_pattern_file_is_found_in_the_cache_and_keeps_its_new_name(tmp_path):
    def measured(name):
        file = tmp_path / name
        file.write_text("angle_deg,azimuth_db\n-10,-3\n0,0\n10,-3\n")
        return build(TARGET, ring(30.0), {"antenna": {"kind": "file", "file": str(file)}})

    simulate(measured("one.csv"))
    again = simulate(measured("other.csv"))
    assert Tracer.traced == 12
    assert again.antenna.file == str(tmp_path / "other.csv")


def test_changed_version_of_the_engine_misses(monkeypatch):
    before = cache_file(scene())
    monkeypatch.setattr(module, "version", lambda _: "0.0")
    assert cache_file(scene()) != before


@pytest.mark.parametrize("damage", [lambda c: c[: len(c) // 2], lambda _: b"", lambda _: b"no CIR" * 99])
def test_damaged_entry_is_traced_again(damage):
    first = simulate(scene())
    entry = cache_file(scene())
    entry.write_bytes(damage(entry.read_bytes()))
    again = simulate(scene())
    assert Tracer.traced == 24
    np.testing.assert_array_equal(again.gain, first.gain)
    same(again, Cir.load(entry))


def test_without_cache_nothing_is_kept(tmp_path):
    simulate(scene(), cache=False)
    simulate(scene(), cache=False)
    assert Tracer.traced == 24
    assert list(tmp_path.rglob("*.nc")) == []


def test_interrupted_run_goes_on_where_it_stopped(tmp_path):
    whole = simulate(scene(), cache=False)
    Tracer.traced, Tracer.stop_at = 0, 5
    with pytest.raises(SimulationInterruptedError, match="after 5 of 12 views; they are kept") as caught:
        simulate(scene())
    assert caught.value.exit_code == 130
    Tracer.stop_at = 8  # a second Ctrl-C, three views further on
    with pytest.raises(SimulationInterruptedError, match="after 8 of 12 views"):
        simulate(scene())
    Tracer.stop_at = None
    resumed = simulate(scene())
    assert Tracer.traced == 12
    for name in ("gain", "delay_s", "row_size", "first_point_m", "interaction"):
        np.testing.assert_array_equal(getattr(resumed, name), getattr(whole, name))
    assert [file.name for file in tmp_path.rglob("*.nc")] == [cache_file(scene()).name]


def test_interruption_before_the_first_view_or_without_cache_keeps_nothing(tmp_path):
    Tracer.stop_at = 0
    with pytest.raises(SimulationInterruptedError, match=r"after 0 of 12 views$"):
        simulate(scene())
    Tracer.stop_at = 3
    with pytest.raises(SimulationInterruptedError, match=r"after 3 of 12 views$"):
        simulate(scene(), cache=False)
    assert list(tmp_path.rglob("*.nc")) == []


def test_damaged_partial_result_is_not_resumed():
    Tracer.stop_at = 5
    with pytest.raises(SimulationInterruptedError):
        simulate(scene())
    partial = cache_file(scene()).with_suffix(".partial.nc")
    partial.write_bytes(partial.read_bytes()[:1000])
    Tracer.traced, Tracer.stop_at = 0, None
    simulate(scene())
    assert Tracer.traced == 12


def test_error_of_a_view_leaves_no_entry(tmp_path):
    Tracer.stop_at, Tracer.error = 4, DataError
    with pytest.raises(DataError, match="stop"):
        simulate(scene())
    assert list(tmp_path.rglob("*.nc")) == []
