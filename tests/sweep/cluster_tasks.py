"""What the tests have workers do, where these can import it."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from mvla_sim.errors import DataError

POISON = "MVLA_TEST_POISON"
"""Key of a case that kills its worker."""


def divide(number, by):
    if by == 0:
        raise DataError(f"{number} / 0\ncannot be")
    return number / by


def made(number):
    """A shared value that knows who made it."""
    return number, os.getpid()


def takes(shared, number):
    return shared, number


def nothing():
    raise DataError("nothing to share")


def state():
    """This process, and the threads that Dr.Jit and linear algebra use in it."""
    import drjit  # noqa: PLC0415 - where the backend is chosen
    import threadpoolctl  # noqa: PLC0415

    algebra = max((pool["num_threads"] for pool in threadpoolctl.threadpool_info()), default=1)
    return os.getpid(), {"drjit": drjit.thread_count(), "algebra": algebra}


def wait(seconds):
    time.sleep(seconds)
    return os.getpid()


def die(number, poison):
    if number == poison:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_once(number, poison, mark):
    """Kill the worker the first time."""
    if number == poison and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def run_cases_or_die(channel, cases):
    from mvla_sim.sweep.jobs import run_cases  # noqa: PLC0415 - what takes seconds, and is needed here alone

    if any(case.key == os.environ.get(POISON) for case in cases):
        os.kill(os.getpid(), signal.SIGKILL)
    return run_cases(channel, cases)
