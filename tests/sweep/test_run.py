"""Running: the same numbers however it is done, nothing done twice, nothing lost."""

from __future__ import annotations

import math
import multiprocessing
import sqlite3
from types import SimpleNamespace

import h5py
import numpy as np
import pandas as pd
import pytest
from sweep_files import AXES, experiment, keep_then, numbers, write

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.raytrace import ViewPaths
from mvla_sim.channel.simulate import simulate
from mvla_sim.engine.cache import VARIABLE
from mvla_sim.errors import OutputError
from mvla_sim.evaluation.candidates import unpack_table
from mvla_sim.evaluation.evaluate import evaluate
from mvla_sim.imaging.pipeline import Pipeline, reconstruct
from mvla_sim.sweep import batch
from mvla_sim.sweep import session as module
from mvla_sim.sweep.batch import run_batch
from mvla_sim.sweep.case import Row
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.jobs import prepare_here
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.run import images_of, run_experiment, run_plan
from mvla_sim.sweep.schedule import groups_of
from mvla_sim.sweep.session import RunInterruptedError
from mvla_sim.sweep.store import FILE, Store, identity
from mvla_sim.sweep.survey import survey
from mvla_sim.sweep.table import load_maps, load_table

MANY = 'interval_deg = [30.0]\noffset = "all"\nseed = [0, 1, 2, 3]\nmethod = ["mvla-gr", "bp"]\n'


def in_process(plan, cases=None):
    """Rows of a plan, computed here."""
    rows = []
    for task in groups_of(plan, cases or plan.cases, 1):
        task.source.make()
        rows += run_batch(Pipeline(prepare_here(task.source.file, task.wanted)), task.cases)
    return {row.key: row for row in rows}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of all cases in this process: plan, folder, table."""
    folder = tmp_path_factory.mktemp("finished")
    settings = experiment(folder)
    return expand(settings), folder / "out", run_experiment(settings, folder / "out", workers=0)


def test_every_case_is_done_and_the_files_say_so(finished):
    _, folder, table = finished
    assert list(table["status"]) == ["done"] * 8
    assert list(table["case"]) == list(range(8))
    assert np.isfinite(table["cd_db"]).all()
    assert sorted(path.name for path in folder.iterdir() if path.suffix != ".parquet") == [
        ".lock",
        "experiment.json",
        FILE,
        "table.csv",
    ]
    pd.testing.assert_frame_equal(load_table(folder), table, check_dtype=False, rtol=1e-8)  # nine digits in the file
    assert table["cd_db"].nunique() == 8


def test_a_sweep_gives_what_one_image_at_a_time_gives(finished):
    """Bit for bit where a case uses every view; a subset's own range axis may begin a node later, and round anew."""
    plan, _, table = finished
    cir = simulate(next(iter(plan.sources.values())).scene)
    for case, row in zip(plan.cases, table.to_dict("records"), strict=True):
        alone = evaluate(reconstruct(cir, case.imaging), case.evaluation).as_dict()
        if case.values["interval_deg"] == 10.0:
            assert {name: row[name] for name in alone} == alone
        else:
            assert row["cd_db"] == pytest.approx(alone["cd_db"], abs=0.05)  # a voxel or two of equal rank


@pytest.mark.parametrize(("workers", "fine"), [(1, False), (2, True)])
def test_the_number_of_workers_changes_no_number(finished, tmp_path, monkeypatch, workers, fine):
    """Neither does how the cases are cut into batches."""
    plan, _, table = finished
    if fine:
        monkeypatch.setattr("mvla_sim.sweep.schedule.BATCH_S", 0.05)
    other = run_plan(plan, tmp_path / "out", workers=workers)
    pd.testing.assert_frame_equal(numbers(other.table), numbers(table), check_exact=True)
    assert other.notes == ()


def test_order_and_company_change_no_number(finished):
    """A case alone gives what it gives among others, in any order."""
    plan, _, table = finished
    backwards = in_process(plan, plan.cases[::-1])
    alone = in_process(plan, plan.cases[5:6])
    for case, row in zip(plan.cases, table.to_dict("records"), strict=True):
        assert {name: row[name] for name in backwards[case.key].metrics} == backwards[case.key].metrics
    assert alone[plan.cases[5].key].metrics == backwards[plan.cases[5].key].metrics


def test_a_run_does_only_what_is_missing(finished, tmp_path):
    """Cases that are stored keep the very time they once took; only the deleted ones get a new one."""
    plan, _, table = finished
    folder = tmp_path / "out"
    first = run_plan(plan, folder, workers=0).table
    with sqlite3.connect(folder / FILE) as database:
        for number in (1, 6):
            database.execute("DELETE FROM cases WHERE key = ?", (plan.cases[number].key,))
    database.close()
    assert survey(plan, folder, 2).done == 6
    again = run_plan(plan, folder, workers=0).table
    assert list(again.index[again["seconds"] != first["seconds"]]) == [1, 6]
    pd.testing.assert_frame_equal(numbers(again), numbers(table), check_exact=True)


def test_a_finished_run_starts_no_worker(finished, monkeypatch):
    plan, folder, table = finished
    monkeypatch.setattr(module.jobs, "run_cases", None)
    monkeypatch.setattr("mvla_sim.sweep.sources.simulate", None)
    pd.testing.assert_frame_equal(run_plan(plan, folder).table, table)


def test_values_added_to_an_axis_are_all_that_runs(finished, tmp_path):
    _, folder, _ = finished
    more = expand(experiment(tmp_path, AXES.replace("[0, 1]", "[0, 7, 1]")))
    found = survey(more, folder, 1)
    assert (found.cases, found.done, found.failed) == (12, 8, 0)
    assert found.measured
    assert [channel.cached for channel in found.channels] == [True]


def test_failing_cases_are_recorded_and_the_others_go_on(tmp_path):
    """No peak is 10⁶ standard deviations strong; backprojection needs none."""
    axes = 'method = ["mvla-gr", "bp"]\nthreshold_sigma = [1e6, 4.0]\n'
    plan = expand(experiment(tmp_path, axes))
    result = run_plan(plan, tmp_path / "out", workers=0)
    assert list(result.table["status"]) == ["failed", "done", "done", "done"]
    assert result.table["error"][0].startswith("DataError: no peak in any of the 36 chosen views")
    assert "Traceback" not in result.table["error"][0]
    assert math.isnan(result.table["cd_db"][0])
    assert (result.count("failed"), result.count("missing")) == (1, 0)
    assert survey(plan, tmp_path / "out", 1).failed == 1  # tried again next time


def test_a_scene_that_cannot_be_traced_fails_its_own_cases_alone(tmp_path):
    plan = expand(experiment(tmp_path, '"scene.ray_tracing.max_paths" = [1, 1000000]\nmethod = ["mvla-gr", "bp"]\n'))
    result = run_plan(plan, tmp_path / "out", workers=0)
    assert list(result.table["status"]) == ["failed", "failed", "done", "done"]
    assert "max_paths" in result.table["error"][0]


@pytest.mark.parametrize(
    "axes",
    [
        '"evaluation.truth" = ["contour", "filled"]\nkappa = [0.3, 0.5, 0.7]\n',
        "spacing_m = [0.1, 0.2]\nkappa = [0.3, 0.5, 0.7]\n",
    ],
)
def test_a_truth_is_built_once_however_cases_alternate(tmp_path, monkeypatch, axes):
    built, build = [], batch.TruthGeometry.build
    monkeypatch.setattr(batch.TruthGeometry, "build", lambda *given: built.append(given) or build(*given))
    table = run_experiment(experiment(tmp_path, axes), tmp_path / "out", workers=0)
    assert (table["status"] == "done").all()
    assert len(built) == 2
    monkeypatch.setattr("mvla_sim.sweep.batch.TRUTH_VOXELS", 0)  # as of huge grids: one at a time
    again = run_experiment(experiment(tmp_path, axes), tmp_path / "again", workers=0)
    assert len(built) > 3
    pd.testing.assert_frame_equal(numbers(again), numbers(table), check_exact=True)


def test_given_thresholds_are_used_and_nothing_is_searched(tmp_path, monkeypatch):
    plan = expand(experiment(tmp_path, 'method = ["bp"]\n', "[evaluation.threshold]\ntop_percent = 3.0\n"))
    monkeypatch.setattr("mvla_sim.evaluation.evaluate.optimal_thresholds", None)
    (row,) = in_process(plan).values()
    assert row.status == "done"
    assert row.metrics["protocol"] == "given"
    assert row.metrics["n_reconstruction"] == 48  # 3 % of 1600
    assert "optimal_cd_db" not in row.metrics


def test_thresholds_of_the_least_mean_are_the_best_one_pair(tmp_path):
    """A sweep with maps, then one at the pair they choose: no pair of candidates has a smaller mean over its cases."""
    first = load_experiment(write(tmp_path, AXES, "[evaluation]\nthreshold_map = true\n", name="first"))
    run_experiment(first, tmp_path / "results" / "first", workers=0)
    calibration = '[calibration]\nfrom = "first"\nover = ["interval_deg", "seed"]\nrule = "least-mean"\n'
    second = load_experiment(write(tmp_path, AXES, calibration, name="second"))
    table = run_experiment(second, tmp_path / "results" / "second", workers=0)
    assert set(table["protocol"]) == {"given"}
    maps = load_maps(tmp_path / "results" / "first")
    keys = load_table(tmp_path / "results" / "first").set_index(["interval_deg", "method", "seed"])["key"]
    for method, part in table.groupby("method"):
        tried = np.mean([unpack_table(maps[key]) for key in keys.xs(method, level="method")], axis=0)
        assert part["top_percent"].nunique() == 1
        assert part["cd_db"].mean() == pytest.approx(tried.min(), abs=0.01)


def test_images_for_pictures_are_those_of_the_table(finished):
    plan, _, table = finished
    wanted = [plan.cases[6], plan.cases[1]]
    shown = list(images_of(plan, wanted))
    assert [outcome.case.number for outcome in shown] == [6, 1]
    # The profiles are computed here with as many threads as linear algebra likes, hence not to the last bit.
    assert [outcome.evaluation.cd_db for outcome in shown] == pytest.approx(list(table["cd_db"][[6, 1]]), abs=0.05)


@pytest.mark.parametrize("damage", ["truncated", "a flipped bit"])
def test_a_damaged_cir_is_noticed_and_traced_again(finished, tmp_path, monkeypatch, damage):
    whole = next(iter(finished[0].sources.values())).file
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))  # the tests' own holds files that others read
    plan, table = expand(experiment(tmp_path)), finished[2]
    file = next(iter(plan.sources.values())).file
    file.parent.mkdir(parents=True)
    content = bytearray(whole.read_bytes())
    if damage == "truncated":
        content = content[: len(content) // 2]
    else:
        with h5py.File(whole) as opened:
            content[opened["delay"].id.get_chunk_info(0).byte_offset + 40] ^= 1
    file.write_bytes(content)
    traced = Cir.load(whole)
    names = ("gain", "delay_s", "interaction", "first_point_m")
    views = (ViewPaths(*(getattr(traced, name)[traced.rows(view)] for name in names)) for view in range(traced.n_view))
    tracer = SimpleNamespace(trace=lambda *_, **__: next(views))
    monkeypatch.setattr("mvla_sim.channel.simulate.ViewTracer", lambda _: tracer)
    result = run_plan(plan, tmp_path / "out", workers=0)
    assert result.notes == ("scene box: the cached CIR was damaged and was traced again",)
    pd.testing.assert_frame_equal(numbers(result.table), numbers(table), check_exact=True)
    assert next(views, None) is None  # every view


def test_a_second_run_is_refused_before_it_does_anything(finished):
    plan, folder, _ = finished
    with (
        Store.open(folder, identity(plan)),
        pytest.raises(OutputError, match="another run is at work here"),
    ):
        run_plan(plan, folder)


def kill_a_worker():
    multiprocessing.active_children()[0].kill()


def test_ctrl_c_keeps_what_is_finished_and_writes_the_table(tmp_path, monkeypatch):
    plan = expand(experiment(tmp_path, MANY))
    expected = in_process(plan)

    def stop():
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        keep_then(patch, 5, stop)
        with pytest.raises(RunInterruptedError, match=r"5 of 24 cases are stored .* run the same command") as raised:
            run_plan(plan, tmp_path / "out", workers=1)
    assert raised.value.exit_code == 130
    assert multiprocessing.active_children() == []
    partial = load_table(tmp_path / "out")
    assert sorted(partial["status"].value_counts().to_dict().items()) == [("done", 5), ("missing", 19)]
    table = run_plan(plan, tmp_path / "out", workers=0).table
    assert (table["status"] == "done").all()
    assert list(table["cd_db"]) == pytest.approx([expected[key].metrics["cd_db"] for key in table["key"]], abs=0.05)


def test_a_worker_that_dies_costs_time_alone(tmp_path, monkeypatch):
    plan = expand(experiment(tmp_path, MANY))
    monkeypatch.setattr("mvla_sim.sweep.schedule.BATCH_S", 0.0)
    with monkeypatch.context() as patch:
        keep_then(patch, 3, kill_a_worker)
        result = run_plan(plan, tmp_path / "out", workers=1)
    assert result.count("done") == 24
    assert all("a worker died once while it ran case" in note for note in result.notes)  # none where it was idle


def test_a_full_disk_ends_the_run_and_keeps_what_was_stored(tmp_path, monkeypatch):
    """SQLite's own page limit stands for the disk."""
    plan = expand(experiment(tmp_path, MANY))
    original = Store.add

    def add(self, row):
        if self._database.execute("SELECT count(*) FROM cases").fetchone()[0] == 4:
            self.flush()
            self._database.execute("PRAGMA max_page_count = 1")  # the file's own size: not a page more
            row = Row(row.key, row.status, "x" * 10_000)
        original(self, row)

    with monkeypatch.context() as patch:
        patch.setattr(Store, "add", add)
        with pytest.raises(OutputError, match="no space left on the disk"):
            run_plan(plan, tmp_path / "out", workers=0)
    assert survey(plan, tmp_path / "out", 1).done == 4
    assert run_plan(plan, tmp_path / "out", workers=0).count("done") == 24
