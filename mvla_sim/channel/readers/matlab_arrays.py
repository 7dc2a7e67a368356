"""Arrays in files of MATLAB 5 to 7: variables, fields of structs in structs, and cells with an array a view.

SciPy takes the numbers out. What the file holds is read here, for SciPy's own list fails where there is an object of
MATLAB, such as a string, a datetime or a table.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.readers.array_values import (
    ArrayEntry,
    Arrays,
    Entries,
    check_claim,
    check_number,
    plain_values,
    refusal_of,
    stacked,
    words_of,
)  # fmt: skip
from mvla_sim.errors import DataError

__all__ = ["MATLAB_NUMBERS", "MATLAB_REMEDY", "read_matlab"]

MATLAB_NUMBERS: Final = ("double", "single", *(f"{sign}int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "u")))
MATLAB_REMEDY: Final = "which only MATLAB can take apart; save its numbers as plain arrays"

_CLASSES: Final = dict(
    enumerate(("cell", "struct", "object", "char", "sparse", *MATLAB_NUMBERS, "function", "opaque"), start=1)
)
_PLAIN: Final = (*MATLAB_NUMBERS, "char", "sparse", "logical")
_MATRIX, _COMPRESSED, _LOGICAL = 14, 15, 0x200
_HEAD_BYTES: Final = 8192  # that hold the flags, the lengths and the name of any variable
_MOST_TEXT: Final = 10_000  # characters of a variable of text that is read for its words
_DEEPEST: Final = 20


class _Variable(NamedTuple):
    name: str
    shape: tuple[int, ...]
    kind: str


def read_matlab(file: Path, wanted: Sequence[str]) -> tuple[Entries, Arrays]:
    """List what a file holds, and read the arrays that are wanted.

    Raises
    ------
    DataError
        It is no such file, has two variables of one name, or a wanted one is larger than the file can hold.
    ValueError, struct.error, zlib.error, and whatever SciPy raises
        It is damaged.
    """
    import scipy.io.matlab as sio  # noqa: PLC0415 - slow, and only here is it needed

    listed = list(_variables(file))
    if len({variable.name for variable in listed}) < len(listed):
        raise DataError(f"{file}: has two variables of one name")
    entries = Entries()
    nested = []
    for name, shape, kind in listed:
        if kind in ("cell", "struct") or (kind == "char" and np.prod(shape, dtype=float) <= _MOST_TEXT):
            nested.append(name)
        else:
            refusal = None if kind in MATLAB_NUMBERS else f"of class {kind}"
            entries[name] = ArrayEntry(shape, refusal, remedy="" if kind in _PLAIN else MATLAB_REMEDY)
    asked = [name for name in wanted if name in entries and entries[name].refusal is None]
    for name in asked:
        check_claim(file, name, entries[name].shape, 1)  # a byte is the least that MATLAB stores for a number
    content = sio.loadmat(file, variable_names=[*asked, *nested]) if asked or nested else {}
    loaded = {name: plain_values(np.asarray(content[name])) for name in asked}
    for name in nested:
        for label, entry, values in _leaves(name, [content[name]], ()):
            entries[label] = entry
            check_number(file, len(entries))
            if label in wanted and values is not None:
                loaded[label] = values
    return entries, loaded


def _leaves(
    label: str, parts: Sequence[Any], outer: tuple[int, ...], depth: int = 0
) -> Iterator[tuple[str, ArrayEntry, NDArray[Any] | None]]:
    """Yield the arrays under one label, by name: of one value, or of a value in each of the elements ``outer``."""
    first: NDArray[Any] = np.asanyarray(parts[0]) if len(parts) else np.empty(0)
    one = not outer
    kinds = {type(part) for part in parts}
    fields = first.dtype.names or ()
    if not first.size or depth > _DEEPEST:
        yield label, ArrayEntry(outer or first.shape, "empty"), None
    elif kinds != {np.ndarray}:
        what = str(first.flat[0]["s2"]) if "s2" in fields else "object"
        yield label, ArrayEntry(first.shape, f"of class {what}", remedy=MATLAB_REMEDY), None
    elif fields and all(part.dtype.names == fields and part.size == 1 for part in parts):
        for field in fields:
            yield from _leaves(f"{label}.{field}", [part.flat[0][field] for part in parts], outer, depth + 1)
    elif one and fields:
        for field in fields:
            yield from _leaves(f"{label}.{field}", [part[field] for part in first.flat], first.shape, depth + 1)
    elif one and first.dtype.kind == "O":
        yield from _leaves(label, list(first.flat), first.shape, depth + 1)
    elif first.dtype.kind == "U":
        yield label, ArrayEntry(outer or first.shape, "text", tuple(w for part in parts for w in words_of(part))), None
    elif one:
        refusal = refusal_of(first.dtype)
        yield label, ArrayEntry(first.shape, refusal), plain_values(first) if refusal is None else None
    else:
        yield label, *stacked([np.asarray(part) for part in parts], outer)


def _variables(file: Path) -> Iterator[_Variable]:
    """Yield the variables of a file by what stands at the start of each."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        order = "<" if stream.read(128)[126:128] == b"IM" else ">"
        at, count = 128, 0
        while at < size:
            stream.seek(at)
            kind, length = struct.unpack(f"{order}II", stream.read(8))
            if at + 8 + length > size:
                raise ValueError("it is truncated")
            head = stream.read(min(length, _HEAD_BYTES))
            if kind == _COMPRESSED:
                head = zlib.decompressobj().decompress(head, _HEAD_BYTES)[8:]
            elif kind != _MATRIX:
                raise ValueError(f"it holds a part of kind {kind}")
            variable = _variable(head, order)
            if variable.name:  # what has none belongs to MATLAB's objects
                yield variable
                check_number(file, count := count + 1)
            at += 8 + length


def _variable(head: bytes, order: str) -> _Variable:
    """Name, lengths and class of a variable; of an object, which says no lengths, its own class."""
    parts = _elements(head, order)
    flags = struct.unpack(f"{order}I", next(parts)[:4])[0]
    kind = _CLASSES.get(flags & 0xFF, "unknown")
    if kind == "opaque":
        name, _, kind = (next(parts).decode("latin1") for _ in range(3))
        return _Variable(name, (), kind)
    lengths = next(parts)
    shape = struct.unpack(f"{order}{len(lengths) // 4}i", lengths)
    return _Variable(next(parts).decode("latin1"), shape, "logical" if flags & _LOGICAL else kind)


def _elements(head: bytes, order: str) -> Iterator[bytes]:
    """Yield the contents of the data elements that follow each other."""
    at = 0
    while True:
        kind = struct.unpack_from(f"{order}I", head, at)[0]
        if kind >> 16:  # a short one, with its length in the upper half
            yield head[at + 4 : at + 4 + (kind >> 16)]
            at += 8
        else:
            length = struct.unpack_from(f"{order}I", head, at + 4)[0]
            yield head[at + 8 : at + 8 + length]
            at += 8 + -(-length // 8) * 8
