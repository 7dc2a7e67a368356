"""``mvla bench``: how the cost of every stage grows, and what a large campaign would take."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from mvla_sim.bench.cost_tables import axis_tables, cost_lines, estimate_lines, frame, markdown
from mvla_sim.bench.estimate import Campaign, Costs, Estimate, costs_from, estimate
from mvla_sim.bench.measure import ALONE
from mvla_sim.bench.stages import STAGES, Row, measure_stages, series_of
from mvla_sim.engine.machine import core_count, cpu_name
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import OutputError
from mvla_sim.files import atomic_output, check_writable
from mvla_sim.interrupt import interruptible

__all__ = ["bench", "write_bench"]

FILES: Final = ("bench.json", "bench.csv", "bench.md")


def bench(
    folder: Path, out: Console, errors: Console, *, quick: bool, stages: Sequence[str] = (), campaign: Campaign
) -> None:
    """Measure stages, print tables, and write ``bench.json``, ``bench.csv`` and ``bench.md`` into a folder.

    Parameters
    ----------
    folder
        Made where it is missing.
    out, errors
        Where results and notes go.
    quick
        Few and small points.
    stages
        Some of them; none means all. The estimate needs all.
    campaign
        What the estimate is for.

    Raises
    ------
    ConfigError, OutputError, RuntimeUnfitError
        One line; nothing is left half-written.
    """
    chosen = [stage for stage in STAGES if stage in stages] if stages else list(STAGES)
    for stage in stages:
        series_of(stage)
    with interruptible():
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"-o {folder}: cannot be made ({error.strerror})") from error
        for name in FILES:
            check_writable(folder / name)
        out.print(f"{cpu_name()}, {core_count()} cores; every point in a process of its own", markup=False)
        rows = measure_stages(chosen, quick=quick)
        costs = costs_from(rows) if chosen == list(STAGES) else None
        found = None if costs is None else estimate(costs, campaign)
        _show(rows, costs, found, out)
        for file in write_bench(folder, rows, costs, found, quick=quick):
            out.print(f"wrote: {file}", markup=False)
    disturbed = sum(row.disturbed for row in rows)
    if disturbed:
        errors.print(f"mvla: note: {_disturbed(disturbed, len(rows))}", markup=False)


def write_bench(
    folder: Path, rows: Sequence[Row], costs: Costs | None, found: Estimate | None, *, quick: bool = False
) -> list[Path]:
    """Write the three files, each at once or not at all, and return their names.

    Raises
    ------
    OutputError
        One cannot be written.
    """
    table = frame(rows)
    machine = {"cpu": cpu_name(), "cores": core_count(), "quick": quick}
    record: dict[str, Any] = {
        "machine": machine,
        "provenance": provenance(),
        "points": [
            {
                "stage": row.series.stage,
                "series": row.series.name,
                "size": dict(row.size),
                "measured": dataclasses.asdict(row.measured),
                "rate_per_s": row.rate,
                "rate_unit": row.series.unit,
                "disturbed": row.disturbed,
            }
            for row in rows
        ],
        "costs": None if costs is None else dataclasses.asdict(costs),
        "estimate": None if found is None else {**dataclasses.asdict(found), "hours": found.hours},
    }
    contents = {
        "bench.json": json.dumps(record, indent=1, sort_keys=True) + "\n",
        "bench.csv": table.to_csv(index=False),
        "bench.md": _page(rows, costs, found, quick=quick),
    }
    for name, content in contents.items():
        with atomic_output(folder / name) as temporary:
            temporary.write_text(content, encoding="utf-8")
    return [folder / name for name in contents]


def _page(rows: Sequence[Row], costs: Costs | None, found: Estimate | None, *, quick: bool) -> str:
    """All tables and the estimate in Markdown."""
    text = [
        "# What things cost\n",
        f"{cpu_name()}, {core_count()} cores{', quick points' if quick else ''}. Every point was measured in a "
        "process of its own on one thread, a worker on one core. *First* is the first call, with compilation; *median* "
        "the time of later ones on the clock, *of a core* the time a core worked in them, which *rate* is of, "
        "but for workers; *memory* the peak beyond the loaded libraries, *steady* that of later calls.\n",
    ]
    disturbed = sum(row.disturbed for row in rows)
    if disturbed:
        text.append(f"\\* {_disturbed(disturbed, len(rows))}\n")
    text += [markdown(table) for table in axis_tables(rows)]
    if costs is not None:
        text += ["## Beside the tables\n", *(f"- {line}" for line in cost_lines(costs)), ""]
    if found is not None:
        text += ["## Estimate\n", *(f"- {line}" for line in estimate_lines(found)), ""]
        text += ["Assumed:\n", *(f"{number}. {line}" for number, line in enumerate(found.assumptions, 1)), ""]
    return "\n".join(text)


def _disturbed(count: int, total: int) -> str:
    return (
        f"at {count} of {total} points a core worked less than {100 * ALONE:.0f} % of the time on the clock: other "
        "programs were running, which slows caches and memory as well; laws and rates use the time of a core"
    )


def _show(rows: Sequence[Row], costs: Costs | None, found: Estimate | None, out: Console) -> None:
    for one in axis_tables(rows):
        table = Table(*one.header, title=one.title, title_justify="left", caption=one.law or None)
        for column in table.columns:
            column.justify = "right"
        for cells in one.lines:
            table.add_row(*cells)
        out.print(table)
    for line in [] if costs is None else cost_lines(costs):
        out.print(line, markup=False)
    if found is not None:
        first, *others = estimate_lines(found)
        out.print(f"\n{first}", markup=False)
        for line in others:
            out.print(f"  {line}", markup=False)
        out.print("assumed:", markup=False)
        for line in found.assumptions:
            out.print(f"  {line}", markup=False)
