"""Touchstone files of a vector network analyser, one frequency sweep each: reading and writing one."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from skrf.io.touchstone import Touchstone

from mvla_sim.channel.readers.array_values import AXIS_TOLERANCE, check_axis, shown
from mvla_sim.channel.readers.rounded_axis import unrounded_axis
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.files import atomic_output, existing_file
from mvla_sim.text_files import lines_of, read_text

__all__ = ["Sweep", "read_touchstone", "write_touchstone"]

LARGEST_FILE: Final = 2**27
"""128 MiB: 100 001 frequencies of four ports take 80. More would take the parser gigabytes."""

PARAMETER: Final = r"[sS](?:([1-9])([1-9])|([1-9]\d{0,3})[,_]([1-9]\d{0,3}))"
"""Names of S-parameters: a digit a port, or numbers with a comma or underscore between them."""

_UNITS = ("hz", "khz", "mhz", "ghz")
_NO_FREQUENCIES: Final = {"time": ("sec", "ms", "us", "µs", "ns", "ps"), "power": ("dbm", "watt", "mw")}
"""Units that analysers write for what is no frequency. Seconds are "S", beside the S of S-parameters."""
_FORMATS = ("ri", "ma", "db")
_UNPARSED = (ValueError, TypeError, IndexError, KeyError, AttributeError, ArithmeticError, MemoryError)


@dataclass(frozen=True, eq=False)
class Sweep:
    """One S-parameter at uniform frequencies, ``[n_frequency]``, relative to the file's own reference impedance.

    ``rounded`` says that the file's frequencies are those rounded to few digits.
    """

    start_hz: float
    step_hz: float
    response: NDArray[np.complex128]
    rounded: bool = False


@dataclass(frozen=True, eq=False)
class _Content:
    """A Touchstone file without comments: its text, data lines (number in the file, text) and declared ports."""

    text: str
    data: Sequence[tuple[int, str]]
    ports: int
    version_2: bool


def read_touchstone(file: str | os.PathLike[str], parameter: str = "S21") -> Sweep:
    """Read one S-parameter of a Touchstone file.

    Formats RI, MA and DB, units Hz to GHz, any reference impedance, versions 1 and 2 of the format.

    Parameters
    ----------
    file
        Its name ends in ``.s1p``, ``.s2p``, … or, for version 2, ``.ts``.
    parameter
        ``"S11"``, ``"S31"``, …: the port received at, then the port transmitted from. With ten ports and more,
        ``"S12,3"``.

    Raises
    ------
    DataError
        Missing, empty, no text, truncated, not of S-parameters, without this parameter, with values that are not
        finite, or with frequencies that do not rise uniformly.
    """
    path = existing_file(file, "Touchstone file")
    named = re.fullmatch(PARAMETER, parameter, re.ASCII)
    if named is None:
        raise ConfigError(f"parameter = '{parameter}': allowed: S11, S21, … or, of ten ports and more, S12,3")
    row, column = (int(number) for number in named.groups() if number is not None)
    content = _essentials(path)
    stream = io.StringIO(content.text)
    stream.name = path.name  # tells the parser the number of ports
    try:
        with np.errstate(all="ignore"):
            parsed = Touchstone(stream)
            frequency, matrix = parsed.get_sparameter_arrays()
            noise = np.zeros((0, 5)) if parsed.noise is None else np.atleast_2d(parsed.noise)
    except _UNPARSED as error:
        raise DataError(f"{path}: {_flaw(content.data, content.ports)}") from error
    if noise.shape[1] != 5:  # a line of a two-port whose frequency falls is taken for the start of noise data
        raise DataError(f"{path}: frequencies fall at {noise[0, 0]:.12g} Hz; they must rise")
    starts = sum(len(line.split()) % 2 for _, line in content.data)  # a frequency and pairs: odd; pairs alone: even
    if starts != len(frequency) + (0 if content.version_2 else len(noise)):
        raise DataError(f"{path}: {_flaw(content.data, content.ports)}")
    declared = parsed.frequency_nb
    if declared is not None and declared != len(frequency):
        raise DataError(f"{path}: declares {declared} frequencies and holds {len(frequency)}; it is truncated")
    ports = matrix.shape[1]
    if max(row, column) > ports:
        last = f"{ports}{ports}" if ports < 10 else f"{ports},{ports}"
        only = "S11 only" if ports == 1 else f"S11 to S{last}"
        raise DataError(f"{path}: has no {parameter.upper()}; a file of {ports} port{'s' * (ports > 1)} has {only}")
    response = np.array(matrix[:, row - 1, column - 1], np.complex128)
    start, step, rounded = _uniform(np.asarray(frequency, np.float64), path)
    bad = np.flatnonzero(~np.isfinite(response))
    if len(bad):
        raise DataError(
            f"{path}: {parameter.upper()} is not finite at {start + step * bad[0]:.12g} Hz ({len(bad)} such values)"
        )
    return Sweep(start, step, response, rounded)


def write_touchstone(
    file: str | os.PathLike[str], frequency_hz: NDArray[np.float64], s: NDArray[np.complex128]
) -> None:
    """Write S-parameters of one or two ports: version 1, RI, Hz, 50 Ω, with every digit.

    Parameters
    ----------
    file
        Name that ends in ``.s1p`` or ``.s2p``.
    frequency_hz
        ``[n_frequency]``, hertz.
    s
        ``[n_frequency, n_port, n_port]``; ``s[:, 1, 0]`` is S21.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    ports = s.shape[-1]
    if s.shape != (len(frequency_hz), ports, ports) or ports not in (1, 2):
        raise DataError(f"{file}: S-parameters of shape {s.shape}; allowed: [{len(frequency_hz)}, n, n] with n = 1, 2")
    if Path(file).suffix.lower() != f".s{ports}p":
        raise ConfigError(f"{file}: the name of a file of {ports} ports must end in .s{ports}p")
    table = np.empty((len(frequency_hz), 1 + 2 * ports**2))
    table[:, 0] = frequency_hz
    columns = s.transpose(0, 2, 1).reshape(len(s), -1)  # S11 S21 S12 S22
    table[:, 1::2], table[:, 2::2] = columns.real, columns.imag
    if not np.isfinite(table).all():
        raise DataError(f"{file}: S-parameters or frequencies are not finite")
    line = " ".join(["%.17g"] * table.shape[1]) + "\n"
    head = "! synthetic: computed by mvla-sim, not measured\n# Hz S RI R 50\n"
    with atomic_output(file) as temporary:
        temporary.write_text(head + line * len(table) % tuple(table.ravel().tolist()), encoding="ascii")


def _text(path: Path) -> str:
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise DataError(f"{path}: has {size / 2**20:.0f} MiB; a Touchstone file of more than 128 MiB is not read")
    return read_text(path)


def _essentials(path: Path) -> _Content:
    """Leave out comments, spell out the option line, and refuse what the parser would take for something else.

    Comments may hold anything, and the parser's search for port names in them takes quadratic time.
    """
    suffix = re.fullmatch(r"\.s(\d{1,4})p|\.ts", path.suffix.lower())
    if suffix is None:
        raise DataError(f"{path}: the name of a Touchstone file ends in .s1p, .s2p, … or .ts")
    ports = int(suffix[1] or 0)
    lines: list[str] = []
    data: list[tuple[int, str]] = []
    option = version_2 = False
    counts = True  # whether lines of numbers here are S-parameters
    for number, line in enumerate(lines_of(_text(path)), 1):
        body = line.partition("!")[0].strip()
        if body.startswith("#"):
            body = "" if option else _option_line(body, f"{path}: line {number}")  # only the first one counts
            option = True
        elif body.startswith("["):
            keyword, _, value = body.lower().partition("]")
            if keyword == "[mixed-mode order":
                raise DataError(f"{path}: line {number}: has mixed-mode parameters; allowed: single-ended ones")
            if keyword == "[number of ports":
                ports = int(value) if re.fullmatch(r"\s*\d{1,4}\s*", value) else 0
            version_2 = version_2 or keyword == "[version"
            counts = keyword == "[network data" or (counts and not version_2)
        elif body and counts:
            data.append((number, body))
        lines.append(body)
    _check_counts(path, data, ports, option)
    return _Content("\n".join(lines), data, ports, version_2)


def _check_counts(path: Path, data: Sequence[tuple[int, str]], ports: int, option: bool) -> None:
    """Refuse data that are none, or that would make the parser fill memory with what is not there."""
    if not data:
        raise DataError(f"{path}: holds no data, only {'an option line' if option else 'comments or blank lines'}")
    if not option:
        raise DataError(f"{path}: has no option line such as '# Hz S RI R 50'; it is no Touchstone file")
    if ports < 1:
        raise DataError(f"{path}: does not say its number of ports in its name or under [Number of Ports]")
    for number, body in data:
        if len(body.split(maxsplit=1)) == 1:
            raise DataError(f"{path}: line {number}: has one value; allowed: a frequency and S-parameters")
    values = sum(len(body.split()) for _, body in data)
    if ports * (ports + 1) >= values:  # half of a symmetric matrix, in pairs, is the least
        raise DataError(f"{path}: holds {values} values, too few for one frequency of {ports} ports; it is truncated")


def _option_line(body: str, place: str) -> str:
    """Spell out an option line, whose parts may stand in any order or be left out; impedances change no value."""
    unit, form = "ghz", "ma"
    tokens = body[1:].lower().split()
    for name, units in _NO_FREQUENCIES.items():
        if any(token in units for token in tokens) or (name == "time" and tokens.count("s") > 1):
            raise DataError(
                f"{place}: '{shown(body)}' is of a sweep over {name} (at one frequency); allowed: a sweep over "
                "frequency, in Hz to GHz"
            )
    for token in tokens:
        if token in _UNITS:
            unit = token
        elif token in _FORMATS:
            form = token
        elif token in ("y", "z", "g", "h"):
            raise DataError(f"{place}: holds {token.upper()}-parameters; allowed: S-parameters")
        elif token not in ("s", "r") and not _is_number(token.removeprefix("r"), complex):
            raise DataError(f"{place}: {token[:20]!r} is unknown in an option line; allowed: as in '# Hz S RI R 50'")
    return f"# {unit} s {form} r 50"


def _is_number(token: str, kind: type[float] | type[complex]) -> bool:
    try:
        kind(token)
    except ValueError:
        return False
    return True


def _flaw(data: Sequence[tuple[int, str]], ports: int) -> str:
    """Say what is wrong with data that did not parse: the first odd one out."""
    for number, body in data:
        for token in body.split():
            if not _is_number(token, float):
                return f"line {number}: {token[:20]!r} is not a number"
    counts = [len(body.split()) for _, body in data]
    if ports <= 2:
        for (number, _), count in zip(data, counts, strict=True):
            if count != 1 + 2 * ports**2:
                return (
                    f"line {number}: has {count} values; a file of {ports} port{'s' * (ports > 1)} has "
                    f"{1 + 2 * ports**2} a line, a frequency and {ports**2} complex numbers (is it truncated?)"
                )
    if sum(counts) % (1 + 2 * ports**2):
        return f"its {sum(counts)} values are no whole number of frequencies of {ports} ports (is it truncated?)"
    return "is no Touchstone file that can be read: its keywords or the breaks of its lines are unusual"


def _uniform(frequency_hz: NDArray[np.float64], file: Path) -> tuple[float, float, bool]:
    """Start and step of the axis, and whether its values are rounded."""
    if not np.isfinite(frequency_hz).all():
        raise DataError(f"{file}: a frequency is not finite")
    if frequency_hz[0] < 0:
        raise DataError(f"{file}: starts at {frequency_hz[0]:.12g} Hz; allowed: 0 or more")
    rounded = unrounded_axis(frequency_hz, AXIS_TOLERANCE)
    if rounded is not None:
        return *rounded, True
    if check_axis(frequency_hz, f"{file}: frequency", AXIS_TOLERANCE):
        raise DataError(f"{file}: frequencies fall from {frequency_hz[0]:.12g} Hz on; they must rise")
    start = float(frequency_hz[0])
    return start, float((frequency_hz[-1] - start) / (len(frequency_hz) - 1)), False
