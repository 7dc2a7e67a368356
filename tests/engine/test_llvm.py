"""The choice of libLLVM, on made-up file trees: nothing is loaded here."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

from mvla_sim.engine import llvm
from mvla_sim.errors import RuntimeUnfitError


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.so", (14,)),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.so.1", (14,)),
        ("/usr/lib/llvm-14/lib/libLLVM-14.0.6.so", (14, 0, 6)),
        ("libLLVM-17.so", (17,)),
        ("libLLVM.so.19.1", (19, 1)),
        ("/opt/venv/lib/libLLVM.so.23.1", (23, 1)),
        ("/opt/homebrew/Cellar/llvm/20.1.8/lib/libLLVM.dylib", (20, 1, 8)),
        ("/opt/homebrew/Cellar/llvm@18/18.1.8/lib/libLLVM.dylib", (18, 1, 8)),
        ("libLLVM.so", None),
        ("libLLVM.so.1", None),
        ("libLLVMCore.so.19.1", None),
        ("/usr/lib/llvm-19/lib/libz.so.1", None),
    ],
)
def test_version_from_name(name, version):
    assert llvm.version_from_name(name) == version


def never(path):
    raise AssertionError(f"{path} was probed though its name gives its version")


def library(folder, name):
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / name
    file.write_bytes(b"not a library")
    return file


def choose(environment=(), wheel=(), system=(), probe=never):
    return llvm.choose(dict(environment), lambda: list(wheel), lambda: list(system), probe)


def test_the_wheel_comes_before_a_newer_system_library(tmp_path):
    wheel = library(tmp_path / "venv", "libLLVM.so.19.1")
    system = library(tmp_path / "usr", "libLLVM.so.22.1")
    chosen = choose(wheel=[wheel], system=[system])
    assert (chosen.path, chosen.version) == (str(wheel), (19, 1))
    assert llvm.WHEEL in chosen.origin


def test_without_a_wheel_the_newest_fit_system_library_is_taken(tmp_path):
    names = ["libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM-17.so", "libLLVM.so.20.1", "libLLVM.so.19.1"]
    files = [library(tmp_path, name) for name in names]
    chosen = choose(system=files)
    assert chosen.path == str(tmp_path / "libLLVM.so.20.1")
    assert chosen.origin == "system"


def test_an_old_wheel_gives_way_to_a_fit_system_library(tmp_path):
    old, fit = library(tmp_path, "libLLVM-16.so"), library(tmp_path, "libLLVM.so.19.1")
    assert choose(wheel=[old], system=[fit]).path == str(fit)


def test_the_named_library_wins_over_everything(tmp_path):
    named = library(tmp_path / "mine", "libLLVM-17.so")
    newer = library(tmp_path / "usr", "libLLVM.so.22.1")
    chosen = choose({llvm.VARIABLE: str(named)}, wheel=[newer], system=[newer])
    assert (chosen.path, chosen.origin) == (str(named), llvm.VARIABLE)


def test_an_empty_variable_names_nothing(tmp_path):
    wheel = library(tmp_path, "libLLVM.so.23.1")
    assert choose({llvm.VARIABLE: ""}, wheel=[wheel]).path == str(wheel)


def test_a_link_is_read_through_to_its_version(tmp_path):
    real = library(tmp_path, "libLLVM.so.19.1")
    link = tmp_path / "libLLVM.so"
    link.symlink_to(real)
    assert choose(wheel=[link]).version == (19, 1)


def test_a_library_without_a_version_in_its_name_is_asked(tmp_path):
    nameless, named = library(tmp_path / "a", "libLLVM.so"), library(tmp_path / "b", "libLLVM.so.19.1")
    chosen = choose(system=[nameless, named], probe=lambda _path: (21, 1, 0))
    assert (chosen.path, chosen.version) == (str(nameless), (21, 1, 0))


def test_what_cannot_be_loaded_is_passed_over(tmp_path):
    broken, fit = library(tmp_path / "a", "libLLVM.so"), library(tmp_path / "b", "libLLVM.so.19.1")
    assert choose(system=[broken, fit], probe=lambda _path: None).path == str(fit)


@pytest.mark.parametrize(
    ("environment", "system", "words"),
    [
        ({}, [], ["no libLLVM was found", "DRJIT_LIBLLVM_PATH", "17"]),
        ({}, ["libLLVM-14.so.1", "libLLVM-15.so.1"], ["libLLVM 15", "too old", "DRJIT_LIBLLVM_PATH", "17"]),
        ({"DRJIT_LIBLLVM_PATH": "libLLVM-14.so.1"}, [], ["libLLVM 14", "too old", "unset DRJIT_LIBLLVM_PATH", "17"]),
        ({"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so.23.1"}, [], ["/nowhere/libLLVM.so.23.1", "no such file"]),
        ({"DRJIT_LIBLLVM_PATH": "libsomething.so"}, [], ["libsomething.so", "cannot be loaded"]),
    ],
)
def test_an_unfit_library_is_refused_in_one_line_with_its_remedy(tmp_path, environment, system, words):
    files = [library(tmp_path, name) for name in system]
    with pytest.raises(RuntimeUnfitError) as caught:
        choose(environment, system=files, probe=lambda _path: None)
    message = str(caught.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []


def test_a_library_too_old_to_tell_its_version_is_refused(tmp_path):
    with pytest.raises(RuntimeUnfitError, match="older than 16"):
        choose(system=[library(tmp_path, "libLLVM.so")], probe=lambda _path: llvm.BEFORE_16)


def test_links_to_one_file_count_once(tmp_path, monkeypatch):
    real = library(tmp_path / "lib", "libLLVM.so.23.1")
    for name in ("libLLVM.so", "libLLVM-23.so"):
        (real.parent / name).symlink_to(real)
    library(tmp_path / "lib", "libLLVMCore.so.23.1")
    monkeypatch.setattr(llvm.sys, "prefix", str(tmp_path))
    monkeypatch.setattr(llvm.metadata, "files", lambda _name: None)
    assert llvm.wheel_files() == [real]


def test_the_wheel_is_found_by_its_metadata_outside_of_the_prefix(tmp_path, monkeypatch):
    real = library(tmp_path / "home" / "lib", "libLLVM.so.23.1")

    class Listed:
        name = "libLLVM.so.23.1"

        def locate(self):
            return tmp_path / "home" / "lib" / "python" / ".." / "libLLVM.so.23.1"

    (tmp_path / "home" / "lib" / "python").mkdir()
    monkeypatch.setattr(llvm.sys, "prefix", str(tmp_path / "elsewhere"))
    monkeypatch.setattr(llvm.metadata, "files", lambda _name: [Listed()])
    assert [file.resolve() for file in llvm.wheel_files()] == [real]


def test_no_wheel_no_files(monkeypatch):
    def missing(name):
        raise llvm.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(llvm.metadata, "files", missing)
    assert llvm.wheel_files() == []


def test_the_probe_agrees_with_the_file_name_and_survives_what_is_no_library(tmp_path):
    assert llvm.probe_version(str(library(tmp_path, "libLLVM.so"))) is None
    files = llvm.wheel_files() or [f for f in llvm.system_files() if (llvm.version_from_name(f) or (0,))[0] >= 17]
    if not files:
        pytest.skip("no libLLVM of version 17 or newer on this machine")
    by_name = llvm.version_from_name(files[0])
    assert llvm.probe_version(str(files[0]))[: len(by_name)] == by_name


def test_a_missing_link_to_the_runtime_library_is_made_up_for(tmp_path):
    """The wheel's libLLVM needs libc++.so.1, a link that is made only when Python first starts after installing."""
    files = [file for file in llvm.wheel_files() if (file.parent / "x86_64-unknown-linux-gnu").is_dir()]
    if not files:
        pytest.skip("the wheel's C++ runtime is not on this machine")
    (tmp_path / "lib").mkdir()
    copy = tmp_path / "lib" / files[0].name
    copy.hardlink_to(files[0]) if _same_disk(files[0], tmp_path) else copy.write_bytes(files[0].read_bytes())
    runtime = tmp_path / "lib" / "x86_64-unknown-linux-gnu"
    runtime.mkdir()
    for file in (files[0].parent / runtime.name).glob("*.so.1.*"):
        (runtime / file.name).write_bytes(file.read_bytes())
    program = (
        "import ctypes, sys; from pathlib import Path; from mvla_sim.engine.llvm import preload_companions\n"
        "if sys.argv[2] == 'yes': preload_companions(Path(sys.argv[1]))\n"
        "ctypes.CDLL(sys.argv[1])"
    )
    ends = [
        subprocess.run([sys.executable, "-c", program, str(copy), preload], capture_output=True, check=False).returncode
        for preload in ("yes", "no")
    ]
    if ends[1] == 0:
        pytest.skip("the system has a libc++ of its own, so the link is not missed")
    assert ends[0] == 0


def _same_disk(one, other):
    return one.stat().st_dev == other.stat().st_dev


def test_this_machine_has_a_fit_library_that_loads():
    assert llvm.choose().fit
    assert ctypes.sizeof(ctypes.c_void_p) == 8
