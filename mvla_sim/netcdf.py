"""Reading and writing the program's NetCDF-4 files, and declaring what is in them."""

from __future__ import annotations

import json
import mmap
import operator
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output, existing_file

__all__ = [
    "PACKED", "Variable", "check_heaps", "check_schema", "read_netcdf", "schema_of", "table_of",
    "write_netcdf",
]  # fmt: skip

PACKED: Final = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}
"""How large variables are stored: compressed, and with a checksum."""

_UNREADABLE = (OSError, ValueError, KeyError, RuntimeError, AttributeError, TypeError)
_HEAP = b"GCOL\x01\0\0\0"
_LENGTHS = {"xyz": 3, "xy": 2}  # of dimensions that are the same in every file


@dataclass(frozen=True)
class Variable:
    """Declaration of a variable of our files: how it is stored, what it means, and which field of an object it holds.

    Attributes
    ----------
    name
        In the file.
    field
        Field of the object, or of a field of it: "views.positions_m"; of a complex one, ``part`` says which part.
    dims
        Dimensions; ``path``, ``component`` and the like are those of ragged arrays.
    dtype
        Of NumPy, as "f8".
    long_name, units
        CF's attributes; empty: none.
    part
        "real" or "imag" of a complex field, which NetCDF has no type for.
    flags
        Meaning of each bit of a value.
    sample_dimension
        Of the lengths of rows: the dimension whose elements they count.
    optional
        Whether the field may be None, and the variable missing.
    """

    name: str
    field: str
    dims: tuple[str, ...]
    dtype: str
    long_name: str = ""
    units: str = ""
    part: Literal["", "real", "imag"] = ""
    flags: Mapping[str, int] | None = None
    sample_dimension: str = ""
    optional: bool = False

    @property
    def packed(self) -> bool:
        """Whether it is stored compressed and with a checksum: all that grows with the data."""
        return bool(self.dims) and self.dims[0] not in _LENGTHS

    @property
    def attributes(self) -> dict[str, Any]:
        """Its attributes in the file."""
        texts = {"long_name": self.long_name, "units": self.units, "sample_dimension": self.sample_dimension}
        found: dict[str, Any] = {name: text for name, text in texts.items() if text}
        if self.flags is not None:
            found["flag_masks"] = np.array(list(self.flags.values()), np.uint8)
            found["flag_meanings"] = " ".join(self.flags)
        return found

    def of(self, owner: Any) -> NDArray[Any] | None:
        """Values that an object has for it, None where it has none."""
        values = operator.attrgetter(self.field)(owner)
        return None if values is None else np.asarray(getattr(values, self.part) if self.part else values, self.dtype)

    def entry(self, values: Any) -> tuple[Any, ...]:
        """The variable as :class:`xarray.Dataset` takes it."""
        return self.dims, np.asarray(values, self.dtype), self.attributes

    def joined(self, parts: Iterable[NDArray[Any]]) -> NDArray[Any]:
        """Arrays of several objects one after another; of the right shape if there are none."""
        empty = np.zeros((0, *(_LENGTHS[dim] for dim in self.dims[1:])), self.dtype)
        return np.concatenate([empty, *parts]).astype(self.dtype, copy=False)

    def checked(self, values: Any) -> NDArray[Any]:
        """Values read from a file in the type that is declared.

        Raises
        ------
        ValueError, TypeError
            They are not numbers, or bits other than those that are declared.
        """
        array = np.asarray(values)
        if array.dtype.kind not in "iuf":
            raise ValueError(f"{self.name} holds {array.dtype}, must be numbers")
        if self.flags is not None and not np.isin(array, np.arange(sum(self.flags.values()) + 1)).all():
            raise ValueError(f"{self.name} holds values other than sums of {list(self.flags.values())}")
        return array.astype(self.dtype)


def write_netcdf(dataset: xr.Dataset, path: str | os.PathLike[str], packed: Iterable[str]) -> None:
    """Write a dataset under a temporary name and rename it; the ``packed`` variables are compressed and checksummed.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    encoding = {name: PACKED for name in packed if dataset[name].size}
    # In memory, as HDF5 crashes where a disk is full; a copy, as an error would keep a view of xarray's buffer.
    content = bytes(dataset.to_netcdf(engine="h5netcdf", encoding=encoding))
    with atomic_output(path) as temporary:
        temporary.write_bytes(content)


def read_netcdf(path: str | os.PathLike[str], what: str = "NetCDF file") -> xr.Dataset:
    """Load a NetCDF-4 file of any schema into memory; messages call it ``what``.

    Raises
    ------
    DataError
        Missing, empty, truncated, corrupted or not NetCDF-4.
    """
    file = existing_file(path, what)
    schema_of(file)  # before h5netcdf, which prints a traceback where root attributes are damaged
    try:
        with xr.open_dataset(file, engine="h5netcdf", decode_cf=False) as handle:
            return handle.load()
    except _UNREADABLE as error:
        raise _unreadable(file) from error


def check_schema(
    dataset: xr.Dataset, source: str | os.PathLike[str], schema: str, version: int, variables: Iterable[str]
) -> None:
    """Refuse a dataset of another schema or version, or without all ``variables``; ``source`` is for the message.

    Raises
    ------
    DataError
        One line that says what it is and must be.
    """
    place = os.fspath(source)
    found = dataset.attrs.get("schema")
    if found != schema:
        raise DataError(f"{place}: schema is {found!r}, not {schema!r}")
    if str(dataset.attrs.get("schema_version")) != str(version):
        raise DataError(
            f"{place}: {schema} version {dataset.attrs.get('schema_version')}; this program reads version {version}"
        )
    for name in variables:
        if name not in dataset:
            raise DataError(f"{place}: variable '{name}' is missing from this {schema} file")


def schema_of(file: os.PathLike[str]) -> str | None:
    """Name of the schema that a NetCDF-4 file declares, None where it declares none; its data are not read.

    Raises
    ------
    DataError
        The file is not NetCDF-4.
    """
    check_heaps(file)
    try:
        with h5py.File(file) as handle:
            schema = dict(handle.attrs).get("schema")
    except _UNREADABLE as error:
        raise _unreadable(file) from error
    return None if schema is None else str(schema)


def check_heaps(file: os.PathLike[str]) -> None:
    """Refuse a global heap in which HDF5 would never reach the end; the file is mapped, not read into memory.

    Texts of attributes lie in heaps that carry no checksum. An object of index 0 is free space of its own size; where
    damage makes that 0, the library walks on the spot for ever (HDF5 file format specification, III.E).

    Raises
    ------
    DataError
        There is such a heap.
    """
    with Path(file).open("rb") as handle, mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as content:
        place = content.find(_HEAP)
        while place >= 0:
            size = int.from_bytes(content[place + 8 : place + 16], "little")
            at, end = place + 16, min(place + size, len(content))
            while at + 16 <= end:
                index = int.from_bytes(content[at : at + 2], "little")
                length = int.from_bytes(content[at + 8 : at + 16], "little")
                step = (length if index == 0 else 16 + (length + 7) // 8 * 8) % 2**64
                if step == 0:
                    raise _unreadable(file)
                at += step
            place = content.find(_HEAP, place + 1)


def table_of(dataset: xr.Dataset, name: str) -> dict[str, Any]:
    """Read the JSON object in an attribute; raises ValueError where it is none."""
    table = json.loads(dataset.attrs.get(name, "{}"))
    if not isinstance(table, dict):
        raise ValueError(f"attribute {name} is no JSON object")  # noqa: TRY004 - a damaged file, not a wrong argument
    return table


def _unreadable(file: os.PathLike[str]) -> DataError:
    return DataError(f"{file}: not a readable NetCDF-4 file (truncated, corrupted or another format)")
