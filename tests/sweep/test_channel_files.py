"""Experiments on channel files: measured responses and components are swept as traced channels are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from command_line import mvla
from sweep_files import SCENE

from mvla_sim.channel.components import Components
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.evaluation.evaluate import evaluate
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.run import run_experiment

EXPERIMENT = """
name = "measured"
channels = ["sweep.nc", "parts.nc"]
[imaging.grid]
size_m = [4.0, 4.0, 0.0]
spacing_m = 0.1
[axes]
interval_deg = [10.0, 30.0]
kappa = [0.5, 1.0]
"""
COUNT = 256
BAND = 3e9


def facing_walls(scene):
    """One-way range of the nearest point of a square of 2 m from each view, metres."""
    offset = np.abs(scene.views.positions_m[:, :2])
    return np.linalg.norm(np.maximum(offset - 1, 0), axis=1)


@pytest.fixture
def folder(tmp_path):
    """A scene, the two kinds of channels that were measured of it, without its outline, and an experiment on them."""
    (tmp_path / "box.toml").write_text(SCENE)
    scene = Scene.load(tmp_path / "box.toml")
    range_m = facing_walls(scene)
    offset_hz = BAND / COUNT * (np.arange(COUNT) - (COUNT - 1) / 2)
    response = np.exp(-4j * np.pi * offset_hz / 299_792_458 * range_m[:, None])
    shared = {"views": scene.views, "extent_m": 2.0}
    FrequencyResponse(response, 36e9, BAND / COUNT, **shared).save(tmp_path / "sweep.nc")
    rows = np.ones(len(scene.views), np.int64)
    fields = {"carrier_hz": 36e9, "bandwidth_hz": BAND, **shared}
    Components(range_m, np.ones(len(rows)), rows, **fields).save(tmp_path / "parts.nc")
    (tmp_path / "measured.toml").write_text(EXPERIMENT)
    return tmp_path


def test_responses_and_components_are_swept_against_a_scenes_truth(folder):
    experiment = load_experiment(folder / "measured.toml", ["truth=box.toml"])
    table = run_experiment(experiment, folder / "out", workers=0)
    assert list(table["status"]) == ["done"] * 8, list(table["error"])
    assert list(table["scene"]) == ["sweep"] * 4 + ["parts"] * 4
    outline = Scene.load(folder / "box.toml").outline
    for kind, name in ((FrequencyResponse, "sweep"), (Components, "parts")):
        channel = dataclasses.replace(kind.load(folder / f"{name}.nc"), outline=outline)
        for row in table[table["scene"] == name].itertuples():
            values = {"interval_deg": row.interval_deg, "kappa": row.kappa}
            image = reconstruct(channel, imaging_settings(**values, grid={"size_m": [4.0, 4.0, 0.0], "spacing_m": 0.1}))
            assert row.cd_db == evaluate(image).scores.cd_db


def test_a_channel_that_carries_its_outline_needs_no_other_truth(folder):
    for kind, name in ((FrequencyResponse, "sweep"), (Components, "parts")):
        channel = kind.load(folder / f"{name}.nc")
        dataclasses.replace(channel, outline=Scene.load(folder / "box.toml").outline).save(folder / f"{name}.nc")
    table = run_experiment(load_experiment(folder / "measured.toml"), folder / "out", workers=0)
    assert list(table["status"]) == ["done"] * 8, list(table["error"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "sweep.nc: carries no outline of its target to score against; give truth = a scene file"),
        (("truth=nowhere.toml",), "nowhere.toml: no such file"),
        (("truth=box.toml", 'channels=["none.nc"]'), "none.nc: no such channel file"),
        (("truth=box.toml", 'axes={"scene.plane_height_m" = [0.1]}'), "sweep is that of a file, not traced"),
        (("truth=box.toml", 'channels=["sweep.nc", "sweep.nc"]'), "'sweep' is also the name of another channel"),
        (("truth=box.toml", 'axes={method = ["bp", "no"]}'), "'no' is no method"),
    ],
)
def test_what_cannot_be_scored_is_refused_before_anything_runs(folder, options, said):
    sets = [word for option in options for word in ("--set", option)]
    assert said in mvla("run", "measured.toml", "-o", "out", *sets, folder=folder, code=2)
    assert not (folder / "out").exists()
