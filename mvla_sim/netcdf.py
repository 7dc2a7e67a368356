"""Reading and writing the program's NetCDF-4 files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import h5py
import xarray as xr

from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output, existing_file

__all__ = ["open_netcdf", "schema_of", "table_of", "write_netcdf"]

_UNREADABLE = (OSError, ValueError, KeyError, RuntimeError, AttributeError, TypeError)
_HEAP = b"GCOL\x01\0\0\0"
_PACKED = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}


def write_netcdf(dataset: xr.Dataset, path: str | os.PathLike[str], packed: Iterable[str]) -> None:
    """Write a dataset under a temporary name and rename it; the ``packed`` variables are compressed and checksummed.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    encoding = {name: _PACKED for name in packed if dataset[name].size}
    content = dataset.to_netcdf(engine="h5netcdf", encoding=encoding)  # in memory: HDF5 crashes where a disk is full
    with atomic_output(path) as temporary:
        temporary.write_bytes(content)


def open_netcdf(
    path: str | os.PathLike[str], schema: str, version: int, variables: Iterable[str], earlier: Iterable[int] = ()
) -> xr.Dataset:
    """Load a NetCDF-4 file of this program into memory; check its schema and that it holds ``variables``.

    Files of the ``earlier`` schema versions are read as well.

    Raises
    ------
    DataError
        Missing, empty, truncated, corrupted, not NetCDF-4, of another schema or schema version, or incomplete.
    """
    file = existing_file(path, "NetCDF file")
    found = schema_of(file)
    if found != schema:
        raise DataError(f"{file}: schema is {found!r}, not {schema!r}")
    try:
        with xr.open_dataset(file, engine="h5netcdf", decode_cf=False) as handle:
            dataset = handle.load()
    except _UNREADABLE as error:
        raise _unreadable(file) from error
    if str(dataset.attrs.get("schema_version")) not in map(str, (version, *earlier)):
        raise DataError(
            f"{file}: {schema} version {dataset.attrs.get('schema_version')}; this program reads version {version}"
        )
    for name in variables:
        if name not in dataset:
            raise DataError(f"{file}: variable '{name}' is missing from this {schema} file")
    return dataset


def schema_of(file: os.PathLike[str]) -> str | None:
    """Name of the schema that a NetCDF-4 file declares, None where it declares none.

    Raises
    ------
    DataError
        The file is not NetCDF-4.
    """
    _check_heaps(file)
    try:
        with h5py.File(file) as handle:  # before h5netcdf, which prints a traceback where root attributes are damaged
            schema = dict(handle.attrs).get("schema")
    except _UNREADABLE as error:
        raise _unreadable(file) from error
    return None if schema is None else str(schema)


def _check_heaps(file: os.PathLike[str]) -> None:
    """Refuse a global heap in which HDF5 would never reach the end.

    Texts of attributes lie in heaps that carry no checksum. An object of index 0 is free space of its own size; where
    damage makes that 0, the library walks on the spot for ever (HDF5 file format specification, III.E).
    """
    content = Path(file).read_bytes()
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
