"""CSV files of positions, of poses and of angles: numbers under a header, every message with file, line and column."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.files import existing_file

__all__ = ["PLACE", "RECEIVER", "Columns", "read_columns"]

PLACE = ("x_m", "y_m", "z_m")
RECEIVER = ("rx_x_m", "rx_y_m", "rx_z_m")

Columns = dict[str, NDArray[np.float64]]


def read_columns(
    name: str | os.PathLike[str],
    what: str,
    needed: Sequence[str],
    optional: Sequence[str] = (),
    texts: Sequence[str] = (),
) -> tuple[Columns, dict[str, list[str]]]:
    """Read a CSV file with a header of known columns in any order.

    Parameters
    ----------
    name
        The file.
    what
        What it should be, for messages ("positions file").
    needed, optional
        Columns of finite numbers that must, or may, be there.
    texts
        Columns of text that must be there.

    Returns
    -------
    numbers, words
        Each column by name, ``[n_row]``.

    Raises
    ------
    DataError
        One line with file, line and column.
    """
    file = existing_file(name, what)
    allowed = [*texts, *needed, *optional]
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            header = [column.strip() for column in next(reader, [])]
            _check_header(header, allowed, [*texts, *needed], f"{file}: line 1")
            for row in reader:
                if not row:
                    continue  # a blank line
                if len(row) != len(header):
                    raise DataError(
                        f"{file}: line {reader.line_num}: has {len(row)} values; the header has {len(header)} columns"
                    )
                rows.append(row)
                lines.append(reader.line_num)
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{file}: is not a CSV text file: {error}") from error
    if not rows:
        raise DataError(f"{file}: has a header and no {what.removesuffix(' file')}")
    numbers: Columns = {}
    words: dict[str, list[str]] = {}
    for place, column in enumerate(header):
        if column in texts:
            words[column] = [row[place].strip() for row in rows]
        else:
            numbers[column] = np.array(
                [_number(r[place], f"{file}: line {n}, column {column}") for r, n in zip(rows, lines, strict=True)]
            )
    return numbers, words


def _check_header(header: list[str], allowed: Sequence[str], needed: Sequence[str], place: str) -> None:
    for column in header:
        if column not in allowed:
            raise DataError(f"{place}: unknown column '{column}'; allowed: {', '.join(allowed)}")
        if header.count(column) > 1:
            raise DataError(f"{place}: column '{column}' appears {header.count(column)} times")
    for column in needed:
        if column not in header:
            raise DataError(f"{place}: missing column '{column}'; the header needs {', '.join(needed)}")


def _number(text: Any, place: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise DataError(f"{place}: '{text}' is not a number") from None
    if not math.isfinite(value):
        raise DataError(f"{place}: '{text}' is not a finite number")
    return value
