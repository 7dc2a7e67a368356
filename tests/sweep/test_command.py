"""``mvla run``: what it prints, its exit codes, and that it survives being killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import command_line
import pandas as pd
import pytest
from sweep_files import numbers, write

from mvla_sim.errors import DataError, OutputError
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.run import run_plan
from mvla_sim.sweep.store import Store, identity
from mvla_sim.sweep.table import load_table

MVLA = [sys.executable, "-c", "from mvla_sim.cli import main; main()"]


def mvla(*arguments, expected=0):
    """Run a command to its end, without workers where it does not ask for some; return what it printed, and notes."""
    workers = () if "--workers" in arguments else ("--workers", "0")
    return command_line.mvla(*arguments, *workers, code=expected, notes=True)


def start(*arguments):
    """Start a command in a process group of its own, so that its workers can be killed with it."""
    return subprocess.Popen(
        [*MVLA, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def stored(plan, folder):
    """Number of cases that a folder's store holds."""
    try:
        return len(Store.peek(folder, identity(plan)))
    except (DataError, OutputError):  # in the middle of being made
        return 0


def wait_for(plan, folder, count, child):
    deadline = time.monotonic() + 60
    while stored(plan, folder) < count:
        assert child.poll() is None, child.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_dry_run_tells_and_does_nothing(tmp_path):
    file = write(tmp_path, 'interval_deg = [10.0, 30.0]\noffset = "all"\nsnr_db = ["none", 5.0]\n')
    text = mvla("run", file, "--dry-run", "-o", tmp_path / "out")
    assert "8; 0 stored, 8 to run" in text
    assert "1 needed" in text
    assert "a guess" in text
    assert not (tmp_path / "out").exists()


def test_too_many_cases_need_a_yes(tmp_path):
    file = write(tmp_path, f"seed = {list(range(20_001))}\n")
    text = mvla("run", file, "-o", tmp_path / "out", expected=2)
    assert "20,001 cases; above 20,000 shorten the axes, or lift the limit (--yes)" in text
    assert not (tmp_path / "out").exists()
    assert "20001; 0 stored" in mvla("run", file, "-o", tmp_path / "out", "--dry-run", "--yes")


def test_failed_cases_make_exit_code_one(tmp_path):
    file = write(tmp_path, 'method = ["mvla-gr", "bp"]\nthreshold_sigma = [1e6]\n')
    text = mvla("run", file, "-o", tmp_path / "out", "--workers", 1, expected=1)
    assert "case 0 failed: DataError: no peak" in text
    assert "of 2 cases 1 failed; see the table" in text
    assert list(load_table(tmp_path / "out")["status"]) == ["failed", "done"]


def test_other_settings_need_another_folder_or_fresh(tmp_path):
    file = write(tmp_path, 'method = ["bp"]\n')
    mvla("run", file, "-o", tmp_path / "out")
    changed = ("--set", "imaging.pdp.window=hamming")
    text = mvla("run", file, "-o", tmp_path / "out", *changed, expected=2)
    assert 'imaging.pdp.window = "hann" there, "hamming" here' in text
    mvla("run", file, "-o", tmp_path / "out", *changed, "--fresh")
    assert list(load_table(tmp_path / "out")["imaging.pdp.window"]) == ["hamming"]


def test_a_calibrated_experiment_follows_the_one_it_names(tmp_path):
    axes = 'interval_deg = [30.0]\noffset = "all"\nmethod = ["bp", "mvla-gr"]\n'
    mvla("run", write(tmp_path, axes, name="first"), "-o", tmp_path / "results" / "first")
    second = write(tmp_path, axes, '[calibration]\nfrom = "first"\nover = ["offset"]\n', name="second")
    mvla("run", second, "-o", tmp_path / "results" / "second")
    best, given = (load_table(tmp_path / "results" / name) for name in ("first", "second"))
    assert set(given["protocol"]) == {"given"}
    assert "optimal_cd_db" not in given
    for method in ("bp", "mvla-gr"):
        mean = best[best["method"] == method][["top_percent", "min_support_deg"]].mean()
        used = given[given["method"] == method][["top_percent", "min_support_deg"]]
        assert used.to_numpy() == pytest.approx(mean.to_numpy()[None].repeat(3, 0))
    # No thresholds beat the optimum; both tables have nine digits.
    assert (given["cd_db"].fillna(99) >= best["cd_db"] - 1e-6).all()


@pytest.mark.parametrize("cases", ["seed = [0, 1]\n", ""])
def test_an_experiment_shows_what_it_is_asked_to(tmp_path, cases):
    file = write(tmp_path, cases, "[[show]]\n")
    text = mvla("run", file, "-o", tmp_path / "out")
    assert text.count("picture: ") == (5 if cases else 4)
    assert (tmp_path / "out" / "box-scene.png").stat().st_size > 1000


LADDER = """
interval_deg = [30.0, 60.0]
method = ["hard-vote", "soft-kernel", "power-weights", "mvla-gr"]
"imaging.impairments.position_error_m" = [0.001, 0.1]
"""


def test_a_ladder_and_swept_impairments_are_drawn(tmp_path):
    """Without being asked: the table and figure of an ablation, a figure a scene of what was impaired."""
    mvla("run", write(tmp_path, LADDER), "-o", tmp_path / "out")
    for name in ("ablation.png", "box-robustness.png"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    assert "| Power weights |" in (tmp_path / "out" / "ablation.md").read_text(encoding="utf-8")


MANY = f"""
interval_deg = [20.0, 30.0]
offset = "all"
method = ["mvla-gr", "bp"]
seed = {list(range(60))}
"""


def test_ctrl_c_is_one_line_and_the_next_run_goes_on(tmp_path):
    """The signal goes to the whole group, as from a terminal; meanwhile a second run is refused."""
    file, folder = write(tmp_path, MANY), tmp_path / "out"
    with start("run", file, "-o", folder, "--workers", 2) as child:
        wait_for(expand(load_experiment(file)), folder, 5, child)
        os.killpg(child.pid, signal.SIGSTOP)  # so that it cannot finish before the second run looks
        refused = mvla("run", file, "-o", folder, expected=2)
        os.killpg(child.pid, signal.SIGCONT)
        assert f"another run is at work here (process {child.pid})" in refused
        os.killpg(child.pid, signal.SIGINT)
        _, errors = child.communicate(timeout=60)
    assert child.returncode == 130
    assert "Traceback" not in errors
    last = errors.strip().splitlines()[-1]
    assert last.startswith("mvla: error: stopped; ")
    assert last.endswith("run the same command to go on")
    before = load_table(folder)
    done = int((before["status"] == "done").sum())
    assert 5 <= done < 600
    assert f"{done} of 600 cases" in last


KILLED = """
import os, signal, sys
import mvla_sim.sweep.run
from mvla_sim.cli.app import run
from mvla_sim.sweep import schedule
from mvla_sim.sweep.store import Store
schedule.BATCH_S = 0.2
added = 0
def watched(name):
    original = getattr(Store, name)
    def method(self, *arguments):
        global added
        result = original(self, *arguments)
        added += name == "add"
        if name == moment and added >= int(rows):
            os.killpg(0, signal.SIGKILL)
        return result
    setattr(Store, name, method)
for name in ("_prepare", "rows", "add", "flush"):
    watched(name)
for line in sys.stdin:
    moment, rows, workers = line.split()
    if not (child := os.fork()):
        os.setsid()
        os.dup2(2, 1)
        os._exit(run([*sys.argv[1:], "--workers", workers]))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
"""``mvla`` that ends itself and its workers, as kill -9 does, after a method of the store, once so many rows are in.

Each line of its input is a run in a process of its own; forked, because each would take seconds to import the same.
"""
MOMENTS = (
    ("_prepare", 0, 2), ("rows", 0, 2), ("add", 1, 0), ("flush", 10, 2), ("add", 30, 0), ("flush", 1, 0), ("add", 7, 2),
    ("flush", 40, 0), ("add", 2, 0), ("flush", 25, 2),
)  # fmt: skip
"""When the store was made, was read, before a commit, and after one; and how many workers there are."""


@pytest.mark.slow
@pytest.mark.timeout(900)  # eleven runs
def test_killed_ten_times_the_tables_are_those_of_an_uninterrupted_run(tmp_path):
    """kill -9 of the run and its workers at chosen moments, from its start to the middle of its cases."""
    file, folder = write(tmp_path, MANY), tmp_path / "killed"
    plan = expand(load_experiment(file))
    whole = run_plan(plan, tmp_path / "whole", workers=0).table
    counts = [0]
    command = ["run", str(file), "-o", str(folder)]
    killed = [sys.executable, "-c", KILLED, *command]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # no threads where it forks
    with subprocess.Popen(killed, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        for moment, rows, workers in MOMENTS:
            print(moment, rows, workers, file=parent.stdin, flush=True)
            assert parent.stdout.readline().split() == [str(-signal.SIGKILL)]
            counts.append(stored(plan, folder))
            if moment == "flush":
                assert counts[-1] >= counts[-2] + rows  # what was committed
        parent.stdin.close()
    assert counts == sorted(counts)  # nothing that was stored is lost
    assert counts[-1] < len(whole)
    mvla(*command)
    pd.testing.assert_frame_equal(
        numbers(load_table(folder)), numbers(load_table(tmp_path / "whole")), check_exact=True
    )
    assert (load_table(folder)["status"] == "done").all()
    assert [path.name for path in Path(folder).glob("*journal*")] == []
