"""``mvla dataset score``: methods on a benchmark, and the leaderboard."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from mvla_sim.cluster.interface import Cluster
from mvla_sim.dataset.access import open_dataset
from mvla_sim.dataset.leaderboard import build_leaderboard, write_leaderboard
from mvla_sim.dataset.score import SCORES, score_dataset

__all__ = ["score"]


def score(
    folder: Path,
    methods: Sequence[str] | None,
    overrides: Sequence[str],
    out: Console,
    errors: Console,
    *,
    label: str | None,
    output: Path | None,
    cluster: Cluster,
    fresh: bool,
) -> int:
    """Score methods and print the leaderboard; returns the exit code, 1 where a method failed on a sample."""
    results = score_dataset(folder, methods, overrides, label=label, output=output, cluster=cluster, fresh=fresh)
    test = open_dataset(folder, "test")
    table = build_leaderboard(results)
    out.print(_shown(table, f"{test.campaign.name}: {len(test)} test scene{'s' * (len(test) > 1)}"))
    for file in write_leaderboard(table, test, output or folder / SCORES):
        out.print(f"wrote:    {file}", markup=False)
    failed = 0
    for result in results:
        bad = [row for row in result.rows if row["error"]]
        failed += len(bad)
        if bad:
            errors.print(
                f"mvla: {result.label} failed on {len(bad)} of {len(result.rows)} test samples, which count as worst; "
                f"the first, sample {bad[0]['sample']}: {bad[0]['error']}",
                markup=False,
            )
    return int(failed > 0)


def _shown(table: pd.DataFrame, title: str) -> Table:
    """What fits a terminal; the files have the rest."""
    shown = Table(title=title)
    shown.add_column("method", overflow="fold")
    for name in ("CD dB(m²)", "behind, dB", "F1 at 10 cm", "empty"):
        shown.add_column(name, justify="right", no_wrap=True)
    for place, row in enumerate(table.to_dict("records")):
        behind = "" if place == 0 else _range(row, "behind_db", 1)
        missing = str(row["empty"] + row["failed"])
        shown.add_row(row["method"], _range(row, "cd_db", 1), behind, f"{row['f1_10cm']:.2f}", missing)
    return shown


def _range(row: Mapping[Any, Any], name: str, digits: int) -> str:
    if math.isnan(row[f"{name}_lo"]):
        return f"{row[name]:.{digits}f}"
    return f"{row[name]:.{digits}f} [{row[f'{name}_lo']:.{digits}f}, {row[f'{name}_hi']:.{digits}f}]"
