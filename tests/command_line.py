"""``mvla`` for tests: in this process, for a child takes a second or more to import what it computes with."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path

from mvla_sim.cli.app import run


def mvla(*arguments, folder=".", code=0, notes=False):
    """Run ``mvla`` in a folder; return what it printed, with ``notes`` those as well, and of an error its one line."""
    printed, errors = io.StringIO(), io.StringIO()
    before = Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(errors):
            found = run([*map(str, arguments)])
    finally:
        os.chdir(before)
    text = errors.getvalue()
    assert found == code, text
    assert "Traceback" not in text
    if code == 2:
        assert len(text.strip().splitlines()) == 1, text
        assert text.startswith("mvla: error: ")
    return printed.getvalue() + text if notes else printed.getvalue() if code == 0 else text
