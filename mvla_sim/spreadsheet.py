"""Tables of text under a header, as spreadsheets and programs write them.

Values are separated by commas, semicolons, tabs, bars or blanks; a first line ``sep=;`` may say so. Numbers have a
decimal point or, all of them, a decimal comma. Comment lines begin with ``#``, ``%`` or ``!``, and the last of them may
be the header; lines before the header that hold none of its names are no data. Encodings are those of
:func:`~mvla_sim.text_files.read_text`.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.text_files import lines_of, read_text

__all__ = ["Cells", "column_name", "decimal_mark", "decimal_numbers", "header_names", "read_cells"]

_SEPARATORS: Final = (",", ";", "\t", "|", " ")
_COMMENT: Final = ("#", "%", "!")
_PREAMBLE: Final = 100
"""Lines among which the header is looked for."""
_HEAD_BYTES: Final = 1 << 16
_LEAST_KNOWN: Final = 2
"""Names that a line must share with the header sought; one may be a word of a sentence."""
_SAID: Final = re.compile(r'"?sep=(.)"?[,;\t]*', re.IGNORECASE)
_MINUS: Final = str.maketrans("−", "-")  # as word processors write it


class Cells(NamedTuple):
    """The text of a table: names of its columns as they stand, rows of as many cells, and the line of each row."""

    header: list[str]
    header_line: int
    rows: list[list[str]]
    lines: list[int]


def column_name(text: str) -> str:
    """Name of a column in lower case, with one underscore for each of its blanks and brackets: ``delay_ns``.

    >>> column_name(" Delay [ns]")
    'delay_ns'
    """
    return re.sub(r"[\s_()\[\]{}/:]+", "_", text).strip("_").lower()


def read_cells(
    file: Path,
    known: Callable[[Sequence[str]], int],
    check_header: Callable[[Sequence[str], int], None] = lambda _names, _line: None,
) -> Cells:
    """Read a table.

    Parameters
    ----------
    file
        The file.
    known
        How many of some columns' names the header sought may have; names are those of :func:`column_name`. The line and
        the separator are chosen by it.
    check_header
        Given the header's cells and its line before the rows are read, so that it can refuse them.

    Raises
    ------
    DataError
        No text, a row of another length than the header, or quotes that are not closed.
    """
    text = read_text(file)
    if "\0" in text:
        raise DataError(f"{file}: is not a CSV text file: it holds zero bytes")
    stream = io.StringIO(text, newline="")
    first = list(itertools.islice(stream, _PREAMBLE))
    try:
        at, separator, header = _find_header(first, known)
        width = max((place + 1 for place, name in enumerate(header) if name), default=0)
        header = [name.strip() for name in header[:width]]
        check_header(header, at)
        rows, lines = [], []
        body = _without_comments(itertools.chain(first[at:], stream), separator)
        reader = csv.reader(body, delimiter=separator, skipinitialspace=True, strict=True)
        for row in reader:
            while row and len(row) > width and not row[-1].strip():
                row.pop()
            if not any(map(str.strip, row)):
                continue  # a blank line, or one of separators alone
            if len(row) != width:
                told = ", decimal commas included" * (separator == "," and len(row) > width)
                raise DataError(
                    f"{file}: line {at + reader.line_num}: has {len(row)} values{told}; the header has {width} columns"
                )
            rows.append(row)
            lines.append(at + reader.line_num)
    except csv.Error as error:
        raise DataError(f"{file}: is not a CSV text file: {error}") from error
    return Cells(header, at, rows, lines)


def header_names(file: Path, known: Callable[[Sequence[str]], int]) -> list[str]:
    """Names of the columns of a table, as those of :func:`column_name`; of a file that is no text, none."""
    try:
        first = lines_of(read_text(file, _HEAD_BYTES))[:_PREAMBLE]
        return [column_name(cell) for cell in _find_header(first, known)[2]]
    except (DataError, OSError, csv.Error):
        return []


def _find_header(first: Sequence[str], known: Callable[[Sequence[str]], int]) -> tuple[int, str, list[str]]:
    """Number of the header's line, from 1, its separator, and its cells; the first line with any where none fits."""
    separators: Sequence[str] = _SEPARATORS
    plain = commented = None
    for number, line in enumerate(first, 1):
        bare = line.strip(" \r\n")
        said = _SAID.fullmatch(bare) if number == 1 else None
        if said is not None:
            separators = said[1]
            continue
        if not bare.strip():
            continue
        comment = bare.startswith(_COMMENT)
        found = max(
            (_split(bare.lstrip("".join(_COMMENT) + " ") if comment else bare, one) for one in separators),
            key=lambda cut: known([column_name(cell) for cell in cut[1]]),
        )
        fits = known([column_name(cell) for cell in found[1]]) >= _LEAST_KNOWN
        if comment:
            commented = (number, *found) if fits else commented
        elif fits:
            return (number, *found)
        elif commented is not None:
            break
        else:
            plain = plain or (number, *found)
    return commented or plain or (len(first), ",", [])


def _split(line: str, separator: str) -> tuple[str, list[str]]:
    return separator, next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])


def _without_comments(lines: Iterable[str], separator: str) -> Iterator[str]:
    """Lines, of which comments are blank, so that they still count."""
    for line in lines:
        if line.lstrip().startswith(_COMMENT):
            yield "\n"
        else:
            yield line.lstrip(" ") if separator == " " else line


def decimal_numbers(
    columns: Sequence[tuple[str, Sequence[str]]], lines: Sequence[int], file: str | os.PathLike[str]
) -> tuple[list[NDArray[np.float64]], str | None]:
    """Turn columns of text, each with its name, into finite numbers ``[n_row]``; the decimal mark is that of them all.

    Returns
    -------
    numbers, doubt
        ``doubt`` is that of :func:`decimal_mark`.

    Raises
    ------
    DataError
        A cell that is no finite number, or commas beside points; with line and column.
    """
    mark, doubt = decimal_mark(columns, lines, file)
    return [_numbers(cells, lines, f"{file}", name, mark) for name, cells in columns], doubt


def decimal_mark(
    columns: Sequence[tuple[str, Sequence[str]]], lines: Sequence[int], file: str | os.PathLike[str]
) -> tuple[str, str | None]:
    """Decimal mark of columns of numbers, and a comma that might set thousands apart where no other shows what it is.

    Raises
    ------
    DataError
        Commas and points.
    """
    marked = [cell for _, cells in columns for cell in cells if "," in cell]
    if not marked:
        return ".", None
    if any("." in cell for _, cells in columns for cell in cells):
        name, cell, line = next(
            (n, c, i) for n, cells in columns for c, i in zip(cells, lines, strict=True) if "," in c
        )
        raise DataError(
            f"{file}: line {line}, column {name}: '{cell.strip()}' is not a number: it has a comma, others a point; "
            "use one decimal mark, none for thousands"
        )
    thousands = all(re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", cell.strip()) for cell in marked)
    return ",", marked[0].strip() if thousands else None


def _numbers(cells: Sequence[str], lines: Sequence[int], file: str, name: str, mark: str) -> NDArray[np.float64]:
    values = np.empty(len(cells))
    for row, (cell, line) in enumerate(zip(cells, lines, strict=True)):
        try:
            values[row] = float(cell.translate(_MINUS).replace(mark, "."))
        except ValueError:
            raise DataError(f"{file}: line {line}, column {name}: '{cell.strip()}' is not a number") from None
        if not math.isfinite(values[row]) or "_" in cell:
            what = "a number" if "_" in cell else "a finite number"
            raise DataError(f"{file}: line {line}, column {name}: '{cell.strip()}' is not {what}")
    return values
