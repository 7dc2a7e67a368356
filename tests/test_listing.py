"""The list of settings is read from the classes: whole, with meanings, and each key in it is one that is accepted."""

from __future__ import annotations

import re
import tomllib

import pytest

import mvla_sim as mv
from mvla_sim.cli import options
from mvla_sim.cli.app import run
from mvla_sim.errors import ConfigError
from mvla_sim.listing import GROUPS, list_settings
from mvla_sim.settings import apply_overrides, parse

ALL = list_settings()


def keys(group):
    return {entry.key for entry in ALL if entry.group == group}


def meaning_of(key):
    return next(entry.meaning for entry in ALL if entry.key == key)


def test_what_was_left_out_is_listed():
    assert {"plane_height_m", "objects.0.radius_m", "trajectory.kind", "trajectory.radius_m", "trajectory.axis_m",
            "radio.antenna.floor_db", "ray_tracing.diffuse_rays"} <= keys("scene")  # fmt: skip
    assert {"axes", "variants.0.label", "calibration.rule", "show", "imaging"} <= keys("experiment")
    assert {"measurement.scene", "import", "smallest_part", "export"} <= keys("process")
    assert {"families.0.size_m", "trajectory.span_deg", "samples_per_shard"} <= keys("campaign")
    assert {"method", "peaks.threshold_sigma", "carving.margin", "noise.snr_db"} <= keys("imaging")
    assert {entry.group for entry in ALL} == set(GROUPS)


def test_every_setting_says_what_it_means():
    """A field without a description is a row that says nothing, or of which kinds it is alone."""
    names = r"[\w-]+(, [\w-]+)*"
    mute = [entry.key for entry in ALL if re.fullmatch(rf"(({names})?(: )?(or a distribution)?)", entry.meaning)]
    assert [key for key in mute if not key.endswith((".kind", ".rule"))] == []


def test_a_filter_takes_groups_and_parts_of_keys():
    assert {entry.group for entry in mv.list_settings("scene")} == {"scene"}
    assert mv.list_settings("scene") == [entry for entry in ALL if entry.group == "scene"]
    assert {entry.key.partition(".")[0] for entry in list_settings("peaks")} == {"peaks"}
    assert [entry.key for entry in list_settings("imaging", "snr")] == ["noise.snr_db"]
    with pytest.raises(ConfigError, match="'peeks'; did you mean 'peaks'"):
        list_settings("peeks")
    with pytest.raises(ConfigError, match="groups are scene, imaging"):
        list_settings("zzzz")


def test_defaults_are_toml():
    for entry in ALL:
        if entry.default:
            tomllib.loads(f"value = {entry.default}")


@pytest.mark.parametrize("group", ["imaging", "evaluation"])
def test_each_default_is_accepted_under_its_key(group):
    tags = {key.rpartition(".")[0]: key for key in keys(group) if key.endswith((".kind", ".rule"))}
    for entry in list_settings(group):
        if entry.default not in ("", '"none"'):
            kind, tag = re.match(r"[\w-]+", entry.meaning), tags.get(entry.key.rpartition(".")[0])
            own = [f"{tag}={kind[0]}"] if tag and ": " in entry.meaning and kind[0] in meaning_of(tag) else []
            parse(GROUPS[group], apply_overrides({}, [*own, f"{entry.key}={entry.default}"]), entry.key)


@pytest.mark.parametrize("columns", [60, 200])
def test_the_command_cuts_nothing(capsys, monkeypatch, columns):
    """Neither long keys nor what stands in brackets, in a terminal of any width or a pipe."""
    monkeypatch.setattr(options.out, "_width", columns)
    assert run(["settings"]) == 0
    text = capsys.readouterr().out
    assert "…" not in text
    for entry in ALL:
        assert entry.key in text
        assert entry.meaning in text
    assert re.search(r"\[from, to\]: views", text)
    assert run(["settings", "scene", "trajectory"]) == 0
    assert "noise" not in capsys.readouterr().out


def test_a_method_of_a_file_is_listed(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def image(seen, level: float = 2.0):\n    return seen.grid\n")
    assert list_settings(str(file)) == [("imaging", "mine.level", "2.0", "")]
    with pytest.raises(ConfigError, match=r"no\.py cannot be read"):
        list_settings(str(tmp_path / "no.py"))
