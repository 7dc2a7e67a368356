"""Files appear whole under their name, or not at all."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from mvla_sim.errors import DataError, OutputError
from mvla_sim.files import atomic_output, existing_file


def write(path, text="new", error=None):
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
        if error is not None:
            raise error


def test_a_finished_file_appears_and_nothing_else(tmp_path):
    target = tmp_path / "result.nc"
    with atomic_output(target) as temporary:
        assert temporary.parent == tmp_path  # the same disk, so that the renaming is one step
        assert temporary.suffix == ".nc"
        temporary.write_text("whole", encoding="utf-8")
        assert not target.exists()
    assert target.read_text(encoding="utf-8") == "whole"
    assert list(tmp_path.iterdir()) == [target]


def test_the_file_has_the_permissions_of_any_new_file(tmp_path):
    ordinary = tmp_path / "ordinary"
    ordinary.write_text("x", encoding="utf-8")
    write(tmp_path / "result")
    assert stat.S_IMODE((tmp_path / "result").stat().st_mode) == stat.S_IMODE(ordinary.stat().st_mode)


@pytest.mark.parametrize("error", [ValueError("wrong"), KeyboardInterrupt(), SystemExit(1)])
@pytest.mark.parametrize("before", [None, "old"])
def test_an_interrupted_write_leaves_what_was_there(tmp_path, error, before):
    target = tmp_path / "result.csv"
    if before is not None:
        target.write_text(before, encoding="utf-8")
    with pytest.raises(type(error)):
        write(target, error=error)
    assert [p.name for p in tmp_path.iterdir()] == ([] if before is None else ["result.csv"])
    if before is not None:
        assert target.read_text(encoding="utf-8") == before


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path):
    with pytest.raises(OutputError, match="no space left") as caught:
        write(tmp_path / "result.nc", error=OSError(errno.ENOSPC, "No space left on device"))
    assert str(tmp_path / "result.nc") in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", [ConnectionResetError, FileNotFoundError, PermissionError])
def test_errors_of_other_things_pass_unchanged(tmp_path, kind):
    """A file that the block reads, or a worker it waits for, is no fault of the target."""
    other = tmp_path / "input.nc"
    error = kind(errno.EACCES, "not mine", str(other)) if kind is not ConnectionResetError else kind("gone")
    with pytest.raises(kind) as caught:
        write(tmp_path / "result.nc", error=error)
    assert caught.value is error
    assert list(tmp_path.iterdir()) == []


def test_the_writers_own_errors_name_the_target(tmp_path):
    """HDF5's error names the temporary file in its text alone."""
    target = tmp_path / "result.nc"
    with pytest.raises(OutputError, match=r"result\.nc: cannot be written"), atomic_output(target) as temporary:
        raise OSError(f"unable to create file (file write failed: filename = '{temporary}', errno = 5)")
    with pytest.raises(OutputError, match=r"result\.nc: not writable"), atomic_output(target) as temporary:
        raise PermissionError(errno.EACCES, "not yours", str(temporary))


def test_no_thread_sees_another_umask(tmp_path, monkeypatch):
    """The process's umask is never changed, not even for a moment."""
    monkeypatch.setattr(os, "umask", None)
    write(tmp_path / "result")
    assert (tmp_path / "result").exists()


def test_a_failing_rename_leaves_nothing(tmp_path, monkeypatch):
    def refuse(self, target):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OutputError, match="not writable"):
        write(tmp_path / "result.nc")
    assert list(tmp_path.iterdir()) == []


def test_impossible_targets_are_refused(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        write(tmp_path / "nowhere" / "result.nc")
    with pytest.raises(OutputError, match="is a folder"):
        write(tmp_path)
    (tmp_path / "file").write_text("x", encoding="utf-8")
    with pytest.raises(OutputError):
        write(tmp_path / "file" / "result.nc")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write into read-only folders")
def test_a_read_only_folder_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="not writable"):
        write(tmp_path / "result.nc")


def test_existing_file(tmp_path):
    file = tmp_path / "scene.toml"
    with pytest.raises(DataError, match="no such scene"):
        existing_file(file, "scene")
    file.write_text("", encoding="utf-8")
    with pytest.raises(DataError, match="is empty"):
        existing_file(file, "scene")
    file.write_text("x", encoding="utf-8")
    assert existing_file(str(file), "scene") == file
    with pytest.raises(DataError, match="is a folder"):
        existing_file(tmp_path, "scene")
