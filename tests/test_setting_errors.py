"""What is wrong with settings is one line that hides nothing."""

from __future__ import annotations

import pytest

from mvla_sim.errors import ConfigError
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.settings import parse


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
