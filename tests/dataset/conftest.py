"""Let the tests of this folder import the helpers beside them; trace by formula where a test asks for it."""

from __future__ import annotations

import importlib
import shutil
import sys
from pathlib import Path

import pytest

sys.path.extend([str(Path(__file__).parent), str(Path(__file__).parents[1])])


def _trace_by_formula(patch):
    helpers = importlib.import_module("campaigns")
    for module in ("shard", "dry_run"):
        patch.setattr(f"mvla_sim.dataset.{module}.simulate", helpers.fake_simulate)
    for module in ("shard", "index"):
        patch.setattr(f"mvla_sim.dataset.{module}.provenance", lambda: {"program": "a formula"})


@pytest.fixture
def fake(monkeypatch):
    """Trace by formula in this process, and ask Git nothing."""
    _trace_by_formula(monkeypatch)


@pytest.fixture(scope="session")
def _tiny_dataset(tmp_path_factory):
    """The dataset of the tiny campaign, built once."""
    helpers = importlib.import_module("campaigns")
    folder = tmp_path_factory.mktemp("tiny")
    with pytest.MonkeyPatch.context() as patch:
        _trace_by_formula(patch)
        return helpers.built(folder)


@pytest.fixture
def tiny_dataset(_tiny_dataset, tmp_path):
    """A copy of the dataset of the tiny campaign; ``tiny.toml``, the campaign's file, is beside it."""
    importlib.import_module("campaigns").write(tmp_path)
    return Path(shutil.copytree(_tiny_dataset, tmp_path / "undisturbed"))
