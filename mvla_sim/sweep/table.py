"""Tidy tables: one row a case, every setting and every metric a column."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from mvla_sim.errors import DataError
from mvla_sim.files import as_path, atomic_output, existing_file
from mvla_sim.sweep.case import MAP, Case, Once, Row, setting_columns

__all__ = [
    "AVERAGED", "FILE", "MAPS", "PARQUET", "RECORD", "averaged", "build_table", "load_maps", "load_table",
    "write_csv", "write_table",
]  # fmt: skip

FILE: Final = "table.csv"
PARQUET: Final = "table.parquet"
MAPS: Final = "maps.parquet"
"""Chamfer distances at every candidate pair of thresholds, by case; kept out of the table, for they are large."""
WHAT: Final = "table of an experiment; run the experiment first"
RECORD: Final = "experiment.json"
"""Settings and provenance, beside the table."""
TEXT: Final = ("key", "status", "error", "scene", "reason", "protocol")


def build_table(
    cases: Sequence[Case],
    rows: Mapping[str, Row],
    columns: Callable[[Case, Once], Mapping[str, Any]] = setting_columns,
    once: Once | None = None,
) -> pd.DataFrame:
    """Join a plan and what is stored of it, in the order of the plan.

    The first columns are ``case``, ``key``, ``status`` (done, failed or missing), ``error`` and ``seconds``; then the
    scene and the axes, every setting by its dotted key, and the metrics, NaN where a case is not done. ``columns``
    tells the settings of a case.
    """
    once = once or Once()
    records: list[dict[str, Any]] = []
    for case in cases:
        row = rows.get(case.key)
        head = {
            "case": case.number,
            "key": case.key,
            "status": row.status if row else "missing",
            "error": row.error if row else "",
            "seconds": row.seconds if row else float("nan"),
        }
        record = head | dict(columns(case, once)) | dict(row.metrics if row else {})
        records.append({name: float("nan") if value is None else value for name, value in record.items()})
    table = pd.DataFrame(records)
    metrics = list(dict.fromkeys(name for row in rows.values() for name in row.metrics if name in table.columns))
    table = table[[*(name for name in table.columns if name not in metrics), *metrics]]
    for name in set(TEXT) & set(table.columns):
        table[name] = table[name].fillna("")
    return table


def write_table(table: pd.DataFrame, folder: Path) -> list[Path]:
    """Write ``table.csv``, ``table.parquet`` and, where there are maps, ``maps.parquet``; return what was written.

    Raises OutputError: the folder cannot be written.
    """
    csv, parquet, maps = (folder / name for name in (FILE, PARQUET, MAPS))
    files = [csv, parquet]
    if MAP in table:
        with atomic_output(maps) as temporary:
            table[["key", MAP]].dropna().to_parquet(temporary, engine="pyarrow", index=False, compression="zstd")
        table = table.drop(columns=MAP)
        files.append(maps)
    else:
        maps.unlink(missing_ok=True)  # of cases that are no more
    write_csv(table, csv, digits=9)
    mixed = [name for name in table.columns if table[name].dropna().map(type).nunique() > 1]
    with atomic_output(parquet) as temporary:
        table.astype(dict.fromkeys(mixed, str)).to_parquet(temporary, engine="pyarrow", index=False)
    return files


def write_csv(table: pd.DataFrame, file: Path, digits: int = 6) -> None:
    """Write a table with numbers of so many digits. Raises OutputError."""
    with atomic_output(file) as temporary:
        table.to_csv(temporary, index=False, float_format=f"%.{digits}g")


def load_maps(folder: str | os.PathLike[str]) -> dict[str, str]:
    """Packed maps of thresholds by the keys of their cases, from an experiment's folder.

    Raises DataError: there are none, or the file cannot be read.
    """
    file = Path(folder) / MAPS
    if not file.exists():
        raise DataError(
            f"{file}: no such file; run that experiment again, with evaluation.threshold_map = true in its file"
        )
    try:
        table = pd.read_parquet(file, engine="pyarrow")
        return dict(zip(table["key"].astype(str), table[MAP].astype(str), strict=True))
    except (ValueError, OSError, KeyError) as error:  # pyarrow's own errors are these
        raise DataError(f"{file}: not a readable file of maps ({error})") from error


def load_table(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """Read the table of an experiment from its folder: ``table.csv`` or, where that is missing, ``table.parquet``.

    Raises DataError: there is none, or it is no table of a sweep.
    """
    csv, parquet = (as_path(folder) / name for name in (FILE, PARQUET))
    file = existing_file(parquet if parquet.exists() and not csv.exists() else csv, WHAT)
    try:
        if file == parquet:
            table = pd.read_parquet(file, engine="pyarrow")
        else:
            table = pd.read_csv(file, dtype=dict.fromkeys(TEXT, str), low_memory=False)
    except (ValueError, UnicodeDecodeError) as error:  # pandas' own errors are ValueErrors
        raise DataError(f"{file}: not a readable table ({error})") from error
    if not {"case", "key", "status"} <= set(table.columns):
        raise DataError(f"{file}: not a table of a sweep; it must have the columns case, key and status")
    for name in set(TEXT) & set(table.columns):
        table[name] = table[name].fillna("")
    return table


AVERAGED: Final = ("offset", "seed")
"""Axes that results are averaged over where they are shown."""


def averaged(table: pd.DataFrame, axes: Sequence[str]) -> pd.DataFrame:
    """Means of the numeric metrics over the finished cases that agree in ``axes``, in the order of the table.

    ``cases`` says how many there are; ``cd_db_min`` and ``cd_db_max`` are the ends of their spread. A CD that is not
    finite is left out of its mean.
    """
    done = table[table["status"] == "done"]
    if done.empty or "cd_db" not in done:
        return done
    metrics = [
        name for name in done.columns[done.columns.get_loc("views") :] if pd.api.types.is_numeric_dtype(done[name])
    ]
    finite = done.assign(cd_db=done["cd_db"].where(np.isfinite(done["cd_db"])))
    groups = finite.groupby(list(axes), sort=False, dropna=False)
    result = groups[metrics].mean()
    result.insert(0, "cases", groups.size())
    result["cd_db_min"], result["cd_db_max"] = groups["cd_db"].min(), groups["cd_db"].max()
    return result.reset_index()
