"""Another package adds kinds of things without touching this one; they are used from TOML and from Python."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import shapely

sys.path.append(str(Path(__file__).parent / "imaging"))
from cases import ring, scatterers

KINDS = {
    "mvla_sim.shapes": {"cross": "Cross"},
    "mvla_sim.trajectories": {"spiral": "Spiral"},
    "mvla_sim.antennas": {"patch": "Patch"},
    "mvla_sim.noises": {"uniform": "Uniform"},
    "mvla_sim.methods": {"loudest": "Loudest", "flat": "flat"},
}
"""What the package offers: classes, and a function, by name and group."""

MODULE = '''
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

import mvla_sim as mv


class Cross(mv.Prism):
    """Two bars."""

    shape: Literal["cross"] = "cross"
    arm_m: float = 2.0
    half_width_m: float = 0.5

    def corners(self):
        a, w = self.arm_m, self.half_width_m
        arm = np.array([(a, -w), (a, w), (w, w)])
        turn = np.array([(0, 1), (-1, 0)])  # by a quarter, of row vectors
        return np.concatenate([arm @ np.linalg.matrix_power(turn, k) for k in range(4)])


class Spiral(mv.Trajectory):
    """A circle that widens."""

    kind: Literal["spiral"] = "spiral"
    turns: int = 2
    steps: int = 24

    def build_views(self, center_xy, key="trajectory"):
        angles = np.arange(self.turns * self.steps) * (360 / self.steps)
        radii = 8 + angles / 360
        x, y = center_xy[0] + radii * np.cos(np.deg2rad(angles)), center_xy[1] + radii * np.sin(np.deg2rad(angles))
        return self.equipped(mv.Views(np.stack([x, y, 0 * x], axis=1), angles % 360, center_xy), key)


class Patch(mv.Antenna):
    """A cosine."""

    kind: Literal["patch"] = "patch"

    def pattern(self):
        return mv.Horn(azimuth_beamwidth_deg=90, shape="cosine").pattern()


class Uniform(mv.Noise):
    """As much anywhere below a level."""

    kind: Literal["uniform"] = "uniform"
    level: float = Field(1.0, gt=0, description="above the mean")

    def drawn(self, pdp, ratio, generators):
        draw = np.array([generator.random(pdp.power.shape[1]) for generator in generators])
        scale = self.level * np.sqrt(self.mean_over_gate(pdp.power**2) / ratio)
        return replace(pdp, power=pdp.power + scale[:, None] * draw, amplitude=None)


class Loudest(mv.Method):
    """Nothing but the strongest power of all, to a power."""

    name = "loudest"
    title = "Loudest"
    uses_pdp = True
    uses_peaks = False
    exponent: float = Field(1.0, gt=0, description="of the power")

    def image(self, seen):
        return mv.Estimate(np.full(seen.grid.shape, seen.pdp.power.max() ** self.exponent, np.float32))


def flat(seen, level: float = 1.0):
    return np.full(seen.grid.shape, level)
'''

SCENE = """
name = "outside"
objects = [{ shape = "cross", arm_m = 3.0, rotation_deg = 10.0 }]
trajectory = { kind = "spiral", turns = 3 }
radio.antenna = { kind = "patch" }
"""

PYTHON = """
import sys

import mvla_sim as mv

file = mv.Scene.load(sys.argv[1], ["objects.0.half_width_m=0.4"])
assert file.outline.area == __import__("pytest").approx(4 * (3 - 0.4) * 0.8 + 0.8**2), file.outline.area
assert len(file.views) == 72
from outside import Cross, Patch, Spiral  # only now: TOML needed no import

made = mv.Scene(
    objects=[Cross(arm_m=3, half_width_m=0.4, rotation_deg=10)], trajectory=Spiral(turns=3), radio={"antenna": Patch()}
)
assert made.fingerprint() == file.fingerprint()
assert made.settings.objects == file.settings.objects and made.settings.trajectory == file.settings.trajectory
again = mv.SceneSettings.model_validate_json(made.settings.model_dump_json())
assert again == made.settings
try:
    mv.Scene.load(sys.argv[1], ["objects.0.arm=1"])
except mv.MvlaError as error:
    assert "objects[0].arm: unknown key (did you mean 'arm_m'?)" in str(error), error
try:
    mv.Scene(objects=[{"shape": "croos"}])
except mv.MvlaError as error:
    assert "did you mean 'cross'?" in str(error), error
"""


EXPERIMENT = """
name = "outside"
channels = ["cir.nc"]
imaging.noise = { kind = "uniform", level = 0.5 }
imaging.grid = { size_m = [2.0, 2.0, 0.0], spacing_m = 0.5 }
imaging.loudest.exponent = 2.0
imaging.flat.level = 3.0
axes.method = ["bp", "loudest", "flat"]
"""

METHODS = """
import os
import sys

import numpy as np

import mvla_sim as mv
from mvla_sim.cli.app import run

cir, folder = mv.load_channel("cir.nc"), sys.argv[1]
grid = {"size_m": [2.0, 2.0, 0.0], "spacing_m": 0.5}


def refused(*overrides, **values):
    try:
        mv.imaging_settings(overrides, **values)
    except mv.MvlaError as error:
        return str(error)


# TOML: an experiment, whose cases have the settings of each method
table = mv.run_experiment(mv.load_experiment("outside.toml"), "out", workers=0)
assert list(table["status"]) == ["done"] * 3, table["error"].tolist()

# the command line, which knows them by name
small = ["--set", "grid.size_m=[2,2,0]", "--set", "grid.spacing_m=0.5"]
noisy = ["--set", "noise.kind=uniform", "--set", "noise.level=0.5"]
assert run(["image", "cir.nc", "-o", "a.nc", "--method", "loudest", "--set", "loudest.exponent=2", *noisy, *small]) == 0
assert run(["image", "cir.nc", "-o", "b.nc", "--method", "flat", "--set", "imaging.flat.level=3", *small]) == 0
loudest, flat = mv.Image.load("a.nc"), mv.Image.load("b.nc")
assert (loudest.method, flat.method, flat.score.max()) == ("loudest", "flat", 3)

# Python: by name and table, and by the class and the function themselves
noise = {"kind": "uniform", "level": 0.5}
made = mv.reconstruct(cir, method="loudest", loudest={"exponent": 2.0}, noise=noise, grid=grid)
assert np.array_equal(made.score, loudest.score)
from outside import Loudest, Uniform, flat as function

own = mv.reconstruct(cir, method="loudest", loudest=Loudest(exponent=2), noise=Uniform(level=0.5), grid=grid)
assert np.array_equal(own.score, loudest.score)
silent = mv.reconstruct(cir, method="loudest", loudest=Loudest(exponent=2), snr_db=None, grid=grid)
assert own.score.max() > silent.score.max()
assert mv.reconstruct(cir, method=function, flat={"level": 3}, grid=grid).score.max() == 3
assert str(mv.imaging_settings(method="loudest", loudest=Loudest(exponent=2)).chosen) == "Loudest(exponent=2.0)"

# what is wrong is told as of this package's own
assert "loudest.exponent = -1: should be greater than 0" in refused("loudest.exponent=-1", method="loudest")
assert "loudest.exponnt: unknown key (did you mean 'exponent'?)" in refused(method="loudest", loudest={"exponnt": 1})
assert "flat.level = 'x': should be a valid number" in refused("flat.level=x", method="flat")
assert "noise.level = 0: should be greater than 0" in refused(noise={"kind": "uniform", "level": 0})
assert "did you mean 'uniform'?" in refused(noise={"kind": "unifrom"})
listed = {setting.key: setting for setting in mv.list_settings("imaging")}
assert listed["loudest.exponent"][2:] == ("1.0", "of the power"), listed
assert listed["noise.level"].meaning == "uniform: above the mean"
assert "spiral" in mv.list_settings("scene", "trajectory.kind")[0].meaning
assert "flat.level" in listed
"""


@pytest.fixture
def package(tmp_path):
    """A folder with the package, as an installer leaves it."""
    folder = tmp_path / "site"
    about = folder / "outside-1.0.dist-info"
    about.mkdir(parents=True)
    (folder / "outside.py").write_text(MODULE)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
    lines = [line for group, offered in KINDS.items()
             for line in (f"[{group}]", *(f"{name} = outside:{value}" for name, value in offered.items()))]  # fmt: skip
    (about / "entry_points.txt").write_text("\n".join(lines))
    return folder


def run(package, program, *arguments):
    paths = [str(package), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-c", textwrap.dedent(program), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=package.parent)


def test_shapes_trajectories_and_antennas_of_another_package(package, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    child = run(package, PYTHON, scene)
    assert child.returncode == 0, child.stderr


def test_noise_and_methods_with_settings_of_another_package(package, tmp_path):
    scatterers([[0.5, 0.25, 0.0]], ring(12), outline=shapely.box(-0.5, -0.5, 0.5, 0.5)).save(tmp_path / "cir.nc")
    (tmp_path / "outside.toml").write_text(EXPERIMENT)
    child = run(package, METHODS, tmp_path)
    assert child.returncode == 0, child.stderr


def test_a_package_that_cannot_be_imported_is_told_in_one_line(package, tmp_path):
    (package / "outside.py").write_text("import no_such_module_anywhere")
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    child = run(package, "import sys, mvla_sim as mv\nmv.Scene.load(sys.argv[1])", scene)
    last = child.stderr.strip().splitlines()[-1]
    assert "objects[0].shape = 'cross': shape 'cross': outside:Cross cannot be imported (ModuleNotFoundError" in last
    others = "import mvla_sim as mv\nmv.Scene(objects=[{'shape': 'star'}])\nprint('fine')"
    assert run(package, others).stdout == "fine\n"
