"""Impairments in sweeps: the same as one image at a time, and nothing else is touched."""

from __future__ import annotations

import pytest
from sweep_files import experiment

from mvla_sim.channel.simulate import simulate
from mvla_sim.evaluation.evaluate import EvaluationSettings, evaluate
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.pipeline import Pipeline, reconstruct
from mvla_sim.sweep.batch import load_profiles, run_batch
from mvla_sim.sweep.case import case_key
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.run import run_experiment
from mvla_sim.sweep.schedule import groups_of

CHANNEL = "c" * 32
VARIANTS = """
[[variants]]
label = "unimpaired"
[[variants]]
label = "position"
set = { "imaging.impairments.position_error_m" = 0.03 }
[[variants]]
label = "timing"
set = { "imaging.impairments.timing_offset_s" = 5e-10, "imaging.impairments.timing_jitter_s" = 2e-10 }
[[variants]]
label = "phase"
set = { "imaging.impairments.random_phase" = true }
[[variants]]
label = "missing"
set = { "imaging.impairments.missing_share" = 0.4 }
[[variants]]
label = "blocked"
set = { "imaging.impairments.blocked_sector_deg.1" = 90.0 }
[[variants]]
label = "clutter"
set = { "imaging.impairments.clutter_paths" = 4.0 }
"""
AXES = 'interval_deg = [20.0]\noffset = [1]\nmethod = ["mvla-gr", "bp"]\nseed = [0, 1]\n'
SECTOR = ("imaging.impairments.blocked_sector_deg=[0.0, 0.0]",)


@pytest.mark.parametrize(
    "values",
    [
        {"position_error_m": 0.01},
        {"timing_offset_s": 1e-9},
        {"timing_jitter_s": 1e-9},
        {"random_phase": True},
        {"missing_share": 0.1},
        {"blocked_sector_deg": [0.0, 10.0]},
        {"clutter_paths": 1.0},
        {"clutter_paths": 1.0, "clutter_db": 3.0},
        {"clutter_paths": 1.0, "seed": 3},
    ],
)
def test_every_impairment_is_in_the_key(values):
    idle = case_key(CHANNEL, imaging_settings(), EvaluationSettings())
    assert case_key(CHANNEL, imaging_settings(impairments=values), EvaluationSettings()) != idle
    plain = {name: value for name, value in values.items() if name not in ("clutter_db", "seed")}
    alike = case_key(CHANNEL, imaging_settings(impairments=plain), EvaluationSettings())
    assert (case_key(CHANNEL, imaging_settings(impairments=values), EvaluationSettings()) == alike) == (plain == values)


def test_cases_share_a_channel_unless_its_impairments_differ(tmp_path):
    plan = expand(experiment(tmp_path, AXES, VARIANTS, SECTOR))
    tasks = groups_of(plan, plan.cases, 1)
    assert sorted(case.number for task in tasks for case in task.cases) == list(range(28))
    shared = [task for task in tasks if not task.wanted.settings.impairments.of_channel(0)]
    assert [len(task.cases) for task in shared] == [12]  # unimpaired, missing, blocked
    assert len(tasks) == 1 + 4 * 2  # and each other one, once a seed
    offset = expand(experiment(tmp_path, AXES, overrides=("imaging.impairments.timing_offset_s=1e-9",)))
    assert len(groups_of(offset, offset.cases, 1)) == 1  # which draws nothing


def test_a_sweep_gives_exactly_what_one_image_at_a_time_gives(tmp_path):
    settings = experiment(tmp_path, AXES, VARIANTS, SECTOR)
    table = run_experiment(settings, tmp_path / "out", workers=0)
    plan = expand(settings)
    cir = simulate(next(iter(plan.sources.values())).scene)
    assert list(table["status"]) == ["done"] * 28
    for case, row in zip(plan.cases, table.to_dict("records"), strict=True):
        image = reconstruct(cir, case.imaging)
        assert row["views"] == image.n_view
        alone = evaluate(image, case.evaluation).as_dict()
        assert {name: row[name] for name in alone} == alone
    views = table.groupby("variant")["views"].first()
    assert (views["unimpaired"], views["missing"], views["blocked"]) == (18, 11, 14)  # 10°, 30°, 50° and 70° of 18
    scores = table[table["method"] == "mvla-gr"].groupby("variant")["cd_db"].mean()
    assert scores["phase"] == pytest.approx(scores["unimpaired"], abs=0.1)


def test_the_prepared_channel_knows_both_kinds_of_positions(tmp_path):
    plan = expand(experiment(tmp_path, 'seed = [0]\n"imaging.impairments.position_error_m" = [0.0, 0.05]\n'))
    for task in groups_of(plan, plan.cases, 1):
        task.source.make()
        channel = load_profiles(task.source.file, task.wanted)
        moved = abs(channel.views.positions_m - channel.true_views.positions_m).max() > 0
        assert moved == (task.cases[0].imaging.impairments.position_error_m > 0)
        assert [row.status for row in run_batch(Pipeline(channel), task.cases)] == ["done"]


def test_cases_without_a_view_fail_in_one_line_and_the_others_go_on(tmp_path):
    axes = 'method = ["mvla-gr"]\n"imaging.impairments.missing_share" = [1.0, 0.5]\n'
    axes += '"imaging.impairments.timing_offset_s" = [0.0, -1e-6]\n'
    table = run_experiment(experiment(tmp_path, axes), tmp_path / "out", workers=0)
    assert list(table["status"]) == ["failed", "failed", "done", "failed"]
    assert "none of the 36 chosen views is left" in table["error"][0]
    assert "none may be below 0" in table["error"][3]
    assert not table["error"].str.contains("\n").any()
