"""Progress: a bar on a terminal, two plain lines elsewhere, silence for what is quick."""

from __future__ import annotations

import io
import time

import pytest
from rich.console import Console

from mvla_sim import progress as module
from mvla_sim.progress import progress


def plain():
    return Console(file=io.StringIO(), force_terminal=False, width=40)


def lines(console):
    return console.file.getvalue().splitlines()


def test_quick_work_is_silent(capfd):
    with progress("tracing", 3, "views") as advance:
        for _ in range(3):
            advance()
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


def test_longer_work_says_one_line_at_the_start_and_one_at_the_end(monkeypatch):
    monkeypatch.setattr(module, "_QUIET_S", 0.05)
    console = plain()
    with progress("tracing a star with a long name [x]", 4, "views", console) as advance:
        time.sleep(0.2)
        began = lines(console)
        advance(3)
        with progress("inside", 2, "peaks", console) as inner:
            inner(2)
            time.sleep(0.1)
        advance()
    assert began == ["tracing a star with a long name [x]: 4 views"]
    assert len(lines(console)) == 2
    assert "4 views in" in lines(console)[1]
    assert "views/s" in lines(console)[1]


def test_stopped_work_says_how_far_it_came(monkeypatch):
    monkeypatch.setattr(module, "_QUIET_S", 0.05)
    console = plain()

    def stopped():
        with progress("tracing", 4, "views", console) as advance:
            advance(1)
            time.sleep(0.2)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert "stopped after 1 of 4 views" in lines(console)[-1]


def test_a_terminal_sees_count_rate_and_nested_bars():
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    with progress("cases", 2, "cases", console) as advance:
        for _ in range(2):
            with progress("tracing", 5, "views", console) as inner:
                inner(5)
            advance()
    shown = console.file.getvalue()
    assert "2/2" in shown
    assert "cases/s" in shown
