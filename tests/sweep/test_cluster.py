"""Tasks and sweeps on real Dask processes on this machine: the same results everywhere, also after the worst."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from importlib.metadata import requires
from pathlib import Path
from types import SimpleNamespace

import cluster_tasks as tasks
import dask
import distributed
import pandas as pd
import psutil
import pytest
from distributed import Client, LocalCluster
from existing_cluster import Existing
from sweep_files import experiment, keep_then, numbers

from mvla_sim.cluster import dask_cluster as module
from mvla_sim.cluster import worker as worker_module
from mvla_sim.cluster.dask_cluster import IN_FLIGHT
from mvla_sim.cluster.existing_cluster import OLDEST
from mvla_sim.cluster.interface import TaskError, WorkerDiedError
from mvla_sim.cluster.opening import open_cluster
from mvla_sim.cluster.worker import fair_share
from mvla_sim.engine.cache import VARIABLE, shared_cache
from mvla_sim.engine.machine import core_count
from mvla_sim.errors import ConfigError, DataError, OutputError, RuntimeUnfitError
from mvla_sim.sweep import session as run_module
from mvla_sim.sweep.case import Row
from mvla_sim.sweep.plan import expand
from mvla_sim.sweep.run import run_plan
from mvla_sim.sweep.store import Store
from mvla_sim.sweep.table import load_table

AXES = 'interval_deg = [30.0]\noffset = "all"\nseed = [0, 1, 2, 3]\nmethod = ["mvla-gr", "bp"]\n'


@pytest.fixture
def existing(tmp_path):
    cluster = Existing(tmp_path, Path(__file__).parent)
    yield cluster
    cluster.end()
    cluster.log.close()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Plan and table of a run in this process."""
    folder = tmp_path_factory.mktemp("undisturbed")
    plan = expand(experiment(folder, AXES))
    return plan, run_plan(plan, folder / "out", workers=0).table


@pytest.fixture(scope="module")
def local():
    """Two workers on this machine, which replace each other where they die."""
    with open_cluster(2) as cluster:
        yield cluster


def assert_same(table, expected):
    pd.testing.assert_frame_equal(numbers(table), numbers(expected), check_exact=True)


def alive(pid):
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE


def check_tasks(cluster):
    """Values, errors, shared values, and that tasks are taken as they are needed."""
    results = dict(cluster.run(tasks.divide, [(6, 2), (1, 0), (8, 2)], label="divide"))
    assert [results[number].value for number in range(3)] == [3, None, 4]
    assert [results[number].reason for number in range(3)] == ["", "DataError: 1 / 0 cannot be", ""]
    assert isinstance(results[1].error, DataError)  # the error itself, where it is of this package
    (result,) = cluster.run(tasks.divide, [("a", 2)], label="divide")
    assert isinstance(result[1].error, TaskError)
    assert result[1].reason == "TypeError: unsupported operand type(s) for /: 'str' and 'int'"
    shared = cluster.share(tasks.made, 7)
    taken = [finished.value for _, finished in cluster.run(tasks.takes, ((shared, n) for n in range(5)), label="take")]
    assert sorted(number for _, number in taken) == list(range(5))
    assert len({value for value, _ in taken}) == 1  # made once
    broken = cluster.share(tasks.nothing)
    (result,) = cluster.run(tasks.takes, [(broken, 0)], label="take")
    assert result[1].reason == "DataError: nothing to share"
    pulled = []
    many = cluster.run(tasks.divide, ((pulled.append(n) or n, 1) for n in range(10**6)), label="many")
    for count, _ in enumerate(many, 1):
        assert len(pulled) <= count + max(12, IN_FLIGHT * cluster.count)
        if count == 30:
            break
    many.close()


def test_in_this_process_without_dask():
    with open_cluster(0) as cluster:
        check_tasks(cluster)
    program = (
        "import sys; from mvla_sim.cluster.opening import open_cluster\n"
        "with open_cluster(0) as c: print(*c.run(abs, [(-1,)], label='x'))\n"
        "sys.exit('distributed' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_local_workers_share_the_cores_listen_here_alone_and_end():
    before = dict(os.environ)
    said = []
    with open_cluster(2, out=said.append) as cluster:
        assert said == []  # nothing runs before it is needed
        check_tasks(cluster)
        states = [finished.value for _, finished in cluster.run(tasks.state, [()] * 8, label="state")]
        pids = {pid for pid, _ in states}
        assert all(threads == {"drjit": max(1, core_count() // 2), "algebra": 1} for _, threads in states)
        for pid in (os.getpid(), *pids):
            listening = [c.laddr.ip for c in psutil.Process(pid).net_connections("inet") if c.status == "LISTEN"]
            assert set(listening) <= {"127.0.0.1"}
    assert len(said) == 1
    assert said[0].startswith(("dashboard: http://127.0.0.1:", "scheduler: tcp://127.0.0.1:"))
    assert not any(alive(pid) for pid in pids)
    assert dict(os.environ) == before


def test_leaving_does_not_wait_for_what_runs():
    with open_cluster(1) as cluster:
        runs = cluster.run(tasks.wait, [(0,), (600,), (600,)], label="wait")
        pid = next(runs)[1].value
        time.sleep(0.3)
        began = time.monotonic()
    assert time.monotonic() - began < 5
    assert not alive(pid)


def test_only_the_task_that_kills_its_workers_is_given_up(local, tmp_path):
    before = local.deaths
    results = dict(local.run(tasks.die, [(n, 5) for n in range(12)], label="die"))
    assert {n: r.reason for n, r in results.items()} == {n: "worker died" if n == 5 else "" for n in range(12)}
    assert isinstance(results[5].error, WorkerDiedError)
    assert results[5].deaths == local.deaths - before == 3
    again = dict(local.run(tasks.die_once, [(n, 3, str(tmp_path / "mark")) for n in range(6)], label="once"))
    assert [again[n].value for n in range(6)] == list(range(6))
    assert again[3].deaths == 1


def test_a_result_that_dies_with_its_worker_is_made_again():
    """Dask calls it lost; the run goes on, and no death is laid on the task."""
    cluster = module.DaskCluster("workers", print)
    cluster._client = SimpleNamespace(status="running", gather=list)
    task = module._Submitted(0, ())
    task.future = SimpleNamespace(status="lost")
    cluster._events.put((77, task.future))
    assert cluster._wait({77: task}) == [(task, None)]
    assert (task.deaths, cluster.deaths) == (0, 0)
    task.future = SimpleNamespace(status="cancelled")  # as when the scheduler is gone
    cluster._events.put((78, task.future))
    with pytest.raises(RuntimeUnfitError, match="the connection is lost"):
        cluster._wait({78: task})


@pytest.mark.parametrize(
    ("granted", "all_granted", "machine", "usable", "share"),
    [(4, 4, 8, 8, 4), (8, 16, 8, 8, 4), (8, 8, 8, 2, 2), (1, 4, 2, 2, 1), (2, 2, 2, 2, 2)],
)
def test_workers_of_one_host_share_its_cores(granted, all_granted, machine, usable, share):
    assert fair_share(granted, all_granted, machine, usable) == share


def test_bad_choices_are_one_line():
    with pytest.raises(ConfigError, match="give one of them"), open_cluster(1, "tcp://127.0.0.1:1"):
        pass
    with pytest.raises(ConfigError, match="at least 0"), open_cluster(-1):
        pass
    with pytest.raises(ConfigError, match=r"cache URL nowhere://x: cannot be used"), shared_cache("nowhere://x"):
        pass
    with pytest.raises(ConfigError, match="must be an address with a port"), open_cluster(None, "nonsense://x"):
        pass
    with open_cluster(None, "nonsense://x:1") as cluster, pytest.raises(RuntimeUnfitError, match="no Dask scheduler"):
        cluster.start()


SITE = """
temporary-directory: /proc/scratch/dask
scheduler-address: tcp://10.255.255.1:8786
distributed:
  comm:
    require-encryption: true
  worker:
    preload: [no_such_module]
"""


def test_local_workers_do_not_depend_on_a_sites_configuration(tmp_path):
    """Folders that cannot be made, encryption and modules to load are for the site's own clusters."""
    (tmp_path / "site.yaml").write_text(SITE)
    program = (
        "from mvla_sim.cluster.opening import open_cluster\nimport cluster_tasks, dask\n"
        "if __name__ == '__main__':\n"
        "    assert dask.config.get('distributed.comm.require-encryption')\n"
        "    with open_cluster(1) as cluster:\n"
        "        print([done.value for _, done in cluster.run(cluster_tasks.divide, [(6, 2)], label='divide')])\n"
        "    assert dask.config.get('temporary-directory') == '/proc/scratch/dask'\n"
    )
    (tmp_path / "program.py").write_text(program)
    where = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    ran = subprocess.run(
        [sys.executable, tmp_path / "program.py"], check=False, capture_output=True, text=True, timeout=100,
        env=os.environ | {"DASK_CONFIG": str(tmp_path), "PYTHONPATH": where},
    )  # fmt: skip
    assert (ran.returncode, ran.stdout) == (0, "[3.0]\n"), ran.stderr


def test_a_broken_configuration_is_one_line(tmp_path):
    (tmp_path / "broken.yaml").write_text("distributed:\n  worker: [1,\n")
    program = (
        "from mvla_sim.cluster.opening import open_cluster\nfrom mvla_sim.errors import ConfigError\n"
        "for choice in ((1,), (None, 'tcp://127.0.0.1:1')):\n"
        "    try:\n        open_cluster(*choice).__enter__()\n"
        "    except ConfigError as error:\n        print(error)\n"
    )
    env = os.environ | {"DASK_CONFIG": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    ran = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True, env=env, timeout=100
    )
    lines = ran.stdout.splitlines()
    assert len(lines) == 2, ran.stderr
    assert all(f"Dask's configuration: '{tmp_path}/broken.yaml' is malformed" in line for line in lines)


def test_encryption_that_a_site_asks_for_is_told():
    with (
        dask.config.set({"distributed.comm.require-encryption": True}),
        open_cluster(None, "tcp://127.0.0.1:1") as cluster,
        pytest.raises(RuntimeUnfitError, match=r"distributed\.comm\.require-encryption = true; give a tls://"),
    ):
        cluster.start()


def test_a_scheduler_of_an_older_dask_is_told_with_both_versions(monkeypatch):
    """A client of this one would ask it what it does not understand, for 40 s."""
    assert any(text.startswith(f"distributed>={OLDEST[0]}.{OLDEST[1]}") for text in requires("mvla-sim"))

    async def versions(packages=None):
        return {"host": {}, "packages": {"distributed": "2024.8.0"}}

    with LocalCluster(n_workers=0, dashboard_address=None, processes=False, host="127.0.0.1", protocol="tcp") as local:
        monkeypatch.setitem(local.scheduler.handlers, "versions", versions)
        with (
            open_cluster(None, local.scheduler_address) as cluster,
            pytest.raises(
                RuntimeUnfitError, match=rf"is 2024\.8\.0, this machine's {distributed.__version__}; install"
            ),
        ):
            cluster.start()


def test_a_shared_cache_spares_tracing(tmp_path, monkeypatch):
    """What one machine has left in fsspec's memory, here and in no file, another one finds."""
    with shared_cache("memory://mvla"):
        for name in ("one", "other"):
            monkeypatch.setenv(VARIABLE, str(tmp_path / name))
            plan = expand(experiment(tmp_path, 'method = ["bp"]\n"scene.ray_tracing.seed" = [17]\n'))
            result = run_plan(plan, tmp_path / f"{name}-out", workers=0)
            assert result.count("done") == 1
            monkeypatch.setattr("mvla_sim.channel.simulate.ViewTracer", None)
    assert [path.name for path in (tmp_path / "other" / "cir").iterdir()] == [
        next(iter(plan.sources.values())).file.name
    ]


def test_a_worker_killed_in_mid_sweep_costs_nothing(undisturbed, local, tmp_path, monkeypatch):
    plan, expected = undisturbed
    monkeypatch.setattr("mvla_sim.sweep.schedule.BATCH_S", 0.0)
    pids = {finished.value for _, finished in local.run(tasks.wait, [(0.1,)] * 8, label="wait")}
    keep_then(monkeypatch, 3, lambda: os.kill(max(pids), signal.SIGKILL))
    result = run_plan(plan, tmp_path / "out", cluster=local)
    assert len(result.table) == len(plan.cases)
    assert_same(result.table, expected)


def test_a_case_that_kills_its_workers_fails_alone(undisturbed, tmp_path, monkeypatch):
    plan, expected = undisturbed
    monkeypatch.setattr(module, "MOST_DEATHS", 1)  # a worker takes seconds to come back
    monkeypatch.setattr(run_module.jobs, "run_cases", tasks.run_cases_or_die)
    monkeypatch.setenv(tasks.POISON, plan.cases[9].key)
    result = run_plan(plan, tmp_path / "out", workers=1)
    assert list(result.table.loc[result.table["status"] == "failed", "case"]) == [9]
    assert result.table["error"][9] == "worker died"
    assert result.notes[-1] == "a worker died once while it ran case 9 of box"
    monkeypatch.undo()
    assert_same(run_plan(plan, tmp_path / "out", workers=0).table, expected)


def test_workers_that_keep_dying_end_the_run(tmp_path, monkeypatch):
    plan = expand(experiment(tmp_path, AXES))
    monkeypatch.setattr(module, "MOST_DEATHS", 1)
    monkeypatch.setattr(run_module, "MOST_DEATHS", 2)
    monkeypatch.setattr(run_module.jobs, "run_cases", tasks.run_cases_or_die)
    monkeypatch.setenv(tasks.POISON, plan.cases[0].key)
    with pytest.raises(RuntimeUnfitError, match="Is there enough memory"):
        run_plan(plan, tmp_path / "out", workers=1)
    table = load_table(tmp_path / "out").set_index("case")
    assert table.loc[0, "status"] != "done"
    assert len(table) == len(plan.cases)  # written, with what was finished by then


@pytest.mark.slow
def test_an_existing_cluster_traces_computes_and_survives_its_scheduler(undisturbed, existing, tmp_path, monkeypatch):
    """No disk is shared: the workers trace into a cache of their own, and this machine gets the CIR from them."""
    plan, expected = undisturbed
    existing.start(workers=2)
    here = tmp_path / "our-cache"
    file = next(iter(plan.sources.values())).file
    content = file.read_bytes()
    monkeypatch.setenv(VARIABLE, str(here))
    plan = expand(experiment(tmp_path, AXES))  # its channels are in the cache of the moment
    with open_cluster(None, existing.address) as cluster:
        states = [finished.value for _, finished in cluster.run(tasks.state, [()] * 8, label="state")]
        assert all(threads == {"drjit": 1, "algebra": 1} for _, threads in states)
        traced = run_plan(plan, tmp_path / "traced", cluster=cluster)
        assert traced.count("done") == len(plan.cases)
        assert (here / "cir" / file.name).exists()
        assert (existing.cache / "cir" / file.name).exists()

        (here / "cir" / file.name).write_bytes(content)  # the undisturbed run's paths, in their order
        assert_same(run_plan(plan, tmp_path / "sent", cluster=cluster).table, expected)

        monkeypatch.setattr("mvla_sim.sweep.schedule.BATCH_S", 0.0)
        with monkeypatch.context() as patch:
            keep_then(patch, 3, existing.kill_scheduler)
            began = time.monotonic()
            with pytest.raises(RuntimeUnfitError, match="the connection is lost; what is finished is kept"):
                run_plan(plan, tmp_path / "out", cluster=cluster)
            assert time.monotonic() - began < 20
    before = load_table(tmp_path / "out")
    assert 3 <= (before["status"] == "done").sum() < len(plan.cases)
    existing.end()
    existing.start()
    with open_cluster(None, existing.address) as cluster:
        table = run_plan(plan, tmp_path / "out", cluster=cluster).table
    done = before["status"] == "done"
    assert_same(table, expected)
    assert list(table["seconds"][done]) == pytest.approx(list(before["seconds"][done]))  # and not computed again


@pytest.mark.slow
def test_an_existing_cluster_with_a_shared_cache_a_full_disk_and_a_case_that_raises(existing, tmp_path, monkeypatch):
    axes = 'threshold_sigma = [1e6, 4.0]\nseed = [0, 1, 2]\n"scene.ray_tracing.max_paths" = [1, 1000000]\n'
    existing.start(threads=2)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "our-cache"))
    plan = expand(experiment(tmp_path, axes))
    monkeypatch.setattr("mvla_sim.sweep.schedule.BATCH_S", 0.0)
    original = Store.add

    def add(self, row):
        if self._database.execute("SELECT count(*) FROM cases").fetchone()[0] == 8:
            self.flush()
            self._database.execute("PRAGMA max_page_count = 1")
            row = Row(row.key, row.status, "x" * 10_000)
        original(self, row)

    with shared_cache(f"file://{tmp_path}/shared"), open_cluster(None, existing.address) as cluster:
        (state,) = cluster.run(tasks.state, [()], label="state")
        assert state[1].value[1]["drjit"] == min(2, core_count())
        with monkeypatch.context() as patch:
            patch.setattr(Store, "add", add)
            with pytest.raises(OutputError, match="no space left on the disk"):
                run_plan(plan, tmp_path / "out", cluster=cluster)
        assert (load_table(tmp_path / "out")["status"] != "missing").sum() == 8
        table = run_plan(plan, tmp_path / "out", cluster=cluster).table
        assert_same(table, run_plan(plan, tmp_path / "whole", cluster=cluster).table)
    status = table.groupby(["scene.ray_tracing.max_paths", "threshold_sigma"])["status"].agg(set).to_dict()
    assert status == {(1, 4): {"failed"}, (1, 1e6): {"failed"}, (10**6, 4): {"done"}, (10**6, 1e6): {"failed"}}
    assert len(list((tmp_path / "shared" / "cir").iterdir())) == 1
    assert not list((tmp_path / "our-cache").rglob("*.nc"))


def other_versions(client, *, packages, original=Client.get_versions):
    """What Dask finds, had this machine another version of mvla-sim."""
    found = original(client, packages=packages)
    found["client"]["packages"]["mvla-sim"] = "0.0.1"
    return found


class OtherProgram:
    """Stands for the digest's function, and gives another digest here than where it is sent."""

    def __call__(self):
        return "0"

    def __reduce__(self):
        return getattr, (worker_module, "program_digest")


@pytest.mark.slow
def test_workers_with_other_versions_are_refused(existing, tmp_path, monkeypatch):
    existing.start()
    with monkeypatch.context() as patch:
        patch.setattr(Client, "get_versions", other_versions)
        with (
            open_cluster(None, existing.address) as cluster,
            pytest.raises(RuntimeUnfitError, match=r"worker tcp://.* has mvla-sim .*, this machine 0\.0\.1; install"),
        ):
            cluster.start()
    monkeypatch.setattr("mvla_sim.cluster.existing_cluster.program_digest", OtherProgram())
    with (
        open_cluster(None, existing.address) as cluster,
        pytest.raises(RuntimeUnfitError, match="but its code differs from this machine's"),
    ):
        cluster.start()
