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

__all__ = ["ArrayEntry", "check_claim", "check_number", "plain_values", "refusal_of", "shown"]

_MOST_PACKED: Final = 1100  # deflate makes at most 1032 bytes of one
_NUMBER_BYTES: Final = 48  # of memory for a number, which becomes complex128 and is copied
_MOST_ARRAYS: Final = 10_000
_COMPLEX_FIELDS: Final = (("real", "imag"), ("re", "im"), ("r", "i"))


@dataclass(frozen=True)
class ArrayEntry:
    """What a file says of one of its arrays.

    Attributes
    ----------
    shape
        Its lengths, those of 1 included.
    refusal
        What it is instead of numbers ("text"); None where it is numbers.
    """

    shape: tuple[int, ...]
    refusal: str | None = None


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


def shown(value: object) -> str:
    """Text of a foreign value, short and in one line; the type's name of an exception that says nothing."""
    text = " ".join(str(value).split())[:80]
    return "".join(c if c.isprintable() else "?" for c in text) or (type(value).__name__ if value != "" else "")
