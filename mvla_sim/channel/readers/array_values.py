"""Arrays of numbers in foreign files: what is none, what stands for one, and claims that no file bears out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.memory import check_memory

__all__ = [
    "AXIS_TOLERANCE", "ELEMENT", "MOST_TEXTS", "UNLIKE", "ArrayEntry", "Arrays", "Entries", "check_axis", "check_claim",
    "check_number", "plain_values", "refusal_of", "shown", "stacked", "words_of",
]  # fmt: skip

ELEMENT: Final = "element"
"""Name of the axis along which the arrays in a cell array, or in an array of structs, are stacked."""
UNLIKE: Final = "a cell array whose cells have different lengths"
MOST_TEXTS: Final = 1000
"""Words of a list of texts that is read."""

AXIS_TOLERANCE: Final = 0.01
"""How far a frequency may be off the uniform axis, in steps. Files hold rounded frequencies; at the unambiguous range
such an error turns the phase by at most 0.01·360° = 3.6°, nearer echoes by less. Lists and segments miss by steps."""

_MOST_PACKED: Final = 1100  # deflate makes at most 1032 bytes of one
_NUMBER_BYTES: Final = 48  # of memory for a number, which becomes complex128 and is copied
_MOST_ARRAYS: Final = 10_000
_COARSEST: Final = 0.2  # of a step, that numbers of single precision may be off; more says little of the axis
_COMPLEX_FIELDS: Final = (("real", "imag"), ("re", "im"), ("r", "i"))


@dataclass(frozen=True)
class ArrayEntry:
    """What a file says of an array: its shape, lengths of 1 included, and what it is instead of numbers ("text").

    ``texts`` are the words of a short list of them, ``axes`` the names that the file gives to the array's axes, and
    ``remedy`` is what helps with what cannot be read.
    """

    shape: tuple[int, ...]
    refusal: str | None = None
    texts: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()
    remedy: str = ""


Arrays = dict[str, NDArray[Any]]
Entries = dict[str, ArrayEntry]


def _complex_fields(dtype: np.dtype[Any]) -> tuple[str, str] | None:
    """Names of the real and imaginary part of a compound type that stands for complex numbers."""
    for pair in _COMPLEX_FIELDS:
        if dtype.names == pair and all(dtype[name].kind in "iuf" and dtype[name].itemsize <= 8 for name in pair):
            return pair
    return None


def refusal_of(dtype: np.dtype[Any]) -> str | None:
    """Say what an array of this type is instead of numbers."""
    if (dtype.kind in "iuf" and dtype.itemsize <= 8) or (dtype.kind == "c" and dtype.itemsize <= 16):
        return None
    if dtype.kind in "OSUT":
        return "text or objects" if dtype.kind == "O" else "text"
    return None if _complex_fields(dtype) else f"of type {shown(dtype)}"


def plain_values(values: NDArray[Any]) -> NDArray[Any]:
    """Join complex numbers, and turn the bytes of a number into this machine's order."""
    fields = _complex_fields(values.dtype)
    if fields is not None:
        joined = np.empty(values.shape, np.complex128)
        joined.real, joined.imag = values[fields[0]], values[fields[1]]
        return joined
    if refusal_of(values.dtype) is not None:
        raise ValueError(f"an array of type {values.dtype}")
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def stacked(parts: Sequence[NDArray[Any]], outer: Sequence[int]) -> tuple[ArrayEntry, NDArray[Any] | None]:
    """One array of those in the elements ``outer`` of a cell array, without lengths of 1; None where they are none."""
    outer = tuple(length for length in outer if length > 1)
    refusal = next((text for part in parts if (text := refusal_of(part.dtype))), None)
    if refusal:
        return ArrayEntry(outer, f"a cell array whose cells are {refusal}"), None
    if len({part.shape for part in parts}) > 1:
        return ArrayEntry(outer, UNLIKE), None
    values = np.stack([plain_values(part).squeeze() for part in parts])
    values = values.reshape(*outer, *values.shape[1:])
    axes = (ELEMENT,) * len(outer) + ("",) * (values.ndim - len(outer))
    return ArrayEntry(values.shape, axes=axes), values


def words_of(values: Any) -> tuple[str, ...]:
    """Words of a short list of texts, or of a table of single characters; none of anything else."""
    array = np.asarray(values)
    if array.size > MOST_TEXTS or array.dtype.kind not in "OSU":
        return ()
    if array.ndim == 2 and array.dtype == "S1":
        array = np.array([b"".join(row) for row in array.tolist()])
    words = [word.decode(errors="replace") if isinstance(word, bytes) else word for word in array.ravel().tolist()]
    return tuple(word.rstrip() for word in words) if all(isinstance(word, str) for word in words) else ()


def check_number(file: Path, count: int) -> None:
    """Refuse a file with more arrays than any has."""
    if count > _MOST_ARRAYS:
        raise DataError(f"{file}: has more than {_MOST_ARRAYS} arrays")


def check_claim(file: Path, name: str, shape: Sequence[int], itemsize: int) -> None:
    """Refuse a shape that a file of this size cannot hold, or the memory not."""
    size, count = file.stat().st_size, math.prod(shape)
    if count * itemsize > _MOST_PACKED * size:
        raise DataError(
            f"{file}: variable '{shown(name)}' announces shape {tuple(shape)}, {size} bytes do not hold that"
        )
    try:
        check_memory(count * _NUMBER_BYTES, f"{file}: the numbers of '{shown(name)}'", "keep fewer in the file")
    except ConfigError as error:
        raise DataError(str(error)) from error


def check_axis(axis: NDArray[np.float64], place: str, unevenness: float) -> bool:
    """Refuse an axis off even steps by more than this share of one, and more than single precision rounds it.

    Returns
    -------
    bool
        Whether it falls.
    """
    if axis.ndim != 1 or axis.size < 2:
        raise DataError(f"{place} has shape {axis.shape}, must be a list of at least 2 values")
    with np.errstate(all="ignore"):
        steps = np.diff(axis)
        mean = (axis[-1] - axis[0]) / (axis.size - 1)
        single = min(2 * np.spacing(np.float32(np.abs(axis).max())), _COARSEST * abs(mean))
        off = np.abs(axis - (axis[0] + mean * np.arange(axis.size)))
        even = off <= max(unevenness * abs(mean), single)
        usual = np.median(steps)
        turn = np.flatnonzero(~(steps * np.sign(usual) > 0))
        worst = int(np.nan_to_num(np.abs(steps - usual), posinf=np.inf).argmax())
    if turn.size:
        i = turn[0]
        raise DataError(
            f"{place} must rise or fall strictly: at place {i + 1} (from 0) {axis[i + 1]:.12g} follows {axis[i]:.12g}"
        )
    if not even.all():
        raise DataError(
            f"{place} is not in even steps: from place {worst} to {worst + 1} it is {steps[worst]:.9g}, mostly "
            f"{usual:.9g}; allowed is a difference of {unevenness:g} of a step"
        )
    return bool(mean < 0)


def shown(value: object) -> str:
    """Text of a foreign value, short and in one line; the type's name of an exception that says nothing."""
    text = " ".join(str(value).split())[:80]
    return "".join(c if c.isprintable() else "?" for c in text) or (type(value).__name__ if value != "" else "")
