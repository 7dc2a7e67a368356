"""Let the tests of this folder import the helpers beside them; start the processes that read files quickly."""

from __future__ import annotations

import contextlib
import importlib
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))


@pytest.fixture(scope="session")
def _quick_children():
    with contextlib.closing(importlib.import_module("quick_children").QuickChildren()) as children:
        yield children


@pytest.fixture
def quick_children(request, monkeypatch):
    """Have files read by forks of one process, but where a test wants ``real_children``; see :mod:`quick_children`."""
    if "real_children" not in request.fixturenames:
        children = request.getfixturevalue("_quick_children")
        monkeypatch.setattr("mvla_sim.channel.readers.array_files.subprocess", children)


@pytest.fixture
def real_children():
    """Have each file read by a new process."""
