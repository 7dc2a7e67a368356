"""What a result was made with: complete, and without anybody's names."""

from __future__ import annotations

import datetime
import getpass
import platform
import shutil
import subprocess
from pathlib import Path

import pytest

from mvla_sim.engine.machine import PACKAGES
from mvla_sim.engine.provenance import code_commit, provenance


def test_everything_is_told_and_nobody_is_named():
    facts = provenance()
    assert {"program", "commit", "created", "python", "platform", "cpu", "backend", *PACKAGES} == set(facts)
    assert all(isinstance(value, str) and value for value in facts.values())
    words = " ".join(facts.values()).split()
    assert not {getpass.getuser(), platform.node(), str(Path.home()), str(Path.cwd())} & set(words)
    assert [word for word in words if word.startswith("/")] == []


def test_the_time_is_utc():
    made = datetime.datetime.fromisoformat(provenance()["created"])
    assert made.utcoffset() == datetime.timedelta(0)
    assert abs(datetime.datetime.now(datetime.UTC) - made) < datetime.timedelta(minutes=1)


def test_outside_a_checkout_the_commit_is_unknown(tmp_path):
    assert code_commit(tmp_path) == "unknown"


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not on this machine")
def test_a_changed_checkout_is_dirty(tmp_path):
    def git(*arguments):
        identity = ("-c", "user.name=test", "-c", "user.email=test@example.org", "-c", "commit.gpgsign=false")
        return subprocess.run(
            ["git", "-C", str(tmp_path), *identity, *arguments], check=True, capture_output=True, text=True
        ).stdout.strip()

    git("init", "-q")
    assert code_commit(tmp_path) == "unknown"  # no commit yet
    (tmp_path / "code.py").write_text("a = 1\n", encoding="utf-8")
    git("add", ".")
    git("commit", "-qm", "first")
    head = git("rev-parse", "HEAD")
    assert code_commit(tmp_path) == head
    (tmp_path / "other.txt").write_text("a result, not code\n", encoding="utf-8")
    assert code_commit(tmp_path) == head
    (tmp_path / "code.py").write_text("a = 2\n", encoding="utf-8")
    assert code_commit(tmp_path) == f"{head}-dirty"
