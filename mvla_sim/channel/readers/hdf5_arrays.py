"""Arrays in HDF5 files, among them those of MATLAB 7.3 and NetCDF-4, and in NetCDF-3 files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.readers.array_values import (
    MOST_TEXTS,
    UNLIKE,
    ArrayEntry,
    Arrays,
    Entries,
    check_claim,
    check_number,
    plain_values,
    refusal_of,
    shown,
    stacked,
    words_of,
)  # fmt: skip
from mvla_sim.channel.readers.matlab_arrays import MATLAB_NUMBERS, MATLAB_REMEDY

__all__ = ["is_hdf5", "read_classic_netcdf", "read_hdf5"]

_FILTERS: Final = {
    305: "LZO", 307: "bzip2", 32000: "LZF", 32001: "Blosc", 32004: "LZ4", 32008: "bitshuffle", 32013: "ZFP",
    32015: "Zstandard", 32017: "SZ", 32026: "Blosc2",
}  # fmt: skip
_DEEPEST: Final = 20


def is_hdf5(file: Path) -> bool:
    """Whether the signature is where HDF5 looks for it: at the start, at 512 bytes, and at each double of that."""
    with file.open("rb") as handle:
        size, at = file.stat().st_size, 0
        while at < size:
            handle.seek(at)
            if handle.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
            at = at * 2 or 512
    return False


def read_hdf5(file: Path, wanted: Sequence[str]) -> tuple[Entries, Arrays]:
    """List what a file holds, and read the arrays that are wanted.

    Those of MATLAB have their axes the other way round, structs for groups, and references for cells.

    Raises
    ------
    DataError
        It has too many arrays, or a wanted one is larger than the file can hold.
    OSError, and whatever h5py raises
        It is damaged.
    """
    import h5py  # noqa: PLC0415 - slow, and only here is it needed

    matlab, netcdf = (file.suffix.lower() == suffix for suffix in (".mat", ".nc"))
    entries, loaded = Entries(), Arrays()
    with h5py.File(file, "r") as handle:
        for name, dataset in _datasets(file, handle, matlab=matlab):
            if netcdf and _text(dataset, "NAME").startswith("This is a netCDF dimension but not a netCDF variable"):
                continue
            if matlab and h5py.check_ref_dtype(dataset.dtype) is h5py.Reference and dataset.shape:
                for label, entry, values in _of_cells(file, name, dataset, wanted):
                    entries[label] = entry
                    if values is not None:
                        loaded[label] = values
                continue
            entries[name] = entry = _entry(dataset, matlab=matlab)
            if name in wanted and entry.refusal is None:
                check_claim(file, name, entry.shape, dataset.dtype.itemsize)
                values = _values(dataset, matlab=matlab)
                loaded[name] = _unpacked(values, dataset.attrs) if netcdf else values
    return entries, loaded


def read_classic_netcdf(file: Path, wanted: Sequence[str]) -> tuple[Entries, Arrays]:
    """List what a NetCDF-3 file holds, and read the arrays that are wanted. Raises as :func:`read_hdf5`."""
    from scipy.io import netcdf_file  # noqa: PLC0415 - slow, and only here is it needed

    entries, loaded = Entries(), Arrays()
    with netcdf_file(file, mmap=False) as handle:
        check_number(file, len(handle.variables))
        for name, variable in handle.variables.items():
            values = np.asarray(variable.data)
            entries[name] = ArrayEntry(values.shape, refusal_of(values.dtype), words_of(values), variable.dimensions)
            if name in wanted and entries[name].refusal is None:
                loaded[name] = _unpacked(plain_values(values), vars(variable)["_attributes"])
    return entries, loaded


def _datasets(file: Path, root: Any, *, matlab: bool) -> Iterator[tuple[str, Any]]:
    """Yield names and datasets of an open HDF5 file, each group once; no soft or external link is followed."""
    import h5py  # noqa: PLC0415 - slow, and only here is it needed

    groups, seen, count = [("", root)], {h5py.h5o.get_info(root.id).addr}, 0
    while groups:
        prefix, group = groups.pop(0)
        for name in group:
            count += 1
            check_number(file, count)
            if matlab and name.startswith("#"):
                continue  # "#refs#" and the like are MATLAB's own
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            child = group[name]
            if isinstance(child, h5py.Dataset):
                yield prefix + name, child
            elif isinstance(child, h5py.Group) and (address := h5py.h5o.get_info(child.id).addr) not in seen:
                seen.add(address)
                groups.append((f"{prefix}{name}{'.' if matlab else '/'}", child))


def _entry(dataset: Any, *, matlab: bool) -> ArrayEntry:
    """What an HDF5 dataset is: its shape, what it is instead of numbers in this very file, and names of its axes."""
    shape = (dataset.shape or ())[:: -1 if matlab else 1]
    if dataset.shape is None or "MATLAB_empty" in dataset.attrs:
        return ArrayEntry(shape, "empty")
    if dataset.is_virtual or dataset.external:
        return ArrayEntry(shape, "in another file")
    kind = _text(dataset, "MATLAB_class")
    if kind == "char":
        return ArrayEntry(shape, "of class char", _characters(dataset))
    if kind not in ("", *MATLAB_NUMBERS):
        return ArrayEntry(shape, f"of class {shown(kind)}", remedy=MATLAB_REMEDY)
    if lacking := _lacking_filter(dataset):
        remedy = "which is not installed; pip install hdf5plugin, or write it with gzip or unpacked"
        return ArrayEntry(shape, f"packed by HDF5's filter {lacking}", remedy=remedy)
    refusal = refusal_of(dataset.dtype)
    texts = words_of(dataset[()]) if refusal and dataset.ndim == 1 and dataset.size <= MOST_TEXTS else ()
    return ArrayEntry(shape, refusal, texts, () if matlab else _axes(dataset))


def _lacking_filter(dataset: Any) -> str:
    """Number and name of a filter that a dataset needs and this process has not; empty where there is none."""
    import h5py  # noqa: PLC0415 - slow, and only here is it needed

    made = dataset.id.get_create_plist()
    for code, *_, name in (made.get_filter(i) for i in range(made.get_nfilters())):
        if not h5py.h5z.filter_avail(code):
            with contextlib.suppress(ImportError):
                import hdf5plugin  # noqa: F401, PLC0415 - where a user has it
            if not h5py.h5z.filter_avail(code):
                return f"{code} ({shown(_FILTERS.get(code) or name.decode(errors='replace') or 'unknown')})"
    return ""


def _axes(dataset: Any) -> tuple[str, ...]:
    """Names of the scales that a dataset's axes have, empty where there is none."""
    if dataset.is_scale:
        return (dataset.name,)
    return tuple(axis[0].name if len(axis) else axis.label for axis in dataset.dims)


def _values(dataset: Any, *, matlab: bool) -> NDArray[Any]:
    values = plain_values(np.asarray(dataset[()]))
    return values.T if matlab else values


def _of_cells(
    file: Path, name: str, dataset: Any, wanted: Sequence[str]
) -> Iterator[tuple[str, ArrayEntry, NDArray[Any] | None]]:
    """Yield the arrays that a cell array or an array of structs refers to: of each label one of all its elements."""
    outer = dataset.shape[::-1]
    check_number(file, dataset.size)
    if "MATLAB_empty" in dataset.attrs or not dataset.size:
        yield name, ArrayEntry(outer, "empty"), None
        return
    references = dataset[()].T.ravel()
    if not all(references):
        yield name, ArrayEntry(outer, "a cell array with empty cells"), None
        return
    found = [dataset.file[reference] for reference in references]
    yield from _same_in_all(name, found, outer, wanted)


def _same_in_all(
    label: str, parts: Sequence[Any], outer: tuple[int, ...], wanted: Sequence[str], depth: int = 0
) -> Iterator[tuple[str, ArrayEntry, NDArray[Any] | None]]:
    """Yield the arrays of what lies in every element of a cell array: datasets, or groups with the same fields."""
    import h5py  # noqa: PLC0415 - slow, and only here is it needed

    if depth < _DEEPEST and all(isinstance(part, h5py.Group) and set(part) == set(parts[0]) for part in parts):
        for field in parts[0]:
            inner = [part[field] for part in parts if isinstance(part.get(field, getlink=True), h5py.HardLink)]
            if len(inner) == len(parts):
                yield from _same_in_all(f"{label}.{field}", inner, outer, wanted, depth + 1)
        return
    if not all(isinstance(part, h5py.Dataset) for part in parts):
        yield label, ArrayEntry(outer, "a cell array of unlike parts"), None
        return
    entries = [_entry(part, matlab=True) for part in parts]
    refusal = next((entry.refusal for entry in entries if entry.refusal), None)
    if refusal:
        texts = tuple(word for entry in entries for word in entry.texts)
        yield label, ArrayEntry(outer, f"a cell array whose cells are {refusal}", texts), None
    elif len({entry.shape for entry in entries}) > 1:
        yield label, ArrayEntry(outer, UNLIKE), None
    else:
        shape = (*outer, *entries[0].shape)
        check_claim(Path(parts[0].file.filename), label, shape, 1)
        if label in wanted:
            yield label, *stacked([_values(part, matlab=True) for part in parts], outer)
        else:
            yield label, ArrayEntry(shape), None


def _characters(dataset: Any) -> tuple[str, ...]:
    """Rows of an array of MATLAB's characters."""
    if dataset.dtype.kind != "u" or dataset.ndim != 2 or dataset.size > MOST_TEXTS:
        return ()
    return tuple("".join(map(chr, row)).rstrip() for row in dataset[()].T.tolist())


def _text(dataset: Any, attribute: str) -> str:
    value = dataset.attrs.get(attribute, "")
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _unpacked(values: NDArray[Any], attributes: Mapping[str, Any]) -> NDArray[Any]:
    """Apply the packing conventions of NetCDF: missing values become NaN, scaled integers what they stand for."""
    if values.dtype.kind in "iuf":
        if "_FillValue" in attributes:
            fill = np.ravel(attributes["_FillValue"])[0]
            values = np.where(values == fill, np.nan, values)
        for key, apply in (("scale_factor", np.multiply), ("add_offset", np.add)):
            if key in attributes:
                values = apply(values, np.float64(np.ravel(attributes[key])[0]))
    return values
