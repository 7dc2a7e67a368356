"""Paths weighed and chosen behind the tracer: against tracing anew, and by hand."""

from __future__ import annotations

import dataclasses
import functools
import warnings

import numpy as np
import pytest
from cases import channel, response, ring
from hypothesis import given, settings
from hypothesis import strategies as st

import mvla_sim as mv
from mvla_sim.channel.components import Components
from mvla_sim.channel.diffraction import diffracted_gain, permittivity
from mvla_sim.channel.simulate import simulate
from mvla_sim.errors import ConfigError, DataError, MvlaWarning
from mvla_sim.imaging.paths import PathSettings, choose_paths
from mvla_sim.imaging.pipeline import observe, profile_key, reconstruct
from mvla_sim.scene.material import ITU_CONSTANTS, CustomMaterial
from mvla_sim.scene.world import Scene

FEW_RAYS = {"diffuse_rays": 200, "specular_rays": 2000}
ABOVE = {"kind": "circle", "interval_deg": 40, "radius_m": 6.0, "height_m": 2.5, "start_deg": 6}
AROUND = {"kind": "circle", "interval_deg": 90, "radius_m": 6.0, "start_deg": 5}
SCENES = {
    "star": ([{"shape": "star", "radius_m": 2.0}], AROUND, {}),
    "glass from above, H": (
        [{"shape": "square", "side_m": 2.0, "material": "glass", "thickness_m": 0.01}], ABOVE, {"polarization": "H"}
    ),
    "horn": (
        [{"shape": "triangle", "altitude_m": 2.0}], AROUND,
        {"antenna": {"kind": "horn", "azimuth_beamwidth_deg": 30, "elevation_beamwidth_deg": 30}},
    ),
}  # fmt: skip


def scene(name, s):
    objects, trajectory, radio = SCENES[name]
    objects = [item | {"scattering_coefficient": s} for item in objects]
    settings = {"objects": objects, "trajectory": trajectory, "radio": radio, "ray_tracing": FEW_RAYS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MvlaWarning)
        return Scene(settings)


@functools.cache
def traced_with(name, s):
    return simulate(scene(name, s), cache=False)


def weighed(cir, s):
    return choose_paths(cir, PathSettings(scattering_coefficient=s))


@pytest.mark.filterwarnings("ignore::mvla_sim.errors.MvlaWarning")  # some look from above, which is said
@pytest.mark.parametrize(
    ("name", "before", "wanted"),
    [("star", 0.1, (0.0, 0.6, 1.0)), ("glass from above, H", 0.5, (0.9,)), ("horn", 0.3, (0.8,))],
)
def test_another_scattering_coefficient_is_as_traced_with_it(name, before, wanted):
    for s in wanted:
        traced, found = traced_with(name, s), weighed(traced_with(name, before), s)
        assert np.array_equal(found.row_size, traced.row_size)
        order = [np.lexsort((*c.first_point_m.T, c.delay_s, c.interaction, c.row_index)) for c in (found, traced)]
        one, other = (c.gain[o].astype(complex) for c, o in zip((found, traced), order, strict=True))
        kind = traced.interaction[order[1]]
        assert np.array_equal(found.interaction[order[0]], kind)
        allowed = 2e-6 * np.abs(other)  # a chain of float32 operations
        parts = diffracted_gain(traced, scene(name, s))  # large ones may cancel, in the tracer in float32
        allowed[np.isin(order[1], parts.paths)] = 0
        size = np.zeros(other.size)
        size[parts.paths] = np.abs(parts.reflected) + np.abs(parts.fixed)
        assert (np.abs(one - other) <= allowed + 1e-4 * size[order[1]]).all()
        assert {int(k) for k in np.unique(kind)} >= ({2, 8} if s else {8})


def test_diffracted_gain_is_what_the_tracer_finds():
    """One of both parts alone would not do."""
    for name, s in (("star", 0.6), ("glass from above, H", 0.5), ("horn", 0.8)):
        traced = traced_with(name, s)
        parts = diffracted_gain(traced, scene(name, s))
        gain = traced.gain[parts.paths]
        error = np.abs(np.sqrt(1 - s**2) * parts.reflected + parts.fixed - gain)
        assert gain.size >= 4
        assert (parts.fixed != 0).any()
        assert (parts.reflected != 0).all()
        assert (error <= 1e-4 * (np.abs(parts.reflected) + np.abs(parts.fixed))).all()  # float32, and its angles


def test_constants_of_materials_are_the_tracers():
    from sionna.rt.radio_materials import itu  # noqa: PLC0415

    for name, rows in ITU_CONSTANTS.items():
        own = {(low, high): tuple(constants) for low, high, *constants in rows}
        assert own == itu.ITU_MATERIALS_PROPERTIES[name]
    assert permittivity(CustomMaterial(relative_permittivity=3.0), 1e9) == 3
    assert permittivity("metal", 36e9).imag == pytest.approx(-4.993e6, rel=1e-3)
    with pytest.raises(ConfigError, match=r"material = 'wet_ground': ITU-R P\.2040 does not give it at 36 GHz"):
        permittivity("wet_ground", 36e9)


def traced_cir(before=0.5, kinds=(1, 2), **changes):
    """A channel whose file says what it was traced with."""
    cir = channel([[(10.0 + 0.1 * k, 1.0 + k) for k in range(len(kinds))]], ring(1))
    star = {"shape": "star", "scattering_coefficient": before}
    config = {"name": "star", "objects": [star], "trajectory": {"kind": "circle"}}
    return dataclasses.replace(cir, interaction=np.array(kinds, np.uint8), config=config | changes)


def test_weights_are_those_of_the_reflected_field():
    cir = weighed(traced_cir(0.6), 0.28)
    assert cir.gain.tolist() == pytest.approx([0.96 / 0.8, 2 * 0.28 / 0.6], rel=1e-7)
    assert weighed(traced_cir(0.6), 0.0).interaction.tolist() == [1]
    assert weighed(traced_cir(0.6), 1.0).interaction.tolist() == [2]
    same = traced_cir(0.6, ray_tracing={"max_depth": 3})
    assert weighed(same, 0.6) is same  # nothing to weigh, whatever was traced


OTHER = {"shape": "square", "scattering_coefficient": 0.3}


@pytest.mark.parametrize(
    ("cir", "wanted", "message"),
    [
        (traced_cir(ray_tracing={"max_depth": 2}), 0.3, "traced with ray_tracing.max_depth = 2; allowed: 1"),
        (traced_cir(objects=[OTHER, {"shape": "star"}]), 0.5, "objects were traced with different ones (0.1, 0.3)"),
        (traced_cir(0.0), 0.3, "no diffuse path was traced, as scattering_coefficient = 0; allowed: 0"),
        (traced_cir(ray_tracing={"diffuse": False}), 0.3, "traced, as ray_tracing.diffuse = false; allowed: 0"),
        (traced_cir(1.0), 0.3, "nothing but diffuse paths was traced, as scattering_coefficient = 1; allowed: 1"),
        (channel([[(10.0, 1.0)]], ring(1)), 0.3, "this file does not say which scattering coefficient it was traced"),
    ],
)  # fmt: skip
def test_paths_that_cannot_be_weighed_are_refused(cir, wanted, message):
    with pytest.raises(ConfigError) as error:
        reconstruct(cir, **{"paths.scattering_coefficient": wanted})
    assert str(error.value).startswith(f"paths.scattering_coefficient = {wanted:g}: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_diffraction_of_another_scene_is_refused(tmp_path):
    cir = traced_with("star", 0.1)
    told = {"objects": [{"shape": "star", "radius_m": 2.0, "material": "glass"}]}
    with pytest.raises(DataError, match=r"coefficient = 0\.3: of \d+ diffracted paths \d+ are not those of the scene"):
        weighed(dataclasses.replace(cir, config={**cir.config, **told}), 0.3)
    away = {"objects": [{"shape": "star", "radius_m": 1.5}]}
    with pytest.raises(DataError, match=r"diffraction needs the scene.*view \d+: a diffracted path is .* m off every"):
        weighed(dataclasses.replace(cir, config={**cir.config, **away}), 0.3)
    gone = {"objects": [{"shape": "mesh", "file": str(tmp_path / "gone.ply")}]}
    with pytest.raises(DataError, match=r"diffraction needs the scene that was traced: .*gone\.ply"):
        weighed(dataclasses.replace(cir, config={**cir.config, **gone}), 0.3)


@settings(max_examples=30)
@given(st.lists(st.lists(st.integers(1, 5), max_size=9), min_size=1, max_size=5), st.integers(1, 6))
def test_strongest_paths_of_each_view_are_kept_in_their_order(gains, count):
    """Equal ones by order, as a stable sort has it."""
    cir = channel([[(10.0 + 0.1 * k, g) for k, g in enumerate(row)] for row in gains], ring(len(gains)))
    found = choose_paths(cir, PathSettings(strongest=count))
    for view, row in enumerate(gains):
        kept = sorted(sorted(range(len(row)), key=lambda k: -row[k])[:count])
        assert np.array_equal(found.gain[found.rows(view)], np.array(row, float)[kept])
        assert np.array_equal(found.delay_s[found.rows(view)], cir.delay_s[cir.rows(view)][kept])


def test_interactions_are_chosen_if_all_of_a_path_are():
    kinds = (1, 2, 3, 8, 10)
    for names, left in {
        ("specular",): [1], ("diffuse",): [2], ("specular", "diffuse"): [1, 2, 3],
        ("diffraction", "diffuse"): [2, 8, 10],
    }.items():  # fmt: skip
        found = choose_paths(traced_cir(kinds=kinds), PathSettings(interactions=names))
        assert found.interaction.tolist() == left
        assert found.row_size.tolist() == [len(left)]
    joined = mv.imaging_settings(["paths.interactions=specular+diffuse"]).paths  # axes of experiments have no lists
    assert joined == mv.imaging_settings(**{"paths.interactions": ["specular", "diffuse"]}).paths
    with pytest.raises(DataError) as error:
        choose_paths(traced_cir(kinds=kinds), PathSettings(interactions=("refraction",)))
    assert str(error.value) == (
        "paths.interactions = ['refraction']: no path of the channel has these interactions alone; interactions there: "
        "specular, diffuse, diffraction"
    )
    with pytest.raises(ConfigError, match="this file does not tell the interactions of 1 of its paths"):
        choose_paths(traced_cir(kinds=(0, 1)), PathSettings(interactions=("specular",)))


def test_weights_come_before_the_choice():
    """Weak diffuse paths become the strongest."""
    cir = traced_cir(0.1, kinds=(1, 2))
    assert choose_paths(cir, PathSettings(strongest=1)).interaction.tolist() == [2]
    assert choose_paths(cir, PathSettings(strongest=1, scattering_coefficient=0.01)).interaction.tolist() == [1]


def test_all_stages_see_the_chosen_paths():
    cir = traced_cir(0.1, kinds=(1, 2, 2))
    chosen = {"paths.interactions": ["specular"], "noise.snr_db": None, "grid.size_m": [4.0, 4.0, 0.0]}
    alone = cir.select(np.array([0]))
    alone = dataclasses.replace(
        alone, gain=alone.gain[:1], delay_s=alone.delay_s[:1], interaction=alone.interaction[:1],
        first_point_m=alone.first_point_m[:1], row_size=np.array([1]),
    )  # fmt: skip
    for more in ({}, {"method": "bp-coherent"}, {"impairments": {"random_phase": True, "clutter_paths": 5.0}}):
        one = observe(cir, **(chosen | more))
        other = observe(alone, **({k: v for k, v in chosen.items() if k != "paths.interactions"} | more))
        assert one.pdp.power.any()
        assert np.array_equal(one.pdp.power, other.pdp.power)
        assert np.array_equal(one.pdp.amplitude, other.pdp.amplitude)


def test_profiles_are_shared_by_equal_choices_alone():
    keys = [profile_key(mv.imaging_settings(**{"paths.strongest": n}), ring(3)) for n in (None, 25, 25, 50)]
    assert keys[0] != keys[1] == keys[2] != keys[3]


@pytest.mark.parametrize("given", [{"scattering_coefficient": 0.1}, {"strongest": 25}, {"interactions": ("specular",)}])
def test_measured_channels_have_no_paths_to_choose(given):
    cir = channel([[(10.0, 1.0)]], ring(1))
    ready = Components(np.array([10.0]), np.array([1.0]), np.array([1]), views=cir.views, carrier_hz=36e9,
                       bandwidth_hz=3e9)  # fmt: skip
    swept = response([[(10.0, 1.0)]], ring(1))
    for channel_, what in ((ready, "ready-made components"), (swept, "measured frequency responses")):
        with pytest.raises(ConfigError, match=rf"^paths\.\w+ = .*: needs traced paths, and this file holds {what}$"):
            reconstruct(channel_, paths=given)


@pytest.mark.parametrize(
    ("key", "value"),
    [("scattering_coefficient", -0.1), ("scattering_coefficient", 1.1), ("strongest", 0), ("strongest", 2.5),
     ("interactions", []), ("interactions", ["specular", "reflection"]), ("interactions", "specular+"),
     ("interactions", "")],
)  # fmt: skip
def test_bad_values_are_refused(key, value):
    with pytest.raises(ConfigError) as error:
        mv.imaging_settings(**{f"paths.{key}": value})
    assert f"paths.{key}" in str(error.value)
    assert "\n" not in str(error.value)
