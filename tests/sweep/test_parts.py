"""Experiments in parts: a union of products, each with axes and scenes of its own."""

from __future__ import annotations

import hashlib
import json

import pytest
from sweep_files import SCENE, experiment, write

from mvla_sim.errors import ConfigError
from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_key
from mvla_sim.imaging.method import METHODS
from mvla_sim.settings import apply_overrides, parse
from mvla_sim.sweep.case import ROW_SCHEMA, case_key, setting_columns
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.run import run_experiment

PARTS = """
[[parts]]
name = "model"
axes = { kappa = [0.3, 0.5], eta = [0.02, 0.04, 0.06] }
[[parts]]
scenes = ["disc.toml"]
axes = { interval_deg = [60.0], offset = "all" }
"""
DISC = SCENE.replace('"box"', '"disc"').replace('"square"', '"circle"').replace("side_m = 2.0", "radius_m = 1.0")


def in_parts(folder, more=PARTS, axes="seed = [0, 1]\n", **others):
    file = write(folder, axes, more)
    (folder / "disc.toml").write_text(DISC)
    return load_experiment(file, **others)


def test_the_cases_are_the_union_of_the_products(tmp_path):
    plan = expand(in_parts(tmp_path))
    model, disc = ([c for c in plan.cases if c.values["part"] == name] for name in ("model", "2"))
    assert (len(model), len(disc), len(plan.cases)) == (2 * 6, 2 * 6, 24)
    assert [case.number for case in plan.cases] == list(range(24))
    assert {c.values["scene"] for c in model} == {"box"}
    assert {c.values["scene"] for c in disc} == {"disc"}
    assert {(c.imaging.mvla.kappa, c.imaging.mvla.eta, c.imaging.noise.seed) for c in model} == {
        (kappa, eta, seed) for kappa in (0.3, 0.5) for eta in (0.02, 0.04, 0.06) for seed in (0, 1)
    }
    assert [c.values["offset"] for c in disc[:6]] == list(range(6))
    assert set(plan.files) == {"box", "disc"}
    alone = expand(experiment(tmp_path, "seed = [0, 1]\nkappa = [0.3, 0.5]\neta = [0.02, 0.04, 0.06]\n"))
    assert [case.key for case in alone.cases] == [case.key for case in model]


def test_a_table_of_parts_has_a_column_for_them(tmp_path):
    table = run_experiment(
        in_parts(tmp_path, '[[parts]]\naxes = { method = ["bp"] }\n[[parts]]\naxes = { kappa = [0.3, 0.5] }\n', ""),
        tmp_path / "out",
        workers=0,
    )
    assert list(table["part"]) == ["1", "2", "2"]
    assert list(table["status"]) == ["done"] * 3
    assert table["method"].fillna("").tolist() == ["bp", "", ""]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("[[parts]]\naxes = { seed = [3] }\n", r"parts\[0\].axes: 'seed' is an axis of all parts already"),
        ('[[parts]]\naxes = { "noise.seed" = [3] }\n', "'noise.seed' is an axis of all parts already"),
        ('[[parts]]\nname = "a"\n[[parts]]\nname = "a"\n', "the name 'a' is used twice"),
        ('[[parts]]\nname = "2"\n[[parts]]\n', "the name '2' is used twice"),
        ("[[parts]]\nscenes = []\n", r"parts\[0\]\.scenes"),
        ("[[parts]]\naxes = { kapa = [3] }\n", r"parts\[0\]\.axes.*'kapa' names no setting"),
        ('[[parts]]\nscenes = ["missing.toml"]\n', "missing.toml"),
        ("[[parts]]\naxes = { kappa = [-1.0] }\n", "mvla.kappa = -1.0"),
        ('[[variants]]\nlabel = "a"\nset = { kappa = 1 }\n[[parts]]\naxes = { kappa = [1] }\n', "which is an axis"),
    ],
)
def test_bad_parts_are_refused(tmp_path, more, said):
    with pytest.raises((ConfigError, ValueError), match=said) as raised:
        expand(in_parts(tmp_path, more))
    assert "\n" not in str(raised.value)


def test_two_scenes_of_one_name_in_two_parts_are_refused(tmp_path):
    settings = in_parts(tmp_path)
    (tmp_path / "disc.toml").write_text(DISC.replace('"disc"', '"box"'))
    with pytest.raises(ConfigError, match="also the name of another scene"):
        expand(settings)


def test_calibration_with_parts_is_refused(tmp_path):
    run_experiment(in_parts(tmp_path, "[[parts]]\n", "seed = [0]\n"), tmp_path / "results" / "tiny", workers=0)
    other = experiment(tmp_path, "", '[calibration]\nfrom = "tiny"\n')
    with pytest.raises(ConfigError, match="has parts or a design"):
        expand(other, tmp_path / "results" / "other")


SWEPT = """
method = ["bp", "mlem"]
snr_db = ["none", 5]
"imaging.noise.kind" = ["exponential"]
"imaging.mlem.iterations" = [7]
"imaging.grid.spacing_m" = [0.2]
"evaluation.truth" = ["filled"]
"scene.objects.0.side_m" = [1.5]
"""


def test_settings_put_together_of_parts_are_those_validated_whole(tmp_path):
    """Each case's settings and key against the plain way: everything of a case in one go."""
    plan = expand(experiment(tmp_path, SWEPT))
    assert len(plan.cases) == 4
    for case in plan.cases:
        given = {key: value for key, value in case.values.items() if key != "scene"}
        own = [f"{name}={'none' if value is None else json.dumps(value)}" for name, value in given.items()]
        texts = [one for one in own if not one.startswith(("evaluation", "scene"))]
        base = {"grid": {"size_m": [4.0, 4.0, 0.0]}}
        whole = parse(ImagingSettings, apply_overrides(base, texts, imaging_key), "test")
        assert case.imaging == whole
        assert case.imaging.model_dump() == whole.model_dump()
        assert case.imaging.noise.model_fields_set == whole.noise.model_fields_set
        assert case.evaluation == EvaluationSettings(truth="filled")
        data = {
            "schema": ROW_SCHEMA,
            "channel": case.channel,
            "imaging": whole.model_dump(mode="json"),
            "evaluation": case.evaluation.model_dump(mode="json"),
        }
        plain = hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
        assert case.key == plain == case_key(case.channel, whole, case.evaluation)
        columns = setting_columns(case)
        assert columns["imaging.mlem.iterations"] == 7
        assert columns["scene.objects.0.side_m"] == 1.5


def test_methods_are_found_by_their_tables(tmp_path):
    """All of this package's, those without settings too."""
    assert {method.block_name() for method in METHODS.own()} == set(METHODS.tables())
    assert METHODS.block("mlem", "bp") is METHODS.find("mlem")
    assert METHODS.block("nothing", "bp") is None
