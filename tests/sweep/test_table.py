"""Tables, and thresholds calibrated with them."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sweep_files import experiment

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.evaluation.candidates import SUPPORTS_DEG, TOP_PERCENTS, pack_table, unpack_table
from mvla_sim.sweep.calibration import average_thresholds, least_mean_thresholds
from mvla_sim.sweep.case import MAP, Row
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.table import averaged, build_table, load_table, write_table

METRICS = {"views": 36, "protocol": "optimal", "top_percent": 2.5, "min_support_deg": 0.0, "cd_db": -math.inf}


def plan_and_rows(folder, axes='seed = [0, 1, 2]\nsnr_db = ["none", 5.0]\n'):
    plan = expand(experiment(folder, axes))
    rows = [Row(case.key, "done", "", 0.5, METRICS | {"cd_db": 0.1 * case.number}) for case in plan.cases]
    return plan, {row.key: row for row in rows}


def test_one_row_a_case_and_every_setting_and_metric_a_column(tmp_path):
    plan, rows = plan_and_rows(tmp_path)
    table = build_table(plan.cases, rows)
    assert list(table.columns[:8]) == ["case", "key", "status", "error", "seconds", "scene", "seed", "snr_db"]
    assert list(table.columns[-5:]) == list(METRICS)
    assert list(table["case"]) == list(range(6))
    assert list(table["imaging.noise.seed"]) == [0, 0, 1, 1, 2, 2]
    assert table["imaging.grid.spacing_m"].eq(0.1).all()
    assert table["scene.ray_tracing.diffuse_rays"].eq(300).all()
    assert table["scene.objects.0.side_m"].eq(2.0).all()
    assert table["snr_db"].isna().tolist() == [True, False] * 3


def test_failed_and_missing_cases_are_rows_too(tmp_path):
    plan, rows = plan_and_rows(tmp_path)
    rows[plan.cases[0].key] = Row(plan.cases[0].key, "failed", "DataError: no, really", 0.1)
    del rows[plan.cases[4].key]
    table = build_table(plan.cases, rows)
    assert list(table["status"]) == ["failed", "done", "done", "done", "missing", "done"]
    assert list(table["error"]) == ["DataError: no, really", "", "", "", "", ""]
    assert table["cd_db"].isna().tolist() == [True, False, False, False, True, False]


def test_nothing_stored_is_a_table_of_missing_cases(tmp_path):
    plan, _ = plan_and_rows(tmp_path)
    assert list(build_table(plan.cases, {})["status"]) == ["missing"] * 6


def test_a_table_comes_back_from_its_file(tmp_path):
    plan, rows = plan_and_rows(tmp_path)
    rows[plan.cases[1].key] = Row(plan.cases[1].key, "done", "", 0.5, METRICS | {"cd_db": -math.inf})
    rows[plan.cases[2].key] = Row(plan.cases[2].key, "failed", 'DataError: "a", b', 0.1)
    table = build_table(plan.cases, rows)
    files = write_table(table, tmp_path)
    assert files[0] == tmp_path / "table.csv"
    # An empty column has no type in CSV, and numbers have nine digits there.
    pd.testing.assert_frame_equal(load_table(tmp_path), table, check_dtype=False, rtol=1e-8)


def test_parquet_holds_the_same_table(tmp_path):
    plan, rows = plan_and_rows(tmp_path)
    table = build_table(plan.cases, rows)
    (tmp_path / "table.parquet").write_bytes(b"of an earlier run")
    files = write_table(table, tmp_path)
    pd.testing.assert_frame_equal(pd.read_parquet(files[1]), table, check_dtype=False)
    files[0].unlink()
    pd.testing.assert_frame_equal(load_table(tmp_path), table, check_dtype=False)


@pytest.mark.parametrize("content", [None, "", "a,b\n1,2\n", "\x00\xff"])
def test_what_is_no_table_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "table.csv").write_bytes(content.encode("latin-1"))
    with pytest.raises(DataError, match=r"table\.csv"):
        load_table(tmp_path)


def test_calibration_weighs_every_interval_the_same():
    """By hand: one offset and two seeds at 10°, means 2 and 15; two offsets at 30°, means 5 and 60; so 3.5 and 37.5."""
    rows = [
        (10.0, 0, 0, 1.0, 10.0),
        (10.0, 0, 1, 3.0, 20.0),
        (30.0, 0, 0, 4.0, 30.0),
        (30.0, 0, 1, 4.0, 50.0),
        (30.0, 1, 0, 6.0, 70.0),
        (30.0, 1, 1, 6.0, 90.0),
    ]
    columns = ["interval_deg", "offset", "seed", "top_percent", "min_support_deg"]
    table = pd.DataFrame([("bp", *row) for row in rows], columns=["method", *columns])
    found = average_thresholds(table, ["method"], ["interval_deg", "offset", "seed"])
    assert found.to_dict("records") == [{"method": "bp", "top_percent": 3.5, "min_support_deg": 37.5}]


def packed(least, *, rows=1):
    """A map of 0 dB everywhere but at (row, column): dB."""
    table = np.zeros((rows, len(TOP_PERCENTS)), np.float32)
    for place, value in least.items():
        table[place] = value
    return pack_table(table)


def test_least_mean_weighs_every_interval_the_same():
    """By hand, means over 10° and 30°: −4.5 and 0 of p₅, 0 and −4 of p₆, −3 and −3.06 of p₇."""
    table = pd.DataFrame({"method": "bp", "interval_deg": [10.0, 30.0, 30.0], "key": list("abc")})
    maps = {
        "a": packed({(0, 5): -9, (0, 7): -6}),
        "b": packed({(0, 6): -16, (0, 7): -6.0}),
        "c": packed({(0, 7): -6.25}),
    }
    found = least_mean_thresholds(table, maps, ["method"], ["interval_deg", "offset"])
    assert found.to_dict("records") == [{"method": "bp", "top_percent": TOP_PERCENTS[7], "min_support_deg": 0.0}]
    maps["b"] = packed({(0, 6): -25})  # −12.5 at 30°, −6.25 of both intervals
    found = least_mean_thresholds(table, maps, ["method"], ["interval_deg", "offset"])
    assert found["top_percent"].tolist() == [TOP_PERCENTS[6]]
    with pytest.raises(DataError, match="has no map of thresholds"):
        least_mean_thresholds(table, {"a": maps["a"]}, ["method"], ["interval_deg"])
    maps["b"] = packed({}, rows=len(SUPPORTS_DEG))
    for over in (["interval_deg"], ["method", "interval_deg"]):
        with pytest.raises(DataError, match="no thresholds in common"):
            least_mean_thresholds(table, maps, [], over)
    maps["b"] = "AAAA"
    with pytest.raises(DataError, match=r"maps\.parquet, case b: not a packed table"):
        least_mean_thresholds(table, maps, ["method"], ["interval_deg"])


@pytest.mark.parametrize("text", ["", "!", "AAAA", pack_table(np.zeros((3, len(TOP_PERCENTS)), np.float32))])
def test_a_damaged_map_is_one_line(text):
    with pytest.raises(DataError, match="not a packed table"):
        unpack_table(text)


def test_maps_survive_packing():
    table = np.random.default_rng(0).uniform(-60, 30, (len(SUPPORTS_DEG), len(TOP_PERCENTS))).astype(np.float32)
    np.testing.assert_allclose(unpack_table(pack_table(table)), table, atol=0.005 + 1e-6)


def source(folder, **changes):
    """A finished experiment 'first' beside others: p is 1 + the SNR for BP, 2 + the SNR for MVLA-GR."""
    axes = 'interval_deg = [10.0, 30.0]\noffset = "all"\nseed = [0, 1]\nsnr_db = ["none", 5.0]\n'
    axes += 'method = ["bp", "mvla-gr"]\n'
    plan = expand(experiment(folder, axes))
    rows = {}
    for case in plan.cases:
        voting = case.values["method"] != "bp"
        percent = 1 + voting + (case.values["snr_db"] or 0.0)
        metrics = METRICS | {"top_percent": percent, "min_support_deg": 30.0 * voting} | changes
        rows[case.key] = Row(case.key, "done", "", 0.5, metrics)
    (folder / "results" / "first").mkdir(parents=True)
    write_table(build_table(plan.cases, rows), folder / "results" / "first")
    record = {"settings": plan.experiment.model_dump(mode="json")}
    (folder / "results" / "first" / "experiment.json").write_text(json.dumps(record))
    return plan, rows


CALIBRATION = '[calibration]\nfrom = "first"\n'
SECOND = 'snr_db = [5.0, "none"]\ninterval_deg = [20.0, 30.0]\nmethod = ["mvla-gr", "bp"]\n'


def test_calibrated_cases_use_the_averages_of_the_other_experiment(tmp_path):
    source(tmp_path)
    plan = expand(experiment(tmp_path, SECOND, CALIBRATION), tmp_path / "results" / "second")
    found = {
        (case.values["snr_db"], case.values["method"], case.values["interval_deg"]): case.evaluation.threshold
        for case in plan.cases
    }
    assert len(found) == 8
    for (snr, method, _), threshold in found.items():
        assert threshold.top_percent == pytest.approx(1 + (method != "bp") + (snr or 0.0))  # a mean of equal numbers
        assert threshold.min_support_deg == (0.0 if method == "bp" else 30.0)


def test_a_fixed_setting_stands_for_the_axis_of_the_other_experiment(tmp_path):
    source(tmp_path)
    overrides = ("imaging.noise.snr_db=5.0", "imaging.method=bp")
    plan = expand(experiment(tmp_path, "seed = [0]\n", CALIBRATION, overrides), tmp_path / "results" / "second")
    assert plan.cases[0].evaluation.threshold.top_percent == 6.0


def test_calibrated_keys_follow_the_thresholds(tmp_path):
    source(tmp_path / "a")
    source(tmp_path / "b", top_percent=9.0)
    keys = [
        {c.key for c in expand(experiment(tmp_path / x, SECOND, CALIBRATION), tmp_path / x / "results" / "s").cases}
        for x in ("a", "b")
    ]
    assert len(keys[0]) == 8
    assert keys[0].isdisjoint(keys[1])


HELD_OUT = CALIBRATION + 'over = ["interval_deg", "offset", "seed", "scene"]\n'


def test_held_out_thresholds_are_those_of_the_scenes_named(tmp_path):
    """The other experiment gets a second scene with p one higher; each alone, and both, have the averages by hand."""
    source(tmp_path)
    table = load_table(tmp_path / "results" / "first")
    other = table.assign(scene="star", top_percent=table["top_percent"] + 1, key="other-" + table["key"])
    write_table(pd.concat([table, other]), tmp_path / "results" / "first")
    for scenes, more in (("", 0.5), ('scenes = ["box"]\n', 0.0), ('scenes = ["star"]\n', 1.0)):
        plan = expand(experiment(tmp_path, SECOND, HELD_OUT + scenes), tmp_path / "results" / "second")
        for case in plan.cases:
            expected = 1 + (case.values["method"] != "bp") + (case.values["snr_db"] or 0.0) + more
            assert case.evaluation.threshold.top_percent == pytest.approx(expected)


@pytest.mark.parametrize("name", ["interval_deg", "views.interval_deg"])
def test_only_cases_of_the_values_named_count(tmp_path, name):
    """At 10° the other experiment gets a p of 6 more and a T_θ of 12 more; the mean over both has half of that."""
    source(tmp_path)
    table = load_table(tmp_path / "results" / "first")
    at_10 = table["interval_deg"] == 10.0
    table["top_percent"] += 6 * at_10
    table["min_support_deg"] += 12 * at_10
    write_table(table, tmp_path / "results" / "first")
    for values, part in (("", 0.5), ("[30]", 0.0), ("[10.0]", 1.0), ("[10, 30]", 0.5)):
        chosen = f'where = {{ "{name}" = {values} }}\n' if values else ""
        for case in expand(experiment(tmp_path, SECOND, CALIBRATION + chosen), tmp_path / "results" / "second").cases:
            p = 1 + (case.values["method"] != "bp") + (case.values["snr_db"] or 0.0) + 6 * part
            support = (0.0 if case.values["method"] == "bp" else 30.0) + 12 * part
            assert case.evaluation.threshold.top_percent == pytest.approx(p)
            assert case.evaluation.threshold.min_support_deg == pytest.approx(support)


def test_the_least_mean_too_is_of_the_values_named(tmp_path):
    plan, rows = source(tmp_path)
    for case in plan.cases:
        voting, column = case.values["method"] != "bp", 100 if case.values["interval_deg"] == 10.0 else 50
        tried = packed({(3 * voting, column): -9}, rows=len(SUPPORTS_DEG) if voting else 1)
        rows[case.key] = replace(rows[case.key], metrics=rows[case.key].metrics | {MAP: tried})
    write_table(build_table(plan.cases, rows), tmp_path / "results" / "first")
    for interval, column in ((10.0, 100), (30.0, 50)):
        more = f'rule = "least-mean"\nwhere = {{ interval_deg = [{interval}] }}\n'
        for case in expand(experiment(tmp_path, SECOND, CALIBRATION + more), tmp_path / "results" / "second").cases:
            assert case.evaluation.threshold.top_percent == TOP_PERCENTS[column]


@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("where = { interval_deg = [25.0] }", r"has no case with interval_deg = 25\.0; allowed: 10, 30"),
        (
            'over = ["kappa", "seed"]\nwhere = { kappa = [1.0] }',
            "has no axis 'kappa'; allowed: interval_deg, offset, seed",
        ),
    ],
)
def test_values_that_the_other_experiment_lacks_are_refused(tmp_path, where, said):
    source(tmp_path)
    settings = experiment(tmp_path, SECOND, CALIBRATION + where + "\n")
    with pytest.raises(ConfigError, match=said) as error:
        expand(settings, tmp_path / "results" / "second")
    assert "\n" not in str(error.value)


def test_the_rule_of_the_least_mean_needs_the_other_experiments_maps(tmp_path):
    """Maps are kept beside the table, not in it; the file is asked for by name where it is missing or damaged."""
    plan, rows = source(tmp_path)
    least_mean = HELD_OUT + 'rule = "least-mean"\n'
    target = tmp_path / "results" / "second"
    with pytest.raises(DataError, match=r"maps\.parquet: no such file.*evaluation\.threshold_map = true"):
        expand(experiment(tmp_path, SECOND, least_mean), target)
    for case in plan.cases:
        voting = case.values["method"] != "bp"
        tried = packed({(3 * voting, 100): -9}, rows=len(SUPPORTS_DEG) if voting else 1)
        rows[case.key] = replace(rows[case.key], metrics=rows[case.key].metrics | {MAP: tried})
    written = write_table(build_table(plan.cases, rows), tmp_path / "results" / "first")
    assert [file.name for file in written] == ["table.csv", "table.parquet", "maps.parquet"]
    assert MAP not in load_table(tmp_path / "results" / "first")
    for case in expand(experiment(tmp_path, SECOND, least_mean), target).cases:
        assert case.evaluation.threshold.top_percent == TOP_PERCENTS[100]
        assert case.evaluation.threshold.min_support_deg == (0.0 if case.values["method"] == "bp" else SUPPORTS_DEG[3])
    (tmp_path / "results" / "first" / "maps.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(DataError, match=r"maps\.parquet: not a readable file"):
        expand(experiment(tmp_path, SECOND, least_mean), target)


def test_one_pair_for_everything_may_be_asked_for(tmp_path):
    """``over`` names every axis and the scene: the mean of p of both methods and SNRs, by hand 1.5 + 2.5."""
    source(tmp_path)
    over = CALIBRATION + 'over = ["interval_deg", "offset", "seed", "snr_db", "method", "scene"]\n'
    for case in expand(experiment(tmp_path, SECOND, over), tmp_path / "results" / "second").cases:
        assert case.evaluation.threshold.top_percent == pytest.approx(4.0)


def test_a_table_without_maps_leaves_no_stale_ones(tmp_path):
    plan, rows = source(tmp_path)
    folder = tmp_path / "results" / "first"
    mapped = {key: replace(row, metrics=row.metrics | {MAP: packed({})}) for key, row in rows.items()}
    write_table(build_table(plan.cases, mapped), folder)
    assert (folder / "maps.parquet").exists()
    write_table(build_table(plan.cases, rows), folder)
    assert not (folder / "maps.parquet").exists()


def test_held_out_scenes_must_be_there(tmp_path):
    source(tmp_path)
    settings = experiment(tmp_path, SECOND, HELD_OUT + 'scenes = ["moon"]\n')
    with pytest.raises(DataError, match="has no scene 'moon'; allowed: box"):
        expand(settings, tmp_path / "results" / "second")


def test_calibration_without_its_table_is_one_line(tmp_path):
    settings = experiment(tmp_path, SECOND, CALIBRATION)
    with pytest.raises(DataError, match=r"first/table\.csv: no such table .* run the experiment first"):
        expand(settings, tmp_path / "results" / "second")


def test_calibration_with_values_the_other_experiment_lacks_is_refused(tmp_path):
    source(tmp_path)
    settings = experiment(tmp_path, "snr_db = [7.0]\n", CALIBRATION)
    with pytest.raises(ConfigError, match=r"has no case with scene = box, snr_db = 7\.0"):
        expand(settings, tmp_path / "results" / "second")


def test_calibration_with_an_unfinished_table_is_refused(tmp_path):
    plan, rows = source(tmp_path)
    del rows[plan.cases[3].key]
    write_table(build_table(plan.cases, rows), tmp_path / "results" / "first")
    with pytest.raises(DataError, match=r"1 of \d+ cases of .* are not done"):
        expand(experiment(tmp_path, SECOND, CALIBRATION), tmp_path / "results" / "second")


def test_calibration_with_given_thresholds_is_refused(tmp_path):
    source(tmp_path, protocol="given")
    with pytest.raises(DataError, match="were given, not optimised"):
        expand(experiment(tmp_path, SECOND, CALIBRATION), tmp_path / "results" / "second")


@pytest.mark.parametrize(
    ("axes", "more", "said"),
    [
        (SECOND, CALIBRATION + "[evaluation.threshold]\ntop_percent = 1.0\n", "both give thresholds"),
        ('"evaluation.threshold.top_percent" = [1.0]\n', CALIBRATION, "both give thresholds"),
        (SECOND, CALIBRATION + 'over = ["intervall"]\n', "'intervall' names no setting"),
        (SECOND, CALIBRATION + "over = []\n", "calibration.over"),
        (SECOND, '[calibration]\nfrom = "../first"\n', "calibration.from"),
        (SECOND, CALIBRATION + 'scenes = ["star"]\n', "scenes: needs 'scene' in over"),
        (
            SECOND,
            CALIBRATION + "where = { interval = [5.0] }\n",
            "where: 'interval' is no axis of over, which is interval",
        ),
        (SECOND, CALIBRATION + "where = { snr_db = [5.0] }\n", "where: 'snr_db' is no axis of over"),
        (SECOND, HELD_OUT + 'where = { scene = ["box"] }\n', r"where: 'scene' is no axis of over.*write scenes = "),
        (SECOND, CALIBRATION + "where = { interval_deg = [] }\n", "where: 'interval_deg' is empty"),
        (SECOND, CALIBRATION + "where = { interval_deg = 5.0 }\n", r"calibration\.where\.interval_deg = 5\.0"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused(tmp_path, axes, more, said):
    with pytest.raises(ConfigError, match=said):
        experiment(tmp_path, axes, more)


def test_averages_are_over_finished_cases_that_agree():
    table = pd.DataFrame(
        {
            "status": ["done", "done", "failed", "done"],
            "method": ["bp", "bp", "bp", "mvla-gr"],
            "offset": [0, 1, 2, 0],
            "views": [4, 4, 4, 4],
            "cd_db": [-10.0, -20.0, -99.0, float("-inf")],
            "p": [1.0, 3.0, 9.0, 2.0],
        }
    )
    bp, mvla = averaged(table, ["method"]).to_dict("records")
    assert (bp["cases"], bp["cd_db"], bp["cd_db_min"], bp["cd_db_max"], bp["p"]) == (2, -15.0, -20.0, -10.0, 2.0)
    assert np.isnan(mvla["cd_db"])
    assert mvla["p"] == 2.0
