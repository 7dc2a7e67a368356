"""The store: what it keeps, what it refuses, and what survives."""

from __future__ import annotations

import json
import math
import os
import signal
import sqlite3
import subprocess
import sys
import time

import pytest
from sweep_files import experiment, write

from mvla_sim.errors import DataError, OutputError
from mvla_sim.sweep import store as module
from mvla_sim.sweep.case import ROW_SCHEMA, Row
from mvla_sim.sweep.experiment import load_experiment
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.store import FILE, Store, identity

ID = {"experiment": {"a": 1}}


def some(count, size=10):
    return [Row(f"key{n}", "done", "", 0.1, {"cd_db": -float(n), "reason": "x" * size}) for n in range(count)]


def fill(folder, rows, wanted=ID, **options):
    with Store.open(folder, wanted, **options) as store:
        for row in rows:
            store.add(row)


def test_rows_come_back_as_they_were(tmp_path):
    rows = [
        Row("a", "done", "", 0.25, {"cd_db": -math.inf, "views": 3, "x": 0.1 + 0.2, "reason": "größer"}),
        Row("b", "failed", "DataError: no path", 0.0),
    ]
    fill(tmp_path, rows)
    assert Store.peek(tmp_path, ID) == {row.key: row for row in rows}


def test_a_case_run_again_replaces_what_was_stored(tmp_path):
    fill(tmp_path, [Row("a", "failed", "no")])
    fill(tmp_path, [Row("a", "done")])
    assert Store.peek(tmp_path, ID)["a"].status == "done"


def test_nothing_is_stored_where_nothing_is(tmp_path):
    assert Store.peek(tmp_path / "none", ID) == {}
    assert not (tmp_path / "none").exists()


def test_fresh_discards(tmp_path):
    fill(tmp_path, some(3))
    fill(tmp_path, some(1), {"experiment": {"a": 2}}, fresh=True)
    assert set(Store.peek(tmp_path, {"experiment": {"a": 2}})) == {"key0"}


def test_a_second_run_on_one_folder_is_refused_at_once(tmp_path):
    began = time.monotonic()
    with Store.open(tmp_path, ID) as store:
        store.add(some(1)[0])
        with (
            pytest.raises(OutputError, match=rf"another run is at work here \(process {os.getpid()}\)"),
            Store.open(tmp_path, ID),
        ):
            pass
    assert time.monotonic() - began < 2  # it does not wait for the first one
    fill(tmp_path, [])  # and the folder is free again


def test_a_killed_run_leaves_no_lock_and_keeps_what_was_committed(tmp_path):
    """The rows before the commit survive kill -9; those of the open transaction are rolled back."""
    program = (
        "import sys, time; from mvla_sim.sweep.case import Row; from mvla_sim.sweep.store import Store;"
        "from pathlib import Path\n"
        "with Store.open(Path(sys.argv[1]), {'experiment': {'a': 1}}) as s:\n"
        "    s.add(Row('kept', 'done')); s.flush(); s.add(Row('open', 'done'))\n"
        "    print('now', flush=True); time.sleep(60)"
    )
    child = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    with child:
        assert child.stdout.readline() == "now\n"
        child.send_signal(signal.SIGKILL)
    with Store.open(tmp_path, ID) as store:
        assert set(store.rows()) == {"kept"}


@pytest.mark.parametrize("damage", ["garbage", "truncated", "another database"])
def test_a_damaged_store_is_one_line(tmp_path, damage):
    fill(tmp_path, some(200, 500))
    file = tmp_path / FILE
    if damage == "garbage":
        file.write_bytes(b"no database at all, " * 500)
    elif damage == "truncated":
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    else:
        file.unlink()
        with sqlite3.connect(file) as other:
            other.execute("CREATE TABLE cases (a)")
        other.close()
    for attempt in (lambda: fill(tmp_path, []), lambda: Store.peek(tmp_path, ID)):
        with pytest.raises(DataError, match="with a fresh run") as raised:
            attempt()
        assert str(file) in str(raised.value)
        assert "\n" not in str(raised.value)


def test_an_empty_file_is_an_empty_store(tmp_path):
    """A run killed between making the file and filling it leaves one."""
    (tmp_path / FILE).touch()
    assert Store.peek(tmp_path, ID) == {}
    fill(tmp_path, some(2))
    assert len(Store.peek(tmp_path, ID)) == 2


def test_another_schema_or_program_is_refused(tmp_path, monkeypatch):
    fill(tmp_path, some(1))
    with monkeypatch.context() as patch:
        patch.setattr(module, "ROW_SCHEMA", 99)
        with pytest.raises(DataError, match=rf"schema {ROW_SCHEMA}; this program writes schema 99"):
            fill(tmp_path, [])
    monkeypatch.setattr(module, "program_version", lambda: "9.9.9")
    with pytest.raises(DataError, match=r"made by mvla-sim .*, this is 9\.9\.9"):
        fill(tmp_path, [])


def test_cases_of_older_code_are_told(tmp_path, monkeypatch):
    with Store.open(tmp_path, ID) as store:
        assert store.notes == []
    with monkeypatch.context() as patch:
        patch.setattr(module, "code_digest", lambda *parts: "changed")
        with Store.open(tmp_path, ID) as store:
            assert "a fresh run computes them anew" in store.notes[0]
    for fresh in (False, True):
        with Store.open(tmp_path, ID, fresh=fresh) as store:
            assert len(store.notes) == 1 - fresh


def test_a_full_disk_is_named_and_what_was_stored_stays(tmp_path):
    """SQLite's own page limit stands for the disk: it raises the same error."""
    fill(tmp_path, some(5))

    def write_on():
        with Store.open(tmp_path, ID) as store:
            pages = store._database.execute("PRAGMA page_count").fetchone()[0]
            store._database.execute(f"PRAGMA max_page_count = {pages + 2}")
            for row in some(1000, 5000):
                store.add(row)
                store.flush()

    with pytest.raises(OutputError, match="no space left on the disk") as raised:
        write_on()
    assert str(tmp_path / FILE) in str(raised.value)
    kept = Store.peek(tmp_path, ID)
    assert kept.keys() >= {"key0", "key1", "key2", "key3", "key4"}
    assert all(row.metrics["cd_db"] == -int(key[3:]) for key, row in kept.items())


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be written"):
        fill(tmp_path / "file" / "folder", [])


def ident(folder, axes="kappa = [0.5]\n", more="", overrides=()):
    return identity(expand(experiment(folder, axes, more, overrides)))


def test_added_values_and_scenes_share_a_store(tmp_path):
    folder = tmp_path / "out"
    fill(folder, some(1), ident(tmp_path))
    fill(folder, [], ident(tmp_path, "kappa = [0.7, 0.5]\n"))
    fill(folder, [], ident(tmp_path, overrides=("imaging.mvla.kappa=0.9", "description=new")))  # the axis replaces it
    file = write(tmp_path, "kappa = [0.5]\n")
    (tmp_path / "other.toml").write_text((tmp_path / "box.toml").read_text().replace('"box"', '"other"'))
    file.write_text(file.read_text().replace('["box.toml"]', '["other.toml", "box.toml"]'))
    fill(folder, [], identity(expand(load_experiment(file))))
    fill(folder, [], ident(tmp_path))
    assert len(Store.peek(folder, ident(tmp_path))) == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"overrides": ("imaging.mvla.eta=0.1",)}, "imaging.mvla.eta = 0.04 there, 0.1 here"),
        ({"overrides": ("imaging.pdp.gate_m=[2, 9]",)}, "imaging.pdp.gate_m = null there, absent here"),
        ({"overrides": ("evaluation.truth=filled",)}, 'evaluation.truth = "contour" there, "filled" here'),
        ({"axes": "kappa = [0.5]\nseed = [0]\n"}, 'axes = "kappa" there, "kappa, seed" here'),
    ],
)
def test_other_settings_are_refused_with_what_differs(tmp_path, change, said):
    folder = tmp_path / "out"
    fill(folder, some(1), ident(tmp_path))
    with pytest.raises(DataError) as raised:
        fill(folder, [], ident(tmp_path, **change))
    assert said in str(raised.value)
    assert len(Store.peek(folder, ident(tmp_path))) == 1


def test_another_scene_of_the_same_name_is_refused(tmp_path):
    folder = tmp_path / "out"
    fill(folder, some(1), ident(tmp_path))
    file = write(tmp_path, "kappa = [0.5]\n", scene=(tmp_path / "box.toml").read_text().replace("2.0", "2.5"))
    with pytest.raises(DataError, match=r"scene box: objects\.0\.side_m = 2\.0 there, 2\.5 here"):
        fill(folder, [], identity(expand(load_experiment(file))))


def test_the_identity_is_plain_json(tmp_path):
    found = ident(tmp_path, 'method = ["bp"]\n', overrides=("imaging.noise.snr_db=none",))
    assert json.loads(json.dumps(found)) == found
    assert str(tmp_path) not in json.dumps(found)  # no place of this machine
