"""Let the tests of this folder import the helpers beside them; what several of them use."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from mvla_sim.evaluation import ground_truth, tuning

sys.path.append(str(Path(__file__).parent))


@pytest.fixture(params=["as shipped", "small stencil", "smallest pieces"])
def sizes(request, monkeypatch):
    """The sizes decide the route taken, never the result: with small ones the fallback runs on small problems."""
    if request.param != "as shipped":
        monkeypatch.setattr(ground_truth, "STENCIL_ENTRIES", 0)
    if request.param == "smallest pieces":
        monkeypatch.setattr(tuning, "BRUTE_FORCE_ENTRIES", 1)
        monkeypatch.setattr(tuning, "LEVELS_AT_ONCE", 3)
