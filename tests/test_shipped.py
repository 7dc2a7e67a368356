"""Scenes and experiments come with the package, and are found by name."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import mvla_sim
from mvla_sim.dataset.campaign import load_campaign
from mvla_sim.errors import DataError
from mvla_sim.measured.process import load_process
from mvla_sim.scene.world import Scene
from mvla_sim.shipped import find, shipped_folder
from mvla_sim.sweep.experiment import load_experiment

ROOT = Path(mvla_sim.__file__).parents[1]


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ["small", "small.toml"])
def test_a_scene_is_found_by_name(name):
    scene = Scene.load(name, ["scene.objects.0.height_m=3"])
    assert scene.name == "small"
    assert scene.settings.objects[0].height_m == 3


def test_ones_own_file_wins(tmp_path):
    (tmp_path / "star.toml").write_text('name = "mine"\nobjects = [{ shape = "square", side_m = 1.0 }]\n')
    assert find("scenes", "star.toml") == Path("star.toml")
    assert Scene.load("star.toml").name == "mine"
    assert Scene.load(tmp_path / "star.toml").name == "mine"


def test_files_of_shipped_experiments_resolve():
    for scene in load_experiment("main").scenes:
        assert Scene.load(scene).views
    assert Path(load_process("vehicle").truth).is_file()
    assert load_campaign("benchmark-small").name == "benchmark-small"


def test_scenes_of_ones_own_experiment_may_be_shipped_ones(tmp_path):
    (tmp_path / "one.toml").write_text('name = "one"\nscenes = ["star", "circle.toml"]\n')
    names = [Path(scene).name for scene in load_experiment("one.toml").scenes]
    assert names == ["star.toml", "circle.toml"]


@pytest.mark.parametrize("load", [Scene.load, load_experiment, load_process, load_campaign])
def test_a_name_that_nothing_has_lists_what_there_is(load):
    with pytest.raises(DataError) as caught:
        load("bencmark-smal")
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert "two-targets" in message or "star-optimal" in message
    if load != Scene.load:
        assert "did you mean 'benchmark-small'?" in message


def test_a_path_is_never_taken_for_a_name():
    with pytest.raises(DataError, match=r"^elsewhere/star\.toml: no such scene file$"):
        Scene.load("elsewhere/star.toml")


def test_the_wheel_takes_them_along(tmp_path):
    """Built without the network; without the build backend, its configuration is looked at."""
    if importlib.util.find_spec("hatchling") is None:
        table = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
        assert {"experiments", "scenes"} < set(table["only-include"])
        assert table["sources"] == {name: f"mvla_sim/data/{name}" for name in ("experiments", "scenes")}
        return
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name.startswith(f"mvla_sim-{mvla_sim.__version__}-")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    for folder in ("scenes", "experiments"):
        there = {file.name for file in (tmp_path / "site" / "mvla_sim" / "data" / folder).glob("*.toml")}
        assert there == {file.name for file in shipped_folder(folder).glob("*.toml")}
    program = "import mvla_sim as mv; print(mv.__file__, mv.Scene.load('star-random'))"
    child = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env={"PYTHONPATH": str(tmp_path / "site")}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    assert child.stdout.startswith(str(tmp_path / "site"))
    assert "Scene('star-random': 1 object" in child.stdout
