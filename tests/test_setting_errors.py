"""What is wrong with settings is one line that hides nothing."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mvla_sim as mv
from mvla_sim.errors import ConfigError, MvlaError
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.methods import functions
from mvla_sim.settings import parse
from mvla_sim.sweep.axes import dotted_key

GRID = mv.VoxelGrid((0.0, 0.0, 0.0), (4, 4, 1), 0.1)
IMAGE = mv.Image(np.zeros(GRID.shape, np.float32), None, GRID, "bp", 1)
FUNCTIONS = [name for name in mv.__all__ if inspect.isfunction(getattr(mv, name))]


def message(call, kind=ConfigError):
    with pytest.raises(kind) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_an_unknown_key_is_told_every_allowed_one():
    """However many there are: the sixteenth may be the one that was meant."""
    text = message(lambda: parse(ImagingSettings, {"xyzzy": 1}, "a.toml"))
    assert text.startswith("a.toml: xyzzy: unknown key; allowed: ")
    assert set(ImagingSettings.model_fields) <= set(text.partition("allowed: ")[2].split(", "))
    assert "more" not in text


@pytest.mark.parametrize("count", [1, 2, 3])
def test_several_errors_are_counted(count):
    wrong = ["pdp.oversampling=0", "peaks.threshold_sigma=-1", "mvla.kappa=0"][:count]
    text = message(lambda: imaging_settings(wrong))
    assert "pdp.oversampling = 0" in text
    assert text.endswith(f" [the first of {count} errors]") == (count > 1)


@pytest.mark.parametrize(
    ("key", "meant"),
    [("snr", "noise.snr_db"), ("kapa", "mvla.kappa"), ("interval", "views.interval_deg"), ("nose", "noise")],
)
def test_a_key_may_be_meant_one_table_further_in(key, meant):
    assert f"{key}: unknown key (did you mean '{meant}'?); allowed: " in message(lambda: imaging_settings(**{key: 1}))


@pytest.mark.parametrize("name", ["extent_m", "mvla.extent_m", "imaging.mvla.extent_m"])
def test_a_setting_has_the_same_names_everywhere(name):
    """In Python, with --set, and as the axis of an experiment."""
    assert imaging_settings(**{name: 4.0}).mvla.extent_m == 4
    assert imaging_settings([f"{name}=4.0"]).mvla.extent_m == 4
    assert dotted_key(name) == "imaging.mvla.extent_m"


def test_settings_cannot_be_changed():
    """What was made from them would not be what they say."""
    for settings in (mv.Star(), mv.PdpSettings(), mv.imaging_settings()):
        name = next(iter(type(settings).model_fields))
        assert f"{name} cannot be changed" in message(lambda settings=settings, name=name: setattr(settings, name, 1))


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: mv.reconstruct("star.nc"), "channel: str is no Channel; for a file: load_channel"),
        (lambda: mv.observe(None), "channel: NoneType is no Channel"),
        (lambda: mv.reconstruct(None, "bp"), "settings: str is no ImagingSettings; see imaging_settings"),
        (lambda: mv.reconstruct(None, {"method": "bp"}), "settings: dict is no ImagingSettings"),
        (lambda: mv.simulate("star"), "scene: str is no Scene; for a file: Scene.load"),
        (lambda: mv.import_channel("sweeps"), "settings: str is no ImportSettings; see import_settings"),
        (lambda: mv.evaluate(mv.Horn(azimuth_beamwidth_deg=9)), "image: Horn is no Image; see reconstruct"),
        (lambda: mv.evaluate(IMAGE, {"truth": "filled"}), "settings: dict is no EvaluationSettings"),
        (lambda: mv.plot_image("star.image.nc"), "image: str is no Image; see reconstruct"),
        (lambda: mv.plot_image(IMAGE, [[True]]), "truth: list is no ndarray; an array [nz, ny, nx] of bool"),
        (lambda: mv.plot_comparison([IMAGE], [None], [3], ["bp"]), "occupied: int is no ndarray"),
        (lambda: mv.plot_comparison(IMAGE, [None], [3], ["bp"]), "images: Image is no list"),
        (lambda: mv.plot_curves({"x": [1]}, "x", "y"), "table: dict is no DataFrame; see load_table"),
        (lambda: mv.compute_pdp(IMAGE, mv.PdpSettings(), (1, 2)), "channel: Image is no Cir or FrequencyResponse"),
        (lambda: mv.bounding_box([True], GRID), "occupied: list is no ndarray"),
        (lambda: mv.imaging_settings("method=bp"), "overrides: str is no list or tuple; dotted.key=value texts"),
        (lambda: mv.load_scene("star", [3]), "overrides: int is no str; dotted.key=value texts"),
        (lambda: mv.list_settings(mv.Star), "words: ModelMetaclass is no str; a group or a part of a key"),
    ],
)
def test_what_is_no_such_object_is_told_with_what_makes_one(call, text):
    assert text in message(call)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("value", [3, object()], ids=["number", "object"])
def test_no_public_function_raises_raw_errors_for_arguments_of_a_wrong_kind(name, value, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    function = getattr(mv, name)
    parameters = list(inspect.signature(function).parameters.values())
    needed = [one for one in parameters if one.default is one.empty and one.kind is one.POSITIONAL_OR_KEYWORD]
    if name == "import_settings":  # has no first argument that it must have, and takes any name of a source
        assert "no such file or folder" in message(lambda: mv.import_channel(function(value)), MvlaError)
        return
    message(lambda: function(*[value] * max(1, len(needed))), MvlaError)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "call",
    [
        lambda: mv.build_dataset("benchmark-small", 3),
        lambda: mv.run_experiment(mv.load_experiment("star-optimal"), 3),
        lambda: mv.score_dataset(Path(), output=3),
        lambda: mv.export_image(IMAGE, 3),
        lambda: mv.process(mv.load_process("vehicle"), 3),
    ],
)
def test_what_is_no_name_of_a_file_is_told(call):
    assert message(call, MvlaError) == "int is no name of a file or folder; give text or a Path"


@pytest.mark.parametrize("value", [pd.DataFrame(), None])
def test_figures_are_saved_of_figures_alone(value, tmp_path):
    assert "figure: " in message(lambda: mv.save_figure(value, tmp_path / "a.png"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "method.py cannot be read (No such file or directory)"),
        ("def image(seen, profiles=1): pass", "'profiles' is taken; give that parameter another name"),
        ("def other(seen): pass", "the file has no function 'image'"),
        ("1 / 0", "method.py cannot be imported (ZeroDivisionError: division by zero)"),
        ("def image(seen, a: 'nothing' = 1): pass", "its parameters cannot be told (NameError: name 'nothing'"),
    ],
)
@pytest.mark.parametrize("make", [imaging_settings, ImagingSettings], ids=["short", "class"])
def test_what_is_wrong_with_a_file_of_a_method_is_told_once(tmp_path, text, told, make):
    file = tmp_path / "method.py"
    if text is not None:
        file.write_text(text)
    line = message(lambda: make(method=str(file)))
    assert told in line
    assert line.count(f"method = '{file}'") == 1
    assert f"method = '{file}': " in message(lambda: functions.of_file(str(file)))  # also where no settings are read
