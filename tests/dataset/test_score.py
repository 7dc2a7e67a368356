"""Scoring methods: the protocol, other people's methods, and the leaderboard."""

from __future__ import annotations

import json
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from campaigns import tiny

import mvla_sim as mv
from mvla_sim.cli.app import run
from mvla_sim.cluster.in_process import InProcess
from mvla_sim.cluster.opening import open_cluster
from mvla_sim.dataset import access
from mvla_sim.dataset.build import build_dataset
from mvla_sim.dataset.leaderboard import build_leaderboard
from mvla_sim.dataset.protocol import Attempt, best_thresholds, protocol_settings, score_sample
from mvla_sim.dataset.score import Result, load_results, score_dataset
from mvla_sim.engine import provenance as provenance_module
from mvla_sim.engine.provenance import code_digest
from mvla_sim.errors import ConfigError, DataError, MvlaError
from mvla_sim.evaluation.candidates import SUPPORTS_DEG, TOP_PERCENTS, chamfer_table, worst_db
from mvla_sim.evaluation.ground_truth import TruthGeometry
from mvla_sim.evaluation.metrics import score
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.method import METHODS
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.imaging.thresholds import joint_threshold

README = Path(__file__).parents[2] / "README.md"
ORACLE = """
import numpy as np

def image(seen):  # what is near the origin, at all samples
    z, y, x = np.meshgrid(*seen.grid.axes()[::-1], indexing="ij")
    return -np.hypot(x, y)
"""


@pytest.fixture
def dataset(tiny_dataset, fake):
    """Ten scenes traced by formula: 5 for training, 2 for validation, 3 for the test."""
    return tiny_dataset


@pytest.fixture
def method(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(ORACLE)
    return str(file)


def test_thresholds_come_from_the_validation_split_alone(dataset, method):
    """The result is what one gets by hand with the validation samples; the test's truth is not looked at before."""
    result = score_dataset(dataset, [method])[0]
    validation = mv.open_dataset(dataset, "validation")
    tables = []
    for sample in validation:
        settings = protocol_settings(validation.campaign, method)
        noise = settings.noise.model_copy(update={"seed": sample.metadata["sample"]})
        image = reconstruct(sample.cir, settings.model_copy(update={"noise": noise}))
        tables.append(chamfer_table(image, TruthGeometry.build(sample.contour, sample.grid)))
    mean = np.mean(np.array(tables, float), axis=0)
    assert result.validation_db == pytest.approx(mean.min())
    assert result.top_percent == TOP_PERCENTS[int(mean.argmin())]
    for row, sample in zip(result.rows, mv.open_dataset(dataset, "test"), strict=True):
        image = reconstruct(sample.cir, settings)
        found = score(sample.contour, joint_threshold(image.score, None, result.top_percent), sample.grid, (0.1,))
        assert row["cd_db"] == pytest.approx(found.cd_db)
        assert row["f1_10cm"] == pytest.approx(found.f1[0])


def test_a_changed_test_truth_changes_no_threshold(dataset, method, monkeypatch):
    before = score_dataset(dataset, [method])[0]
    whole = access.Sample.contour.fget

    def moved(self):
        return np.roll(whole(self), 9, axis=2) if self.metadata["split"] == "test" else whole(self)

    monkeypatch.setattr(access.Sample, "contour", property(moved))
    after = score_dataset(dataset, [method], fresh=True)[0]
    assert (after.top_percent, after.validation_db) == (before.top_percent, before.validation_db)
    assert [row["cd_db"] for row in after.rows] != [row["cd_db"] for row in before.rows]


def test_the_table_of_candidates_is_the_score_at_each_pair(dataset):
    sample = mv.open_dataset(dataset, "validation")[0]
    image = reconstruct(sample.cir, protocol_settings(mv.open_dataset(dataset).campaign, "mvla-gr"))
    table = chamfer_table(image, TruthGeometry.build(sample.contour, sample.grid))
    assert table.shape == (len(SUPPORTS_DEG), len(TOP_PERCENTS))
    for row, column in ((0, 100), (3, 150), (30, 199), (len(SUPPORTS_DEG) - 1, 0)):
        occupied = joint_threshold(image.score, image.support_deg, TOP_PERCENTS[column], SUPPORTS_DEG[row])
        cd_db = score(sample.contour, occupied, sample.grid, (0.1,)).cd_db
        assert table[row, column] == pytest.approx(worst_db(sample.grid) if np.isnan(cd_db) else cd_db, abs=1e-4)


def test_the_best_pair_is_that_of_the_mean_and_failures_count():
    grid = VoxelGrid((0.0, 0.0, 0.0), (10, 10, 1), 0.1)
    tables = [np.zeros((len(SUPPORTS_DEG), len(TOP_PERCENTS)), np.float32) for _ in range(2)]
    tables[0][2, 7], tables[1][2, 7] = -3, -1
    tables[0][4, 9], tables[1][4, 9] = -9, 8  # better alone
    attempts = [Attempt(k, table=table) for k, table in enumerate(tables)]
    pair, mean = best_thresholds(attempts, grid)
    assert (pair.top_percent, pair.min_support_deg, mean) == (TOP_PERCENTS[7], SUPPORTS_DEG[2], -2)
    _, mean = best_thresholds([*attempts, Attempt(2, error="broken")], grid)
    assert mean == pytest.approx((-4 + worst_db(grid)) / 3)
    with pytest.raises(ConfigError, match="no image of any validation sample: broken"):
        best_thresholds([Attempt(2, error="broken")], grid)


def test_what_is_there_is_not_computed_again(dataset, method, monkeypatch):
    first = score_dataset(dataset, [method])
    monkeypatch.setattr("mvla_sim.dataset.score.score_sample", None)
    assert score_dataset(dataset, [method]) == first
    Path(method).write_text(ORACLE + "\n")
    with pytest.raises(MvlaError):
        score_dataset(dataset, [method])


def test_scores_are_computed_again_when_the_packages_own_code_changes(dataset, tmp_path, monkeypatch):
    first = score_dataset(dataset, ["bp"])
    copy = tmp_path / "mvla_sim"
    shutil.copytree(Path(mv.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr("mvla_sim.engine.provenance.PACKAGE", copy)
    monkeypatch.setattr("mvla_sim.dataset.score.code_digest", code_digest.__wrapped__)
    assert score_dataset(dataset, ["bp"]) == first  # the same code elsewhere
    with (copy / "cli" / "app.py").open("a") as file:
        file.write("# no part of any score")
    assert score_dataset(dataset, ["bp"]) == first
    with (copy / "imaging" / "projection.py").open("a") as file:
        file.write("# changed")
    again = score_dataset(dataset, ["bp"])
    assert [row["cd_db"] for row in again[0].rows] == [row["cd_db"] for row in first[0].rows]
    assert again[0].identity != first[0].identity


def test_the_time_of_an_image_has_no_git_in_it(dataset, monkeypatch):
    """Git is asked once a process, and not while a method is timed."""
    asked = []
    provenance_module._installation.cache_clear()
    monkeypatch.setattr(provenance_module, "_git", lambda *command: asked.append(time.sleep(2)) or "")
    sample = mv.open_dataset(dataset, "test")[0]
    settings = protocol_settings(mv.open_dataset(dataset).campaign, "bp")
    attempts = [score_sample(sample, [settings], [None])[0] for _ in range(3)]
    assert len(asked) <= 2
    assert all(attempt.seconds < 2 for attempt in attempts[1:])
    assert attempts[0].seconds - attempts[1].seconds < 2  # the first may have compiled the kernels
    provenance_module._installation.cache_clear()


def test_results_of_another_dataset_or_protocol_are_not_in_the_table(dataset, method, tmp_path):
    score_dataset(dataset, [method], output=tmp_path / "results")
    file = next((tmp_path / "results").glob("*.json"))
    data = json.loads(file.read_text())
    assert str(tmp_path) not in file.read_text()
    for change in ({"protocol": 0}, {"dataset": "0" * 64}):
        file.write_text(json.dumps(data | change))
        assert load_results(mv.open_dataset(dataset, "test"), tmp_path / "results") == []
    file.write_text("{")
    with pytest.raises(DataError, match="not a readable result file"):
        load_results(mv.open_dataset(dataset, "test"), tmp_path / "results")


def test_a_method_that_fails_on_a_sample_gets_the_worst_for_it(dataset, tmp_path, capsys):
    file = tmp_path / "moody.py"
    test = mv.open_dataset(dataset, "test")
    bad = test.numbers[1]
    file.write_text(ORACLE.replace("# what", f"\n    1 / (seen.settings.noise.seed - {bad})  # what"))
    assert run(["dataset", "score", "--workers", "0", str(dataset), "--method", str(file)]) == 1
    text = capsys.readouterr()
    assert f"failed on 1 of 3 test samples, which count as worst; the first, sample {bad}:" in text.err
    assert "ZeroDivisionError" in text.err
    result = load_results(test, dataset / "scores")[0]
    assert result.rows[1]["cd_db"] == worst_db(test.grid)
    assert result.rows[0]["cd_db"] < worst_db(test.grid)


def test_the_readme_example_joins_the_leaderboard(dataset, tmp_path, capsys):
    """The method of the README, as it stands there, runs and is at most 15 lines."""
    blocks = re.findall(r"```python\n(# my_method\.py\n.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 1
    assert len(blocks[0].strip().splitlines()) <= 15
    (tmp_path / "my_method.py").write_text(blocks[0])
    call = ["dataset", "score", str(dataset), "--method", f"{tmp_path}/my_method.py:image", "--method", "bp"]
    assert run([*call, "--workers", "0"]) == 0
    text = capsys.readouterr().out
    assert "my_method" in text
    markdown = (dataset / "scores" / "leaderboard.md").read_text()
    assert "| my_method |" in markdown
    assert "| bp |" in markdown


def test_every_method_is_scored_by_default(dataset):
    assert run(["dataset", "score", "--workers", "0", str(dataset)]) == 0
    results = load_results(mv.open_dataset(dataset, "test"), dataset / "scores")
    assert {result.label for result in results} == {method.name for method in METHODS.own()} - {"bp-coherent"}


class Backwards(InProcess):
    """The last task is finished first."""

    def _run(self, *arguments):
        yield from reversed(list(super()._run(*arguments)))


def test_worker_processes_change_no_number(dataset, tmp_path):
    """Nor does the order in which they finish."""
    with open_cluster(1) as cluster:
        there = score_dataset(dataset, ["mvla-gr"], output=tmp_path / "there", cluster=cluster)
    here = score_dataset(dataset, ["mvla-gr"], output=tmp_path / "here")
    backwards = score_dataset(dataset, ["mvla-gr"], output=tmp_path / "backwards", cluster=Backwards())
    timeless = [[{**row, "seconds": 0} for row in result.rows] for result in (*there, *here, *backwards)]
    assert timeless[0] == timeless[1] == timeless[2]
    assert there[0].identity == here[0].identity == backwards[0].identity


def result_of(label: str, values: list[float], **changes) -> Result:
    rows = [
        {"sample": k, "cd_db": v, "f1_5cm": 0.1, "f1_10cm": 0.2, "empty": 0.0, "seconds": 0.1, "error": ""} | changes
        for k, v in enumerate(values)
    ]
    return Result(label, "", 1.0, 0.0, -1.0, tuple(rows), {})


def test_intervals_hold_the_mean_as_often_as_they_say():
    """Of normal samples the 95 % interval covers the true mean about so often, a little less for 25 samples."""
    random = np.random.default_rng(1)
    covered = 0
    for _ in range(100):
        row = build_leaderboard([result_of("one", list(random.normal(3, 2, 25)))]).iloc[0]
        covered += row["cd_db_lo"] <= 3 <= row["cd_db_hi"]
    assert 85 <= covered <= 99


def test_differences_are_paired():
    """Two methods that follow each other scene by scene differ surely, although their own intervals overlap."""
    hard = list(np.random.default_rng(0).normal(-10, 5, 20))
    table = build_leaderboard([result_of("worse", [v + 1 for v in hard]), result_of("better", hard)])
    assert list(table["method"]) == ["better", "worse"]
    assert table["cd_db_hi"][0] > table["cd_db_lo"][1]
    assert table["behind_db_lo"][1] == pytest.approx(1)
    assert table["behind_db_hi"][1] == pytest.approx(1)


def test_one_test_scene_has_no_interval():
    row = build_leaderboard([result_of("one", [-4.0])]).iloc[0]
    assert row["cd_db"] == -4.0
    assert np.isnan(row["cd_db_lo"])
    assert np.isnan(row["cd_db_hi"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "nothing"], "'nothing' is no method; allowed: "),
        (["--method", "nowhere.py"], "nowhere.py cannot be read"),
        (["--method", "bp", "--set", "noise.snr_db=60"], "the protocol fixes noise"),
        (["--method", "bp", "--set", "grid.spacing_m=1"], "the protocol fixes grid"),
        (["--method", "bp", "--set", "mvla.kapa=1"], "kapa"),
        (["--label", "mine"], "names one method, "),
        (["--method", "bp", "--label", "a/b\n"], "allowed: up to 60 letters"),
        (["--scheduler", "tcp://127.0.0.1:1"], "give one of them (--scheduler)"),
    ],
)
def test_bad_input_is_one_line_before_work(dataset, arguments, message, capsys, monkeypatch):
    monkeypatch.setattr("mvla_sim.dataset.score.score_sample", None)
    assert run(["dataset", "score", "--workers", "0", str(dataset), *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
    assert not (dataset / "scores").exists()


def test_a_truncated_shard_is_refused_also_where_results_are_kept(dataset, method, capsys):
    score_dataset(dataset, [method])
    shard = sorted(dataset.glob("*.nc"))[-1]
    shard.write_bytes(shard.read_bytes()[:-100])
    assert run(["dataset", "score", "--workers", "0", str(dataset), "--method", method]) == 2
    assert f"{shard.name}: has " in capsys.readouterr().err


def test_a_dataset_without_validation_cannot_be_scored(tmp_path, fake, capsys):
    build_dataset(tiny(tmp_path, "split={train = 0.5, validation = 0.0, test = 0.5}"), tmp_path / "set", workers=0)
    assert run(["dataset", "score", "--workers", "0", str(tmp_path / "set"), "--method", "bp"]) == 2
    assert "the validation split has no samples" in capsys.readouterr().err
