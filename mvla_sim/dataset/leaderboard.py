"""The leaderboard: methods in the order of their mean Chamfer distance, with confidence intervals over the samples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mvla_sim.dataset.access import BenchmarkDataset
from mvla_sim.dataset.protocol import PROTOCOL, SNR_DB
from mvla_sim.dataset.score import Result
from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output

__all__ = ["CONFIDENCE", "build_leaderboard", "leaderboard_text", "write_leaderboard"]

CONFIDENCE: Final = 0.95
RESAMPLES: Final = 10_000
SEED: Final = 0
BLOCK: Final = 1 << 22  # indices drawn at a time

Floats = NDArray[np.float64]


def build_leaderboard(results: Sequence[Result]) -> pd.DataFrame:
    """One row a method, the best first, from results on the same samples.

    Returns
    -------
    DataFrame
        Columns ``method``; ``cd_db``, ``f1_5cm``, ``f1_10cm``: means over the test samples, each with ``_lo`` and
        ``_hi``; ``behind_db`` with ``_lo`` and ``_hi``: the mean over samples of its CD minus that of the first
        method; ``top_percent``, ``min_support_deg``: thresholds from the validation split; ``validation_db``: mean CD
        there; ``empty``, ``failed``: samples without a voxel above the thresholds, or without an image; ``seconds``:
        median time from CIR to image.

    Notes
    -----
    Intervals are those of the percentile bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap, 1993,
    ch. 13): samples are drawn with replacement 10,000 times, the same draws for all methods, so differences are paired.
    One sample alone has no interval: its ends are NaN.

    Raises
    ------
    DataError
        There is no result, or results are of different samples.
    """
    if not results:
        raise DataError("leaderboard: there is no result of this dataset and protocol")
    samples = [tuple(row["sample"] for row in result.rows) for result in results]
    if len(set(samples)) > 1:
        raise DataError("leaderboard: results are of different samples")
    ordered = sorted(results, key=lambda result: float(_column(result, "cd_db").mean()))
    first = _column(ordered[0], "cd_db")
    names = ("cd_db", "f1_5cm", "f1_10cm")
    values = np.array(
        [[*(_column(result, name) for name in names), _column(result, "cd_db") - first] for result in ordered]
    )
    low, high = _interval(values)
    rows = []
    for number, result in enumerate(ordered):
        row: dict[str, Any] = {"method": result.label}
        for place, name in enumerate((*names, "behind_db")):
            row[name] = float(values[number, place].mean())
            row[f"{name}_lo"], row[f"{name}_hi"] = float(low[number, place]), float(high[number, place])
        row |= {
            "top_percent": result.top_percent,
            "min_support_deg": result.min_support_deg,
            "validation_db": result.validation_db,
            "empty": int(sum(row["empty"] > 0 and not row["error"] for row in result.rows)),
            "failed": sum(bool(row["error"]) for row in result.rows),
            "seconds": float(np.median(_column(result, "seconds"))),
        }
        rows.append(row)
    return pd.DataFrame(rows)


def leaderboard_text(table: pd.DataFrame, dataset: BenchmarkDataset) -> str:
    """The leaderboard as Markdown, with what one must know to read it."""
    lines = [
        f"# {dataset.campaign.name}: leaderboard",
        "",
        f"{len(dataset)} test scene{'s' * (len(dataset) > 1)}, protocol {PROTOCOL}: all views, SNR {SNR_DB:g} dB, "
        "one pair of thresholds a method, chosen on the validation split. Means over the scenes with "
        f"{100 * CONFIDENCE:g} % bootstrap intervals; the distance to the first is paired, scene by scene.",
        "",
        "| | method | CD dB(m²) | behind the first, dB | F1 at 5 cm | F1 at 10 cm | p % | T_θ ° | empty | s an image |",
        "|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for place, row in enumerate(table.to_dict("records"), 1):
        behind = "" if place == 1 else _range(row, "behind_db", 1)
        missing = row["empty"] + row["failed"]
        lines.append(
            f"| {place} | {row['method']} | {_range(row, 'cd_db', 1)} | {behind} | {_range(row, 'f1_5cm', 2)} | "
            f"{_range(row, 'f1_10cm', 2)} | {row['top_percent']:.3g} | {row['min_support_deg']:g} | {missing} | "
            f"{row['seconds']:.2g} |"
        )
    return "\n".join(lines) + "\n"


def write_leaderboard(table: pd.DataFrame, dataset: BenchmarkDataset, folder: Path) -> list[Path]:
    """Write ``leaderboard.csv`` and ``leaderboard.md``.

    Raises
    ------
    OutputError
        They cannot be written.
    """
    files = [folder / "leaderboard.csv", folder / "leaderboard.md"]
    for file, text in zip(files, (table.to_csv(index=False), leaderboard_text(table, dataset)), strict=True):
        with atomic_output(file) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return files


def _column(result: Result, name: str) -> Floats:
    return np.array([float(row[name]) for row in result.rows])


def _interval(values: Floats) -> tuple[Floats, Floats]:
    """Ends of the bootstrap interval of the mean over the last axis."""
    count = values.shape[-1]
    if count == 1:  # one scene says nothing of others
        return np.full(values.shape[:-1], np.nan), np.full(values.shape[:-1], np.nan)
    random = np.random.default_rng(SEED)
    means = []
    step = max(1, BLOCK // (count * values[..., 0].size))
    for start in range(0, RESAMPLES, step):
        drawn = random.integers(count, size=(min(step, RESAMPLES - start), count))
        means.append(values[..., drawn].mean(axis=-1))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(np.concatenate(means, axis=-1), [tail, 1 - tail], axis=-1)
    return low, high


def _range(row: Mapping[Any, Any], name: str, digits: int) -> str:
    if math.isnan(row[f"{name}_lo"]):
        return f"{row[name]:.{digits}f}".replace("-", "\N{MINUS SIGN}")
    low, high = row[f"{name}_lo"], row[f"{name}_hi"]
    return f"{row[name]:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]".replace("-", "\N{MINUS SIGN}")
