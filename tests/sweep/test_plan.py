"""From axes to cases, and everything that is refused before anything runs."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from sweep_files import SCENE, experiment, write

from mvla_sim.errors import ConfigError
from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.view_selection import select_views
from mvla_sim.sweep.case import Case, setting_columns
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.schedule import case_seconds, groups_of


def keys(folder, axes, *overrides, **others):
    return {case.key for case in expand(experiment(folder, axes, overrides=overrides), **others).cases}


def case_of(**values):
    """A case of such imaging settings, on a grid so fine that projecting takes the most of its time."""
    settings = imaging_settings(**({"spacing_m": 0.02} | values))
    return Case(0, None, settings, EvaluationSettings(), "", "", {})


def test_cases_are_the_product_in_the_order_of_the_file(tmp_path):
    plan = expand(experiment(tmp_path, 'seed = [3, 1]\nmethod = ["bp", "mvla-gr"]\nsnr_db = ["none", 5.0]\n'))
    found = [(c.values["seed"], c.values["method"], c.values["snr_db"]) for c in plan.cases]
    assert found == [(s, m, d) for s in (3, 1) for m in ("bp", "mvla-gr") for d in (None, 5.0)]
    assert [case.number for case in plan.cases] == list(range(8))
    for case, (seed, method, snr) in zip(plan.cases, found, strict=True):
        assert (case.imaging.noise.seed, case.imaging.method, case.imaging.noise.snr_db) == (seed, method, snr)
    assert len({case.key for case in plan.cases}) == 8


def test_all_offsets_cover_every_view_of_every_interval_once(tmp_path):
    plan = expand(experiment(tmp_path, 'interval_deg = [10.0, 20.0, 60.0]\noffset = "all"\n'))
    assert len(plan.cases) == 1 + 2 + 6
    scene = plan.sources[plan.cases[0].channel]
    for interval in (10.0, 20.0, 60.0):
        chosen = [
            select_views(scene.views, c.imaging.views) for c in plan.cases if c.values["interval_deg"] == interval
        ]
        assert sorted(np.concatenate(chosen)) == list(range(36))
        assert [c.values["offset"] for c in plan.cases if c.values["interval_deg"] == interval] == list(
            range(len(chosen))
        )


def test_all_offsets_follow_the_spacing_of_each_scene(tmp_path):
    axes = 'offset = "all"\n"scene.trajectory.interval_deg" = [5.0, 10.0]\n'
    plan = expand(experiment(tmp_path, axes, overrides=("imaging.views.interval_deg=30",)))
    counts = [c.scene.trajectory.interval_deg for c in plan.cases]
    assert (counts.count(5.0), counts.count(10.0)) == (6, 3)
    assert len(plan.sources) == 2


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ("kapa = [1.0]", "'kapa' names no setting"),
        ('"imaging.noise.snr" = [1.0]', "noise.snr: unknown key"),
        ('"scene.objects.0.radius_m" = [1.0]', "unknown key"),
        ('"scene.objects.7.height_m" = [1.0]', "not an element"),
        ("kappa = []", "'kappa' is empty"),
        ("kappa = [0.5, 1, 0.5]", "'kappa' has 0.5 twice"),
        ("seed = [1, 1.0]", "'seed' has 1.0 twice"),
        ('kappa = [0.5]\n"imaging.mvla.kappa" = [1.0]', "name the same setting"),
        ("kappa = 0.5", "axes.kappa"),
        ("kappa = [-1.0]", "mvla.kappa = -1.0"),
        ("seed = [0.5]", "noise.seed = 0.5"),
        ("interval_deg = [7.0]", "does not divide"),
        ("interval_deg = [20.0]\noffset = [0, 2]", "allowed: 0 to 1"),
        ("offset = [1]", "needs views.interval_deg"),
        ('offset = ["all", 1]', "'all' and other values"),
    ],
)
def test_an_axis_that_cannot_be_is_refused(tmp_path, axes, said):
    with pytest.raises(ConfigError, match=said) as raised:
        expand(experiment(tmp_path, axes))
    assert "\n" not in str(raised.value)


def test_views_that_are_not_evenly_spaced_have_no_offsets(tmp_path):
    scene = SCENE.replace(
        "radius_m = 5.0\ninterval_deg = 10.0", "kind = 'positions'\npositions_m = [[5, 0, 0], [0, 5, 0], [1, 5, 0]]"
    )
    file = write(tmp_path, 'offset = "all"\ninterval_deg = [10.0]', scene=scene.replace("'", '"'))
    with pytest.raises(ConfigError, match="not evenly spaced"):
        expand(load_experiment(file))


def test_the_limit_counts_offsets_and_can_be_lifted(tmp_path):
    settings = experiment(tmp_path, 'interval_deg = [10.0, 60.0]\noffset = "all"\nseed = [0, 1, 2]\n')
    assert len(expand(settings, limit=21).cases) == 21
    with pytest.raises(ConfigError, match=r"21 cases; above 20 shorten the axes"):
        expand(settings, limit=20)
    with pytest.raises(ConfigError, match=r"at least 6 cases"):
        expand(settings, limit=3)
    assert len(expand(settings, limit=None).cases) == 21


def test_a_huge_product_is_refused_at_once(tmp_path):
    axes = "".join(f'"imaging.mvla.{name}" = {list(range(1, 1001))}\n' for name in ("kappa", "eta", "tolerance_m"))
    with pytest.raises(ConfigError, match="1,000,000,000 cases"):
        expand(experiment(tmp_path, axes))


def test_keys_are_the_same_in_another_process(tmp_path):
    file = write(tmp_path)
    program = (
        "import sys; from mvla_sim.sweep.experiment import load_experiment as l;"
        "from mvla_sim.sweep.plan import expand;"
        "print(*[c.key for c in expand(l(sys.argv[1])).cases])"
    )
    child = subprocess.run(
        [sys.executable, "-c", program, str(file)],
        env={**os.environ, "PYTHONHASHSEED": "7"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert child.stdout.split() == [case.key for case in expand(load_experiment(file)).cases]


@pytest.mark.parametrize(
    "override",
    [
        "imaging.mvla.kappa=0.6",
        "imaging.grid.spacing_m=0.2",
        "imaging.noise.kind=complex",
        "evaluation.truth=filled",
        "evaluation.distances_m=[0.2]",
    ],
)
def test_keys_cover_every_stage(tmp_path, override):
    assert keys(tmp_path, "seed = [0]").isdisjoint(keys(tmp_path, "seed = [0]", override))


def test_keys_cover_the_scene_but_not_its_name(tmp_path):
    first = keys(tmp_path, "seed = [0]")
    file = write(tmp_path, "seed = [0]", scene=SCENE.replace('"box"', '"carton"'))
    assert {case.key for case in expand(load_experiment(file)).cases} == first
    file = write(tmp_path, "seed = [0]", scene=SCENE.replace("side_m = 2.0", "side_m = 2.1"))
    assert {case.key for case in expand(load_experiment(file)).cases}.isdisjoint(first)


def test_added_values_leave_the_keys_of_others(tmp_path):
    assert keys(tmp_path, "seed = [0, 1]") < keys(tmp_path, "seed = [5, 1, 0]")


def test_two_scenes_of_one_name_are_refused(tmp_path):
    file = write(tmp_path)
    (tmp_path / "other.toml").write_text(SCENE)
    file.write_text(file.read_text().replace('["box.toml"]', '["box.toml", "other.toml"]'))
    with pytest.raises(ConfigError, match="also the name"):
        expand(load_experiment(file))


def test_show_must_name_an_axis(tmp_path):
    with pytest.raises(ConfigError, match="'kapa' is no axis"):
        experiment(tmp_path, more="[[show]]\nkapa = 1\n")


def test_batches_hold_every_case_once_and_share_front_ends(tmp_path):
    plan = expand(
        experiment(tmp_path, 'seed = [0, 1, 2]\nmethod = ["bp", "mvla-gr"]\n"imaging.pdp.oversampling" = [4, 8]')
    )
    tasks = groups_of(plan, plan.cases, workers=3)
    assert len(tasks) == 2  # one for each oversampling
    assert sorted(case.number for task in tasks for case in task.cases) == list(range(12))
    for task in tasks:
        seeds = [case.values["seed"] for case in task.cases]
        assert seeds == sorted(seeds)  # cases of one noise follow each other


VARIANTS = """
[[variants]]
label = "default"
[[variants]]
label = "rough"
set = { "scene.objects.0.scattering_coefficient" = 0.3 }
[[variants]]
label = "deaf"
set = { threshold_sigma = 9.0 }
"""


def test_each_variant_is_the_whole_product_with_its_settings(tmp_path):
    plan = expand(experiment(tmp_path, more=VARIANTS))
    assert [case.number for case in plan.cases] == list(range(24))
    by_label = {
        label: [c for c in plan.cases if c.values["variant"] == label] for label in ("default", "rough", "deaf")
    }
    assert {len(cases) for cases in by_label.values()} == {8}
    assert {c.scene.objects[0].scattering_coefficient for c in by_label["rough"]} == {0.3}
    assert {c.imaging.peaks.threshold_sigma for c in by_label["deaf"]} == {9.0}
    assert {c.key for c in by_label["default"]} == keys(
        tmp_path, "interval_deg = [10.0, 30.0]\nmethod = ['mvla-gr', 'bp']\nseed = [0, 1]\n"
    )
    assert len({c.channel for c in plan.cases}) == 2  # only the rough one is another channel
    assert set(plan.sources) == {c.channel for c in plan.cases}


def test_variants_may_be_in_a_file_of_their_own(tmp_path):
    (tmp_path / "others.toml").write_text(VARIANTS)
    file = write(tmp_path)
    file.write_text('variants = "others.toml"\n' + file.read_text())
    assert len(expand(load_experiment(file)).cases) == 24


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('[[variants]]\nlabel = "a"\n[[variants]]\nlabel = "a"\n', "label 'a' is used twice"),
        ('[[variants]]\nlabel = "a"\nset = { colour = 1 }\n', "'colour' names no setting"),
        ('[[variants]]\nlabel = "a"\nset = { seed = 1 }\n', "sets imaging.noise.seed, which is an axis"),
        ('[[variants]]\nlabel = "a"\nset = { "imaging.peaks.sigma" = 1 }\n', "sigma.*unknown key"),
    ],
)
def test_bad_variants_are_refused(tmp_path, more, message):
    with pytest.raises(ConfigError, match=message):
        expand(experiment(tmp_path, more=more))


@pytest.mark.parametrize(("method", "block"), [("mlem", "mlem"), ("nnls", "nnls"), ("mvla-em", "em"), ("carving", "")])
def test_the_estimate_of_time_knows_the_iterations_of_a_method(method, block):
    """Ten times the steps take about ten times as long, and a hundred projections longer than one."""
    once = case_seconds(case_of(method="bp"), 36)
    if not block:  # it projects twice and has no steps
        assert case_seconds(case_of(method=method), 36) > once
        return
    few, many = (case_seconds(case_of(method=method, **{f"{block}.iterations": n}), 36) for n in (100, 1000))
    assert few > once
    assert many / few == pytest.approx(10, rel=0.3)


def test_the_estimate_of_time_grows_with_views_and_voxels():
    whole = case_seconds(case_of(), 360)
    assert case_seconds(case_of(interval_deg=10.0), 360) < whole
    assert case_seconds(case_of(spacing_m=0.05), 360) < whole


def test_settings_of_a_function_on_the_method_axis(tmp_path):
    """Its table is no other method's, and each case has it in its columns."""
    (tmp_path / "mine.py").write_text("def sharper(seen, power: float = 2.0):\n    return seen.range_m(0)\n")
    name = f"{tmp_path / 'mine.py'}:sharper"
    plan = expand(experiment(tmp_path, f"method = ['bp', '{name}']\n", more="[imaging.sharper]\npower = 3.0\n"))
    assert [case.imaging.method for case in plan.cases] == ["bp", name]
    assert plan.cases[1].imaging.chosen.power == 3.0
    with pytest.raises(ConfigError, match=r"sharper\.pwr: unknown key"):
        experiment(tmp_path, f"method = ['bp', '{name}']\n", more="[imaging.sharper]\npwr = 3.0\n")


def test_bounds_of_the_scan_are_swept_and_are_columns(tmp_path):
    """Which they are not of the same case: another bound may have another optimum."""
    plan = expand(experiment(tmp_path, '"evaluation.scan.max_area_m2" = ["none", 1.0, 0.5]\n'))
    columns = [setting_columns(case)["evaluation.scan.max_area_m2"] for case in plan.cases]
    assert columns == [None, 1.0, 0.5]
    assert len({case.key for case in plan.cases}) == 3


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ('"scan.max_area_m2" = [1.0, 0.009]\n', r"max_area_m2 = 0\.009: is below one voxel .* at least 0\.01 m²"),
        (
            '"scan.max_percent" = [0.1]\n"grid.spacing_m" = [0.1, 0.2]\n',
            r"max_percent = 0\.1: is below one voxel .* at least 0\.25 %",
        ),
        (
            '"scan.max_area_m2" = [0.1]\n"scan.step_percent" = [1.0]\n',
            r"max_area_m2 = 0\.1: is below one step of 1 %; must be at least 0\.16 m²",
        ),
        ('"evaluation.thickness_m" = [0.1]\n"evaluation.truth" = ["filled"]\n', r"thickness_m = 0\.1: is of a contour"),
    ],
)
def test_an_evaluation_that_cannot_be_is_refused_before_anything_runs(tmp_path, axes, said):
    with pytest.raises(ConfigError, match=said) as error:
        expand(experiment(tmp_path, axes))
    assert "\n" not in str(error.value)
