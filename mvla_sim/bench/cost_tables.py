"""What ``mvla bench`` found as tables and text, and its files: all as JSON and CSV, and a page of tables."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from mvla_sim.bench.estimate import CostForecast, Costs, fit_affine, fit_power_law, rows_along
from mvla_sim.bench.measure import ALONE
from mvla_sim.bench.ratios import Ratio
from mvla_sim.bench.stages import SIZES, TimedPoint
from mvla_sim.engine.machine import core_count, cpu_name
from mvla_sim.engine.provenance import provenance
from mvla_sim.files import atomic_output

__all__ = [
    "FILES", "AxisTable", "axis_tables", "cost_lines", "disturbed_note", "estimate_lines", "frame", "markdown",
    "ratio_line", "write_bench", "write_ratios",
]  # fmt: skip

FILES: Final = ("bench.json", "bench.csv", "bench.md")
MIB = 2**20
HEADER = ("first", "median", "of a core", "rate", "memory", "steady")


@dataclass(frozen=True)
class AxisTable:
    """One series along one axis, as text."""

    title: str
    header: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    law: str  # how cost grows along the axis; empty where there are fewer than two sizes


def write_bench(
    folder: Path, rows: Sequence[TimedPoint], costs: Costs | None, found: CostForecast | None, *, quick: bool = False
) -> list[Path]:
    """Write the three files, each at once or not at all, and return their names.

    Raises
    ------
    OutputError
        One cannot be written.
    """
    table = frame(rows)
    record: dict[str, Any] = {
        "machine": {"cpu": cpu_name(), "cores": core_count(), "quick": quick},
        "provenance": provenance(),
        "points": json.loads(table.to_json(orient="records")),
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


def frame(rows: Sequence[TimedPoint]) -> pd.DataFrame:
    """One row a point: stage, series, every size (NaN where it has none), seconds, rate, memory, and its facts."""
    data = [
        {
            "stage": row.series.stage,
            "series": row.series.name,
            **{name: row.size.get(name, math.nan) for name in SIZES},
            "first_s": row.measured.first_s,
            "median_s": row.measured.median_s,
            "core_s": row.measured.core_s,
            "repeats": row.measured.repeats,
            "rate_per_s": row.rate,
            "rate_unit": row.series.unit,
            "memory_mib": row.measured.memory_bytes / MIB,
            "steady_mib": row.measured.steady_bytes / MIB,
            "loaded_mib": row.measured.loaded_bytes / MIB,
            "disturbed": row.disturbed,
            **row.measured.facts,
        }
        for row in rows
    ]
    return pd.DataFrame(data)


def axis_tables(rows: Sequence[TimedPoint]) -> Iterator[AxisTable]:
    """Tables of every series along each of its axes."""
    for series in dict.fromkeys((row.series.stage, row.series.name) for row in rows):
        first = next(row.series for row in rows if (row.series.stage, row.series.name) == series)
        for axis in first.axes or dict.fromkeys(("workers",)):
            found = rows_along(rows, *series, axis)
            rest = ", ".join(f"{value:,.0f} {key}" for key, value in first.base.items() if key != axis)
            yield AxisTable(
                f"{first.stage}: {first.name} against {axis}" + (f" ({rest})" if rest else ""),
                (axis, *HEADER),
                tuple(_cells(row, axis) for row in found),
                _law(found, axis),
            )


def markdown(table: AxisTable) -> str:
    """The table in Markdown, with its title above and its law below."""
    lines = [f"**{table.title}**", "", f"| {' | '.join(table.header)} |", "|" + "---:|" * len(table.header)]
    lines += [f"| {' | '.join(cells)} |" for cells in table.lines]
    return "\n".join([*lines, "", *([table.law, ""] if table.law else [])])


def cost_lines(costs: Costs) -> list[str]:
    """What does not show in the tables."""
    return [
        f"a path: {costs.memory_bytes_per_path:.0f} bytes in memory, {costs.disk_bytes_per_path:.1f} in a CIR file",
        f"two workers: {100 * costs.efficiency:.0f} % of the speed of one each",
        f"handing out a task: {1e3 * costs.handing_out_s:.1f} ms of the coordinator",
        f"a case of the sweep: {_seconds(costs.case_s)} of a core; noise, peaks, projection and search on their own "
        f"make {_seconds(costs.parts_s)}",
        f"a traced view: {_seconds(costs.trace.per_unit)}",
    ]


def ratio_line(one: Ratio) -> str:
    """One ratio as text."""
    took = "" if math.isnan(one.seconds) else f"{_seconds(one.seconds)}, "
    rate = "" if math.isnan(one.rate_per_s) else f"{_rate(one.rate_per_s)} {one.unit}/s, "
    return f"{one.stage}: {one.name}: {took}{rate}{one.ratio:.4g} × {one.against}"


def estimate_lines(found: CostForecast) -> list[str]:
    """The estimate, one line a figure; assumptions last."""
    campaign = found.campaign
    lines = [
        f"{campaign.scenes:,} scenes × {campaign.views} views on {_count(campaign.nodes, 'node')} of "
        f"{_count(campaign.cores, 'core')}: "
        f"{_hours(found.hours)}, bounded by {found.bound}"
    ]
    total = sum(stage.core_s for stage in found.stages)
    lines += [
        f"{stage.name}: {_seconds(stage.core_s)} of a core a scene ({100 * stage.core_s / total:.1f} %), "
        f"{_hours(stage.hours)} on all cores"
        for stage in found.stages
    ]
    lines += [
        f"coordination: {_hours(found.coordinating_hours)} of one process, meanwhile",
        f"CIR files: {_bytes(found.disk_bytes)}, written at {_bytes(found.disk_bytes_per_s)}/s",
        f"memory: {_bytes(found.worker_bytes)} a worker, {_bytes(found.node_bytes)} a node",
    ]
    return lines


def _cells(row: TimedPoint, axis: str) -> tuple[str, ...]:
    measured = row.measured
    return (
        f"{row.size[axis]:,.0f}",
        _seconds(measured.first_s),
        _seconds(measured.median_s) + ("*" if row.disturbed else ""),
        _seconds(measured.core_s),
        f"{_rate(row.rate)} {row.series.unit}/s",
        f"{measured.memory_bytes / MIB:.0f} MiB",
        f"{measured.steady_bytes / MIB:.0f} MiB",
    )


def _law(rows: Sequence[TimedPoint], axis: str) -> str:
    sizes = [row.size[axis] for row in rows]
    if len(set(sizes)) < 2 or axis == "workers":
        return ""
    costs = [row.measured.core_s for row in rows]
    power, affine = fit_power_law(sizes, costs), fit_affine(sizes, costs)
    last = fit_power_law(sizes[-2:], costs[-2:])
    return (
        f"{axis}^{power.exponent:.2f} overall, ^{last.exponent:.2f} between the last two; "
        f"{_seconds(affine.fixed)} + {_seconds(affine.per_unit)} × {axis} within {100 * affine.spread:.0f} %"
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _seconds(value: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value * 1e9:.3g} ns"


def _hours(value: float) -> str:
    if value < 1 / 30:
        return f"{3600 * value:.0f} s"
    return f"{60 * value:.0f} min" if value < 2 else f"{value:.1f} h" if value < 72 else f"{value / 24:.1f} days"


def _rate(value: float) -> str:
    return f"{value:.2e}" if value >= 1e5 else f"{value:.3g}"


def _bytes(value: float) -> str:
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value / 1e3:.3g} kB"
