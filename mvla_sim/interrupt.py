"""Ctrl-C: at once where nothing is being written, after a whole piece of work where something is.

An interrupt inside a compiled loop or a half-done import surfaces as another error, or aborts the process. So the
command line ends at once on Ctrl-C, unless the program is in a block that asked for a KeyboardInterrupt or to wait.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final

__all__ = ["INTERRUPTED", "deferred_interrupt", "end_on_interrupt", "interruptible", "raise_lost"]

INTERRUPTED: Final = 130
"""Exit code after Ctrl-C."""
_MESSAGE: Final = b"mvla: stopped; finished files are whole, nothing half-written is left\n"
_SHOW_CURSOR: Final = b"\x1b[?25h"


def end_on_interrupt() -> None:
    """From now on, Ctrl-C prints one line and ends the process with code 130, without unwinding."""
    signal.signal(signal.SIGINT, _end)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Within the block, Ctrl-C raises KeyboardInterrupt, so that the block can clean up (:func:`raise_lost`)."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not _end:
        yield
        return
    signal.signal(signal.SIGINT, _raise)
    try:
        yield
    finally:
        _interrupted.clear()
        signal.signal(signal.SIGINT, _end)


def raise_lost() -> None:
    """Raise the KeyboardInterrupt of an :func:`interruptible` block again, if there was one: for loops that wait.

    Python ignores it where it comes while an object is finalised or in a callback of the garbage collector.
    """
    if _interrupted.is_set():
        raise KeyboardInterrupt


@contextlib.contextmanager
def deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Within the block, hold back Ctrl-C; yield ``check()``, which raises KeyboardInterrupt if there was one.

    A second Ctrl-C is not held back. Outside the main thread nothing is changed, since signals do not arrive there.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    pending = False
    before = signal.getsignal(signal.SIGINT)

    def remember(number: int, frame: FrameType | None) -> None:
        nonlocal pending
        if pending and callable(before):
            before(number, frame)
        pending = True

    def check() -> None:
        if pending:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, remember)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)


_interrupted = threading.Event()


def _raise(number: int, frame: FrameType | None) -> None:
    _interrupted.set()
    signal.default_int_handler(number, frame)


def _end(number: int, frame: FrameType | None) -> None:
    del number, frame
    os.write(2, (_SHOW_CURSOR if os.isatty(2) else b"") + _MESSAGE)
    os._exit(INTERRUPTED)
