"""Reader of measured responses that lie as named arrays in one file, with their axis and where they were measured."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.readers.array_files import ArrayFile, read_array_file, shown
from mvla_sim.errors import ConfigError, DataError

__all__ = ["ArrayData", "ArrayFile", "read_array_file", "read_responses"]

UNEVENNESS: Final = 1e-4
"""How far a value of an axis may be from where even steps put it, in steps."""


@dataclass(frozen=True, eq=False)
class ArrayData:
    """Measured responses of every view.

    Attributes
    ----------
    values
        Response, ``[n_view, n_axis]`` complex128, finite; its unit is the file's.
    axis
        Frequencies in hertz or delays in seconds, ``[n_axis]`` float64, rising in even steps.
    angles_deg
        Angle of each view as the file counts it, ``[n_view]`` float64, degrees; None where it is not in the file.
    positions_m, receivers_m
        Position of the sensor, or of its transmitter, and of the receiver, ``[n_view, 3]`` float64, metres; None where
        they are not in the file.
    """

    values: NDArray[np.complex128]
    axis: NDArray[np.float64]
    angles_deg: NDArray[np.float64] | None = None
    positions_m: NDArray[np.float64] | None = None
    receivers_m: NDArray[np.float64] | None = None


def read_responses(
    file: str | os.PathLike[str],
    *,
    data: str,
    axis: str,
    axis_kind: Literal["frequency", "delay"],
    data_imag: str | None = None,
    axis_unit: float = 1.0,
    angles: str | None = None,
    positions: str | None = None,
    receivers: str | None = None,
) -> ArrayData:
    """Read frequency responses or impulse responses of every view.

    Parameters
    ----------
    file
        A file as :func:`read_array_file` takes it.
    data, data_imag
        Name of the response, complex or with its imaginary part apart. Which of its two axes is the view is told by the
        lengths of the others; where both fit it is the first. A single view may have one axis.
    axis
        Name of the frequencies or delays.
    axis_kind
        Which of the two they are.
    axis_unit
        Hertz or seconds in a unit of the axis, 1e9 for gigahertz.
    angles
        Name of the angles, ``[n_view]`` degrees.
    positions, receivers
        Names of positions, ``[n_view, 3]`` or ``[n_view, 2]`` metres, or the other way round; z is 0 where it is not
        given.

    Returns
    -------
    ArrayData
        By rising frequency or delay.

    Raises
    ------
    ConfigError
        ``axis_kind`` is none of the two, or ``axis_unit`` not above 0.
    DataError
        The file cannot be used, lacks an array, or its arrays are not finite, of other shapes or not evenly spaced.
    """
    if axis_kind not in ("frequency", "delay"):
        raise ConfigError(f"axis_kind = {axis_kind!r}: unknown; allowed: 'frequency', 'delay'")
    if not 0 < axis_unit < math.inf:
        raise ConfigError(f"axis_unit = {axis_unit:g}: must be above 0 and finite")
    source = read_array_file(file, [name for name in (data, data_imag, axis, angles, positions, receivers) if name])
    steps = _real(source, axis, axis_unit)
    falling = _check_axis(steps, f"{source.file}: axis '{shown(axis)}'")
    angles_deg = None if angles is None else _angles(source, angles)
    positions_m, receivers_m = (None if name is None else _places(source, name) for name in (positions, receivers))
    per_view = {"angles": angles_deg, "positions": positions_m, "receivers": receivers_m}
    lengths = {what: len(array) for what, array in per_view.items() if array is not None}
    if len(set(lengths.values())) > 1:
        texts = (f"{length} {what}" for what, length in lengths.items())
        raise DataError(f"{source.file}: has {', '.join(texts)}; each view needs one")
    values = _oriented(source, data, data_imag, next(iter(lengths.values()), None), steps.size)
    if axis_kind == "frequency" and values.dtype.kind != "c":
        raise DataError(
            f"{source.file}: variable '{shown(data)}' is real; a frequency response is complex, or has its imaginary "
            "part in another variable (data_imag)"
        )
    _check_finite(values, f"{source.file}: variable '{shown(data)}'", ("view", "point"))
    order = slice(None, None, -1 if falling else 1)
    return ArrayData(
        np.array(values[:, order], np.complex128, order="C"),
        np.array(steps[order]),
        angles_deg,
        positions_m,
        receivers_m,
    )


def _real(source: ArrayFile, name: str, unit: float = 1.0) -> NDArray[np.float64]:
    values = source.get(name)
    place = f"{source.file}: variable '{shown(name)}'"
    if values.dtype.kind == "c":
        raise DataError(f"{place} is complex, must be real")
    with np.errstate(all="ignore"):
        scaled = values.astype(np.float64) * unit
    _check_finite(scaled, place, ("place",) * scaled.ndim)
    return scaled


def _check_finite(values: NDArray[Any], place: str, axes: Sequence[str]) -> None:
    bad = ~np.isfinite(values)
    if bad.any():
        first = np.unravel_index(int(bad.argmax()), values.shape)
        where = ", ".join(f"{axis} {index}" for axis, index in zip(axes, first, strict=True))
        raise DataError(f"{place} is {values[first]} at {where} (from 0), must be finite")


def _check_axis(axis: NDArray[np.float64], place: str) -> bool:
    """Refuse an axis that is not in even steps; return whether it falls."""
    if axis.ndim != 1 or axis.size < 2:
        raise DataError(f"{place} has shape {axis.shape}, must be a list of at least 2 values")
    with np.errstate(all="ignore"):
        steps = np.diff(axis)
        mean = (axis[-1] - axis[0]) / (axis.size - 1)
        even = np.abs(axis - (axis[0] + mean * np.arange(axis.size))) <= UNEVENNESS * abs(mean)
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
            f"{usual:.9g}; allowed is a difference of {UNEVENNESS:g} of a step"
        )
    return bool(mean < 0)


def _angles(source: ArrayFile, name: str) -> NDArray[np.float64]:
    values = np.atleast_1d(_real(source, name))
    if values.ndim != 1 or not values.size:
        raise DataError(f"{source.file}: variable '{shown(name)}' has shape {values.shape}, must be [n_view] degrees")
    return values


def _places(source: ArrayFile, name: str) -> NDArray[np.float64]:
    """Positions ``[n_view, 3]``."""
    values = np.atleast_2d(_real(source, name))
    if values.ndim == 2 and values.shape[1] not in (2, 3):
        values = values.T
    if values.ndim != 2 or values.shape[1] not in (2, 3) or not values.size:
        raise DataError(
            f"{source.file}: variable '{shown(name)}' has shape {source.get(name).shape}, must be [n_view, 3] or "
            "[n_view, 2]"
        )
    return np.pad(values, ((0, 0), (0, 3 - values.shape[1])))


def _oriented(source: ArrayFile, data: str, data_imag: str | None, n_view: int | None, n_axis: int) -> NDArray[Any]:
    """Response ``[n_view, n_axis]``, real or complex."""
    values = source.get(data)
    place = f"{source.file}: variable '{shown(data)}'"
    if data_imag is not None:
        imaginary = source.get(data_imag)
        if "c" in (values.dtype.kind, imaginary.dtype.kind):
            raise DataError(f"{place} or '{shown(data_imag)}' is complex; as parts of one response both must be real")
        if imaginary.shape != values.shape:
            raise DataError(f"{place} has shape {values.shape}, '{shown(data_imag)}' has {imaginary.shape}")
        with np.errstate(all="ignore"):
            parts = np.empty(values.shape, np.complex128)
            parts.real, parts.imag = values, imaginary
        values = parts
    table = np.atleast_2d(values)
    views = (n_view,) if n_view is not None else table.shape
    if table.ndim == 2:
        for candidate in (table, table.T):
            if candidate.size and candidate.shape[1] == n_axis and candidate.shape[0] in views:
                return candidate
    wanted = f"({n_view or 'views'}, {n_axis})"
    raise DataError(f"{place} has shape {values.shape}, must be {wanted}: views, values of the axis")
