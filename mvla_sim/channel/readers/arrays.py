"""Reader of measured responses that lie as named arrays in one file, with their axis and where they were measured."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt, PositiveFloat

from mvla_sim.channel.readers.array_axes import joined_parts, of_views, parts_in_last_axis
from mvla_sim.channel.readers.array_files import SUFFIXES, ArrayFile, read_array_file
from mvla_sim.channel.readers.array_values import AXIS_TOLERANCE, ELEMENT, check_axis, shown
from mvla_sim.channel.readers.axis_units import AngleUnit, AxisKind, check_axis_unit, degrees_of
from mvla_sim.channel.readers.rounded_axis import unrounded_axis
from mvla_sim.channel.readers.source import Foreign, GivenRadio, Reader, note
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import ConfigError, DataError

__all__ = ["ArrayData", "ArrayReader", "read_responses"]


@dataclass(frozen=True, eq=False)
class ArrayData:
    """Measured responses of every view.

    The response ``[n_view, n_axis]``, finite, in the file's unit, at frequencies in hertz or delays in seconds
    ``[n_axis]``, which rise in even steps; angles and positions as in ``Foreign``, which is made of it.
    """

    values: NDArray[np.complex128]
    axis: NDArray[np.float64]
    angles_deg: NDArray[np.float64] | None = None
    positions_m: NDArray[np.float64] | None = None
    receivers_m: NDArray[np.float64] | None = None


class ArrayReader(Reader):
    """Named arrays in a .mat, .npz, HDF5 or NetCDF file.

    Which of the response's axes is the view is told by the lengths of the others, or by ``view_axis``. A third axis is
    of channels, such as polarisations, or one of two at the end is of real and imaginary parts. A single view may have
    one axis. Positions may also lie the other way round; z is 0 where it is not given.
    """

    name: ClassVar = "arrays"
    block: ClassVar = "arrays"
    takes: ClassVar = "a .mat, .npz, .h5, .hdf5 or .nc file"

    data: str = Field("response", description="name of the complex array [view, frequency] or [view, delay]")
    data_imag: str | None = Field(None, description="name of the imaginary part, where it is apart")
    axis: str = Field("frequency", description="name of the frequency or delay axis")
    axis_kind: AxisKind = "frequency"
    axis_unit: PositiveFloat | None = Field(
        None, description="Hz or s per unit of the axis: 1e9 for GHz, 1e-9 for ns; by default 1, if that is plausible"
    )
    view_axis: Annotated[int, Field(ge=0, le=2)] | None = Field(
        None, description="which axis of the data is the view, from 0, without lengths of 1; by default told by lengths"
    )
    channel: NonNegativeInt | str | None = Field(
        None, description="which of a third axis, such as polarisations: its number from 0, or its name in the file"
    )
    angles: str | None = Field(None, description="name of the angles, one a view")
    angle_unit: AngleUnit | None = Field(
        None, description="degree or radian; by default degrees, unless they look like radians"
    )
    positions: str | None = Field(None, description="name of the positions, [view, 2 or 3] metres")
    receivers: str | None = Field(None, description="name of the receivers' positions, where they differ")

    @classmethod
    def recognises(cls, source: Path) -> bool:
        """Whether its suffix is one of a file of arrays."""
        return source.suffix.lower() in SUFFIXES and source.is_file()

    def read(self, source: Path, radio: GivenRadio) -> Foreign:
        """Read responses, or the taps that they are made of."""
        found = read_responses(source, self)
        if self.axis_kind == "frequency":
            axis = found.axis
            data = found.values, float(axis[0]), float((axis[-1] - axis[0]) / (axis.size - 1))
        else:
            data = _of_taps(found, radio)
        return Foreign(
            FrequencyResponse, dict(zip(("response", "start_hz", "step_hz"), data, strict=True)), len(found.values),
            found.angles_deg, found.positions_m, found.receivers_m,
        )  # fmt: skip


def read_responses(file: str | os.PathLike[str], names: ArrayReader) -> ArrayData:
    """Read frequency responses or impulse responses of every view, by rising frequency or delay.

    Raises
    ------
    DataError
        The file cannot be used, lacks an array, or its arrays are not finite, of other shapes or not evenly spaced.
    """
    data, data_imag, axis = names.data, names.data_imag, names.axis
    angles, positions, receivers = names.angles, names.positions, names.receivers
    source = read_array_file(file, [name for name in (data, data_imag, axis, angles, positions, receivers) if name])
    steps, written = _real(source, axis, names.axis_unit or 1.0), _real(source, axis)
    place = f"{source.file}: axis '{shown(axis)}'"
    falling = written.ndim == 1 and written.size > 1 and written[0] > written[-1]
    order = slice(None, None, -1 if falling else 1)
    rounded = unrounded_axis(written[order], AXIS_TOLERANCE) if written.ndim == 1 else None
    if rounded is not None:
        unit = names.axis_unit or 1.0
        steps = np.asarray((rounded[0] + rounded[1] * np.arange(written.size))[order] * unit, np.float64)
        note(f"{place} is rounded; its values are taken for even steps of {rounded[1] * unit:.9g}")
    else:
        check_axis(written, place, AXIS_TOLERANCE)
    check_axis_unit(written[order], names.axis_kind, names.axis_unit, place)
    angles_deg = None if angles is None else _angles(source, angles, names.angle_unit)
    positions_m, receivers_m = (None if name is None else _places(source, name) for name in (positions, receivers))
    per_view = {"angles": angles_deg, "positions": positions_m, "receivers": receivers_m}
    lengths = {what: len(array) for what, array in per_view.items() if array is not None}
    if len(set(lengths.values())) > 1:
        texts = (f"{length} {what}" for what, length in lengths.items())
        raise DataError(f"{source.file}: has {', '.join(texts)}; each view needs one")
    values = _responses(source, names, next(iter(lengths.values()), None), steps.size)
    if names.axis_kind == "frequency" and values.dtype.kind != "c":
        raise DataError(
            f"{source.file}: variable '{shown(data)}' is real; a frequency response is complex, or has its imaginary "
            "part in another variable (data_imag)"
        )
    _check_finite(values, f"{source.file}: variable '{shown(data)}'", ("view", "point"))
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


def _angles(source: ArrayFile, name: str, unit: AngleUnit | None) -> NDArray[np.float64]:
    values = np.atleast_1d(_real(source, name))
    if values.ndim != 1 or not values.size:
        raise DataError(f"{source.file}: variable '{shown(name)}' has shape {values.shape}, must be [n_view] degrees")
    return degrees_of(values, unit, f"{source.file}: variable '{shown(name)}'")


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


def _responses(source: ArrayFile, names: ArrayReader, n_view: int | None, n_axis: int) -> NDArray[Any]:
    """Response ``[n_view, n_axis]``, real or complex."""
    values = source.get(names.data)
    place = f"{source.file}: variable '{shown(names.data)}'"
    if names.data_imag is not None:
        imaginary = source.get(names.data_imag)
        if "c" in (values.dtype.kind, imaginary.dtype.kind):
            other = shown(names.data_imag)
            raise DataError(f"{place} or '{other}' is complex; as parts of one response both must be real")
        if imaginary.shape != values.shape:
            raise DataError(f"{place} has shape {values.shape}, '{shown(names.data_imag)}' has {imaginary.shape}")
        values = joined_parts(values, imaginary, place)
    elif parts_in_last_axis(values, n_view, n_axis) and not _two_real_channels(values, names):
        values = joined_parts(values[..., 0], values[..., 1], place)
        note(f"{place}: its last axis of two is taken for real and imaginary parts")
    texts = [entry.texts for entry in source.entries.values() if entry.texts]
    return of_views(
        values, place, n_view=n_view, n_axis=n_axis, view_axis=names.view_axis, labelled=_labelled_view(source, names),
        channel=names.channel, names=texts,
    )  # fmt: skip


def _labelled_view(source: ArrayFile, names: ArrayReader) -> int | None:
    """Which axis of the data is the view by the names that the file gives to axes; None where these do not tell."""
    labels = source.axes(names.data)
    per_view = [name for name in (names.angles, names.positions, names.receivers) if name]
    of_view = {ELEMENT, *(label for name in per_view for label in source.axes(name)[:1])} - {""}
    of_axis = set(source.axes(names.axis)) - {""}
    found = [i for i, label in enumerate(labels) if label in of_view]
    if not found and len(labels) == 2 and of_axis & set(labels):
        found = [i for i, label in enumerate(labels) if label not in of_axis]
    return found[0] if len(found) == 1 else None


def _two_real_channels(values: NDArray[Any], names: ArrayReader) -> bool:
    """Whether a last axis of two holds two views or channels of real taps, as a delay response may."""
    return names.axis_kind == "delay" and (values.ndim == 2 or (values.ndim == 3 and names.channel is not None))


def _of_taps(data: ArrayData, radio: GivenRadio) -> tuple[NDArray[np.complex128], float, float]:
    """Frequency response of complex taps h_l at delays τ_l: H(f) = (K/L) Σ_l h_l exp(−j2π(f − f_c)τ_l).

    Taps Δτ apart fill the band 1/Δτ; where the data's bandwidth is smaller, the K frequencies inside it are kept. The
    factor is such that an isolated path of gain g, sampled as in our own profiles, has |H| = |g|.
    """
    if radio.carrier_hz is None:
        raise ConfigError("carrier_hz: missing key; taps over delay do not say their carrier")
    spacing = float((data.axis[-1] - data.axis[0]) / (data.axis.size - 1))
    band = 1 / spacing
    wanted = radio.bandwidth_hz or band
    if wanted > band * (1 + 1e-6):
        raise ConfigError(f"bandwidth_hz = {wanted:g}: taps {spacing:g} s apart hold {band:g} Hz at most")
    length = int(np.ceil(data.axis[-1] / spacing)) + 1  # so that the unambiguous range holds the last tap
    step = band / length
    kept = max(2, min(length, round(wanted / step)))
    number = np.arange(kept) - (kept - 1) / 2
    ramp = np.exp(2j * np.pi * (kept - 1) / 2 * np.arange(data.axis.size) / length)
    spectrum = np.fft.fft(data.values * ramp, length, axis=1)[:, :kept]
    spectrum *= np.exp(-2j * np.pi * number * step * data.axis[0]) * (kept / data.axis.size)
    return spectrum, radio.carrier_hz + float(number[0]) * step, step
