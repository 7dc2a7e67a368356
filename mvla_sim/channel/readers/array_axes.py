"""Which axis of a foreign array is the view, which the frequency or delay, and which one more."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.readers.array_values import shown
from mvla_sim.errors import ConfigError, DataError

__all__ = ["joined_parts", "of_views", "parts_in_last_axis"]

_MOST_AXES: Final = 3
_AS_TABLE: Final = (" (a row a view)", " (a column a view)")
_PHASES: Final = 1.5 * np.pi
"""Least span of the second of two parts that is a phase: imaginary parts of S-parameters are within ±1."""


def joined_parts(real: NDArray[Any], imaginary: NDArray[Any], place: str) -> NDArray[np.complex128]:
    """Complex numbers of two real arrays of one shape.

    Raises
    ------
    DataError
        They look like amplitude or level and phase.
    """
    first, second = np.asarray(real, np.float64), np.asarray(imaginary, np.float64)
    with np.errstate(all="ignore"):
        phases = second.size > 2 and np.ptp(second) > _PHASES and np.abs(second).max() <= 360
        if phases and ((first >= 0).all() or (first <= 0).all()):
            raise DataError(
                f"{place} has a first part that never changes its sign and a second from {second.min():g} to "
                f"{second.max():g}: they look like amplitude and phase; save real and imaginary parts"
            )
    values = np.empty(first.shape, np.complex128)
    values.real, values.imag = first, second
    return values


def parts_in_last_axis(values: NDArray[Any], n_view: int | None, n_axis: int) -> bool:
    """Whether a real array without its last axis of two could be the responses."""
    return values.dtype.kind != "c" and values.ndim >= 2 and values.shape[-1] == 2 and bool(
        _fits(values.shape[:-1], n_view, n_axis)
    )  # fmt: skip


def of_views(
    values: NDArray[Any],
    place: str,
    *,
    n_view: int | None,
    n_axis: int,
    view_axis: int | None = None,
    labelled: int | None = None,
    channel: int | str | None = None,
    names: Sequence[Sequence[str]] = (),
) -> NDArray[Any]:
    """Responses ``[n_view, n_axis]`` of an array whose axes are in any order.

    Parameters
    ----------
    values
        The array without its lengths of 1; of one view it may have one axis.
    place
        File and variable, for messages.
    n_view, n_axis
        Number of views, None where nothing says it, and of values of the frequency or delay axis.
    view_axis
        Which axis is the view, from 0; None: told by the lengths.
    labelled
        Which is the view by the file's names of axes, where the lengths do not tell.
    channel
        What to take of one more axis: a number from 0, or a name in one of ``names``, the file's lists of texts.

    Raises
    ------
    ConfigError, DataError
        No axis fits, or several do and nothing says which; there is no such channel, or it is not chosen.
    """
    shape = values.shape
    single = values.ndim == 1 or n_view == 1
    table = values[None] if single else values
    fits = _fits(table.shape, n_view, n_axis)
    chosen = [fit for fit in fits if single or view_axis is None or fit[0] == view_axis]
    if not chosen:
        wanted = f"({n_view or 'views'}, {n_axis})"
        along = f"; arrays.view_axis = {view_axis} does not fit" if fits else ""
        raise DataError(f"{place} has shape {shape}, must be {wanted}: views, values of the axis{along}")
    if len(chosen) > 1 and labelled is not None and view_axis is None:
        chosen = [fit for fit in chosen if fit[0] == labelled] or chosen
    if len(chosen) > 1:
        axes = sorted({fit[0] for fit in chosen})
        if len(axes) > 1:
            ways = " or ".join(f"{axis}{_AS_TABLE[axis] if len(shape) == 2 else ''}" for axis in axes)
            raise DataError(
                f"{place} has shape {shape}, whose lengths do not tell which axis is the view; set arrays.view_axis = "
                f"{ways}"
            )
        raise DataError(f"{place} has shape {shape}, whose lengths do not tell which axis is the one of {n_axis}")
    view, axis = chosen[0]
    rest = [i for i in range(table.ndim) if i not in (view, axis)]
    table = table.transpose(*rest, view, axis)
    if rest:
        return np.asarray(table[_channel(channel, len(table), place, names)])
    if channel is not None:
        raise ConfigError(f"arrays.channel = {channel}: {place} has no third axis, only shape {shape}")
    return table


def _fits(shape: Sequence[int], n_view: int | None, n_axis: int) -> list[tuple[int, int]]:
    """Pairs of axes that may be the view and the frequency or delay."""
    if len(shape) == 1:
        shape = (1, *shape)
    if len(shape) > _MOST_AXES or 0 in shape:
        return []
    pairs = permutations(range(len(shape)), 2)
    return [(i, j) for i, j in pairs if shape[j] == n_axis and n_view in (None, shape[i])]


def _channel(channel: int | str | None, count: int, place: str, names: Sequence[Sequence[str]]) -> int:
    """Number of a chosen channel."""
    lists = [names_of for names_of in names if len(names_of) == count]
    known = f" ({', '.join(shown(name) for name in lists[0])})" if lists else ""
    if channel is None:
        raise DataError(
            f"{place} has one more axis, of {count}{known}, such as polarisations; choose one with arrays.channel = 0 "
            f"to {count - 1}{', or by its name' * bool(lists)}"
        )
    if isinstance(channel, int):
        if not 0 <= channel < count:
            raise ConfigError(f"arrays.channel = {channel}: allowed: 0 to {count - 1}{known} of {place}")
        return channel
    found = {names_of.index(channel) for names_of in lists if list(names_of).count(channel) == 1}
    if len(found) != 1:
        raise ConfigError(
            f"arrays.channel = '{shown(channel)}': {place} has one more axis of {count}{known}; give one of its names, "
            f"if the file lists them, or 0 to {count - 1}"
        )
    return found.pop()
