"""Tables, files and the command itself; measuring is made up."""

from __future__ import annotations

import json

import pandas as pd
import pytest
from rows import measured_rows

from mvla_sim.bench import stages
from mvla_sim.bench.cost_tables import axis_tables, estimate_lines, frame, markdown
from mvla_sim.bench.estimate import CostScenario, costs_from, estimate
from mvla_sim.cli.app import run as mvla


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """The command with made-up rows; returns its folder, what it printed, and its errors."""
    monkeypatch.setattr(stages, "measure_stages", measured_rows)

    def call(*chosen, folder=tmp_path / "new" / "bench", code=0):
        options = [word for stage in chosen for word in ("--stage", stage)]
        assert mvla(["bench", "--quick", "-o", str(folder), *options]) == code
        printed = capsys.readouterr()
        return folder, printed.out, printed.err

    return call


def test_files(run):
    folder, text, errors = run()
    assert {path.name for path in folder.iterdir()} == {"bench.json", "bench.csv", "bench.md"}
    record = json.loads((folder / "bench.json").read_text())
    assert record["machine"]["cores"] >= 1
    assert record["machine"]["cpu"]
    assert record["estimate"]["bound"] == "tracing"
    table = pd.read_csv(folder / "bench.csv")
    assert len(table) == len(record["points"]) == len(measured_rows(quick=True))
    assert {"stage", "series", "rays", "first_s", "median_s", "core_s", "memory_mib", "steady_mib", "rate_unit"} <= set(
        table
    )
    page = (folder / "bench.md").read_text()
    assert record["machine"]["cpu"] in page
    assert "bounded by tracing" in page
    assert "bounded by tracing" in text
    assert all(assumed in page for assumed in record["estimate"]["assumptions"])
    assert errors == ""


def test_some_stages_have_no_estimate(run):
    folder, text, _ = run("search")
    record = json.loads((folder / "bench.json").read_text())
    assert record["estimate"] is None
    assert {point["stage"] for point in record["points"]} == {"search"}
    assert "bounded" not in text


def test_bad_input_is_found_before_anything_is_measured(run, tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "measure_stages", pytest.fail)
    assert "nonsense" in run("search", "nonsense", code=2)[2]
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    assert "cannot be made" in run(folder=tmp_path / "file", code=2)[2]
    (tmp_path / "taken" / "bench.csv").mkdir(parents=True)
    assert "is a folder" in run(folder=tmp_path / "taken", code=2)[2]


def test_ctrl_c_leaves_earlier_files_as_they_were(run, monkeypatch):
    folder, _, _ = run()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def interrupted(chosen, *, quick):
        raise KeyboardInterrupt

    monkeypatch.setattr(stages, "measure_stages", interrupted)
    run(code=130)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_tables_hold_every_axis_and_its_law():
    tables = {table.title.partition(" (")[0]: table for table in axis_tables(measured_rows())}
    views = tables["tracing: star against views"]
    assert [cells[0] for cells in views.lines] == sorted((cells[0] for cells in views.lines), key=int)
    assert "100 ms + 200 ms × views within 0 %" in views.law
    assert "voxels^1.00 overall, ^1.00 between the last two" in tables["projection: bp against voxels"].law
    assert "thresholds^0.50 overall" in tables["search: image of the target against thresholds"].law
    assert tables["sweep: cases against workers"].law == ""
    text = markdown(views)
    assert text.count("\n|") == 2 + len(views.lines)
    assert text.splitlines()[0] == f"**{views.title}**"


def test_a_disturbed_point_is_marked(run, monkeypatch):
    def slow(chosen, *, quick):
        rows = measured_rows(chosen, quick=quick)
        object.__setattr__(rows[0].measured, "median_s", 10 * rows[0].measured.core_s)
        return rows

    monkeypatch.setattr(stages, "measure_stages", slow)
    folder, _, errors = run()
    assert errors.startswith(f"mvla: note: at 1 of {len(measured_rows(quick=True))} points")
    assert frame(slow(["tracing"], quick=True))["disturbed"].tolist().count(True) == 1
    assert "s* |" in (folder / "bench.md").read_text()


def test_the_estimate_is_told_in_units_one_can_read():
    lines = estimate_lines(estimate(costs_from(measured_rows()), CostScenario(scenes=10, views=36, nodes=1, cores=2)))
    assert lines[0].startswith("10 scenes × 36 views on 1 node of 2 cores: ")
    assert any(line.startswith("CIR files: 7.2 MB, written at ") for line in lines)
