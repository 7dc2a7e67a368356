"""Jobs for the child processes of the tests."""

from __future__ import annotations

import os
import sys
import time

import numpy as np

from mvla_sim.bench.child import Job


class Hold(Job):
    """Holds so much memory, and says which process and which call it was."""

    def __init__(self, mebibytes=0, fail=""):
        self.count = mebibytes * 2**20
        self.fail = fail
        self.calls = []

    def call(self, number):
        if self.fail == "error":
            raise ValueError("no such\nthing")
        if self.fail == "death":
            os._exit(7)
        time.sleep(0.01)
        np.ones(self.count, np.uint8).sum()
        sys.stdout.write("not an answer\n")
        self.calls.append(number)

    def facts(self):
        return {"process": float(os.getpid()), "calls": float(len(self.calls)), "last": float(self.calls[-1])}
