"""A point is measured in a process of its own: its time, its memory, its errors."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from mvla_sim.bench.measure import Measured, Work, measure, memory_of
from mvla_sim.errors import RuntimeUnfitError


def hold(**params):
    return Work("children:Hold", params, repeats=3)


def test_each_point_has_a_process_of_its_own():
    one, other = measure(hold()), measure(hold())
    assert len({one.facts["process"], other.facts["process"], float(os.getpid())}) == 3
    assert one.repeats == 3
    assert one.facts["calls"] == 4  # one to warm up
    assert one.facts["last"] == 3


def test_memory_is_that_of_the_work_alone():
    """However large this process is: its own 300 MB are not the child's."""
    ballast = np.ones(300 * 2**20, np.uint8)
    small, large = measure(hold()), measure(hold(mebibytes=200))
    assert ballast.sum() == ballast.size
    assert small.memory_bytes < 20 * 2**20
    assert 195 * 2**20 < large.memory_bytes < 240 * 2**20
    assert large.loaded_bytes == pytest.approx(small.loaded_bytes, rel=0.1)
    assert small.loaded_bytes < 150 * 2**20


def test_sleep_is_time_but_no_work():
    found = measure(hold())
    assert found.median_s >= 0.01
    assert found.core_s < found.median_s


def test_long_calls_are_repeated_less_often():
    assert measure(Work("children:Hold", {}, repeats=50, budget_s=0.0)).repeats == 2


@pytest.mark.parametrize(
    ("fail", "said"),
    [("error", r"ValueError: no such thing$"), ("death", r"ended with code 7")],
    ids=["error", "death"],
)
def test_a_failure_is_one_line(fail, said):
    with pytest.raises(RuntimeUnfitError, match=said) as failure:
        measure(hold(fail=fail))
    assert "\n" not in str(failure.value)
    assert f"fail = {fail}" in str(failure.value)


def test_memory_of_another_process():
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        time.sleep(0.3)
        found = memory_of(child.pid)
        assert 0 < found.now <= found.peak < memory_of().peak
    finally:
        child.kill()
        child.wait()


def test_ctrl_c_leaves_neither_child_nor_file(tmp_path):
    program = "from mvla_sim.bench.measure import *; measure(Work('children:Hold', {}, repeats=10**9, budget_s=1e9))"
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    parent = subprocess.Popen(
        [sys.executable, "-c", program], env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while not (children := psutil.Process(parent.pid).children()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert children
    parent.send_signal(signal.SIGINT)
    _, errors = parent.communicate(timeout=60)
    assert "KeyboardInterrupt" in errors
    _, alive = psutil.wait_procs(children, timeout=30)
    assert alive == []
    assert list(tmp_path.iterdir()) == []


def test_a_child_ends_with_its_parent(tmp_path):
    program = "from mvla_sim.bench.measure import *; measure(Work('children:Hold', {}, repeats=10**9, budget_s=1e9))"
    environment = os.environ | {"TMPDIR": str(tmp_path)}  # a parent that is killed leaves its folder
    parent = subprocess.Popen([sys.executable, "-c", program], env=environment, start_new_session=True)
    deadline = time.monotonic() + 60
    while not (children := psutil.Process(parent.pid).children()) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1)
    parent.kill()
    parent.wait()
    _, alive = psutil.wait_procs(children, timeout=30)
    assert alive == []


def test_measured_is_plain():
    assert Measured(1.0, 1.0, 1.0, 2, 0.0, 0.0, 0.0).facts == {}
