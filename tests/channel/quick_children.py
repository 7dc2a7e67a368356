"""Processes that read files, as forks of one that has imported the libraries: each costs a hundredth of a second.

A process that starts from nothing spends half a second on importing SciPy, and the tests start hundreds of them. What
is run in them, and what becomes of them, is the same; the tests of the processes themselves have real ones.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import types

PARENT = """
import json, os, sys, traceback
import h5py, numpy, psutil, scipy.io.matlab
from mvla_sim.channel.readers import array_files

for line in sys.stdin:
    arguments, files = json.loads(line)
    child = os.fork()
    if not child:
        code = 1
        try:
            for number, file in enumerate(files):
                os.dup2(os.open(file, os.O_RDWR), number)
            sys.argv[1:] = arguments[1:]
            exec(arguments[0], {})
            sys.stdout.flush()
            code = 0
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        finally:
            os._exit(code)
    sys.stdout.write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\\n")
    sys.stdout.flush()
"""


class QuickChildren:
    """What stands in for the module :mod:`subprocess` where a file is read in another process."""

    DEVNULL = subprocess.DEVNULL
    TimeoutExpired = subprocess.TimeoutExpired

    def __init__(self):
        self.parent = subprocess.Popen(
            [sys.executable, "-c", PARENT],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "HDF5_PLUGIN_PRELOAD": "::"},
        )  # fmt: skip

    def run(self, command, *, stdout, stderr, **_):
        """Run the program of a command ``python -I -c PROGRAM ARGUMENTS``; its own limit ends one that hangs."""
        assert command[:3] == [sys.executable, "-I", "-c"]
        files = [os.devnull, *(f"/proc/{os.getpid()}/fd/{file.fileno()}" for file in (stdout, stderr))]
        self.parent.stdin.write(json.dumps([command[3:], files]) + "\n")
        self.parent.stdin.flush()
        return types.SimpleNamespace(returncode=int(self.parent.stdout.readline()))

    def close(self):
        """End the parent of them all."""
        self.parent.stdin.close()
        self.parent.wait(10)
        self.parent.stdout.close()
