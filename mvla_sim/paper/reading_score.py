"""How far a reading of the paper is from what it publishes: the score that readings are chosen by.

The paper leaves settings open; a *reading* is one choice of all of them. Its distance is a sum of terms, each 0 where
the paper is met. Terms and weights were written down before the search and are not changed after it:

========================  ======  ======================================================================================
term                      weight  what it is, from 0 to 1
========================  ======  ======================================================================================
each of C1 to C13         1       0 where the claim holds; else 0.5, rising to 1 where its margin is one unit of
                                  :data:`UNITS` below the rule; a claim that cannot be told counts as 1 where its
                                  table is there, and not at all where it is not
depth of J                2       CD averaged over the targets at (κ, η) = (0.5, 0.04), above its minimum: dB of 6 dB
place of J's minimum      1       cells of the grid of (κ, η), the larger of both directions, of 4 cells
calibrated thresholds     4       mean over the 15 values of Table I of |ln(ours/paper)|, of ln 4 each
========================  ======  ======================================================================================

p is compared as area: in per cent of the reading's own grid, and in per cent of a grid as wide as the trajectory,
20 m × 20 m; the nearer one counts, and both are figures of the score. C14 to C16 do not depend on a reading.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import pandas as pd

from mvla_sim.paper.averages import (
    BP,
    MVLA,
    CannotTellError,
    calibrated_means,
    finite,
    grid_area_m2,
    mean_by_target,
    need,
)
from mvla_sim.paper.claims import PAPER_ETA, PAPER_KAPPA, PAPER_THRESHOLDS, TARGETS, WIDE_M2, Claim, ResultTables, judge

__all__ = ["UNITS", "reading_score", "tables_of"]

UNITS: Final[dict[str, float]] = {
    "C1": 3.0, "C2": 0.5, "C3": 0.5, "C4": 1.0, "C5": 3.0, "C6": 2.0, "C7": 1.0, "C8": 1.0, "C9": 1.0, "C10": 1.0,
    "C11": 10.0, "C12": 0.3, "C13": 1.0,
}  # fmt: skip
"""Margins, in the units of each claim's figure, at which a claim that does not hold counts in full."""
_DEPTH_WEIGHT, _DEPTH_DB = 2.0, 6.0
_PLACE_WEIGHT, _PLACE_CELLS = 1.0, 4.0
_TABLE_WEIGHT, _TABLE_RATIO = 4.0, 4.0
_COLUMNS: Final = (
    "scene", "protocol", "status", "method", "kappa", "eta", "snr_db", "interval_deg", "offset", "seed", "cd_db",
    "top_percent", "min_support_deg", "area_m2",
)  # fmt: skip
"""What the score looks at; of a hundred columns, averages take longer."""
_HOLDS: Final = {"holds": 1.0, "does not hold": 0.0, "not tested": float("nan")}


def reading_score(table: pd.DataFrame) -> dict[str, float]:
    """Score of one reading, for designs: ``score = "reading"``.

    Parameters
    ----------
    table
        Cases of one reading: (κ, η) of circle, square and triangle; SNR, Δθ and method of the star under optimal
        thresholds, and, where they are there, under calibrated ones.

    Returns
    -------
    dict
        ``score``, the distance: lower is nearer, 0 is the paper itself. ``held`` and ``tested``: claims of C1 to C13.
        ``gap_db``, ``kappa``, ``eta``: depth of J at the paper's point, and where its minimum is. ``table_error``: mean
        of |ours/paper − 1| over the 15 thresholds, with p on whichever grid is nearer; ``table_error_own`` and
        ``table_error_wide``, with p on the reading's own grid, and on the one as wide as the trajectory. The thresholds
        themselves: ``mvla_area_20db`` (m²) and so on. ``margin_c1`` … ``margin_c13``, and ``holds_c1`` …, 1 or 0. NaN:
        could not be told.
    """
    tables = tables_of(table[[name for name in _COLUMNS if name in table]])
    claims = [claim for claim in judge(tables) if claim.number in UNITS]
    tested = [claim for claim in claims if claim.detail != "the experiment was not run"]
    total = sum(_shortfall(claim) for claim in tested)
    figures = {
        "held": float(sum(claim.verdict == "holds" for claim in tested)),
        "tested": float(len(tested)),
        **_minimum(tables.kappa_eta),
        **_thresholds(tables.star_optimal),
        **{f"margin_{claim.number.lower()}": claim.margin for claim in claims},
        **{f"holds_{claim.number.lower()}": _HOLDS[claim.verdict] for claim in claims},
    }
    if tables.kappa_eta is not None:
        total += _DEPTH_WEIGHT * _share(figures["gap_db"], _DEPTH_DB)
        total += _PLACE_WEIGHT * _share(figures["cells_away"], _PLACE_CELLS)
    if tables.star_optimal is not None:
        total += _TABLE_WEIGHT * _share(figures.pop("table_log_error"), 1.0)
    return {"score": total, **figures}


def tables_of(table: pd.DataFrame) -> ResultTables:
    """The tables that claims are judged by, of the cases of one reading; None for what there is none of."""
    scene, protocol = table["scene"], table.get("protocol", pd.Series("optimal", table.index))
    star = scene == "star"
    parts = (scene.isin(TARGETS), star & (protocol != "given"), star & (protocol == "given"))
    kappa_eta, optimal, calibrated = (table[rows] if rows.any() else None for rows in parts)
    return ResultTables(kappa_eta, optimal, calibrated)


def _shortfall(claim: Claim) -> float:
    """What a claim adds to the distance, 0 to 1."""
    if claim.verdict == "holds":
        return 0.0
    return 0.5 + 0.5 * _share(-claim.margin, UNITS[claim.number])


def _share(value: float, unit: float) -> float:
    """A value of a unit, between 0 and 1; 1 where it is not known."""
    return 1.0 if math.isnan(value) else min(1.0, max(0.0, value / unit))


def _minimum(table: pd.DataFrame | None) -> dict[str, float]:
    """Depth of J at the paper's point in dB, where its minimum lies, and how many cells that is away."""
    lost = dict.fromkeys(("gap_db", "cells_away", "kappa", "eta"), float("nan"))
    if table is None:
        return lost
    try:
        average = mean_by_target(table, TARGETS)
        need("every target at (0.5, 0.04)", (PAPER_KAPPA, PAPER_ETA) in average.index)
    except CannotTellError:
        return lost
    best: Any = average.idxmin()
    steps = [
        abs(int(np.searchsorted(values, here)) - int(np.searchsorted(values, paper)))
        for values, here, paper in zip(
            (np.unique(table["kappa"]), np.unique(table["eta"])), best, (PAPER_KAPPA, PAPER_ETA), strict=True
        )
    ]
    gap = float(average[(PAPER_KAPPA, PAPER_ETA)] - average.min())
    return {"gap_db": gap, "cells_away": float(max(steps)), "kappa": float(best[0]), "eta": float(best[1])}


def _thresholds(table: pd.DataFrame | None) -> dict[str, float]:
    """Calibrated thresholds and their distance from Table I, with p on both grids."""
    errors = {f"table_error{name}": float("nan") for name in ("", "_own", "_wide")}
    if table is None:
        return {**errors, "table_log_error": float("nan")}
    means = calibrated_means(finite(table))
    paper = PAPER_THRESHOLDS.set_index("snr_db")
    rows = [snr for snr in paper.index if snr in means.index]
    grid_m2 = grid_area_m2(table)
    if not rows or math.isnan(grid_m2):
        return {**errors, "table_log_error": float("nan")}
    p = {method: means["top_percent"][method].loc[rows] for method in (MVLA, BP)}
    support = means["min_support_deg"][MVLA].loc[rows]
    ratios = {}
    for name, factor in (("_own", 1.0), ("_wide", grid_m2 / WIDE_M2)):
        ratios[name] = np.concatenate(
            [
                factor * p[MVLA] / paper.loc[rows, "mvla_top_percent"],
                support / paper.loc[rows, "mvla_min_support_deg"],
                factor * p[BP] / paper.loc[rows, "bp_top_percent"],
            ]
        )
    with np.errstate(divide="ignore"):
        logs = {name: np.minimum(np.abs(np.log(value)) / math.log(_TABLE_RATIO), 1) for name, value in ratios.items()}
    nearer = min(logs, key=lambda name: float(logs[name].mean()))
    errors |= {f"table_error{name}": float(np.abs(value - 1).mean()) for name, value in ratios.items()}
    found = {"table_log_error": float(logs[nearer].mean()), **errors, "table_error": errors[f"table_error{nearer}"]}
    for snr in rows:
        found[f"mvla_area_{snr:g}db"] = float(p[MVLA][snr]) * grid_m2 / 100
        found[f"mvla_support_{snr:g}db"] = float(support[snr])
        found[f"bp_area_{snr:g}db"] = float(p[BP][snr]) * grid_m2 / 100
    return found
