"""Showing how far a long computation is, on standard error."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Final, Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

__all__ = ["Advance", "progress"]


class Advance(Protocol):
    """What :func:`progress` yields."""

    def __call__(self, n: int = 1, /) -> None:
        """Count ``n`` more units as done."""


_QUIET_S: Final[float] = 2.0
"""Seconds below which nothing is said where standard error is no terminal."""

_outer: ContextVar[Progress | None] = ContextVar("_outer", default=None)
_plain: ContextVar[bool] = ContextVar("_plain", default=False)


@contextlib.contextmanager
def progress(description: str, total: int, unit: str, console: Console | None = None) -> Iterator[Advance]:
    """Show a bar with count, rate and remaining time; yield ``advance(n=1)`` to move it.

    Where standard error is no terminal there is one plain line at the start and one at the end, and none at all for
    what takes less than two seconds. A bar inside another one's block appears below it; plain lines are then left out.

    Parameters
    ----------
    description
        What is being done: "tracing star".
    total
        How many units there are.
    unit
        What is counted, in the plural: "views".
    console
        Where to show it; by default standard error.
    """
    console = console or Console(stderr=True)
    show = _bar if console.is_terminal else _lines
    with show(description, total, unit, console) as advance:
        yield advance


class _RateColumn(ProgressColumn):
    """Units a second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        unit = task.fields["unit"]
        return Text("" if speed is None else f"{_rate(speed)} {unit}/s", style="progress.data.speed")


@contextlib.contextmanager
def _bar(description: str, total: int, unit: str, console: Console) -> Iterator[Advance]:
    with contextlib.ExitStack() as stack:
        shown = _outer.get()
        if shown is None:
            shown = stack.enter_context(
                Progress(
                    TextColumn("{task.description}", markup=False),
                    BarColumn(),
                    MofNCompleteColumn(),
                    _RateColumn(),
                    TimeRemainingColumn(),
                    console=console,
                )
            )
            token = _outer.set(shown)
            stack.callback(_outer.reset, token)
            task = shown.add_task(description, total=total, unit=unit)
        else:
            task = shown.add_task(description, total=total, unit=unit)
            stack.callback(shown.remove_task, task)

        def advance(n: int = 1, /) -> None:
            shown.advance(task, n)

        yield advance


@contextlib.contextmanager
def _lines(description: str, total: int, unit: str, console: Console) -> Iterator[Advance]:
    def say(text: str) -> None:
        if not nested:
            console.print(text, markup=False, highlight=False, soft_wrap=True)

    nested = _plain.get()
    token = _plain.set(True)
    done = 0

    def advance(n: int = 1, /) -> None:
        nonlocal done
        done += n

    began = time.monotonic()
    opening = threading.Timer(_QUIET_S, say, (f"{description}: {total} {unit}",))
    opening.daemon = True
    opening.start()
    try:
        yield advance
    finally:
        opening.cancel()
        opening.join()
        _plain.reset(token)
        took = time.monotonic() - began
        if took > _QUIET_S:
            count = f"{done} {unit}" if done == total else f"stopped after {done} of {total} {unit}"
            say(f"{description}: {count} in {took:.0f} s ({_rate(done / took)} {unit}/s)")


def _rate(speed: float) -> str:
    return f"{speed:.0f}" if speed >= 100 else f"{speed:.1f}" if speed >= 1 else f"{speed:.2g}"
