"""``doctor`` in a process of its own, as a user runs it: exit status, and the remedy in one line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mvla_sim.engine import doctor, llvm

OLD = Path("/usr/lib/x86_64-linux-gnu/libLLVM-14.so")
PROGRAM = """
import sys
from mvla_sim.cli.app import run
sys.exit(run(["doctor"]))
"""
CRASH = """
import json, os, sys
print(json.dumps(dict(backend="llvm", libllvm="/x/libLLVM.so", libllvm_version="17.0", origin="system")), flush=True)
print("LLVM ERROR: Cannot select", file=sys.stderr, flush=True)
os.abort()
"""


def run(**variables):
    environment = {k: v for k, v in os.environ.items() if k not in ("MVLA_BACKEND", "DRJIT_LIBLLVM_PATH")}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment | variables, capture_output=True, text=True, check=False
    )


def unfit_lines(output):
    return [line for line in output.splitlines() if line.startswith("unfit:")]


def test_a_fit_machine_ends_with_zero_and_names_backend_and_versions():
    child = run()
    assert child.returncode == 0, child.stdout + child.stderr
    assert unfit_lines(child.stdout) == []
    for word in ("backend", "libLLVM", "drjit", "mitsuba", "sionna-rt", "numpy", "memory", "cores", "cache folder"):
        assert word in child.stdout
    assert "1 ray" in child.stdout


@pytest.mark.skipif(not OLD.exists(), reason=f"{OLD} is not on this machine")
def test_a_library_too_old_is_named_with_its_remedy():
    child = run(DRJIT_LIBLLVM_PATH=str(OLD))
    assert child.returncode == 2
    (line,) = unfit_lines(child.stdout)
    assert str(OLD) in line
    assert "unset DRJIT_LIBLLVM_PATH" in line
    assert "Traceback" not in child.stdout + child.stderr


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"MVLA_BACKEND": "nonsense"}, ["MVLA_BACKEND", "nonsense", "auto, cuda, llvm"]),
        ({"MVLA_BACKEND": "cuda"}, ["MVLA_BACKEND = cuda", "no CUDA device", "install NVIDIA's driver or unset"]),
        ({"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"}, ["/nowhere/libLLVM.so", "no such file"]),
    ],
)
def test_wrong_settings_are_found(variables, words):
    child = run(**variables)
    assert child.returncode == 2
    (line,) = unfit_lines(child.stdout)
    assert [word for word in words if word not in line] == []
    assert "Traceback" not in child.stdout + child.stderr
    assert ("no fit libLLVM" in child.stdout) == ("DRJIT_LIBLLVM_PATH" in variables)  # else it is not looked for


def test_a_cache_folder_that_cannot_be_made_is_unfit(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    monkeypatch.setenv("MVLA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    facts = doctor.collect(doctor.Smoke({}, "fine", None))
    assert len(facts.problems) == 1
    assert "MVLA_CACHE_DIR" in facts.problems[0]


def smoke(program, timeout_s=60.0):
    return doctor.run_smoke((sys.executable, "-c", program), timeout_s)


def test_a_crash_of_the_trace_is_a_finding():
    outcome = smoke(CRASH)
    assert outcome.result is None
    assert "\n" not in outcome.problem
    for word in ("SIGABRT", "LLVM ERROR: Cannot select", "/x/libLLVM.so", llvm.VARIABLE):
        assert word in outcome.problem


def test_a_trace_that_hangs_or_fails_is_a_finding():
    assert "did not end" in smoke("import time; time.sleep(60)", timeout_s=0.5).problem
    failed = smoke("raise RuntimeError('broken')").problem
    assert "exit status 1" in failed
    assert "broken" in failed
    assert "\n" not in failed


def test_what_libraries_print_is_passed_over():
    outcome = smoke("print('{not JSON'); print('[1]'); print('{\"range_m\": 5.0, \"seconds\": 0.1}')")
    assert outcome.result == "1 ray, 5.000 m as expected, 0.1 s"


def test_a_silent_success_is_not_believed():
    assert smoke("pass").problem is not None
