"""The command line. It is thin: it reads arguments, calls the package, and turns errors into one line."""

from __future__ import annotations

import sys

from mvla_sim.interrupt import end_on_interrupt

__all__ = ["main"]


def main() -> None:
    """Entry point of ``mvla``."""
    end_on_interrupt()
    from mvla_sim.cli.app import run  # noqa: PLC0415 - keeps importing the package free of the command line

    sys.exit(run(sys.argv[1:]))
