"""Sections of the report on the search for the paper's reading: what came nearest, and what decides each claim."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from mvla_sim.errors import DataError
from mvla_sim.files import existing_file
from mvla_sim.paper.claims import CLAIM_TEXTS
from mvla_sim.paper.effects import conditions, effects
from mvla_sim.paper.page import Section, table_html
from mvla_sim.paper.panels import plot_effects
from mvla_sim.paper.reading_score import UNITS
from mvla_sim.plot.style import save_figure
from mvla_sim.sweep.design_run import DESIGN, HEAD, load_design
from mvla_sim.sweep.table import write_csv

__all__ = ["READINGS_FILE", "load_readings", "search_sections"]

READINGS_FILE: Final = "readings.csv"
"""One row a reading: settings, figures when it was screened, and those of later rounds with the round behind."""
SEARCH: Final = "readings"
"""Folder of the design's results."""
LATER: Final = ("score", "held", "gap_db", "table_error")
"""Figures of later rounds that are kept."""
BEST: Final = 12
_FAR: Final = 2.0
"""Units beyond which a margin is as good, or as bad, as at them: a ratio of spreads has no end."""
TABLE_FIGURES: Final = (
    "gap_db",
    "table_error",
    "mvla_support_0db",
    "mvla_support_20db",
    "mvla_area_20db",
    "bp_area_20db",
)
"""What Table I and the map are about, for the page on effects."""
_LABELS: Final = {
    "gap_db": "depth of J", "table_error": "Table I",
    "mvla_support_0db": "T_θ, 0 dB", "mvla_support_20db": "T_θ, 20 dB",
    "mvla_area_20db": "p, 20 dB", "bp_area_20db": "BP's p, 20 dB",
}  # fmt: skip


def search_sections(folder: Path) -> list[Section]:
    """Build the sections where a search is stored; write ``readings.csv``, ``effects.csv`` and ``effects.png``.

    Raises
    ------
    DataError
        A table cannot be read.
    OutputError
        The folder cannot be written.
    """
    file = folder / READINGS_FILE
    if (folder / SEARCH / DESIGN).exists():
        write_csv(_one_row_each(load_design(folder / SEARCH)), file)
    if not file.exists():
        return []
    readings, settings = load_readings(file)
    return [_found(readings, settings), _decides(readings, settings, folder), _together(readings, settings)]


def load_readings(file: Path) -> tuple[pd.DataFrame, list[str]]:
    """Read ``readings.csv``: its rows, and which of its columns are settings.

    Raises DataError: it is no such table.
    """
    existing_file(file, "table of readings; run the search first")
    try:
        table = pd.read_csv(file, low_memory=False)
    except (ValueError, UnicodeDecodeError) as error:  # pandas' own errors are ValueErrors
        raise DataError(f"{file}: not a readable table ({error})") from error
    if not {"sample", "rounds", "score", "held"} <= set(table.columns):
        raise DataError(f"{file}: not a table of readings; it must have the columns sample, rounds, score and held")
    names = list(table.columns)
    settings = names[names.index("rounds") + 1 : names.index("score")]
    return table, settings


def _one_row_each(design: pd.DataFrame) -> pd.DataFrame:
    """One row a reading of a design's table of one row a sample and round."""
    screened = design[design["round"] == 1].set_index("sample")
    names = list(design.columns)
    settings = [name for name in names[: names.index("score")] if name not in HEAD]
    figures = names[names.index("score") :]
    rounds = design.groupby("sample")["round"].max()
    table = screened[[*settings, *figures]].dropna(axis=1, how="all")
    table.insert(0, "rounds", rounds.reindex(table.index))
    for number in range(2, int(design["round"].max()) + 1):
        later = design[design["round"] == number].set_index("sample")
        for name in LATER:
            table[f"{name}_{number}"] = later[name].reindex(table.index)
    return table.reset_index()


def _best(readings: pd.DataFrame) -> pd.DataFrame:
    """The nearest readings: those of the last round before others, then by their score there."""
    last = int(readings["rounds"].max())
    name = "score" if last == 1 else f"score_{last}"
    return readings.sort_values(["rounds", name], ascending=[False, True], kind="stable").head(BEST)


def _found(readings: pd.DataFrame, settings: Sequence[str]) -> Section:
    last = int(readings["rounds"].max())
    behind = "" if last == 1 else f"_{last}"
    best = _best(readings)
    shown = best[["sample", f"score{behind}", f"held{behind}", f"gap_db{behind}", f"table_error{behind}", *settings]]
    shown = shown.rename(columns={
        f"score{behind}": "distance", f"held{behind}": "of C1–C13 hold", f"gap_db{behind}": "depth of J (dB)",
        f"table_error{behind}": "Table I, mean error",
    })  # fmt: skip
    counts = [int((readings["rounds"] >= number).sum()) for number in range(1, last + 1)]
    text = (
        f"{counts[0]:,} readings of {len(settings)} settings were drawn at once and screened"
        + "".join(f", the nearest {count} run in a finer round" for count in counts[1:])
        + ". Their distance from the paper is a sum of terms that was written down before: claims that do not hold and "
        "by how much, how far (0.5, 0.04) is above the minimum of J, and how far the 15 calibrated thresholds are from "
        "Table I; 0 is the paper itself. Below the nearest of the last round, there chosen with one tracing seed and "
        "few noise seeds; what becomes of the chosen one on fresh seeds is in the table of claims."
    )
    return Section("How the paper's reading was found", text, tables=[table_html(shown, digits=3)])


def _decides(readings: pd.DataFrame, settings: Sequence[str], folder: Path) -> Section:
    """One figure and one table: which settings decide each claim and the table's values, and when a claim holds."""
    claims = [number for number in UNITS if f"margin_{number.lower()}" in readings]
    figures = [f"margin_{number.lower()}" for number in claims] + [name for name in TABLE_FIGURES if name in readings]
    within = {
        f"margin_{number.lower()}": readings[f"margin_{number.lower()}"].clip(
            -_FAR * UNITS[number], _FAR * UNITS[number]
        )
        for number in claims
    }
    found = effects(readings.assign(**within), settings, figures)
    write_csv(found, folder / "effects.csv")
    labels = dict(zip(figures, [*claims, *(_LABELS[name] for name in TABLE_FIGURES if name in readings)], strict=True))
    picture = folder / "effects.png"
    save_figure(plot_effects(found[found["partner"] == ""], labels), picture)
    pairs = found[found["partner"] != ""]
    rows = []
    for number in claims:
        steps = conditions(readings, settings, f"holds_{number.lower()}")
        margin = f"margin_{number.lower()}"
        strongest = pairs[pairs["figure"] == margin].head(1)
        rows.append(
            {
                "claim": number,
                "the paper says": CLAIM_TEXTS[number],
                "holds in": f"{100 * steps[0][1]:.0f} % of readings",
                "holds when": "; ".join(f"{text}: {100 * share:.0f} %" for text, share in steps[1:]) or "–",
                "strongest pair": "; ".join(map(_pair, strongest.to_dict("records"))),
            }
        )
    text = (
        "Shares of variance over all readings that were screened: how much of a claim's margin, or of a figure, one "
        "setting decides by itself (ω², the first-order Sobol' index); what is missing to 100 % is decided by settings "
        "together and by chance. 'Holds when' names settings one after the other, each among the readings that meet "
        "those before it, and how often the claim holds there."
    )
    caption = (
        "Share of the variance of each claim's margin and of the table's values that a setting decides by itself, %"
    )
    return Section("What decides each claim", text, [(picture, caption)], [table_html(pd.DataFrame(rows), stack=True)])


def _pair(row: dict[Hashable, Any]) -> str:
    share, low, high = (100 * float(row[name]) for name in ("share", "low", "high"))
    return f"{row['setting']} with {row['partner']}: {share:.0f} % [{low:.0f}, {high:.0f}]"


def _pull(readings: pd.DataFrame, settings: Sequence[str], one: str, two: str) -> str:
    """The setting that pulls two claims furthest apart, with the value that each holds most often at."""
    best, text = 0.0, "–"
    for name in settings:
        shares = readings.groupby(name, dropna=False)[[f"holds_{one.lower()}", f"holds_{two.lower()}"]].mean()
        (first, second), spread = shares.idxmax(), float((shares.max() - shares.min()).min())
        if first != second and spread > best:
            best, text = spread, f"{name}: {first} for {one}, {second} for {two}"
    return text


def _together(readings: pd.DataFrame, settings: Sequence[str]) -> Section:
    """Which claims exclude each other: how often two hold in one reading, beside what chance would give."""
    names = {number: f"holds_{number.lower()}" for number in UNITS if f"holds_{number.lower()}" in readings}
    held = readings[list(names.values())].dropna(axis=0, how="all")
    rows = []
    numbers = list(names)
    for place, one in enumerate(numbers):
        for two in numbers[place + 1 :]:
            both = held[[names[one], names[two]]].dropna()
            if both.empty:
                continue
            values = both.to_numpy(float)
            share, chance = float(values.prod(axis=1).mean()), float(values.mean(axis=0).prod())
            if chance > 0:
                rows.append({"claims": f"{one} and {two}", "hold together (%)": 100 * share,
                             "were they independent (%)": 100 * chance, "ratio": share / chance})  # fmt: skip
    table = pd.DataFrame(rows).sort_values("ratio", kind="stable", ignore_index=True).head(10)
    pairs = [claims.split(" and ") for claims in table["claims"]]
    table["pulls each way"] = [_pull(readings, settings, one, two) for one, two in pairs]
    counts, readings_of = np.unique(held.sum(axis=1).to_numpy(int), return_counts=True)
    known = held.notna().sum(axis=1).max()
    spread = ", ".join(f"{count} in {n}" for count, n in zip(counts[::-1][:4], readings_of[::-1][:4], strict=True))
    text = (
        f"Pairs of claims that hold together least often, for how often each holds. Of the {known:.0f} claims that "
        f"screening could tell, so many hold in so many readings: {spread}. What pulls each way is the setting that "
        "both depend on most and that they want different values of."
    )
    return Section("Which claims exclude each other", text, tables=[table_html(table, digits=3)])
