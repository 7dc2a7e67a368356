"""CSV files of positions, of poses and of angles: numbers under a header, every message with file, line and column."""

from __future__ import annotations

import difflib
import logging
import os
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.files import existing_file
from mvla_sim.spreadsheet import column_name, decimal_numbers, read_cells

__all__ = ["PLACE", "RECEIVER", "ColumnTable", "Columns", "read_columns"]

PLACE = ("x_m", "y_m", "z_m")
RECEIVER = ("rx_x_m", "rx_y_m", "rx_z_m")

Columns = dict[str, NDArray[np.float64]]

_MEANT: Final = frozenset((*PLACE, *RECEIVER, "heading_deg", "azimuth_deg", "elevation_deg", "angle_deg", "azimuth_db"))
"""Names of columns that change what a table says: one that is not for this kind of table is refused."""
_ALIKE: Final = 0.75


class ColumnTable(NamedTuple):
    """Columns of numbers and of text by name, ``[n_row]``, and the line of each row and of the header in the file."""

    numbers: Columns
    words: dict[str, list[str]]
    lines: list[int]
    header_line: int


def read_columns(
    name: str | os.PathLike[str],
    what: str,
    needed: Sequence[str],
    optional: Sequence[str] = (),
    texts: Sequence[str] = (),
) -> ColumnTable:
    """Read a CSV file with a header of known columns in any order, as :mod:`~mvla_sim.spreadsheet` says.

    Case, blanks and brackets in their names do not matter ("Delay (ns)"). Other columns are left out with a note,
    unless their name is much like a known one's, or lacks only its unit.

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

    Raises
    ------
    DataError
        One line with file, line and column.
    """
    file = existing_file(name, what)
    allowed = [*texts, *needed, *optional]
    left_out: list[str] = []

    def check(shown: Sequence[str], line: int) -> None:
        left_out.extend(_check_header(shown, allowed, [*texts, *needed], f"{file}: line {line}"))

    cells = read_cells(file, lambda names: len(set(names) & set(allowed)), check)
    header = [column_name(column) for column in cells.header]
    if not cells.rows:
        raise DataError(f"{file}: has a header and no {what.removesuffix(' file')}")
    if left_out:
        _note(f"{file}: columns that are not read: {', '.join(left_out)}")
    columns = {column: [row[place] for row in cells.rows] for place, column in enumerate(header) if column in allowed}
    words = {column: [cell.strip() for cell in columns.pop(column)] for column in texts}
    numbers, doubt = decimal_numbers(list(columns.items()), cells.lines, file)
    if doubt is not None:
        _note(f"{file}: '{doubt}' is read with a decimal comma, as {float(doubt.replace(',', '.')):g}")
    return ColumnTable(dict(zip(columns, numbers, strict=True)), words, cells.lines, cells.header_line)


def _note(text: str) -> None:
    logging.getLogger("mvla_sim").warning("mvla: note: %s", text)


def _check_header(shown: Sequence[str], allowed: Sequence[str], needed: Sequence[str], place: str) -> list[str]:
    """Refuse a header that lacks or repeats a column or may mean another; return what it has beyond the known."""
    header = [column_name(column) for column in shown]
    lacking = [column for column in needed if column not in header]
    absent = [column for column in allowed if column not in header]
    for text, column in zip(shown, header, strict=True):
        if column in allowed:
            if header.count(column) > 1:
                raise DataError(f"{place}: column '{column}' appears {header.count(column)} times")
        elif column and (
            lacking
            or column in _MEANT
            or any(other.rpartition("_")[0] == column for other in absent)
            or difflib.get_close_matches(column, absent, 1, _ALIKE)
        ):
            raise DataError(f"{place}: unknown column '{_short(text)}'; allowed: {', '.join(allowed)}")
    if lacking:
        raise DataError(f"{place}: missing column '{lacking[0]}'; the header needs {', '.join(needed)}")
    return [
        f"'{_short(text)}'" if column else f"number {nth}"
        for nth, (text, column) in enumerate(zip(shown, header, strict=True), 1)
        if column not in allowed
    ]


def _short(text: str) -> str:
    """A name for a message: one line, of bounded length."""
    return " ".join(text.split())[:60]
