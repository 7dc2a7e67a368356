"""Which settings decide a figure: shares of its variance over the samples of a design, and when a claim holds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

__all__ = ["conditions", "effects"]

BINS: Final = 4
"""Quantiles that a setting of many values is divided into."""
MANY: Final = 6
"""Values above which a setting is divided."""
RESAMPLES: Final = 100
LEVEL: Final = 0.95


def effects(
    samples: pd.DataFrame, settings: Sequence[str], figures: Sequence[str], *, pairs: bool = True, seed: int = 0
) -> pd.DataFrame:
    """First-order and pair effects of settings on figures, as shares of the figures' variance.

    Parameters
    ----------
    samples
        One row a sample of a design, with a column a setting and a column a figure; rows that lack a figure are left
        out of its effects.
    settings
        Columns of the settings, drawn independently. One of more than six numbers is divided into its quartiles.
    figures
        Columns of the figures.
    pairs
        Also the share that two settings have together beyond their own.
    seed
        Of the bootstrap.

    Returns
    -------
    DataFrame
        ``figure``, ``setting``, ``partner`` (empty for a setting's own effect), ``share`` and the ends ``low`` and
        ``high`` of its 95 % interval (bootstrap over the samples); the largest share of each figure first.

    Notes
    -----
    The share of a setting is ω² = (SS_between − (k − 1)·MS_within)/(SS_total + MS_within) over its k values, an
    estimate of Var(E[y|x])/Var(y), the first-order Sobol' index, that is 0 on average where there is no effect (W. L.
    Hays, *Statistics*, 1963). That of a pair is the ω² of their combined values minus both own shares, at least 0.
    """
    codes = {name: _codes(samples[name]) for name in settings}
    random = np.random.default_rng(seed)
    rows: list[dict[str, Any]] = []
    for figure in figures:
        values = samples[figure].to_numpy(float)
        known = np.flatnonzero(np.isfinite(values))
        if known.size < 3 or np.ptp(values[known]) == 0:
            continue
        draws = [known, *(random.choice(known, known.size) for _ in range(RESAMPLES))]
        own = {name: np.array([_omega(values[draw], codes[name][draw]) for draw in draws]) for name in settings}
        shares = {(name, ""): share for name, share in own.items()}
        for one, two in itertools.combinations(settings, 2) if pairs else ():
            joint = codes[one] * (codes[two].max() + 1) + codes[two]
            both = np.array([_omega(values[draw], joint[draw]) for draw in draws])
            shares[one, two] = np.maximum(both - own[one] - own[two], 0)
        for (setting, partner), share in shares.items():
            low, high = np.quantile(share[1:], [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            rows.append(
                {
                    "figure": figure, "setting": setting, "partner": partner, "share": max(0.0, float(share[0])),
                    "low": max(0.0, float(low)), "high": max(0.0, float(high)),
                }
            )  # fmt: skip
    table = pd.DataFrame(rows, columns=["figure", "setting", "partner", "share", "low", "high"])
    order = {figure: place for place, figure in enumerate(figures)}
    return table.sort_values(
        ["figure", "share"], ascending=[True, False], key=lambda c: c.map(order) if c.name == "figure" else c,
        kind="stable", ignore_index=True,
    )  # fmt: skip


def conditions(samples: pd.DataFrame, settings: Sequence[str], holds: str, most: int = 3) -> list[tuple[str, float]]:
    """When a claim holds: the values of settings under which it does most often.

    Parameters
    ----------
    samples, settings
        As for :func:`effects`.
    holds
        Column that is 1 where the claim holds, 0 where it does not, NaN where that cannot be told.
    most
        How many settings are named, one after the other: each among the samples that meet those before it.

    Returns
    -------
    list of (text, share)
        First how often it holds at all, then with each value named; fewer where no setting adds to it, or where fewer
        than 20 samples would be left.
    """
    known = samples[np.isfinite(samples[holds].astype(float))]
    held = known[holds].astype(float)
    found = [("all readings", float(held.mean()))]
    chosen = pd.Series(True, known.index)
    free = list(settings)
    for _ in range(most):
        best: tuple[float, str, pd.Series[bool], str] | None = None
        for name in free:
            codes = _codes(known[name])
            for code in np.unique(codes):
                here = chosen & (codes == code)
                if here.sum() >= 20 and here.sum() < chosen.sum() and (best is None or held[here].mean() > best[0]):
                    best = (float(held[here].mean()), _label(known[name], codes == code), here, name)
        if best is None or best[0] <= found[-1][1]:
            break
        found.append((best[1], best[0]))
        chosen = best[2]
        free.remove(best[3])
    return found


def _codes(column: pd.Series[Any]) -> NDArray[np.intp]:
    """The values of a setting as numbers 0, 1, 2 …, quartiles where there are many."""
    if pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column) and column.nunique() > MANY:
        column = pd.qcut(column, BINS, labels=False, duplicates="drop")
    return np.asarray(pd.factorize(column.astype(str), sort=True)[0], np.intp)


def _label(column: pd.Series[Any], rows: NDArray[np.bool_]) -> str:
    """A setting with its value, or the ends of its quartile."""
    values = column[rows]
    if values.nunique(dropna=False) == 1:
        value = values.iloc[0]
        return f"{column.name} = {value:g}" if isinstance(value, float) else f"{column.name} = {value}"
    return f"{values.min():.3g} ≤ {column.name} ≤ {values.max():.3g}"


def _omega(values: NDArray[np.float64], codes: NDArray[np.intp]) -> float:
    """ω² of groups."""
    counts = np.bincount(codes)
    means = np.bincount(codes, values) / np.maximum(counts, 1)
    groups, size = np.count_nonzero(counts), values.size
    total = float(((values - values.mean()) ** 2).sum())
    between = float((counts * (means - values.mean()) ** 2)[counts > 0].sum())
    if size <= groups or total == 0:
        return 0.0
    within = (total - between) / (size - groups)
    return (between - (groups - 1) * within) / (total + within)
