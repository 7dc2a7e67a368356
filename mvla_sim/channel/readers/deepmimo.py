"""Reader of DeepMIMO v4 scenarios: a folder with ``params.json`` and the paths as one array a file.

A file is named by its array, the set and the number of the transmitter, and the set of the receivers:
``power_t000_tx000_r001.npz``. It is an ``.npz`` with one member of the array's name, a MATLAB 5 ``.mat`` with one
variable of that name, or a plain ``.npy``:

* ``rx_pos`` ``[n_rx, 3]`` and ``tx_pos`` ``[1, 3]`` or ``[3]``, metres
* ``power`` ``[n_rx, n_slot]``, dB: dBW received for 0 dBW transmitted
* ``phase`` ``[n_rx, n_slot]``, degrees; ``delay`` ``[n_rx, n_slot]``, seconds
* ``inter`` ``[n_rx, n_slot]``: a decimal digit for each interaction, from the transmitter on; 1 reflection,
  2 diffraction, 3 scattering, 4 transmission; 0 alone is the direct path
* ``inter_pos`` ``[n_rx, n_slot, n_interaction, 3]``, metres

Slots without a path are NaN in all of them. ``params.json`` holds ``rt_params.frequency`` in hertz.
"""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import psutil
from numpy.typing import NDArray

from mvla_sim.channel.cir import INTERACTIONS
from mvla_sim.channel.readers.array_files import read_single_arrays
from mvla_sim.channel.readers.array_values import shown
from mvla_sim.channel.readers.pairs import PairPaths, PairReader, join_pairs
from mvla_sim.errors import DataError
from mvla_sim.files import existing_file
from mvla_sim.memory import USABLE

__all__ = ["DeepMimo", "read_deepmimo"]

_LARGEST_ARRAY_BYTES: Final = 4 << 30
_LARGEST_PARAMS_BYTES: Final = 64 << 20
_ARRAYS: Final = ("rx_pos", "tx_pos", "power", "phase", "delay", "inter")
_FILE: Final = re.compile(rf"({'|'.join(_ARRAYS)}|inter_pos)_(t\d{{1,6}}_tx\d{{1,6}}_r\d{{1,6}})\.(?:mat|npz|npy)")
_BITS: Final = np.array([0, *(INTERACTIONS[n] for n in ("specular", "diffraction", "diffuse", "refraction"))], np.uint8)
_MOST_DIGITS: Final = 15  # of an interaction code; float64 holds no more
_MOST_POINTS: Final = 100  # of a path; DeepMIMO keeps 10
_SLOT_BYTES: Final = 150  # of memory for a slot of all arrays, while they are put together


class DeepMimo(PairReader):
    """A folder of a DeepMIMO v4 scenario."""

    name: ClassVar = "deepmimo"
    takes: ClassVar = "a DeepMIMO folder with params.json"

    @classmethod
    def recognises(cls, source: Path) -> bool:
        """Whether it is a folder with ``params.json``."""
        return source.is_dir() and (source / "params.json").exists()

    def paths(self, source: Path) -> PairPaths:
        """All pairs of a scenario."""
        return read_deepmimo(source)


def read_deepmimo(folder: str | os.PathLike[str]) -> PairPaths:
    """Read every transmitter and every set of receivers of a scenario.

    The arrays that lie in the folder decide what is read; ``params.json`` gives the carrier and says who traced the
    paths. A scenario of several scenes has a folder for each of them; give one of these.

    Parameters
    ----------
    folder
        The scenario's folder.

    Returns
    -------
    PairPaths
        One pair for each transmitter and receiver, those without paths included. Scenarios of Sionna RT hold the phase
        before the carrier's −2πfτ, which is added where the carrier is known; of other tracers it is taken as it is.

    Raises
    ------
    DataError
        No such folder, no scenario, or an array that is missing, damaged, too large or at odds with the others.
    """
    place = Path(folder)
    try:
        params = _params(place)
        arrays = _arrays_of(place)
    except OSError as error:
        raise DataError(f"{place}: not readable ({error.strerror})") from error
    carrier_hz, tracer = _carrier(place, params), _told(params["rt_params"], "raytracer_name")
    turned = tracer.startswith("Sionna") and carrier_hz is not None
    parts, cut = [], 0
    for code, files in sorted(arrays.items()):
        absent = [name for name in _ARRAYS if name not in files]
        if absent:
            raise DataError(f"{place / absent[0]}_{code}: no such array, though there is {next(iter(files.values()))}")
        with np.errstate(all="ignore"):  # PairPaths refuses what is not finite
            part, beyond = _pairs(files, carrier_hz, turned=turned)
        parts.append(part)
        cut += beyond
    if not parts:
        raise DataError(f"{place}: holds no arrays of paths such as power_t000_tx000_r001.npz")
    source = {
        "format": "DeepMIMO v4",
        "folder": place.resolve().name,
        "deepmimo_version": _told(params, "version"),
        "raytracer": f"{tracer} {_told(params['rt_params'], 'raytracer_version')}",
        "phase": "of the file, less 2 pi carrier delay" if turned else "of the file",
        "arrays": f"{len(parts)} of a transmitter and a receiver set",
        "interaction_codes_cut": str(cut),
    }
    return join_pairs(parts, source)


def _params(place: Path) -> dict[str, Any]:
    """Content of ``params.json``, with ``rt_params`` as an object in it."""
    if not place.is_dir():
        raise DataError(f"{place}: no such folder of a DeepMIMO scenario")
    file = place / "params.json"
    scenes = [] if file.exists() else sorted(place.glob("*/params.json"))
    if scenes:
        raise DataError(f"{place}: holds scenes in folders of their own; give one of them, such as {scenes[0].parent}")
    file = existing_file(file, "DeepMIMO v4 scenario")
    if file.stat().st_size > _LARGEST_PARAMS_BYTES:
        raise DataError(f"{file}: is larger than {_LARGEST_PARAMS_BYTES >> 20} MiB; this is no DeepMIMO scenario")
    try:
        params = json.loads(file.read_bytes())
    except (ValueError, RecursionError) as error:
        raise DataError(f"{file}: is not readable JSON ({shown(error)})") from error
    if not isinstance(params, dict) or not isinstance(params.get("rt_params"), dict):
        raise DataError(f"{file}: has no object rt_params; this is no DeepMIMO v4 scenario")
    return params


def _carrier(place: Path, params: dict[str, Any]) -> float | None:
    """Carrier in hertz, None where ``frequency`` is missing or 0, as DeepMIMO writes what it does not know."""
    value = params["rt_params"].get("frequency")
    if value is None:
        return None
    try:
        carrier_hz = math.nan if isinstance(value, bool) else float(value)  # NumPy scalars are written as text
    except (TypeError, ValueError, OverflowError):
        carrier_hz = math.nan
    if not 0 <= carrier_hz < math.inf:
        raise DataError(
            f"{place / 'params.json'}: rt_params.frequency is {shown(value)!r}, must be hertz above 0, or 0 if unknown"
        )
    return carrier_hz or None


def _arrays_of(place: Path) -> dict[str, dict[str, Path]]:
    """Files of the folder by the code of transmitter and receiver set, and by array."""
    found: dict[str, dict[str, Path]] = {}
    for file in sorted(place.iterdir()):
        match = _FILE.fullmatch(file.name)
        if match is None:
            continue
        name, code = match.groups()
        known = found.setdefault(code, {}).setdefault(name, file)
        if known is not file:
            raise DataError(f"{file}: {known.name} holds the same array; keep one of the two")
    return found


def _pairs(files: dict[str, Path], carrier_hz: float | None, *, turned: bool) -> tuple[PairPaths, int]:
    """Pairs of one transmitter and one set of receivers, and how many interaction codes were cut."""
    arrays = _arrays(files)
    receivers, transmitter = arrays["rx_pos"], arrays["tx_pos"]
    if receivers.ndim != 2 or receivers.shape[1] != 3:
        raise DataError(f"{files['rx_pos']}: rx_pos has shape {receivers.shape}, must be [receivers, 3]")
    if transmitter.size != 3:
        raise DataError(f"{files['tx_pos']}: tx_pos has shape {transmitter.shape}, must be [1, 3]")
    power = arrays["power"]
    if power.ndim != 2 or len(power) != len(receivers):
        raise DataError(f"{files['power']}: power has shape {power.shape}, must be [{len(receivers)} receivers, paths]")
    _check_size(files["power"], power.size * _SLOT_BYTES, most=math.inf)
    slots = {"power": power} | {name: arrays[name] for name in ("phase", "delay", "inter")}
    present = ~np.isnan(power)
    for name, values in slots.items():
        if values.shape != power.shape:
            raise DataError(f"{files[name]}: {name} has shape {values.shape}, power has {power.shape}")
        if values.dtype.kind == "f" and (np.isnan(values) == present).any():
            receiver, slot = np.argwhere(np.isnan(values) == present)[0]
            raise DataError(f"{files[name]}: receiver {receiver}, path {slot} is NaN either in {name} or in power only")
    row = np.nonzero(present)[0]
    power_db, phase_deg, delay_s = (slots[name][present].astype(np.float64) for name in ("power", "phase", "delay"))
    interaction, cut = _interactions(files["inter"], slots["inter"][present])
    first_point = np.full((row.size, 3), np.nan, np.float32)
    if "inter_pos" in files:
        first_point = _first_points(files["inter_pos"], arrays["inter_pos"], present)
        first_point[interaction == 0] = np.nan
    order = np.lexsort((delay_s, row))
    phase_rad = np.deg2rad(phase_deg)
    if turned and carrier_hz is not None:
        phase_rad -= 2 * np.pi * carrier_hz * delay_s
    gain = np.float_power(10, power_db / 20) * np.exp(1j * phase_rad)
    try:
        part = PairPaths(
            transmitters_m=np.tile(transmitter.reshape(3).astype(np.float64), (len(receivers), 1)),
            receivers_m=receivers.astype(np.float64),
            row_size=present.sum(axis=1).astype(np.int64),
            gain=gain[order],
            delay_s=delay_s[order],
            interaction=interaction[order],
            first_point_m=first_point[order],
            carrier_hz=carrier_hz,
        )
    except DataError as error:
        raise DataError(f"{files['power']} and its companions: {error}") from error
    return part, cut


def _interactions(file: Path, codes: NDArray[Any]) -> tuple[NDArray[np.uint8], int]:
    """Bits of the interaction codes ``[n_path]``, and how many codes lost digits to the number that holds them."""
    values = codes.astype(np.float64)
    wrong = ~((values >= 0) & (values < 10**_MOST_DIGITS) & (values == np.floor(values)))
    rest = np.where(wrong, 0, values).astype(np.int64)
    cut = np.zeros(rest.shape, np.bool_)
    if codes.dtype.kind == "f":
        exact = 2 ** (np.finfo(codes.dtype).nmant + 1)
        cut = rest > exact
        while (long := cut & (rest * 10 > exact)).any():  # only the leading digits are those that were written
            rest[long] //= 10
    bits = np.zeros(rest.shape, np.uint8)
    while rest.any():
        digit = rest % 10
        wrong |= (rest > 0) & ((digit == 0) | (digit >= _BITS.size))
        bits |= _BITS[np.where(digit < _BITS.size, digit, 0)]
        rest //= 10
    if wrong.any():
        raise DataError(f"{file}: interaction code {codes[wrong][0]:.15g}: must be 0 or of the digits 1 to 4")
    return bits, int(np.count_nonzero(cut))


def _first_points(file: Path, points: NDArray[Any], present: NDArray[np.bool_]) -> NDArray[np.float32]:
    """First known interaction point of each path, ``[n_path, 3]`` metres; NaN where there is none."""
    if points.ndim != 4 or points.shape[:2] != present.shape or points.shape[3] != 3:
        raise DataError(f"{file}: inter_pos has shape {points.shape}, must be {(*present.shape, 'interactions', 3)}")
    if points.shape[2] > _MOST_POINTS:
        raise DataError(f"{file}: inter_pos has room for {points.shape[2]} interactions a path, at most {_MOST_POINTS}")
    first = np.full((np.count_nonzero(present), 3), np.nan)
    for nth in range(points.shape[2]):
        unknown = np.isnan(first).any(axis=1)
        first[unknown] = points[:, :, nth][present][unknown]
    first[np.isnan(first).any(axis=1)] = np.nan
    return first.astype(np.float32)


def _arrays(files: dict[str, Path]) -> dict[str, NDArray[Any]]:
    """The arrays of some files by name: real numbers."""
    for file in files.values():
        _check_size(existing_file(file, "DeepMIMO array"), file.stat().st_size)
    arrays = read_single_arrays(files)
    for name, values in arrays.items():
        if values.dtype.kind not in "fiu":
            raise DataError(f"{files[name]}: {name} has type {values.dtype}, must be real numbers")
    return arrays


def _check_size(file: Path, size: int, most: float = _LARGEST_ARRAY_BYTES) -> None:
    """Refuse what is larger than ``most`` bytes, or than the free memory, were it copied twice."""
    most = min(most, USABLE * psutil.virtual_memory().available / 3)
    if size > most:
        raise DataError(f"{file}: takes {size / 2**30:.2f} GiB; at most {most / 2**30:.2f} GiB can be read")


def _told(params: dict[str, Any], key: str) -> str:
    return "unknown" if params.get(key) is None else shown(params[key])
