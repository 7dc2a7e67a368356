"""Workers as SLURM jobs: run this where jobs can be submitted, with `pip install dask-jobqueue`; adapt OPTIONS.

It prints the scheduler's address for `mvla run --scheduler`, and ends the jobs when Enter is pressed.
"""

from __future__ import annotations

import sys
from typing import Any

OPTIONS: dict[str, Any] = {
    "queue": "compute",
    "account": "my-project",
    "cores": 32,  # of a job, which is a node here
    "processes": 32,  # single-threaded workers are fastest
    "memory": "64GB",
    "walltime": "08:00:00",
    "interface": "ib0",  # of the nodes and of this machine
    "local_directory": "/tmp",  # noqa: S108 - a disk of the node
    "job_script_prologue": [
        ". ~/mvla/.venv/bin/activate",
        "export MVLA_CACHE_DIR=/tmp/mvla-cache",
        "export MALLOC_TRIM_THRESHOLD_=268435456 MALLOC_MMAP_THRESHOLD_=33554432",  # see README, On a cluster
    ],
}
JOBS = 64


def main() -> None:
    """Keep the jobs until Enter."""
    from dask_jobqueue import SLURMCluster  # noqa: PLC0415 - an extra package

    with SLURMCluster(**OPTIONS) as cluster:
        cluster.scale(jobs=JOBS)
        sys.stdout.write(f"{cluster.scheduler_address}\nEnter ends the jobs\n")
        sys.stdout.flush()
        sys.stdin.readline()


if __name__ == "__main__":
    main()
