"""What is wrong with settings is one line that hides nothing."""

from __future__ import annotations

import pytest

import mvla_sim as mv
from mvla_sim.errors import ConfigError
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.settings import parse
from mvla_sim.sweep.experiment import dotted_key


def message(call):
    with pytest.raises(ConfigError) as caught:
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
        (lambda: mv.reconstruct("star.nc"), "channel: str is no channel; for a file: load_channel"),
        (lambda: mv.observe(None), "channel: NoneType is no channel"),
        (lambda: mv.reconstruct(None, "bp"), "settings: str is no ImagingSettings; see imaging_settings"),
        (lambda: mv.reconstruct(None, {"method": "bp"}), "settings: dict is no ImagingSettings"),
        (lambda: mv.simulate("star"), "scene: str is no scene; for a file: Scene.load"),
        (lambda: mv.import_channel("sweeps"), "settings: str is no ImportSettings; see import_settings"),
    ],
)
def test_what_is_no_such_object_is_told_with_what_makes_one(call, text):
    assert text in message(call)
