"""Another package adds kinds of things without touching this one; they are used from TOML and from Python."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

import pytest

KINDS = {
    "mvla_sim.shapes": ("cross", "Cross"),
    "mvla_sim.trajectories": ("spiral", "Spiral"),
    "mvla_sim.antennas": ("patch", "Patch"),
}
"""What the package offers: name and class by group."""

MODULE = '''
from typing import Literal

import numpy as np

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


@pytest.fixture
def package(tmp_path):
    """A folder with the package, as an installer leaves it."""
    folder = tmp_path / "site"
    about = folder / "outside-1.0.dist-info"
    about.mkdir(parents=True)
    (folder / "outside.py").write_text(MODULE)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
    groups = (f"[{group}]\n{name} = outside:{cls}\n" for group, (name, cls) in KINDS.items())
    (about / "entry_points.txt").write_text("\n".join(groups))
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


def test_a_package_that_cannot_be_imported_is_told_in_one_line(package, tmp_path):
    (package / "outside.py").write_text("import no_such_module_anywhere")
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    child = run(package, "import sys, mvla_sim as mv\nmv.Scene.load(sys.argv[1])", scene)
    last = child.stderr.strip().splitlines()[-1]
    assert "objects[0].shape = 'cross': shape 'cross': outside:Cross cannot be imported (ModuleNotFoundError" in last
    others = "import mvla_sim as mv\nmv.Scene(objects=[{'shape': 'star'}])\nprint('fine')"
    assert run(package, others).stdout == "fine\n"
