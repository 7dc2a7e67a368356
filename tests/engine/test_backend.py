"""The backend in this process, and the order in which libraries are loaded, in child processes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mvla_sim.engine import llvm
from mvla_sim.engine.backend import activate, activate_sionna, active, set_threads
from mvla_sim.errors import ConfigError

OLD = Path("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1")


def child(program, **variables):
    environment = {k: v for k, v in os.environ.items() if k not in ("MVLA_BACKEND", "DRJIT_LIBLLVM_PATH")}
    return subprocess.run(
        [sys.executable, "-c", program], env=environment | variables, capture_output=True, text=True, check=False
    )


def test_the_backend_is_chosen_once_and_computes():
    backend = activate()
    assert activate() is backend
    assert active() is backend
    if backend.name == "llvm":
        assert int(backend.libllvm_version.split(".")[0]) >= llvm.MINIMUM_VERSION
    total = backend.arrays.Float32(np.arange(5, dtype=np.float32)) * 2
    np.testing.assert_array_equal(total.numpy(), [0, 2, 4, 6, 8])  # small whole numbers are exact in float32


def test_mitsuba_matches_the_backend():
    rt = activate_sionna()
    assert sys.modules["mitsuba"].variant() == activate().variant
    assert rt.PathSolver


def test_threads():
    activate()
    dr = sys.modules["drjit"]
    before = dr.thread_count()
    try:
        set_threads(1)
        assert dr.thread_count() == 1
    finally:
        set_threads(before)
    with pytest.raises(ConfigError, match="threads = 0"):
        set_threads(0)


def test_an_unknown_backend_is_refused_before_anything_is_loaded():
    ended = child(
        "import sys\nfrom mvla_sim.errors import ConfigError\nfrom mvla_sim.engine.backend import activate\n"
        "try: activate()\nexcept ConfigError as e: print(e, 'drjit' in sys.modules)",
        MVLA_BACKEND="opencl",
    )
    assert ended.returncode == 0, ended.stderr
    assert "'opencl'" in ended.stdout
    assert ended.stdout.strip().endswith("False")


SOLVE = """
import mvla_sim
import sionna.rt as rt
scene = rt.load_scene(rt.scene.box)
scene.tx_array = scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
scene.add(rt.Transmitter("tx", position=[0, 0, 1]))
scene.add(rt.Receiver("rx", position=[1, 0, 1]))
paths = rt.PathSolver()(scene, max_depth=1, samples_per_src=1000)
from mvla_sim.engine.backend import activate
backend = activate()
print(paths.tau.shape, backend.origin, backend.libllvm)
"""


def test_sionna_imported_after_the_package_works():
    """Left alone, Dr.Jit takes what the system has; with libLLVM 15 the solver aborts the process."""
    ended = child(SOLVE, MVLA_BACKEND="llvm")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith("(1, 1, ")
    assert ended.stdout.strip().endswith(f"{llvm.choose({}).origin} {llvm.choose({}).path}")


@pytest.mark.parametrize(
    ("before", "variables", "expected"),
    [
        ("", {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"}, "/nowhere/libLLVM.so"),  # the user's choice, wrong or not
        ("sys.modules['drjit'] = sys", {}, "None"),  # too late
        ("import importlib.metadata; importlib.metadata.files = lambda name: []\n"
         "import glob, pathlib; pathlib.Path.glob = lambda *a: iter(())\n"
         "import shutil; shutil.which = lambda *a, **k: None", {}, "None"),  # no library anywhere
    ],
)  # fmt: skip
def test_importing_the_package_sets_what_nobody_has_set(before, variables, expected):
    program = f"import sys\n{before}\nimport mvla_sim, os\nprint(os.environ.get('DRJIT_LIBLLVM_PATH'))"
    ended = child(program, **variables)
    assert (ended.returncode, ended.stdout.strip()) == (0, expected), ended.stderr


@pytest.mark.skipif(not OLD.exists(), reason=f"{OLD} is not on this machine")
def test_dr_jit_imported_earlier_with_an_old_library_is_refused():
    ended = child(
        "import drjit\nfrom mvla_sim.errors import RuntimeUnfitError\nfrom mvla_sim.engine.backend import activate\n"
        "try: activate()\nexcept RuntimeUnfitError as e: print(e)",
        DRJIT_LIBLLVM_PATH=str(OLD),
        MVLA_BACKEND="llvm",
    )
    assert ended.returncode == 0, ended.stderr
    assert "libLLVM 15" in ended.stdout
    assert "import mvla_sim before drjit" in ended.stdout


def test_dr_jit_imported_earlier_with_a_fit_library_is_accepted():
    ended = child(
        "import drjit\nfrom mvla_sim.engine.backend import activate\nprint(activate().origin)",
        DRJIT_LIBLLVM_PATH=llvm.choose({}).path,
        MVLA_BACKEND="llvm",
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip() == "loaded before"
