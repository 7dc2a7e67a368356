"""Reader of frequency responses in CSV: a column a view, or a row a value.

A column a view: one column is ``frequency_hz`` (or ``_khz``, ``_mhz``, ``_ghz``), each other one is named by the angle
of its view in degrees (``30``, ``30 deg``, ``angle_30``) or by its number (``view_3``). Its cells are complex numbers
(``0.1+0.2j``, ``0.1-0.2i``), or there are two columns a view, ``30_re`` and ``30_im`` or ``30_db`` and ``30_phase``
(degrees).

A row a value: the columns ``frequency_hz``, ``real`` and ``imag`` or ``magnitude_db`` and ``phase_deg``, ``view`` (from
0) or ``angle_deg``, and what a table of components may say of its views.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.readers.array_values import check_axis
from mvla_sim.channel.readers.component_tables import PER_VIEW, columns_of_views, only_one, points_of_views
from mvla_sim.channel.readers.frequency_columns import FREQUENCIES, has_frequencies, is_table
from mvla_sim.channel.readers.rounded_axis import unrounded_axis
from mvla_sim.channel.readers.source import Foreign, GivenRadio, Reader, note
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.files import existing_file
from mvla_sim.memory import check_memory
from mvla_sim.scene.columns import PLACE, RECEIVER, read_columns
from mvla_sim.spreadsheet import Cells, column_name, decimal_mark, decimal_numbers, read_cells

__all__ = ["ResponseReader", "read_response_table"]

_WHAT: Final = "frequency response file"
_PAIRS: Final = (("real", "imag"), ("magnitude_db", "phase_deg"))
_LONG: Final = ("view", *PER_VIEW, *_PAIRS[0], *_PAIRS[1])
_PARTS: Final = {"": "", "re": "real", "real": "real", "im": "imag", "imag": "imag", "db": "db", "phase": "phase"}
_PART: Final = "re|real|im|imag|db|phase"
_VIEW: Final = re.compile(
    rf"(?:({_PART})_)?(?:s\d\d_)?(?:(view|angle|azimuth|az)_?)?([+-]?\d{{1,9}}(?:[.,]\d{{1,12}})?)"
    rf"_?(?:deg|°)?(?:_({_PART})(?:_deg)?)?"
)
_ORDER: Final = ("real", "imag", "db", "phase")
_UNEVENNESS: Final = 0.01
_MEMORY_A_BYTE: Final = 40


class ResponseReader(Reader):
    """A CSV file of frequency responses."""

    name: ClassVar = "responses"
    block: ClassVar = "responses"
    takes: ClassVar = "a .csv file of frequency responses"

    @classmethod
    def recognises(cls, source: Path) -> bool:
        """Whether it is a .csv, .tsv or .txt file with a column of frequency."""
        return is_table(source) and has_frequencies(source)

    def read(self, source: Path, radio: GivenRadio) -> Foreign:
        """Read the table."""
        del radio
        return read_response_table(source)


class _Label(NamedTuple):
    """What a column's name says: which view, by angle or number, and which part of a complex number."""

    angle: bool
    said: bool  # and not a number alone
    value: float
    part: str


def read_response_table(file: str | os.PathLike[str]) -> Foreign:
    """Read a CSV file of frequency responses.

    Separators, decimal commas, comments and encodings are those of :mod:`~mvla_sim.spreadsheet`.

    Returns
    -------
    Foreign
        ``response`` ``[n_view, n_frequency]``, ``start_hz``, ``step_hz``, and the views' angles or positions where the
        file says them; views in the order of columns, of numbers, or of rising angle.

    Raises
    ------
    DataError
        One line with file, line and column: cells that are no number, views of different frequencies, uneven steps.
    """
    path = existing_file(file, _WHAT)
    try:
        check_memory(path.stat().st_size * _MEMORY_A_BYTE, f"{path}: its numbers", "split the file")
    except ConfigError as error:
        raise DataError(str(error)) from error
    cells = read_cells(path, lambda names: sum(2 * (n in FREQUENCIES) for n in names) + sum(n in _LONG for n in names))
    names = [column_name(name) for name in cells.header]
    if any(first in names for first, _ in _PAIRS):
        return _long(path)
    return _wide(path, cells, names)


def _long(path: Path) -> Foreign:
    table = read_columns(path, _WHAT, (), (*FREQUENCIES, *_LONG))
    if "view" not in table.numbers and "angle_deg" not in table.numbers:
        raise DataError(f"{path}: line {table.header_line}: missing column 'view'; or give angle_deg")
    unit = only_one(path, table, tuple(FREQUENCIES))
    first, second = _PAIRS[_PAIRS[1][0] == only_one(path, table, tuple(pair[0] for pair in _PAIRS))]
    if second not in table.numbers:
        raise DataError(f"{path}: line {table.header_line}: missing column '{second}'; {first} needs it")
    by = "view" if "view" in table.numbers else "angle_deg"
    known, view, row_size = np.unique(table.numbers[by], return_inverse=True, return_counts=True)
    if by == "view" and (gap := np.flatnonzero(known != np.arange(known.size))).size:
        raise DataError(
            f"{path}: column view: {known[gap[0]]:g} where {gap[0]} is next; views are numbered from 0, none left out"
        )
    if (row_size != row_size[0]).any():
        odd = int((row_size != row_size[0]).argmax())
        raise DataError(f"{path}: {by} {known[odd]:g} has {row_size[odd]} frequencies, {known[0]:g} has {row_size[0]}")
    frequency = table.numbers[unit] * FREQUENCIES[unit]
    order = np.lexsort((frequency, view))
    axes = frequency[order].reshape(known.size, -1)
    differs = (axes != axes[0]).any(axis=1)
    if differs.any():
        raise DataError(f"{path}: {by} {known[differs.argmax()]:g} has other frequencies than {known[0]:g}")
    fixed = columns_of_views(path, table, view.astype(np.int64), row_size.astype(np.int64))
    parts = [table.numbers[name][order].reshape(known.size, -1) for name in (first, second)]
    places = points_of_views(fixed, PLACE, np.zeros(known.size))
    receivers = None if places is None else points_of_views(fixed, RECEIVER, places[:, 2])
    response = _joined(*parts, decibel=first == "magnitude_db")
    data = _on_axis(path, axes[0], response)
    return Foreign(FrequencyResponse, data, known.size, fixed.get("angle_deg"), places, receivers)


def _wide(path: Path, cells: Cells, names: Sequence[str]) -> Foreign:
    place = f"{path}: line {cells.header_line}"
    frequencies = [i for i, name in enumerate(names) if name in FREQUENCIES]
    if len(frequencies) != 1:
        raise DataError(f"{place}: has {len(frequencies)} of {', '.join(list(FREQUENCIES)[:4])}; give exactly one")
    if not cells.rows:
        raise DataError(f"{path}: has a header and no frequency responses")
    at = frequencies[0]
    labels = {i: _label(name, f"{place}: column '{cells.header[i][:60]}'") for i, name in enumerate(names) if i != at}
    views = _views(labels, place)
    columns = [(name, [row[i] for row in cells.rows]) for i, name in enumerate(names)]
    mark, _ = decimal_mark(columns, cells.lines, path)
    [frequency], _ = decimal_numbers([columns[at]], cells.lines, path)
    rows = []
    for parts in views.values():
        if "" in parts:
            rows.append(_complex(*columns[parts[""]], cells.lines, path, mark))
            continue
        pair = sorted(parts, key=_ORDER.index)
        numbers = [decimal_numbers([columns[parts[part]]], cells.lines, path)[0][0] for part in pair]
        rows.append(_joined(numbers[0], numbers[1], decibel=pair[0] == "db"))
    angles = np.array(list(views)) if labels[next(iter(labels))].angle else None
    if angles is not None and not any(label.said for label in labels.values()):
        note(f"{path}: names of columns are read as angles: {angles[0]:g}° to {angles[-1]:g}°")
    order = np.argsort(frequency, kind="stable")
    data = _on_axis(path, frequency[order] * FREQUENCIES[names[at]], np.stack(rows)[:, order])
    return Foreign(FrequencyResponse, data, len(rows), angles)


def _views(labels: Mapping[int, _Label], place: str) -> dict[float, dict[str, int]]:
    """Columns of the parts of each view, by its angle or number."""
    views: dict[float, dict[str, int]] = {}
    for i, label in labels.items():
        if label.part in views.setdefault(label.value, {}):
            raise DataError(f"{place}: two columns for {label.value:g}")
        views[label.value][label.part] = i
    if not views:
        raise DataError(f"{place}: has no column of a view beside that of frequency")
    if len({label.angle for label in labels.values()}) > 1:
        raise DataError(f"{place}: some columns are named by angles and others by numbers of views")
    if not labels[next(iter(labels))].angle and list(views) != list(range(len(views))):
        raise DataError(f"{place}: views are numbered from 0, in order and none left out")
    for value, parts in views.items():
        if set(parts) not in ({""}, {"real", "imag"}, {"db", "phase"}):
            has = " and ".join(part or "a column without a part" for part in parts)
            raise DataError(f"{place}: {value:g} has {has}; needs re and im, or db and phase, or one column")
    return views


def _label(name: str, place: str) -> _Label:
    found = _VIEW.fullmatch(name)
    if found is None or (found[1] and found[4]):
        raise DataError(f"{place} is none of a view; allowed: an angle (30, 30_re, 30_im, angle_30) or view_3")
    said = found[2] is not None or "°" in name or "deg" in name.replace("phase_deg", "")
    value = float(found[3].replace(",", "."))
    return _Label(angle=found[2] != "view", said=said, value=value, part=_PARTS[found[1] or found[4] or ""])


def _complex(name: str, texts: Sequence[str], lines: Sequence[int], path: Path, mark: str) -> NDArray[np.complex128]:
    values = np.empty(len(texts), np.complex128)
    for row, (text, line) in enumerate(zip(texts, lines, strict=True)):
        plain = text.replace(" ", "").replace(mark, ".").strip("()").lower().replace("i", "j")
        try:
            values[row] = complex(plain)
        except ValueError:
            plain = "_"
        if "_" in plain or not np.isfinite(values[row]):
            raise DataError(f"{path}: line {line}, column {name}: '{text.strip()[:40]}' is not a finite complex number")
    if not any("i" in text or "j" in text.lower() for text in texts):
        raise DataError(
            f"{path}: column {name} is real; a frequency response is complex: 0.1+0.2j, or two columns, {name}_re and "
            f"{name}_im"
        )
    return values


def _joined(first: NDArray[np.float64], second: NDArray[np.float64], *, decibel: bool) -> NDArray[np.complex128]:
    with np.errstate(all="ignore"):  # what is not finite is refused by the channel
        values = 10 ** (first / 20) * np.exp(1j * np.deg2rad(second)) if decibel else first + 1j * second
    return np.asarray(values, np.complex128)


def _on_axis(path: Path, frequency_hz: NDArray[np.float64], response: NDArray[np.complex128]) -> dict[str, Any]:
    """Data of the channel; frequencies rise."""
    if not np.isfinite(response).all():
        raise DataError(f"{path}: a response is too large for a number")
    axis = unrounded_axis(frequency_hz, _UNEVENNESS)
    if axis is None:
        check_axis(frequency_hz, f"{path}: frequency", _UNEVENNESS)
        axis = float(frequency_hz[0]), float((frequency_hz[-1] - frequency_hz[0]) / (len(frequency_hz) - 1))
    if axis[0] < 0:
        raise DataError(f"{path}: starts at {axis[0]:.12g} Hz; allowed: 0 or more")
    return {"response": response, "start_hz": axis[0], "step_hz": axis[1]}
