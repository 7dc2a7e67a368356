"""Dask's own processes on loopback, and what the tests have their workers do."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import campaigns
import psutil

from mvla_sim.dataset import shard

POISON = "MVLA_TEST_POISON"
"""Number of a sample that kills its worker."""
BAD = "MVLA_TEST_BAD"
"""Number of a sample that raises."""


def trace(scene, *, cache=True):
    """A channel by formula, in a twentieth of a second."""
    number = scene.name.rpartition("-")[2].lstrip("0") or "0"
    if number == os.environ.get(POISON):
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    if number == os.environ.get(BAD):
        return campaigns.failing_simulate(int(number))(scene)
    return campaigns.fake_simulate(scene)


def make_shard(task):
    shard.simulate, shard.provenance = trace, lambda: {"program": "a formula"}
    return shard.make_shard(task)


def make_one(campaign, number):
    shard.simulate = trace
    return shard.make_one(campaign, number)


def alone(number):
    """Keep a worker busy, and tell its process."""
    time.sleep(0.1)
    return os.getpid() + 0 * number


class Existing:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.folder = folder / "their-disk"
        self.log = (folder / "cluster.log").open("a")
        self.children: list[subprocess.Popen] = []

    def start(self, workers=1):
        self._start("dask_scheduler", "--host", "127.0.0.1", "--port", self.port, "--no-dashboard", "--no-show")
        deadline = time.monotonic() + 30
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
                break
            assert time.monotonic() < deadline
            time.sleep(0.05)
        flags = ("--host", "127.0.0.1", "--nthreads", 1, "--no-dashboard", "--local-directory", self.folder)
        for _ in range(workers):
            self._start("dask_worker", self.address, *flags)

    def _start(self, name, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.{name}", *map(str, arguments)]
        paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[2])])
        environment = os.environ | {"PYTHONPATH": paths}
        self.children.append(subprocess.Popen(command, env=environment, stdout=self.log, stderr=self.log))

    def kill_scheduler(self):
        self.children[0].kill()

    def end(self):
        """End all of it, and what the workers' nannies have started."""
        for child in self.children:
            with contextlib.suppress(psutil.NoSuchProcess):
                for below in psutil.Process(child.pid).children(recursive=True):
                    with contextlib.suppress(psutil.NoSuchProcess):
                        below.kill()
            child.kill()
            child.wait()
        self.children.clear()
