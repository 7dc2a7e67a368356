"""A tiny scene and experiments on it: 36 views, 1600 voxels, milliseconds a case."""

from __future__ import annotations

from pathlib import Path

from mvla_sim.sweep.case import Row
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.store import Store

SCENE = """
name = "box"
[[objects]]
shape = "square"
side_m = 2.0
[trajectory]
radius_m = 5.0
interval_deg = 10.0
[ray_tracing]
diffuse_rays = 300
specular_rays = 2000
"""

EXPERIMENT = """
name = "tiny"
scenes = ["box.toml"]
[imaging.grid]
size_m = [4.0, 4.0, 0.0]
spacing_m = 0.1
[axes]
"""

AXES = """
interval_deg = [10.0, 30.0]
method = ["mvla-gr", "bp"]
seed = [0, 1]
"""


def write(folder: Path, axes: str = AXES, more: str = "", name: str = "tiny", scene: str = SCENE) -> Path:
    """Write scene and experiment into a folder; ``more`` comes after the axes."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "box.toml").write_text(scene)
    file = folder / f"{name}.toml"
    file.write_text(EXPERIMENT.replace("tiny", name) + axes + more)
    return file


def experiment(folder: Path, axes: str = AXES, more: str = "", overrides: tuple[str, ...] = ()):
    """The settings of such an experiment."""
    return load_experiment(write(folder, axes, more), overrides)


def numbers(table):
    """A table without what may differ between two runs that agree: the time each case took."""
    return table.drop(columns="seconds")


def keep_then(monkeypatch, count, act):
    """Let ``act`` happen when the run keeps its ``count``-th row."""
    kept = []
    original = Store.add

    def add(self, row: Row):
        original(self, row)
        kept.append(row)
        if len(kept) == count:
            act()

    monkeypatch.setattr(Store, "add", add)
