"""Reader of ready-made multipath components: a CSV file with a header and one component a row, in any order.

Separators, decimal commas, comments and encodings are those of :mod:`~mvla_sim.spreadsheet`.

==========================================  ========================================================================
column                                      what it holds
==========================================  ========================================================================
``view``                                    number of the view, from 0
one of ``delay_s``, ``delay_ns``            round-trip delay
or ``range_m``                              one-way range, c·τ/2
one of ``power``, ``power_db``              power, linear or in dB
``angle_deg``                               if known: angle of the view
``x_m``, ``y_m``, ``z_m``                   if known: position of the sensor, or of its transmitter; z may be left out
``rx_x_m``, ``rx_y_m``, ``rx_z_m``          if it is elsewhere: position of the receiver; z may be left out
==========================================  ========================================================================
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.components import Components
from mvla_sim.channel.readers.frequency_columns import has_frequencies, is_table
from mvla_sim.channel.readers.source import Foreign, GivenRadio, Reader
from mvla_sim.constants import delay_to_range
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.files import existing_file
from mvla_sim.memory import check_memory
from mvla_sim.scene.columns import PLACE, RECEIVER, Columns, ColumnTable, read_columns

__all__ = ["PER_VIEW", "ComponentReader", "columns_of_views", "only_one", "points_of_views", "read_components"]

LARGEST_VIEW: Final = 999_999
LONGEST_DELAY_S: Final = 1.0
LARGEST_COORDINATE_M: Final = 1e9
LARGEST_LEVEL_DB: Final = 300.0
"""Beyond these, levels either side of 0 dB, a file is damaged or in other units."""

_DISTANCES: Final[dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]]] = {
    "delay_s": delay_to_range,
    "delay_ns": lambda delay_ns: delay_to_range(delay_ns * 1e-9),
    "range_m": lambda range_m: range_m,
}
_POWERS: Final[dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]]] = {
    "power": lambda power: power,
    "power_db": lambda power_db: 10 ** (power_db / 10),
}
PER_VIEW: Final = ("angle_deg", *PLACE, *RECEIVER)
_MEMORY_A_BYTE: Final = 30  # of the text, whose words take some 50 bytes each while they are read


class ComponentReader(Reader):
    """A CSV file of ready-made components."""

    name: ClassVar = "components"
    block: ClassVar = "components"
    takes: ClassVar = "a .csv file of components"

    @classmethod
    def recognises(cls, source: Path) -> bool:
        """Whether it is a .csv, .tsv or .txt file, and none of frequency responses."""
        return is_table(source) and not has_frequencies(source)

    def read(self, source: Path, radio: GivenRadio) -> Foreign:
        """Read the table."""
        del radio
        return read_components(source)


def read_components(file: str | os.PathLike[str]) -> Foreign:
    """Read a CSV file of components.

    Parameters
    ----------
    file
        The file. What it says of a view (angle, positions) must be the same in all its rows. A view between 0 and the
        last that has no row is one without components, unless the file gives angles or positions: its own are then
        unknown.

    Returns
    -------
    Foreign
        Components view after view, within a view by rising range: ``range_m`` ``[n_component]`` metres, ``power``
        ``[n_component]`` linear in the file's unit, ``row_size`` ``[n_view]``, which may be 0. A z that is not given is
        0, or for receivers that of the transmitter.

    Raises
    ------
    DataError
        One line with file, line and column.
    """
    path = existing_file(file, "components file")
    try:
        check_memory(path.stat().st_size * _MEMORY_A_BYTE, f"{path}: its numbers", "split the file")
        table = read_columns(path, "components file", ("view",), (*_DISTANCES, *_POWERS, *PER_VIEW))
    except (ConfigError, DataError) as error:
        raise DataError(" ".join(str(error).splitlines())) from error
    except OSError as error:
        raise DataError(f"{path}: not readable ({error.strerror})") from error
    view = _views(path, table)
    distance = only_one(path, table, tuple(_DISTANCES))
    level = only_one(path, table, tuple(_POWERS))
    with np.errstate(all="ignore"):
        range_m, power = _DISTANCES[distance](table.numbers[distance]), _POWERS[level](table.numbers[level])
    farthest_m = delay_to_range(LONGEST_DELAY_S)
    _check(path, table, distance, (range_m >= 0) & (range_m <= farthest_m), f"0 to {farthest_m:.4g} m of range")
    most = 10 ** (LARGEST_LEVEL_DB / 10)
    usual = (power >= 1 / most) & (power <= most)
    _check(path, table, level, usual, f"above 0, {1 / most:g} to {most:g} or ±{LARGEST_LEVEL_DB:g} dB")
    row_size = np.bincount(view).astype(np.int64)
    fixed = columns_of_views(path, table, view, row_size)
    order = np.lexsort((range_m, view))
    positions_m = points_of_views(fixed, PLACE, np.zeros(row_size.size))
    receivers_m = None if positions_m is None else points_of_views(fixed, RECEIVER, positions_m[:, 2])
    data = {"range_m": range_m[order], "power": power[order], "row_size": row_size}
    return Foreign(Components, data, row_size.size, fixed.get("angle_deg"), positions_m, receivers_m)


def only_one(path: Path, table: ColumnTable, names: Sequence[str]) -> str:
    """Name of the one of these columns that the file has; raises DataError where it has none or several."""
    found = [name for name in names if name in table.numbers]
    if len(found) != 1:
        told = f"has {' and '.join(found) or 'none'} of {', '.join(names)}"
        raise DataError(f"{path}: line {table.header_line}: {told}; give exactly one")
    return found[0]


def _views(path: Path, table: ColumnTable) -> NDArray[np.int64]:
    """Views of the rows ``[n_row]``."""
    value = table.numbers["view"]
    whole = (value >= 0) & (value <= LARGEST_VIEW) & (value == np.floor(value))
    _check(path, table, "view", whole, f"a whole number from 0 to {LARGEST_VIEW}")
    return value.astype(np.int64)


def columns_of_views(path: Path, table: ColumnTable, view: NDArray[np.int64], row_size: NDArray[np.int64]) -> Columns:
    """What the file says of its views: columns ``[n_view]``, each the same in all rows of a view.

    ``view`` ``[n_row]`` are numbers from 0, ``row_size`` ``[n_view]`` how often each occurs.
    """
    header = f"{path}: line {table.header_line}"
    names = [name for name in PER_VIEW if name in table.numbers]
    for kind, partners in (("positions", PLACE), ("receivers", RECEIVER)):
        lacking = [name for name in partners[:2] if name not in names]
        if lacking and any(name in names for name in partners):
            raise DataError(f"{header}: missing column '{lacking[0]}'; {kind} need {partners[0]} and {partners[1]}")
    if RECEIVER[0] in names and PLACE[0] not in names:
        raise DataError(f"{header}: missing column '{PLACE[0]}'; receivers need the positions of transmitters")
    if names and not row_size.all():
        raise DataError(
            f"{path}: view {row_size.argmin()} of 0 to {row_size.size - 1} has no row, so its {names[0]} is unknown"
        )
    first = np.unique(view, return_index=True)[1]
    fixed = {}
    for name in names:
        fixed[name] = table.numbers[name][first]
        if name != "angle_deg":
            _check(
                path, table, name, np.abs(table.numbers[name]) <= LARGEST_COORDINATE_M, f"±{LARGEST_COORDINATE_M:g} m"
            )
        same = table.numbers[name] == fixed[name][view]
        if not same.all():
            row = int(same.argmin())
            raise DataError(
                f"{path}: line {table.lines[row]}, column {name}: {table.numbers[name][row]:.10g} differs from "
                f"{fixed[name][view[row]]:.10g} in an earlier row of view {view[row]}"
            )
    return fixed


def points_of_views(fixed: Columns, names: Sequence[str], height_m: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Points ``[n_view, 3]`` of three columns, the third of which may be missing; None where all are."""
    x, y, z = names
    return np.column_stack([fixed[x], fixed[y], fixed.get(z, height_m)]) if x in fixed else None


def _check(path: Path, table: ColumnTable, column: str, good: NDArray[np.bool_], allowed: str) -> None:
    if not good.all():
        row = int(good.argmin())
        raise DataError(
            f"{path}: line {table.lines[row]}, column {column}: {table.numbers[column][row]:.10g} must be {allowed}"
        )
