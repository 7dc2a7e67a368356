"""Files of ``mvla bench``: all that was measured as JSON and CSV, and a page of tables with the estimate."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from mvla_sim.bench.cost_tables import axis_tables, cost_lines, estimate_lines, frame, markdown
from mvla_sim.bench.estimate import CostForecast, Costs
from mvla_sim.bench.measure import ALONE
from mvla_sim.bench.ratios import Ratio
from mvla_sim.bench.stages import TimedPoint
from mvla_sim.engine.machine import core_count, cpu_name
from mvla_sim.engine.provenance import provenance
from mvla_sim.files import atomic_output

__all__ = ["FILES", "disturbed_note", "write_bench", "write_ratios"]

FILES: Final = ("bench.json", "bench.csv", "bench.md")


def write_bench(
    folder: Path, rows: Sequence[TimedPoint], costs: Costs | None, found: CostForecast | None, *, quick: bool = False
) -> list[Path]:
    """Write the three files, each at once or not at all, and return their names.

    Raises
    ------
    OutputError
        One cannot be written.
    """
    record: dict[str, Any] = {
        "machine": {"cpu": cpu_name(), "cores": core_count(), "quick": quick},
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
        "bench.csv": frame(rows).to_csv(index=False),
        "bench.md": _page(rows, costs, found, quick=quick),
    }
    for name, content in contents.items():
        with atomic_output(folder / name) as temporary:
            temporary.write_text(content, encoding="utf-8")
    return [folder / name for name in contents]


def _page(rows: Sequence[TimedPoint], costs: Costs | None, found: CostForecast | None, *, quick: bool) -> str:
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
        text.append(f"\\* {disturbed_note(disturbed, len(rows))}\n")
    text += [markdown(table) for table in axis_tables(rows)]
    if costs is not None:
        text += ["## Beside the tables\n", *(f"- {line}" for line in cost_lines(costs)), ""]
    if found is not None:
        text += ["## Estimate\n", *(f"- {line}" for line in estimate_lines(found)), ""]
        text += ["Assumed:\n", *(f"{number}. {line}" for number, line in enumerate(found.assumptions, 1)), ""]
    return "\n".join(text)


def write_ratios(folder: Path, found: Sequence[Ratio]) -> Path:
    """Write ``ratios.csv``, one row a ratio, and return its name. Raises as :func:`write_bench`."""
    machine = {"cpu": cpu_name(), "cores": core_count()}
    with atomic_output(folder / "ratios.csv") as temporary:
        pd.DataFrame([{**dataclasses.asdict(one), **machine} for one in found]).to_csv(temporary, index=False)
    return folder / "ratios.csv"


def disturbed_note(count: int, total: int) -> str:
    """What it means that a core was not this program's alone at some of the points."""
    return (
        f"at {count} of {total} points a core worked less than {100 * ALONE:.0f} % of the time on the clock: other "
        "programs were running, which slows caches and memory as well; laws and rates use the time of a core"
    )
