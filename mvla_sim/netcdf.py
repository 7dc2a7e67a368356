"""Reading and writing the program's NetCDF-4 files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from typing import Any

import h5py
import xarray as xr

from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output, existing_file

__all__ = ["open_netcdf", "schema_of", "table_of", "write_netcdf"]

_UNREADABLE = (OSError, ValueError, KeyError, RuntimeError, AttributeError, TypeError)
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


def open_netcdf(path: str | os.PathLike[str], schema: str, version: int, variables: Iterable[str]) -> xr.Dataset:
    """Load a NetCDF-4 file of this program into memory; check its schema and that it holds ``variables``.

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
    if str(dataset.attrs.get("schema_version")) != str(version):
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
    try:
        with h5py.File(file) as handle:  # before h5netcdf, which prints a traceback where root attributes are damaged
            schema = dict(handle.attrs).get("schema")
    except _UNREADABLE as error:
        raise _unreadable(file) from error
    return None if schema is None else str(schema)


def table_of(dataset: xr.Dataset, name: str) -> dict[str, Any]:
    """Read the JSON object in an attribute; raises ValueError where it is none."""
    table = json.loads(dataset.attrs.get(name, "{}"))
    if not isinstance(table, dict):
        raise ValueError(f"attribute {name} is no JSON object")  # noqa: TRY004 - a damaged file, not a wrong argument
    return table


def _unreadable(file: os.PathLike[str]) -> DataError:
    return DataError(f"{file}: not a readable NetCDF-4 file (truncated, corrupted or another format)")
