"""Averages of result tables that claims rest on; each says what it lacks instead of averaging what is left."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

__all__ = [
    "BP", "DENSE_DEG", "MVLA", "SPARSE_DEG", "CannotTellError", "calibrated_means", "dense_and_sparse", "finite",
    "grid_area_m2", "left_out", "mean_advantage", "mean_by_target", "mean_cd", "need",
    "rank_correlation", "spread_over_snr",
]  # fmt: skip

MVLA, BP = "mvla-gr", "bp"
SPARSE_DEG: Final = 10.0
DENSE_DEG: Final = 2.0
"""The densest sampling is at most this far apart, or nothing is known about dense views."""
LEAST_RANKED: Final = 3
"""Values of which a rank correlation says anything."""


class CannotTellError(Exception):
    """The table does not hold what the claim is about."""


def finite(table: pd.DataFrame) -> pd.DataFrame:
    """Cases with a finite CD."""
    return table[np.isfinite(table["cd_db"].astype(float))]


def left_out(frames: Sequence[pd.DataFrame]) -> str:
    """How many cases have no finite CD, and why: missing, failed, an empty reconstruction, identical sets."""
    reasons: dict[str, int] = {}
    for frame in frames:
        gone = ~np.isfinite(frame["cd_db"].to_numpy(float))
        if not gone.any():
            continue
        lost = frame.loc[gone, [c for c in ("status", "cd_db") if c in frame]]
        identical = np.where(lost["cd_db"].astype(float) == -np.inf, "identical sets", "empty")
        status = lost["status"].astype(str) if "status" in lost else pd.Series("done", lost.index)
        for name, count in pd.Series(np.where(status != "done", status, identical)).value_counts().items():
            reasons[str(name)] = reasons.get(str(name), 0) + int(count)
    if not reasons:
        return ""
    counts = ", ".join(f"{count} {name}" for name, count in sorted(reasons.items()))
    return f"{sum(reasons.values())} of {sum(map(len, frames))} cases without a finite CD were left out ({counts})"


def mean_cd(table: pd.DataFrame) -> pd.DataFrame:
    """Mean CD of each condition ``(snr_db, interval_deg)``, a column a method."""
    table = table[table["method"].isin((MVLA, BP))]
    every = table.groupby(["snr_db", "interval_deg"]).size()
    means = finite(table).groupby(["snr_db", "interval_deg", "method"])["cd_db"].mean().unstack("method")
    means = pd.DataFrame(means.reindex(index=every.index, columns=[MVLA, BP]))
    if lacking := [(place, m) for m in (MVLA, BP) for place in means.index[means[m].isna()]]:
        (snr, interval), method = lacking[0]
        others = f" and in {len(lacking) - 1} more" if len(lacking) > 1 else ""
        raise CannotTellError(f"no finite CD of {method} at {snr:g} dB and {interval:g}°{others}")
    if len(means) < np.prod([means.index.get_level_values(level).nunique() for level in (0, 1)]):
        raise CannotTellError("needs every interval at every SNR")
    return means


def mean_by_target(table: pd.DataFrame, targets: Sequence[str]) -> pd.Series[float]:
    """J(κ, η), the mean CD over the targets (``eq:param_selection_obj``), dB(m²), by ``(kappa, eta)``.

    A cell that lacks a target is no average of all, and left out.
    """
    by_target = finite(table).groupby(["kappa", "eta", "scene"])["cd_db"].mean().unstack("scene")
    need(", ".join(targets), set(targets) <= set(by_target.columns))
    average: pd.Series[float] = by_target[list(targets)].dropna().mean(axis=1)
    return average


def mean_advantage(table: pd.DataFrame) -> float:
    """BP's mean CD minus MVLA-GR's over all conditions, dB; NaN where a condition lacks one of them."""
    try:
        means = mean_cd(table)
    except CannotTellError:
        return float("nan")
    return float((means[BP] - means[MVLA]).mean())


def need(what: str, *conditions: bool) -> None:
    """Raise :class:`CannotTellError` unless every condition is met."""
    if not all(conditions):
        raise CannotTellError(f"needs {what}")


def spread_over_snr(table: pd.DataFrame) -> pd.DataFrame:
    """Largest minus smallest mean CD over the SNRs, by interval, a column a method."""
    means = mean_cd(table)
    need("two SNRs", means.index.get_level_values("snr_db").nunique() > 1)
    return means.groupby("interval_deg").agg(np.ptp)


def dense_and_sparse(values: pd.Series[float]) -> tuple[float, float]:
    """Value at the densest interval, and the mean of those from 10° on."""
    values = values.sort_index()
    sparse = values[values.index >= SPARSE_DEG]
    need(f"an interval of at most {DENSE_DEG:g}° and one of at least {SPARSE_DEG:g}°",
          values.index[0] <= DENSE_DEG, len(sparse) > 0)  # fmt: skip
    return float(values.iloc[0]), float(sparse.mean())


def calibrated_means(table: pd.DataFrame) -> pd.DataFrame:
    """Means of thresholds and area per SNR and method: over offsets and seeds first, then over intervals."""
    names = ["top_percent", "min_support_deg", "area_m2"]
    within = table.groupby(["snr_db", "method", "interval_deg"])[names].mean()
    return pd.DataFrame(within.groupby(["snr_db", "method"]).mean().unstack("method"))


def grid_area_m2(table: pd.DataFrame) -> float:
    """Area of the grid that a table's images are on, m², from BP's retained areas and their p; NaN without any."""
    bp = table[(table["method"] == BP) & (table["top_percent"] > 0)]
    return float((100 * bp["area_m2"] / bp["top_percent"]).median())


def rank_correlation(x: Any, y: Any) -> float:
    """Spearman's rank correlation; 0 where one side is constant."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    need(f"{LEAST_RANKED} values to rank", x.size >= LEAST_RANKED, bool(np.isfinite(y).all()))
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    return float(spearmanr(x, y).statistic)
