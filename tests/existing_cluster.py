"""An existing Dask cluster on loopback, as its own processes, for the tests of sweeps and of datasets."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil

from mvla_sim.engine.cache import VARIABLE


class Existing:
    """A scheduler and its workers, each a process; workers have a cache of their own, and import from ``modules``."""

    def __init__(self, folder, modules):
        self.modules = modules
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.cache = folder / "their-cache"
        self.log = (folder / "cluster.log").open("a")
        self.children: list[subprocess.Popen] = []

    def start(self, workers=1, threads=1):
        self._start("dask_scheduler", "--host", "127.0.0.1", "--port", self.port, "--no-dashboard", "--no-show")
        deadline = time.monotonic() + 30
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
                break
            assert time.monotonic() < deadline
            time.sleep(0.05)
        flags = ("--host", "127.0.0.1", "--nthreads", threads, "--no-dashboard", "--local-directory", self.cache)
        for _ in range(workers):
            self._start("dask_worker", self.address, *flags)

    def _start(self, name, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.{name}", *map(str, arguments)]
        paths = os.pathsep.join([str(self.modules), str(Path(__file__).parents[1])])
        environment = os.environ | {VARIABLE: str(self.cache), "PYTHONPATH": paths}
        child = subprocess.Popen(command, env=environment, stdout=self.log, stderr=self.log)
        self.children.append(child)

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
