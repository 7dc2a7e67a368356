"""Sections of the report that show the paper's experiments under each reading, the nearest one first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from mvla_sim.paper.averages import finite
from mvla_sim.paper.claims import Claim, ResultTables, judge, thresholds_table
from mvla_sim.paper.page import Section, table_html
from mvla_sim.paper.panels import parameter_maps, plot_cd_panels, plot_examples, plot_parameter_maps
from mvla_sim.plot.style import png_bytes, save_figure
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.run import images_of
from mvla_sim.sweep.table import FILE, PARQUET, load_table, write_csv

__all__ = ["FRESH", "READINGS", "ReadingResults", "draw_examples", "sections_of_readings", "stored_readings"]

READINGS: Final = ("paper", "physical")
"""Readings that are reproduced, in the order of the report."""
FRESH: Final = "-fresh"
"""Behind a reading's name: judged on seeds that it was not chosen with."""
TABLES: Final = ("kappa-eta", "star-optimal", "star-calibrated")
EXAMPLE_CASES = [(20.0, i) for i in (1.0, 5.0, 10.0, 30.0)] + [(snr, 5.0) for snr in (15.0, 10.0, 5.0, 0.0)]
"""(SNR in dB, interval in degrees) of the paper's eight example panels."""
_MAP_COLUMNS = {"scene", "kappa", "eta", "cd_db"}
_STAR_COLUMNS = {"snr_db", "interval_deg", "method", "cd_db", "top_percent", "min_support_deg", "area_m2"}
_HEADS = {
    "snr_db": "SNR (dB)",
    "mvla_top_percent": "MVLA-GR p (%)",
    "mvla_wide_percent": "of 20 × 20 m (%)",
    "paper_mvla_top_percent": "paper",
    "mvla_min_support_deg": "MVLA-GR T_θ (°)",
    "paper_mvla_min_support_deg": "paper ",
    "bp_top_percent": "BP p (%)",
    "bp_wide_percent": "of 20 × 20 m (%) ",
    "paper_bp_top_percent": "paper  ",
    "mvla_area_m2": "MVLA-GR area (m²)",
    "mvla_optimal_area_m2": "at its optima (m²)",
    "bp_area_m2": "BP area (m²)",
}
"""Heads of the table of thresholds; columns of one head differ by blanks."""


@dataclass(frozen=True, eq=False)
class ReadingResults:
    """What is stored of a reading: its tables, None where one is not there or of no use, and its claims, judged."""

    name: str
    folder: Path
    tables: dict[str, pd.DataFrame | None]
    claims: list[Claim]

    def __repr__(self) -> str:
        """One line: which tables there are."""
        return f"ReadingResults({self.name!r}: {', '.join(n for n, table in self.tables.items() if table is not None)})"

    @property
    def unfinished(self) -> str:
        """Which experiments have cases that failed or are missing, and the first error of each."""
        parts = []
        for name, table in self.tables.items():
            if table is None or (table["status"] == "done").all():
                continue
            rest = table[table["status"] != "done"]
            errors = [text for text in rest.get("error", pd.Series(dtype=str)).fillna("") if text]
            why = f" ({errors[0]})" if errors else ""
            parts.append(f"{self.name}/{name}: {len(rest)} of {len(table)} cases failed or are missing{why}")
        return "; ".join(parts)


def stored_readings(folder: Path, checks: dict[str, Any]) -> list[ReadingResults]:
    """The readings that a folder of results holds experiments of, known ones first; ``checks`` count for all of them.

    Raises
    ------
    DataError
        A table cannot be read.
    """
    there = sorted({file.parent.parent.name for name in TABLES for file in folder.glob(f"*/{name}/table.*")})
    found = []
    order = [name for reading in READINGS for name in (reading, f"{reading}{FRESH}")]
    for name in sorted(there, key=lambda n: order.index(n) if n in order else len(order)):
        tables = {table: _table(folder / name / table) for table in TABLES}
        if any(table is not None for table in tables.values()):
            maps, optimal, calibrated = tables.values()
            claims = judge(ResultTables(maps, optimal, calibrated, checks))
            found.append(ReadingResults(name, folder / name, tables, claims))
    return found


def sections_of_readings(readings: Sequence[ReadingResults]) -> list[Section]:
    """Maps of κ and η, curves, calibrated thresholds and examples; in each section one reading after the other.

    Of what was judged on fresh seeds the thresholds are shown: its maps and curves look like those of the reading.
    """
    drawn = [reading for reading in readings if not reading.name.endswith(FRESH)]
    return [
        _maps(drawn),
        *(_curves(drawn, name) for name in ("star-optimal", "star-calibrated")),
        _thresholds(readings),
        _examples(drawn),
    ]


def draw_examples(plan: Plan, folder: Path) -> list[Path]:
    """Draw the paper's eight example panels, a figure a method."""
    drawn = []
    for method in ("mvla-gr", "bp"):
        by_place = {
            (c.values["snr_db"], c.values["interval_deg"]): c for c in plan.cases if c.values["method"] == method
        }
        cases = [by_place[place] for place in EXAMPLE_CASES if place in by_place]
        shown = list(images_of(plan, cases))
        if not shown:
            continue
        labels = [
            f"{o.case.values['interval_deg']:g}°, {o.case.values['snr_db']:g} dB: CD {o.evaluation.cd_db:.1f} dB(m²)"
            for o in shown
        ]
        drawn.append(folder / f"examples-{method}.png")
        truths, masks = ([getattr(o.evaluation, name) for o in shown] for name in ("truth", "occupied"))
        figure = plot_examples([o.image for o in shown], truths, masks, labels)
        save_figure(figure, drawn[-1])
    return drawn


def _maps(readings: Sequence[ReadingResults]) -> Section:
    figures = []
    for reading in readings:
        if (table := reading.tables["kappa-eta"]) is None:
            continue
        save_figure(plot_parameter_maps(table), reading.folder / "kappa-eta.png")
        names = list(parameter_maps(table))
        pictures = [(png_bytes(plot_parameter_maps(table, name)), f"CD over κ and η, {name}") for name in names]
        caption = (
            f"Reading '{reading.name}': smallest CD over every admissible p and T_θ for each (κ, η), at 72 views and "
            "20 dB, in dB(m²); first the average of the targets. Circle: smallest; cross: the paper's point. One "
            "colour scale for all."
        )
        figures.append((pictures, caption))
    return Section("Choosing κ and η (Section IV-A)", "" if figures else "Not run.", figures=figures)


def _curves(readings: Sequence[ReadingResults], name: str) -> Section:
    kind = name.removeprefix("star-")
    figures = []
    for reading in readings:
        if (table := reading.tables[name]) is None:
            continue
        save_figure(plot_cd_panels(table), reading.folder / f"{name}.png")
        pictures = [
            (png_bytes(plot_cd_panels(table, only=snr)), f"CD against Δθ at {snr:g} dB, {kind} thresholds")
            for snr in sorted(finite(table)["snr_db"].unique())
        ]
        caption = (
            f"Reading '{reading.name}': CD against Δθ under {kind} thresholds; lines: means over offsets and seeds, "
            "bands: 10 to 90 %"
        )
        figures.append((pictures, caption))
    title = f"The star under {kind} thresholds (Section IV-B)"
    return Section(title, "" if figures else "Not run.", figures=figures)


def _thresholds(readings: Sequence[ReadingResults]) -> Section:
    title = "Calibrated thresholds (Table I)"
    tables = []
    for reading in readings:
        if (optimal := reading.tables["star-optimal"]) is None:
            continue
        thresholds = thresholds_table(optimal, reading.tables["star-calibrated"])
        write_csv(thresholds, reading.folder / "thresholds.csv")
        shown = thresholds.rename(columns=_HEADS)[list(_HEADS.values())]
        tables.append(table_html(shown, f"Reading '{reading.name}'"))
    if not tables:
        return Section(title, "Not run.")
    text = (
        "p is per cent of all voxels and depends on the grid, areas do not. The paper does not say its grid; beside p "
        "it is given as area, in per cent of a grid as wide as the trajectory. MVLA-GR's p is before the test Θ ≥ T_θ, "
        "its area after it."
    )
    return Section(title, text, tables=tables)


def _examples(readings: Sequence[ReadingResults]) -> Section:
    pictures = [
        (file, f"Reading '{reading.name}': binary reconstructions over the ground truth, {method}")
        for reading in readings
        for method in ("mvla-gr", "bp")
        if (file := reading.folder / "examples" / f"examples-{method}.png").exists()
    ]
    return Section("Examples", "" if pictures else "Not run.", figures=pictures)


def _table(folder: Path) -> pd.DataFrame | None:
    """Cases of an experiment, failed ones too; None where there is no table, or too little of it for any figure."""
    if not ((folder / FILE).exists() or (folder / PARQUET).exists()):
        return None
    table = load_table(folder)
    done = table[table["status"] == "done"]
    needed = _MAP_COLUMNS if {"kappa", "eta"} <= set(table.columns) else _STAR_COLUMNS
    if done.empty or not needed <= set(table.columns):
        return None
    return table if needed is _MAP_COLUMNS or set(done["method"]) >= {"mvla-gr", "bp"} else None
