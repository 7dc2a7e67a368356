"""Running a design: rounds, scores, what is kept, and nothing computed twice."""

from __future__ import annotations

import json
import math
import sys
from types import SimpleNamespace

import command_line
import numpy as np
import pandas as pd
import pytest
from sweep_files import keep_then, write
from test_design import design, example

import mvla_sim as mv
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.sweep import batch, scores
from mvla_sim.sweep.case import Row
from mvla_sim.sweep.design_plan import plan_design
from mvla_sim.sweep.design_run import DESIGN, best_samples, load_design, run_design, survey_design
from mvla_sim.sweep.run import run_experiment
from mvla_sim.sweep.scores import Score, find_score, mean_of
from mvla_sim.sweep.session import RunInterruptedError
from mvla_sim.sweep.store import Store
from mvla_sim.sweep.table import load_table


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of the example in this process: plan, folder, result, lines told."""
    folder = tmp_path_factory.mktemp("finished")
    plan, told = plan_design(example(folder)), []
    return plan, folder / "out", run_design(plan, folder / "out", workers=0, tell=told.append), told


def counted(monkeypatch):
    """Rows that runs keep from now on."""
    kept, original = [], Store.add

    def add(self, row: Row):
        kept.append(row.key)
        original(self, row)

    monkeypatch.setattr(Store, "add", add)
    return kept


def test_rounds_keep_the_best_of_each(finished):
    plan, _, result, told = finished
    assert (result.table["status"] == "done").all()
    by_round = dict(iter(result.table.groupby("round")))
    assert [part["sample"].nunique() for part in by_round.values()] == [8, 4, 1]
    for number, count in ((1, 4), (2, 1)):
        means = by_round[number].groupby("sample")["cd_db"].mean()
        assert set(by_round[number + 1]["sample"]) == set(means.nsmallest(count).index)
    assert told[0] == "round 1 of 3: 8 samples, 16 cases"
    assert told[1].startswith("round 1 of 3: best cd_db ")
    assert told[1].endswith("; 4 of 8 go on")
    assert len(told) == 6
    assert plan.counts == (8, 4, 1)


def test_the_tables_say_what_each_sample_was_and_came_to(finished):
    plan, folder, result, _ = finished
    table, samples = load_table(folder), load_design(folder)
    assert list(table.columns[5:8]) == ["scene", "round", "sample"]
    assert {"kappa", "eta", "noise.kind", "interval_deg", "part", "cd_db", "views"} <= set(table.columns)
    assert "imaging.grid.spacing_m" not in table.columns  # the same for all, so in the record alone
    assert list(table["case"]) == list(range(len(result.table)))
    assert list(dict.fromkeys(samples["sample"])) == [sample.label for sample in plan.samples]
    assert sorted(samples["round"]) == [1] * 8 + [2] * 4 + [3]
    by_label = {sample.label: sample for sample in plan.samples}
    for row in samples.to_dict("records"):
        sample = by_label[row["sample"]]
        for key, value in sample.values.items():
            assert row[key] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-8))
        mine = table[(table["sample"] == sample.label) & (table["round"] == row["round"])]
        assert row["score"] == pytest.approx(mine["cd_db"].mean(), rel=1e-8)
        assert (row["cases"], row["failed"]) == (len(mine), 0)
    best = best_samples(samples, 5)
    assert list(best["round"]) == [3, 2, 2, 2, 1]
    assert best["score"][1:4].is_monotonic_increasing
    record = json.loads((folder / "experiment.json").read_text())
    assert record["settings"]["design"]["settings"]["kappa"] == {
        "min": 0.1,
        "max": 2.0,
        "scale": "linear",
        "step": None,
    }
    assert record["settings"]["scenes"] == ["box.toml"]
    assert str(folder.parent) not in json.dumps(record["settings"])
    pd.testing.assert_frame_equal(result.design, samples, check_dtype=False, rtol=1e-8)


def test_cases_that_rounds_share_are_run_once(finished, tmp_path, monkeypatch):
    plan = finished[0]
    kept = counted(monkeypatch)
    result = run_design(plan, tmp_path / "out", workers=0)
    assert len(result.table) == 16 + 4 * 4 + (4 + 6)
    assert len(kept) == len(set(kept)) == len(set(result.table["key"]))
    assert len(kept) == 16 + 4 * 2 + (2 + 5)  # 2 of 4 cases ran before, then 2 of 4 and 1 of the 6 offsets


def test_a_second_run_computes_nothing(finished, monkeypatch):
    plan, folder, result, _ = finished
    kept = counted(monkeypatch)
    again = run_design(plan, folder, workers=0)
    assert kept == []
    pd.testing.assert_frame_equal(again.table, result.table)
    pd.testing.assert_frame_equal(again.design, result.design)


def test_more_samples_run_the_new_ones_alone(finished, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    text = "[design]\nsamples = {n}\n[design.settings]\nkappa = {{ min = 0.1, max = 2.0 }}\n"
    run_experiment(design(tmp_path, text.format(n=2)), folder, workers=0)
    kept = counted(monkeypatch)
    table = run_experiment(design(tmp_path, text.format(n=3)), folder, workers=0)
    assert len(kept) == 2
    assert (len(table), len(load_design(folder))) == (6, 3)


def test_an_interrupted_run_goes_on_where_it_was(finished, tmp_path, monkeypatch):
    plan, _, result, _ = finished

    def stop():
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        keep_then(patch, 20, stop)  # in the second round
        with pytest.raises(RunInterruptedError, match=r"20 cases are stored|of \d+ cases are stored"):
            run_design(plan, tmp_path / "out", workers=0)
    partial = load_design(tmp_path / "out")
    assert set(partial["round"]) == {1, 2}
    kept = counted(monkeypatch)
    again = run_design(plan, tmp_path / "out", workers=0)
    assert len(kept) == 31 - 20
    drop = {"columns": "seconds"}
    pd.testing.assert_frame_equal(again.table.drop(**drop), result.table.drop(**drop))


def test_workers_change_no_number(finished, tmp_path):
    plan, _, result, _ = finished
    other = run_design(plan, tmp_path / "out", workers=2)
    pd.testing.assert_frame_equal(other.table.drop(columns="seconds"), result.table.drop(columns="seconds"))
    pd.testing.assert_frame_equal(other.design, result.design)


def test_python_runs_a_design_as_any_experiment(tmp_path):
    settings = design(tmp_path, "[design]\nsamples = 2\n[design.settings]\nkappa = { min = 0.1, max = 2.0 }\n")
    table = mv.run_experiment(settings, tmp_path / "out", workers=0)
    assert len(table) == 4
    assert len(mv.load_design(tmp_path / "out")) == 2


def test_a_channel_is_read_once_for_all_samples(tmp_path, monkeypatch):
    """Two scenes and settings of the profiles that all differ: four times as many profiles as channels."""
    read = []
    load = mv.load_channel
    batch._load.cache_clear()
    monkeypatch.setattr("mvla_sim.sweep.batch.load_channel", lambda file: read.append(file) or load(file))
    text = '[design]\nsamples = 4\n[design.settings]\n"pdp.kaiser_beta" = { min = 2.0, max = 6.0 }\n'
    file = write(tmp_path, "interval_deg = [60.0]\n", '[imaging.pdp]\nwindow = "kaiser"\n' + text)
    (tmp_path / "disc.toml").write_text(
        (tmp_path / "box.toml").read_text().replace('"box"', '"other"').replace("2.0", "1.6")
    )
    file.write_text(file.read_text().replace('["box.toml"]', '["box.toml", "disc.toml"]'))
    table = run_experiment(mv.load_experiment(file), tmp_path / "out", workers=0)
    assert (table["status"] == "done").all()
    assert table["cd_db"].nunique() == 8
    assert len(read) == 2


SCORE = '''
def score(table):
    """The worst seed, and how coarse the grid is."""
    return {"score": table["cd_db"].max(), "spacing": table["imaging.grid.spacing_m"].iloc[0], "cases": 1.0}


def steady(table):
    return {"score": table["cd_db"].max() - table["cd_db"].min(), "spacing": table["imaging.grid.spacing_m"].iloc[0]}


def broken(table):
    return table["no such column"].mean()


def wordy(table):
    return {"score": "good"}


def picky(table):
    """It cannot take some samples."""
    if table["imaging.mvla.kappa"].iloc[0] > 1.0:
        raise ValueError("too wide for me")
    return {"score": table["cd_db"].mean()}


def silent(table):
    return 3.0
'''
SCORED = '[design]\nsamples = 4\nscore = "{name}"\n[design.settings]\nkappa = {{ min = 0.1, max = 2.0 }}\n'


def scored(folder, function):
    (folder / "mine.py").write_text(SCORE)
    name = f"{folder / 'mine.py'}{function}"
    return design(folder, SCORED.format(name=name))


def test_a_score_may_be_a_function_of_a_file(tmp_path):
    result = run_design(plan_design(scored(tmp_path, ":steady")), tmp_path / "out", workers=0)
    spread = result.table.groupby("sample")["cd_db"].agg(lambda part: part.max() - part.min())
    assert list(result.design["score"]) == pytest.approx(list(spread))
    assert set(result.design["spacing"]) == {0.1}


@pytest.mark.parametrize(
    ("function", "error", "said"),
    [
        (":nothing", ConfigError, "there is no such function"),
        (":broken", DataError, "sample s0000: KeyError: 'no such column'"),
        (":wordy", DataError, "score = 'good' is no number"),
        (":silent", DataError, "must return a mapping with 'score'; it is float"),
        ("", DataError, "a figure cannot be called 'cases'"),
    ],
)
def test_a_score_that_fails_is_one_line(tmp_path, function, error, said):
    with pytest.raises(error, match=said) as raised:
        run_design(plan_design(scored(tmp_path, function)), tmp_path / "out", workers=0)
    assert "\n" not in str(raised.value)


def test_a_score_that_fails_for_some_samples_ends_nothing(tmp_path):
    """Hours of computing are not lost for one odd sample; a note says which."""
    result = run_design(plan_design(scored(tmp_path, ":picky")), tmp_path / "out", workers=0)
    wide = result.design["kappa"] > 1
    assert 0 < wide.sum() < 4
    assert list(result.design["score"].isna()) == list(wide)
    (note,) = result.notes
    assert note.startswith(f"round 1: no score for {wide.sum()} samples; the first: design.score = ")
    assert "ValueError: too wide for me" in note


def test_a_sample_without_a_finished_case_is_not_shown_to_the_score(tmp_path):
    """Its table has no metrics, which a function may well take for granted."""
    (tmp_path / "mine.py").write_text(SCORE)
    text = DEAF.replace("samples = 8", f'samples = 8\nscore = "{tmp_path / "mine.py"}:steady"')
    result = run_design(plan_design(design(tmp_path, text)), tmp_path / "out", workers=0)
    assert list(result.design["score"].isna()) == list(result.design["threshold_sigma"] == 1e6)
    assert not any("no score" in note for note in result.notes)


def test_installed_packages_offer_scores(monkeypatch):
    module = SimpleNamespace(worth=lambda table: {"score": 1.0 * len(table)})
    monkeypatch.setitem(sys.modules, "outside_scores", module)
    points = [
        SimpleNamespace(name="worth", value="outside_scores:worth", load=lambda: module.worth),
        SimpleNamespace(name="gone", value="no_such_module:x", load=lambda: __import__("no_such_module")),
    ]
    monkeypatch.setattr(scores, "entry_points", lambda group: points if group == "mvla_sim.scores" else [])
    assert find_score("worth", ("cd_db",)).figures(pd.DataFrame({"a": [1, 2]}), "s0000") == {"score": 2.0}
    with pytest.raises(ConfigError, match=r"no_such_module:x cannot be imported \(ModuleNotFoundError"):
        find_score("gone", ())
    with pytest.raises(ConfigError, match=r"did you mean 'worth'.*allowed: worth, gone, cd_db, or file.py:function"):
        find_score("wort", ("cd_db",))


def test_the_score_of_a_metric_is_its_mean_over_finished_cases():
    table = pd.DataFrame({"status": ["done", "done", "failed", "done"], "cd_db": [1.0, 2.0, 90.0, -math.inf]})
    assert mean_of(table, "cd_db") == 1.5
    assert math.isnan(mean_of(table[2:3], "cd_db"))
    assert math.isnan(mean_of(table, "f1_10cm"))
    assert Score("cd_db", lambda t: {"score": mean_of(t, "cd_db")}).figures(table, "s") == {"score": 1.5}


DEAF = """
[design]
samples = 8
[design.settings]
threshold_sigma = { choices = [1e6, 4.0], weights = [5, 3] }
kappa = { min = 0.1, max = 2.0 }
[[design.rounds]]
keep = 0.5
[[design.rounds]]
overrides = { interval_deg = 30.0 }
"""


def test_samples_without_a_score_never_go_on(tmp_path):
    """No peak is 10⁶ standard deviations strong: five of eight samples have no finished case."""
    result = run_design(plan_design(design(tmp_path, DEAF)), tmp_path / "out", workers=0)
    samples = result.design
    deaf = samples["threshold_sigma"] == 1e6
    assert deaf.sum() == 5
    assert set(samples.loc[deaf, "round"]) == {1}
    assert sorted(samples.loc[~deaf, "round"]) == [1, 1, 1, 2, 2, 2]
    assert samples.loc[deaf, "score"].isna().all()
    assert set(samples.loc[deaf, "failed"]) == {2}
    assert "round 1: 5 samples have failed cases; scored without them" in result.notes
    assert list(best_samples(samples, 8)["score"].isna()) == [False] * 3 + [True] * 5


def test_a_round_without_any_score_ends_the_run(tmp_path):
    text = DEAF.replace("[1e6, 4.0], weights = [5, 3]", "[1e6, 2e6]")
    with pytest.raises(DataError, match="round 1 of tiny: no sample has a score"):
        run_design(plan_design(design(tmp_path, text)), tmp_path / "out", workers=0)
    assert (load_table(tmp_path / "out")["status"] == "failed").all()  # the errors are there


def test_the_survey_knows_what_is_stored_and_what_is_not_known_yet(finished, tmp_path):
    plan, folder, _, _ = finished
    before, after = survey_design(plan, tmp_path / "nothing", 2), survey_design(plan, folder, 2)
    assert [(one.samples, one.known, one.survey.cases) for one in before] == [
        (8, True, 16),
        (4, False, 16),
        (1, False, 10),
    ]
    assert all(one.known and one.survey.done == one.survey.cases for one in after)
    assert sum(one.survey.seconds for one in after) == 0
    assert all(one.survey.seconds > 0 for one in before)


def test_the_command_line_shows_rounds_and_the_best(tmp_path):
    example(tmp_path)
    run = ("run", tmp_path / "design.toml", "-o", tmp_path / "out", "--workers", "0")
    text = command_line.mvla(*run, "--dry-run", code=0, notes=True)
    assert "tiny-design: 8 samples of 5 settings" in text
    assert "at most 16" in text
    assert "a guess" in text
    assert not (tmp_path / "out").exists()
    text = command_line.mvla(*run, code=0, notes=True)
    assert "round 3 of 3: 1 samples, 10 cases" in text
    assert "tiny-design: the best" in text
    assert text.count("noise.kind = ") == 8
    assert f"{tmp_path / 'out' / DESIGN}" in text
    text = command_line.mvla(*run, "--dry-run", code=0, notes=True)
    assert "at most" not in text


@pytest.mark.parametrize("content", ["", "a,b\n1,2\n", "\x00\xff"])
def test_what_is_no_table_of_a_design_is_refused(tmp_path, content):
    with pytest.raises(DataError, match="run the experiment first"):
        load_design(tmp_path)
    (tmp_path / DESIGN).write_text(content)
    with pytest.raises(DataError, match=r"design\.csv"):
        load_design(tmp_path)


def test_scores_are_finite_numbers_or_nan():
    assert math.isnan(Score("x", lambda _: {"score": math.nan}).figures(pd.DataFrame(), "s")["score"])
    assert Score("x", lambda _: {"n": np.int64(3), "score": np.float32(1)}).figures(pd.DataFrame(), "s") == {
        "score": 1.0,
        "n": 3.0,
    }
