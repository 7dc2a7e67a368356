"""Mitsuba scenes, really opened by Sionna RT."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mvla_sim.errors import ConfigError, OutputError
from mvla_sim.scene.mitsuba_xml import export_mitsuba
from mvla_sim.scene.world import Scene, SceneSettings

# In a process of its own: the engine keeps global state and needs its compiler named before it is imported.
READER = """
import json, sys
import numpy as np
import sionna.rt as rt

scene = rt.load_scene(sys.argv[1])
scene.frequency = 36e9
def number(value):
    return float(np.ravel(value)[0])
out = {}
for name, thing in scene.objects.items():
    material = thing.radio_material
    box = thing.mi_mesh.bbox()
    out[name] = {
        "kind": type(material).__name__,
        "itu": getattr(material, "itu_type", None),
        "low": [float(v) for v in box.min],
        "high": [float(v) for v in box.max],
        "faces": int(thing.mi_mesh.face_count()),
        "permittivity": number(material.relative_permittivity),
        "conductivity": number(material.conductivity),
        "thickness": number(material.thickness),
        "scattering": number(material.scattering_coefficient),
        "xpd": number(material.xpd_coefficient),
    }
print(json.dumps(out))
"""


DIRECTIVE = {"scattering_pattern": {"kind": "directive"}}


def build(*objects):
    return Scene(SceneSettings.model_validate({"name": "test", "objects": list(objects)}))


def test_sionna_opens_what_was_written(tmp_path):
    common = {"thickness_m": 0.25, "scattering_coefficient": 0.3, "xpd_coefficient": 0.125}
    world = build(
        {"shape": "star", "radius_m": 2.0, **common},
        {
            "shape": "circle",
            "radius_m": 1.0,
            "facets": 36,
            "position_m": (4, 0, 0.5),
            "material": "concrete",
            "name": "itu_x",
        },
        {"shape": "square", "side_m": 1.0, "position_m": (0, 4, 0), "material": "concrete", "name": "metal"},
        {
            "shape": "triangle",
            "altitude_m": 1.0,
            "position_m": (-4, 0, 0),
            "material": {"relative_permittivity": 3.5, "conductivity_s_per_m": 0.75},
            **common,
        },
        {"shape": "car", "position_m": (0, -4, -0.9), "rotation_deg": 30.0},
    )
    file = export_mitsuba(world, tmp_path / "out scene.xml")
    library = Path(sys.prefix) / "lib" / "libLLVM.so"
    environment = dict(os.environ)
    if library.exists():
        environment["DRJIT_LIBLLVM_PATH"] = str(library)
    done = subprocess.run(
        [sys.executable, "-c", READER, str(file)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert set(found) == {o.name for o in world.objects}
    for item in world.objects:
        seen = found[item.name]
        np.testing.assert_allclose([seen["low"], seen["high"]], item.mesh.bounds, atol=1e-6)  # single precision, 5 m
        assert seen["faces"] == len(item.mesh.faces)
        assert seen["thickness"] == pytest.approx(item.settings.thickness_m, rel=1e-6)  # single precision, as below
        assert seen["scattering"] == pytest.approx(item.settings.scattering_coefficient, rel=1e-6)
        assert seen["xpd"] == pytest.approx(item.settings.xpd_coefficient, abs=1e-6)
    itu = [found[o.name]["itu"] for o in world.objects]
    assert itu == ["metal", "concrete", "concrete", None, "metal", "glass", "metal", *[None] * 4, "metal", "metal"]
    own = found["triangle-3"]
    assert own["kind"] == "RadioMaterial"
    assert own["permittivity"] == pytest.approx(3.5)
    assert own["conductivity"] == pytest.approx(0.75)
    assert found["car-4-wheel-front-left"]["permittivity"] == pytest.approx(4.0)


def test_each_object_is_a_closed_ply_beside_the_scene(tmp_path):
    world = build({"shape": "star"}, {"shape": "circle", "name": "post", "radius_m": 1.0, "position_m": (0, 6, 0)})
    export_mitsuba(world, tmp_path / "scene.xml")
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["meshes", "post.ply", "scene.xml", "star-0.ply"]
    for item in world.objects:
        back = trimesh.load(tmp_path / "meshes" / f"{item.name}.ply")
        assert back.is_watertight
        np.testing.assert_array_equal(back.faces, item.mesh.faces)
        np.testing.assert_allclose(back.vertices, item.mesh.vertices, atol=1e-6)  # metres, single precision


def test_writing_again_gives_the_same_bytes(tmp_path):
    world = build({"shape": "star"})
    file = export_mitsuba(world, tmp_path / "scene.xml")
    before = file.read_bytes(), (tmp_path / "meshes" / "star-0.ply").read_bytes()
    export_mitsuba(world, file)
    assert before == (file.read_bytes(), (tmp_path / "meshes" / "star-0.ply").read_bytes())


def test_a_pattern_that_the_format_cannot_hold_is_refused_before_anything_is_written(tmp_path):
    world = build({"shape": "star", **DIRECTIVE})
    with pytest.raises(ConfigError, match=r"test: objects\[0\]\.scattering_pattern\.kind = 'directive'"):
        export_mitsuba(world, tmp_path / "scene.xml")
    with pytest.raises(ConfigError, match=r"test: objects\[1\]\.scattering_pattern\.kind"):  # a car is one entry
        export_mitsuba(
            build(
                {"shape": "car", "position_m": (0, -4, -0.9)}, {"shape": "star", "position_m": (0, 4, 0), **DIRECTIVE}
            ),
            tmp_path / "scene.xml",
        )
    assert not list(tmp_path.iterdir())
    smooth = build({"shape": "star", **DIRECTIVE, "scattering_coefficient": 0.0})
    assert export_mitsuba(smooth, tmp_path / "scene.xml").exists()  # without scattering the pattern has no effect


def test_places_that_cannot_be_written_are_named(tmp_path):
    world = build({"shape": "star"})
    with pytest.raises(OutputError, match="gone"):
        export_mitsuba(world, tmp_path / "gone" / "scene.xml")
    (tmp_path / "meshes").write_text("in the way")
    with pytest.raises(OutputError, match="meshes"):
        export_mitsuba(world, tmp_path / "scene.xml")
    assert (tmp_path / "meshes").read_text() == "in the way"
    assert not (tmp_path / "scene.xml").exists()
