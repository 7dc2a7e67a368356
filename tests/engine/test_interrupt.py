"""Ctrl-C where Python would lose it."""

from __future__ import annotations

import signal

import pytest

from mvla_sim.interrupt import end_on_interrupt, interruptible, raise_lost


@pytest.fixture
def _command_line():
    """Signals as the command line has them."""
    before = signal.getsignal(signal.SIGINT)
    end_on_interrupt()
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_command_line")
def test_an_interrupt_that_was_swallowed_is_raised_again():
    """As one in a callback of the garbage collector, of which Python only prints that it was ignored."""
    with interruptible():
        raise_lost()  # there is none yet
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            raise_lost()
    with interruptible():
        raise_lost()
