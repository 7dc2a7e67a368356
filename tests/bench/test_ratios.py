"""Ratios to a reference: what is counted, what is written. Sizes are tiny; no time is judged."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import mvla_sim.bench.ratios as bench
import mvla_sim.imaging.observation as user
from mvla_sim.bench import sweep_jobs
from mvla_sim.bench.cost_tables import ratio_line
from mvla_sim.bench.ratios import RATIOS, Ratio, measure_ratios, watched
from mvla_sim.cli.app import run as mvla
from mvla_sim.errors import ConfigError
from mvla_sim.imaging.method import phase_free_methods
from mvla_sim.imaging.projection import project
from mvla_sim.sweep.run import run_plan
from mvla_sim.sweep.store import Store


def test_time_is_counted_wherever_a_function_is_known_and_no_longer_than_asked(monkeypatch):
    monkeypatch.setattr(user, "project", bench.project)
    add = Store.add
    with watched(project=bench.project, add=Store.add) as seconds:
        for call in (user.project, bench.project):
            before = seconds["project"]
            with pytest.raises(TypeError):
                call()
            assert seconds["project"] > before
        assert Store.add is not add
    assert user.project is bench.project is project
    assert Store.add is add
    assert seconds["add"] == 0


def test_every_method_is_compared_with_the_projection_of_bp(monkeypatch):
    monkeypatch.setattr(bench, "METHOD_SIZES", ((400, 6),))
    found = {one.name.partition(",")[0]: one for one in measure_ratios(["methods"], runs=1)}
    assert tuple(found) == phase_free_methods()
    assert {one.against for one in found.values()} == {"BP's projection"}
    assert found["bp"].ratio > 0


def test_parts_of_a_sweep_and_the_rest_are_the_whole(monkeypatch):
    monkeypatch.setattr(bench, "VIEWS", 6)
    monkeypatch.setattr(bench, "AXES", {"interval_deg": [60.0], "snr_db": [0.0], "method": ["bp"]})
    monkeypatch.setattr(sweep_jobs, "DEFAULT_RAYS", (600, 2000))
    monkeypatch.setattr(bench, "run_plan", lambda plan, folder, workers=0: run_plan(plan, folder, workers=0))
    found = {one.name: one for one in measure_ratios(["sweep"])}
    parts = [*bench.PARTS, "the rest"]
    assert sum(found[part].ratio for part in parts) == pytest.approx(1)
    assert found["search"].seconds > 0
    assert found["all cases"].seconds == pytest.approx(sum(found[part].seconds for part in parts))


def test_an_unknown_stage_is_one_line(tmp_path, capsys):
    with pytest.raises(
        ConfigError, match=r"^stage = search: no ratios of it; allowed: projection, methods, tracing, s"
    ):
        next(measure_ratios(["search"]))
    assert mvla(["bench", "--ratios", "--stage", "search", "-o", str(tmp_path / "new")]) == 2
    assert "no ratios of it" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_command_prints_and_stores_what_it_found(tmp_path, monkeypatch, capsys):
    made = Ratio("projection", "BP", 0.25, 40.0, "a NumPy twin", 1.44e9, "voxel·view")
    monkeypatch.setitem(RATIOS, "projection", lambda runs: iter([made]))
    assert mvla(["bench", "--ratios", "--stage", "projection", "-o", str(tmp_path / "bench")]) == 0
    assert ratio_line(made) == "projection: BP: 250 ms, 1.44e+09 voxel·view/s, 40 × a NumPy twin"
    assert ratio_line(made) in capsys.readouterr().out.splitlines()
    (row,) = pd.read_csv(tmp_path / "bench" / "ratios.csv").to_dict("records")
    assert row["ratio"] == 40
    assert row["cores"] >= 1
    assert "nan" not in ratio_line(Ratio("tracing", "power", math.nan, 1.0, "half as many"))


def test_the_gpu_check_skips_with_the_reason_where_there_is_no_gpu():
    program = Path(__file__).parents[1] / "gpu_check.py"
    environment = {key: value for key, value in os.environ.items() if key != "MVLA_GPU_CHECK_BACKEND"}
    child = subprocess.run(
        [sys.executable, program], env=environment | {"CUDA_VISIBLE_DEVICES": ""}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert child.returncode == 0, child.stdout + child.stderr
    assert "5 skipped" in child.stdout
    assert "Dr.Jit finds no CUDA device" in child.stdout
