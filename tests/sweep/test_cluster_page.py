"""``docs/clusters.md``: SLURM's set-up makes the job script it should, Kubernetes' starts what Dask knows."""

from __future__ import annotations

import re
from pathlib import Path

import dask
import dask_jobqueue
import pytest
import yaml
from distributed.cli import dask_scheduler, dask_worker

PAGE = Path(__file__).parents[2] / "docs" / "clusters.md"


def block(language):
    """The one code block of a language on the page."""
    (text,) = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return text


def test_slurm_jobs_hold_one_single_threaded_worker_a_core():
    slurm = {"__name__": "slurm"}
    exec(compile(block("python"), "slurm.py", "exec"), slurm)
    assert callable(slurm["main"])
    known = dask.config.get("jobqueue.slurm")
    assert {name.replace("_", "-") for name in slurm["OPTIONS"]} <= set(known)
    options = slurm["OPTIONS"] | {"interface": "lo"}  # this machine has no InfiniBand
    with dask_jobqueue.SLURMCluster(**options, scheduler_options={"dashboard_address": "127.0.0.1:0"}) as cluster:
        script = cluster.job_script()
    for line in ("#SBATCH -p compute", "#SBATCH -A my-project", "#SBATCH --cpus-per-task=32", "#SBATCH -t 08:00:00"):
        assert line in script
    assert "distributed.cli.dask_worker tcp://127.0.0.1:" in script
    assert "--nthreads 1 " in script
    assert "--nworkers 32 " in script
    assert script.index("MVLA_CACHE_DIR") < script.index("dask_worker")


def kubernetes():
    return yaml.safe_load(block("yaml"))


@pytest.mark.parametrize(("role", "command"), [("worker", dask_worker.main), ("scheduler", dask_scheduler.main)])
def test_the_pods_run_commands_that_dask_knows(role, command):
    (container,) = kubernetes()["spec"][role]["spec"]["containers"]
    assert container["args"][:2] == ["dask", role]
    context = command.make_context(role, container["args"][2:])  # refuses what it does not know
    if role == "worker":
        assert context.params["nthreads"] == int(container["resources"]["limits"]["cpu"]) == 1
        limit = dask.utils.parse_bytes(context.params["memory_limit"])
        assert limit == dask.utils.parse_bytes(container["resources"]["limits"]["memory"] + "B")


def test_the_service_leads_to_the_schedulers_ports():
    cluster = kubernetes()
    assert (cluster["apiVersion"], cluster["kind"]) == ("kubernetes.dask.org/v1", "DaskCluster")
    scheduler = cluster["spec"]["scheduler"]
    names = {port["name"]: port["containerPort"] for port in scheduler["spec"]["containers"][0]["ports"]}
    assert {port["targetPort"]: port["port"] for port in scheduler["service"]["ports"]} == names
    assert scheduler["service"]["selector"]["dask.org/cluster-name"] == cluster["metadata"]["name"]
    assert names["tcp-comm"] == dask_scheduler.main.make_context("scheduler", []).params.get("port") or 8786
