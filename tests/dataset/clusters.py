"""What the tests of datasets have their workers do."""

from __future__ import annotations

import os
import signal
import time

import campaigns

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


def make_shard(campaign, number):
    shard.simulate, shard.provenance = trace, lambda: {"program": "a formula"}
    return shard.make_shard(campaign, number)


def make_one(campaign, number):
    shard.simulate = trace
    return shard.make_one(campaign, number)


def alone(number):
    """Keep a worker busy, and tell its process."""
    time.sleep(0.1)
    return os.getpid() + 0 * number
