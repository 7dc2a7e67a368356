"""Units that foreign files do not say: an axis or angles that no radar measures are refused with what they would be."""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvla_sim.constants import SPEED_OF_LIGHT, delay_to_range, range_resolution
from mvla_sim.errors import DataError

__all__ = ["AngleUnit", "AxisKind", "axis_text", "axis_units", "check_axis_unit", "degrees_of", "with_prefix"]

AxisKind = Literal["frequency", "delay"]
AngleUnit = Literal["degree", "radian"]

_UNITS: Final[dict[AxisKind, dict[str, float]]] = {
    "frequency": {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6, "GHz": 1e9, "THz": 1e12},
    "delay": {"s": 1.0, "µs": 1e-6, "ns": 1e-9, "ps": 1e-12, "metres of one-way range": 2 / SPEED_OF_LIGHT},
}


class _Bounds(NamedTuple):
    """Least and most of an axis's last value, hertz or seconds, of its band, hertz, and of its unambiguous range."""

    last: tuple[float, float]
    band_hz: tuple[float, float]
    range_m: tuple[float, float]

    def hold(self, kind: AxisKind, axis: NDArray[np.float64]) -> bool:
        """Whether a rising axis, hertz or seconds, is within."""
        found = (float(axis[-1]), *_band_and_range(kind, axis))
        return bool(axis[0] >= 0) and all(least <= x <= most for x, (least, most) in zip(found, self, strict=True))


_USUAL: Final[dict[AxisKind, _Bounds]] = {
    "frequency": _Bounds((4e8, 3e12), (1e7, 3e12), (0.1, 1e5)),
    "delay": _Bounds((1e-10, 1e-4), (1e7, 1e13), (0.0, 1e5)),
}
"""What radars that see a vehicle have; an axis beyond them is taken only where its unit is said."""
_POSSIBLE: Final[dict[AxisKind, _Bounds]] = {
    "frequency": _Bounds((1e6, 1e14), (1e6, 1e14), (1e-3, 1e6)),
    "delay": _Bounds((1e-12, 1e-2), (1e5, 1e15), (0.0, 2e6)),
}
"""What none is beyond."""
_THOUSANDTHS: Final = 2e-3
_PREFIXES: Final = {1e12: "T", 1e9: "G", 1e6: "M", 1e3: "k", 1.0: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n", 1e-12: "p"}


def with_prefix(value: float, unit: str, digits: int = 6) -> str:
    """Text of a value in the decimal multiple of its unit that suits it: ``"34.5 GHz"``."""
    size = next((size for size in _PREFIXES if abs(value) >= size * (1 - 1e-9)), 1.0)
    return f"{value / size:.{digits}g} {_PREFIXES[size]}{unit}" if 1e-15 < abs(value) < 1e15 else f"{value:g} {unit}"


def axis_text(kind: AxisKind, axis: NDArray[np.float64]) -> str:
    """What a rising axis, hertz or seconds, means: its ends, step, and unambiguous or largest range, in a few words."""
    unit, range_m = "Hz" if kind == "frequency" else "s", _band_and_range(kind, axis)[1]
    step = (axis[-1] - axis[0]) / (axis.size - 1)
    reach = f"unambiguous to {range_m:.4g} m" if kind == "frequency" else f"ranges to {range_m:.4g} m"
    ends = f"{with_prefix(float(axis[0]), unit)} to {with_prefix(float(axis[-1]), unit)}"
    return f"{ends} in steps of {with_prefix(float(step), unit, 4)}, {reach}"


def axis_units(axis: NDArray[np.float64]) -> dict[tuple[AxisKind, str], float]:
    """Units in which a rising axis as the file has it would be usual: hertz or seconds a unit, by kind and name."""
    found: dict[tuple[AxisKind, str], float] = {}
    for kind, units in _UNITS.items():
        for name, unit in units.items():
            starts = kind == "frequency" or axis[0] <= axis[-1] / 2  # delays begin near the sensor
            if starts and _USUAL[kind].hold(kind, axis * unit):
                found[kind, name] = unit
    return found


def check_axis_unit(axis: NDArray[np.float64], kind: AxisKind, unit: float | None, place: str) -> None:
    """Refuse an axis that would mean a band, step or range that no radar has.

    Parameters
    ----------
    axis
        Rising, in even steps, in the file's unit, ``[n_axis]``.
    kind, unit
        What it is said to be, and hertz or seconds a unit; None where nothing is said, which means 1.
    place
        File and variable, for the message.

    Raises
    ------
    DataError
        It names the units in which the axis would be usual, and the settings that say so.
    """
    taken = axis * (unit or 1.0)
    if (_USUAL if unit is None else _POSSIBLE)[kind].hold(kind, taken):
        return
    if axis[0] < 0:
        raise DataError(f"{place} begins at {taken[0]:g}; {kind}s are absolute and at least 0")
    likely = [
        f"in {name} it would be {'delays of ' * (other == 'delay')}{axis_text(other, axis * size)}: set "
        f"{f'arrays.axis_kind = {other!r} and ' * (other != kind)}arrays.axis_unit = {_factor(size)}"
        for (other, name), size in axis_units(axis).items()
        if (other, size) != (kind, unit or 1.0)
    ]
    if unit is None and _POSSIBLE[kind].hold(kind, taken):
        likely.append("if it is right, say arrays.axis_unit = 1")
    remedy = "; ".join(likely) or "neither as frequencies nor as delays does it fit any unit"
    raise DataError(f"{place} would be {axis_text(kind, taken)}, which is no radar's; {remedy}")


def _factor(size: float) -> str:
    """Text of a number as a person writes it: "1e9"."""
    return f"{size:.9g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")


def degrees_of(angles: NDArray[np.float64], unit: AngleUnit | None, place: str) -> NDArray[np.float64]:
    """Angles in degrees, ``[n_view]``; where their unit is not said they are, unless they look like radians.

    Raises
    ------
    DataError
        They look like radians though nothing says so: no more than 2π apart, and they go once round in radians or are
        no round numbers of degrees. Or they are said to be radians, and span more than a turn.
    """
    span, turn = float(np.ptp(angles)), 2 * np.pi
    if unit == "radian":
        if span > 1.01 * turn:
            raise DataError(
                f"{place} spans {span:g}, which in radians would be {np.rad2deg(span):.0f}°; "
                "set arrays.angle_unit = 'degree'"
            )
        return np.rad2deg(angles)
    if unit is None and 0 < span <= 1.001 * turn:
        step = np.median(np.diff(np.sort(angles)))
        thousandths = angles * 1000
        whole = abs(thousandths - np.rint(thousandths)).max() <= _THOUSANDTHS
        if not whole or turn - span <= 1.5 * step:
            ends = f"{np.rad2deg(angles.min()):.6g}° to {np.rad2deg(angles.max()):.6g}°"
            raise DataError(
                f"{place} goes from {angles.min():.6g} to {angles.max():.6g}; in radians it would be {ends}: set "
                "arrays.angle_unit = 'radian', or 'degree' if it is right"
            )
    return angles


def _band_and_range(kind: AxisKind, axis: NDArray[np.float64]) -> tuple[float, float]:
    """Band in hertz, and the unambiguous range or that of the last delay, metres."""
    with np.errstate(all="ignore"):
        step = float((axis[-1] - axis[0]) / (axis.size - 1))
        if kind == "frequency":
            return step * axis.size, range_resolution(step) if step > 0 else np.inf
        return (1 / step if step > 0 else np.inf), float(delay_to_range(float(axis[-1])))
