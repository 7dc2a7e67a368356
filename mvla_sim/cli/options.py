"""What commands share: where they print, options, and checks of what was given."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from mvla_sim.errors import ConfigError, MvlaError
from mvla_sim.files import check_writable

__all__ = [
    "CacheUrl", "Output", "Overrides", "Reading", "Scheduler", "Workers", "check_output", "duration", "errors", "note",
    "option_for", "out", "say", "show", "wrote",
]  # fmt: skip

errors = Console(stderr=True, soft_wrap=True, highlight=False, emoji=False)
out = Console(soft_wrap=True, highlight=False, emoji=False)

Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="Override a setting: dotted.key=value. May be repeated.")
]
Output = Annotated[Path, typer.Option("--output", "-o", help="File to write.")]
Reading = Annotated[str | None, typer.Option(help="Preset of what the paper leaves open: paper, physical, or a file.")]
Workers = Annotated[int | None, typer.Option(min=0, help="Worker processes; default one a core, 0: none but this one.")]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask scheduler whose workers do the work.")]
CacheUrl = Annotated[
    str | None, typer.Option("--cache-url", help="Cache of CIRs that the workers share; default $MVLA_CACHE_URL.")
]

OPTIONS = {
    "output": "-o",
    "workers": "--workers",
    "scheduler": "--scheduler",
    "fresh": "--fresh",
    "label": "--label",
    "limit": "--yes",
}
"""Option of each argument of the library that an error may name."""

WIDE = 10_000
"""Columns of what is no terminal: a file or pipe has room for every table."""


def say(text: str) -> None:
    """Print a result as it is; brackets in it are no markup."""
    out.print(text, markup=False)


def option_for(error: MvlaError) -> str:
    """The option that helps with an error, in brackets after its message; empty where there is none."""
    return f" ({OPTIONS[error.setting]})" if error.setting in OPTIONS else ""


def note(text: str) -> None:
    """Tell something that is no result."""
    errors.print(f"mvla: {text}", markup=False)


def wrote(*files: Path, what: str = "wrote") -> None:
    """Name files that were written."""
    for file in files:
        say(f"{what + ':':<9} {file}")


def show(table: Table) -> None:
    """Print a table with nothing cut off: cells fold in a terminal, and have all the room they need in a file."""
    for column in table.columns:
        column.overflow = "fold"
    if not out.is_terminal:
        out.width = WIDE
    out.print(table, soft_wrap=False, markup=False)


def duration(seconds: float) -> str:
    """About how long: "80 s", "5 min", "2.5 h"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def check_output(path: Path, *suffixes: str) -> None:
    """Refuse an output of another suffix, or that cannot be written, before anything is computed."""
    if path.suffix.lower() not in suffixes:
        raise ConfigError(f"-o {path}: the name must end in {' or '.join(suffixes)}")
    check_writable(path)
