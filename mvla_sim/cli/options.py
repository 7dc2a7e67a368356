"""Options that several commands share, and where they print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

__all__ = ["CacheUrl", "Output", "Overrides", "Scheduler", "Workers", "errors", "note", "out"]

errors = Console(stderr=True, soft_wrap=True, highlight=False, emoji=False)
out = Console(soft_wrap=True, highlight=False, emoji=False)

Overrides = Annotated[
    list[str] | None, typer.Option("--set", help="Override a setting: dotted.key=value. May be repeated.")
]
Output = Annotated[Path, typer.Option("--output", "-o", help="File to write.")]
Workers = Annotated[int | None, typer.Option(min=0, help="Worker processes; default one a core, 0: none but this one.")]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask scheduler whose workers do the work.")]
CacheUrl = Annotated[
    str | None, typer.Option("--cache-url", help="Cache of CIRs that the workers share; default $MVLA_CACHE_URL.")
]


def note(text: str) -> None:
    """Tell something that is no result."""
    errors.print(f"mvla: {text}", markup=False)
