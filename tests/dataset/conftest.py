"""Let the tests of this folder import the helpers beside them; trace by formula where a test asks for it."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

sys.path.extend([str(Path(__file__).parent), str(Path(__file__).parents[1])])


@pytest.fixture
def fake(monkeypatch):
    """Trace by formula in this process, and ask Git nothing."""
    helpers = importlib.import_module("campaigns")
    for module in ("shard", "dry_run"):
        monkeypatch.setattr(f"mvla_sim.dataset.{module}.simulate", helpers.fake_simulate)
    for module in ("shard", "index"):
        monkeypatch.setattr(f"mvla_sim.dataset.{module}.provenance", lambda: {"program": "a formula"})
