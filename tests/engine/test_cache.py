"""The cache folder: where it is told to be, made on demand, refused in one line."""

from __future__ import annotations

import pytest

from mvla_sim.engine.cache import cache_folder
from mvla_sim.errors import OutputError


def test_the_folder_is_made_where_the_variable_says(tmp_path, monkeypatch):
    monkeypatch.setenv("MVLA_CACHE_DIR", str(tmp_path / "a" / "b"))
    assert cache_folder() == tmp_path / "a" / "b"
    assert list(cache_folder().iterdir()) == []


def test_by_default_it_is_the_users_cache(tmp_path, monkeypatch):
    monkeypatch.delenv("MVLA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder().is_relative_to(tmp_path)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    monkeypatch.setenv("MVLA_CACHE_DIR", str(tmp_path / "file"))
    with pytest.raises(OutputError, match="MVLA_CACHE_DIR"):
        cache_folder()


def test_a_user_without_a_home_is_told_what_to_set(monkeypatch):
    """As in a batch job without HOME whose user is not in the password file."""

    def unknown(user):
        raise KeyError(f"getpwuid(): uid not found: {user}")

    for name in ("MVLA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    with pytest.raises(OutputError, match=r"has no home folder .*; set MVLA_CACHE_DIR to a folder of yours"):
        cache_folder()
    monkeypatch.setenv("MVLA_CACHE_DIR", "~/cache")
    with pytest.raises(OutputError, match="has no home folder"):
        cache_folder()
