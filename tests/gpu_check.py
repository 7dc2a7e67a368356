"""What a GPU computes, and how fast: ``python tests/gpu_check.py``.

The kernels are held to their float64 twins, then the projection and tracing benchmarks print their figures, in under
five minutes. Without CUDA all of it skips, with the reason. MVLA_GPU_CHECK_BACKEND=llvm runs the same on the CPU, to
check the check. Pytest collects it only where it is named, as in ``python -m pytest -s tests/gpu_check.py``.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mvla_sim.engine.backend import VARIABLE, activate
from mvla_sim.engine.machine import cpu_name
from mvla_sim.errors import MvlaError

HERE = Path(__file__).parent
os.environ[VARIABLE] = os.environ.get("MVLA_GPU_CHECK_BACKEND", "cuda")  # a process computes with one backend
TWINS = ["imaging/test_projection.py", "imaging/test_beams.py", "imaging/test_tomography.py"]


@pytest.fixture(scope="module", autouse=True)
def _backend():
    try:
        found = activate()
    except MvlaError as error:
        pytest.skip(str(error))
    assert found.name == os.environ[VARIABLE]
    sys.stdout.write(f"\n{found.name} beside {cpu_name()}\n")


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", TWINS)
def test_kernels_agree_with_their_twins(name):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", str(HERE / name)]
    child = subprocess.run(command, capture_output=True, text=True, check=False)
    assert child.returncode == 0, child.stdout
    sys.stdout.write(f"{name}: {child.stdout.splitlines()[-1]}\n")


@pytest.mark.timeout(900)
@pytest.mark.parametrize("stage", ["projection", "tracing"])
def test_benchmarks_run(stage):
    tables, ratios = (importlib.import_module(f"mvla_sim.bench.{name}") for name in ("cost_tables", "ratios"))
    for one in ratios.measure_ratios([stage]):  # importing it loads the kernels, and they the backend
        sys.stdout.write(f"{tables.ratio_line(one)}\n")
        assert one.ratio > 0


if __name__ == "__main__":
    sys.exit(pytest.main(["-q", "-s", "-rs", "-p", "no:xdist", "-p", "no:cacheprovider", __file__]))
