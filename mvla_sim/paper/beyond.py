"""Sections of the report beyond the paper: ablation, fair thresholds, robustness, the benchmark."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pandas as pd

from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output
from mvla_sim.imaging.method import title_of
from mvla_sim.paper.ablation import ablation_table, plot_ablation
from mvla_sim.paper.averages import finite
from mvla_sim.paper.fair import EXPLAINED, WAYS, automatic_cost, fair_table, plot_fair
from mvla_sim.paper.page import Section, table_html
from mvla_sim.paper.robustness import plot_robustness
from mvla_sim.plot.style import png_bytes, save_figure
from mvla_sim.sweep.table import FILE, PARQUET, load_table

__all__ = ["sections_beyond"]

ABLATION: Final = "ablation"
BENCHMARK: Final = "benchmark-small"
FAIR_SCENE: Final = "star"
FAIR_LEAST_DEG: Final = 5.0
ROBUSTNESS: Final = {
    "robustness": "every 5° on a circle, 20 dB",
    "robustness-trajectories": "other trajectories, 20 dB",
    "robustness-coherent": "coherent backprojection where its sampling is fair: 0.2 m, 480 views, 20 dB",
}
"""Experiments on robustness, and what is seen in them."""


def sections_beyond(folder: Path) -> list[Section]:
    """Build the sections whose experiments are stored in a folder of results; write ``fair.csv``, ``automatic.csv``.

    Raises
    ------
    DataError
        A table or the leaderboard cannot be read.
    OutputError
        The folder cannot be written.
    """
    return [*_ablation(folder), *_fair(folder), *_automatic(folder), *_robustness(folder), *_benchmark(folder)]


def _ablation(folder: Path) -> Iterator[Section]:
    if (table := _stored(folder / ABLATION, "scene", "method", "interval_deg")) is None:
        return
    means = ablation_table(table)
    text = (
        "Mean CD in dB(m²) over intervals, SNRs and seeds, each case at its own best thresholds. The first four rows "
        "are a ladder: each adds one ingredient to the one before. The others are backprojection with one of them each."
    )
    shown = _titled(means.rename(columns={"mean": "mean of all"}))
    pictures = [(png_bytes(plot_ablation(table)), "CD against Δθ of each rung, on four shapes")]
    caption = "CD against Δθ, means over SNRs and seeds; the ladder is drawn through, backprojection dashed"
    yield Section("Which ingredient brings how much", text, [(pictures, caption)], [table_html(shown, digits=3)])


def _fair(folder: Path) -> Iterator[Section]:
    tables: dict[str, pd.DataFrame] = {}
    for way, name in WAYS.items():
        if (table := _stored(folder / name)) is None:
            continue
        with contextlib.suppress(DataError):  # nothing of this scene is finished there, or it is another sort of table
            fair_table(tables | {way: table}, FAIR_SCENE, FAIR_LEAST_DEG)
            tables[way] = table
    if len(tables) < 2:
        return
    means = fair_table(tables, FAIR_SCENE, FAIR_LEAST_DEG)
    with atomic_output(folder / "fair.csv") as temporary:
        means.rename_axis("method").reset_index().to_csv(temporary, index=False, float_format="%.6g")
    picture = folder / "fair.png"
    save_figure(plot_fair(means), picture)
    text = " ".join(
        (
            f"Mean CD in dB(m²) on the {FAIR_SCENE}, Δθ from {FAIR_LEAST_DEG:g}°, and each method's rank.",
            *(EXPLAINED[way] for way in tables),
            "The area under precision and recall (AP) needs no thresholds.",
        )
    )
    places = {name: 2 if str(name).startswith("ap_") else 1 for name in means if means[name].dtype == float}
    rounded = means.round(places)
    shown = _titled(rounded[[name for name in means if name != "lacking" or means[name].any()]])
    caption = "Each method's mean CD under each way to choose thresholds"
    yield Section("Methods under fair thresholds", text, [(picture, caption)], [table_html(shown, digits=3)])


def _automatic(folder: Path) -> Iterator[Section]:
    optimal, automatic = (_stored(folder / WAYS[way]) for way in ("oracle", "automatic"))
    if optimal is None or automatic is None:
        return
    try:
        cost = automatic_cost(optimal, automatic)
    except DataError:  # they have no case in common
        return
    with atomic_output(folder / "automatic.csv") as temporary:
        cost.reset_index().to_csv(temporary, index=False, float_format="%.6g")
    text = (
        "Mean CD under automatic thresholds minus that under the oracle's, in dB, over all intervals, SNRs and seeds. "
        "The rule was chosen on circle, square and triangle."
    )
    yield Section("What not knowing the truth costs", text, tables=[table_html(_titled(cost), digits=2)])


def _robustness(folder: Path) -> Iterator[Section]:
    figures = []
    for name, what in ROBUSTNESS.items():
        if (table := _stored(folder / name, "scene")) is None:
            continue
        columns = [name for name in map(str, table) if re.fullmatch(r"f1_[\d.]+cm", name)]
        column = max(columns, key=lambda name: float(name[3:-2]), default="")
        label = f"F1 at {column[3:-2]} cm"
        for scene in dict.fromkeys(table["scene"]):
            try:
                figure = plot_robustness(table, scene=scene, f1=column, f1_label=label, title=scene)
            except DataError:  # nothing of this scene is finished
                continue
            figures.append(([(png_bytes(figure), f"CD and F1 against impairments, {scene}")], f"{scene}: {what}"))
    if figures:
        text = "One impairment at a time, at the best thresholds; lines are means, bands the range over the seeds."
        yield Section("Robustness", text, figures)


def _benchmark(folder: Path) -> Iterator[Section]:
    file = folder / BENCHMARK / "leaderboard.csv"
    if not file.exists():
        return
    try:
        board = pd.read_csv(file)
        shown = pd.DataFrame(
            {
                "method": [title_of(name) for name in board["method"]],
                "CD (dB(m²))": board["cd_db"],
                "from": board["cd_db_lo"],
                "to": board["cd_db_hi"],
                "behind the first (dB)": board["behind_db"],
                "F1 at 10 cm": board["f1_10cm"],
                "p (%)": board["top_percent"],
                "T_θ (°)": board["min_support_deg"],
            }
        )
    except (ValueError, KeyError) as error:
        raise DataError(f"{file}: not a leaderboard ({error!r})") from error
    text = (
        f"The test split of {BENCHMARK}, at the one pair of thresholds a method that has the least mean CD over the "
        "validation split; 95 % bootstrap intervals over the scenes."
    )
    yield Section("The benchmark of unseen scenes", text, tables=[table_html(shown, digits=3)])


def _titled(table: pd.DataFrame) -> pd.DataFrame:
    """Methods by their titles, as the first column; ranks as plain numbers."""
    shown = table.copy()
    heads = {name: f"AP {name[3:-2]} cm" for name in map(str, shown) if re.fullmatch(r"ap_[\d.]+cm", name)}
    for number, name in enumerate(map(str, shown)):
        if name.endswith(" rank"):
            shown[name] = [str(rank) for rank in shown[name]]
            heads[name] = "rank" + " " * number  # columns of one head differ by blanks
    shown = shown.rename(columns=heads)
    shown.insert(0, "method", [title_of(str(name)) for name in table.index])
    return shown


def _stored(folder: Path, *columns: str) -> pd.DataFrame | None:
    """Table of an experiment; None where there is none, it lacks a column, or nothing in it is finished."""
    if not ((folder / FILE).exists() or (folder / PARQUET).exists()):
        return None
    table = load_table(folder)
    if not {"cd_db", *columns} <= set(table.columns):
        return None
    return None if finite(table[table["status"] == "done"]).empty else table
