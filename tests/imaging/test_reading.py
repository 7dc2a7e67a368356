"""Readings of the paper: presets under settings of one's own, in Python, in experiments and on the command line."""

from __future__ import annotations

import json
import warnings

import pytest
import shapely
from cases import ring, scatterers
from command_line import mvla

import mvla_sim as mv
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.imaging.reading import ReadingWarning, load_reading
from mvla_sim.listing import list_settings
from mvla_sim.shipped import shipped_folder
from mvla_sim.sweep.experiment import load_experiment

MINE = """
description = "another laboratory's"
[imaging.noise]
kind = "exponential"
signal = "mean-power"
[imaging.pdp]
window = "rectangular"
oversampling = 2
[evaluation]
distances_m = [0.2]
"""
EXPERIMENT = """
name = "small"
scenes = ["star"]
reading = "mine.toml"
[imaging.noise]
snr_db = 7.0
[axes]
interval_deg = [5.0]
"""


@pytest.fixture
def mine(tmp_path):
    (tmp_path / "mine.toml").write_text(MINE)
    (tmp_path / "experiment.toml").write_text(EXPERIMENT)
    return tmp_path / "mine.toml"


def test_a_reading_takes_the_place_of_defaults(mine):
    settings = mv.imaging_settings(reading=str(mine), snr_db=3)
    assert (settings.noise.kind, settings.noise.signal, settings.noise.snr_db) == ("exponential", "mean-power", 3)
    assert (settings.pdp.window, settings.pdp.oversampling) == ("rectangular", 2)
    assert settings.peaks == mv.imaging_settings().peaks


def test_what_is_set_by_hand_wins_and_a_line_says_so(mine):
    with pytest.warns(ReadingWarning, match=r"imaging.pdp.window = 'hann' is set by hand and wins over 'rectangular'"):
        settings = mv.imaging_settings(reading=str(mine), pdp={"window": "hann"})
    assert (settings.pdp.window, settings.pdp.oversampling) == ("hann", 2)


def test_the_same_value_by_hand_is_no_clash(mine):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert mv.imaging_settings(["pdp.oversampling=2"], reading=str(mine)).pdp.oversampling == 2


def test_another_kind_by_hand_takes_nothing_of_the_readings_kind(mine):
    with pytest.warns(ReadingWarning, match="noise.kind = 'complex'"):
        settings = mv.imaging_settings(reading=str(mine), noise={"kind": "complex"})
    assert (settings.noise.kind, settings.noise.signal) == ("complex", "mean-square")


def test_the_physical_reading_is_the_defaults():
    assert mv.imaging_settings(reading="physical") == mv.imaging_settings()
    assert load_reading("physical") == {}


@pytest.mark.parametrize("name", sorted(file.stem for file in shipped_folder("readings").glob("*.toml")))
def test_every_reading_that_comes_along_is_valid(name):
    assert "physical" in {file.stem for file in shipped_folder("readings").glob("*.toml")}
    assert isinstance(mv.imaging_settings(reading=name), mv.ImagingSettings)
    assert {entry.group for entry in list_settings(reading=name)} == {"imaging", "evaluation"}


def test_experiments_have_a_reading(mine):
    experiment = load_experiment(mine.parent / "experiment.toml")
    assert experiment.imaging == mv.imaging_settings(reading=str(mine), snr_db=7)
    assert experiment.evaluation.distances_m == (0.2,)
    with pytest.warns(ReadingWarning, match=r"evaluation.distances_m = \[0.3\]"):
        other = load_experiment(mine.parent / "experiment.toml", ["evaluation.distances_m=[0.3]"])
    assert other.evaluation.distances_m == (0.3,)
    assert load_experiment(mine.parent / "experiment.toml", ["reading=physical"]).imaging.pdp.window == "hann"


def test_every_value_of_a_reading_is_listed(mine):
    text = mvla("settings", "--reading", mine)
    line = next(line for line in text.splitlines() if line.startswith("pdp.window"))
    assert line.split("#")[0].split() == ["pdp.window", "=", '"rectangular"']
    assert line.endswith('default "hann"')
    assert "noise.snr_db = 20.0" in text  # what it leaves at its default is shown too
    assert "[0.2]" in text
    assert "trajectory" not in text  # which no reading sets


def test_the_command_line_tells_what_wins(mine, tmp_path):
    text = mvla("run", "experiment.toml", "--dry-run", "--set", "pdp.window=hann", folder=tmp_path, notes=True)
    assert "mvla: note: imaging.pdp.window = 'hann' is set by hand and wins over 'rectangular'" in text


def test_image_and_evaluate_take_a_reading(mine, tmp_path):
    cir = scatterers([[1.0, 0.5, 0.0]], ring(24), outline=shapely.Point(1.0, 0.5).buffer(0.3))
    cir.save(tmp_path / "cir.nc")
    options = ["--set", "grid.size_m=[4, 4, 0]", "--set", "eta=0"]
    mvla("image", tmp_path / "cir.nc", "-o", tmp_path / "image.nc", "--reading", mine, *options)
    image = mv.Image.load(tmp_path / "image.nc")
    assert image.config["imaging"]["pdp"]["window"] == "rectangular"
    found = json.loads(mvla("evaluate", tmp_path / "image.nc", "--reading", mine, "--json"))
    assert "f1_20cm" in found
    assert "f1_5cm" not in found


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        (None, DataError, "come with mvla-sim (did you mean 'physical'?)"),
        ("[scene]\nname = 'x'", ConfigError, "scene: unknown key of a reading; allowed: description, imaging"),
        ("imaging = 3", ConfigError, "imaging: unknown key"),
        ("[imaging.noise]\nsigma = 1", ConfigError, "noise.sigma"),
        ("[imaging", ConfigError, "not valid TOML"),
    ],
)
def test_bad_readings_are_one_line(tmp_path, text, error, words):
    name = "phisical"
    if text is not None:
        (tmp_path / "bad.toml").write_text(text)
        name = str(tmp_path / "bad.toml")
    with pytest.raises(error) as caught:
        mv.imaging_settings(reading=name)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
