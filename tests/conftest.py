"""Shared by all tests: nothing outside temporary folders is written, nothing opens a window."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

os.environ["MPLBACKEND"] = "Agg"
sys.path.append(str(Path(__file__).parent))  # helpers of several folders

settings.register_profile("mvla", deadline=None)  # the first call of a compiled kernel takes seconds, later ones do not
settings.load_profile("mvla")


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory):
    """Keep the user's cache out of the tests, and the tests out of the user's cache.

    The processes of one run share theirs, so that a scene is traced once; tests that damage files have their own.
    """
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MVLA_CACHE_DIR", str(folder / "cache"))
        yield
