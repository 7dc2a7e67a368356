"""Reader of the propagation paths that Remcom Wireless InSite writes as text (``*.paths.t001_01.r002.p2m``).

One file holds one transmitter and the points of one receiver set. Lines that begin with ``#`` are comments, empty lines
mean nothing. What remains is:

* the number of receiver points, then for each of them
* its number and how many paths it has; where that is 0, nothing more;
* received power (dBm), mean time of arrival and delay spread (s) over all its paths, then for each path
* path number, number of interactions, received power (dBm), phase (degrees), time of arrival (s), and four angles
  (degrees); InSite 3.2 and older leave out the phase;
* the interactions in words, ``Tx-R-D-Rx``: R reflection, D diffraction (d in older files), DS diffuse scattering,
  T transmission, F and X transmission through foliage;
* a line with x y z (m) for the transmitter, for each interaction and for the receiver.
"""

from __future__ import annotations

import math
import os
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, ClassVar, Final, NoReturn

import numpy as np

from mvla_sim.channel.cir import INTERACTIONS
from mvla_sim.channel.readers.pairs import PairPaths, PairReader, join_pairs
from mvla_sim.channel.readers.source import note
from mvla_sim.errors import DataError
from mvla_sim.files import existing_file

__all__ = ["InSite", "read_p2m"]

_LETTERS: Final = {
    "R": INTERACTIONS["specular"],
    "D": INTERACTIONS["diffraction"],
    "d": INTERACTIONS["diffraction"],
    "DS": INTERACTIONS["diffuse"],
    "T": INTERACTIONS["refraction"],
    "F": INTERACTIONS["refraction"],
    "X": INTERACTIONS["refraction"],
}
_PATHS: Final = "paths"
_OUTPUT: Final = re.compile(r".+?\.([A-Za-z_]+)\.t\d+(?:_\d+)?(?:\.r\d+)?\.p2m", re.IGNORECASE)
_LONGEST_LINE: Final = 4096
_RECEIVER_BYTES, _PATH_BYTES, _POINT_BYTES = len("1 0\n"), len("1 0 0 0 0 0 0 0\nTx-Rx\n0 0 0\n0 0 0\n"), len("0 0 0\n")
"""The fewest bytes that can hold one; a count that needs more than the file has is refused before it is followed."""
_PHASELESS, _WITH_PHASE = 8, 9  # numbers in the line of a path
_DRIFT_M: Final = 0.1  # the ends of paths are printed from one and the same point; beyond rounding, lines are mixed up
_NUMBER = re.compile(rb"[0-9]{1,15}")


def _doubles() -> array[float]:
    return array("d")


@dataclass
class _Found:
    """What has been read, of receivers and then of paths; compact, for a file may hold millions of paths."""

    receivers: array[float] = field(default_factory=_doubles)  # x y z after x y z, as all points
    row_size: list[int] = field(default_factory=list)
    power_dbm: array[float] = field(default_factory=_doubles)
    phase_deg: array[float] = field(default_factory=_doubles)
    delay_s: array[float] = field(default_factory=_doubles)
    interaction: bytearray = field(default_factory=bytearray)
    first_point: array[float] = field(default_factory=_doubles)
    transmitter: list[float] = field(default_factory=list)
    columns: int = 0
    silent: int = 0


class InSite(PairReader):
    """A .p2m file of Wireless InSite, or a folder of them."""

    name: ClassVar = "insite"
    takes: ClassVar = "a .p2m file or a folder of them"

    @classmethod
    def recognises(cls, source: Path) -> bool:
        """Whether its suffix is .p2m, or a folder holds such files."""
        return source.suffix.lower() == ".p2m" or (source.is_dir() and any(map(_is_p2m, source.glob("*"))))

    def paths(self, source: Path) -> PairPaths:
        """All pairs of all files of paths; what else InSite writes beside them is left out."""
        files = _path_files(source) if source.is_dir() else [source]
        parts = [read_p2m(file, self.transmit_power_dbm) for file in files]
        return parts[0] if len(parts) == 1 else join_pairs(parts, {"files": str(len(parts))})


def _is_p2m(file: Path) -> bool:
    return file.suffix.lower() == ".p2m" and not file.name.startswith(".")


def _output(file: Path) -> str:
    """What InSite's name of a file says it holds: ``cir`` of ``model.cir.t001_01.r002.p2m``; "" for other names."""
    named = _OUTPUT.fullmatch(file.name)
    return named[1].lower() if named else ""


def _path_files(folder: Path) -> list[Path]:
    """Files of paths in a study folder: by name, or else those whose name does not say what they hold."""
    files = sorted(filter(_is_p2m, folder.glob("*")))
    if not files:
        raise DataError(f"{folder}: holds no .p2m file")
    chosen = [file for file in files if _output(file) == _PATHS] or [file for file in files if not _output(file)]
    others = sorted({_output(file) or file.name for file in files if file not in chosen})
    if not chosen:
        raise DataError(
            f"{folder}: holds InSite's output of {', '.join(others[:12])} and no propagation paths; request these in "
            "InSite, which writes them as NAME.paths.t001_01.r002.p2m"
        )
    if others:
        note(f"{folder}: {', '.join(file.name for file in chosen[:3])}{', …' * (len(chosen) > 3)} read; InSite's other "
             f"output is left out: {', '.join(others[:12])}{', …' * (len(others) > 12)}")  # fmt: skip
    return chosen


def read_p2m(file: str | os.PathLike[str], transmit_power_dbm: float = 0.0) -> PairPaths:
    """Read the paths of one transmitter to the points of one receiver set.

    A receiver without paths is left out, for the file does not say where it is; ``source`` tells how many there were,
    and a file in which no receiver has a path gives no pair.

    Parameters
    ----------
    file
        A ``.p2m`` file of paths.
    transmit_power_dbm
        Power of the transmitter in the InSite project, dBm; the file holds received powers only. They include the
        gains of both antennas.

    Returns
    -------
    PairPaths
        One pair for each receiver with paths, in the file's order. Phases are the file's, or 0 where it has none. The
        carrier is unknown.

    Raises
    ------
    DataError
        Missing, truncated, not of this format, or with an unknown interaction; the message names the line.
    """
    path = existing_file(file, "InSite path file (.p2m)")
    if (output := _output(path)) not in ("", _PATHS):
        wanted = re.sub(rf"\.{output}\.", f".{_PATHS}.", path.name, count=1, flags=re.IGNORECASE)
        raise DataError(
            f"{path}: is InSite's output '{output}', which lacks the points of paths; give {wanted}, its output "
            "of propagation paths"
        )
    try:
        with path.open("rb") as handle:
            found = _parse(_Lines(path, handle, path.stat().st_size))
    except OSError as error:
        raise DataError(f"{path}: not readable ({error.strerror})") from error
    try:
        return _assemble(path, found, transmit_power_dbm)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


class _Lines:
    """The lines of a file that are neither empty nor comment, with what is left of the file."""

    def __init__(self, path: Path, handle: BinaryIO, size: int) -> None:
        self.path, self.number, self.left = path, 0, size
        self._lines = self._read(handle)

    def _read(self, handle: BinaryIO) -> Iterator[bytes]:
        while line := handle.readline(_LONGEST_LINE):
            self.number += 1
            self.left -= len(line)
            if len(line) == _LONGEST_LINE:
                self.fail(f"is longer than {_LONGEST_LINE} bytes; this is no InSite path file")
            line = line.strip()
            if line and not line.startswith(b"#"):
                yield line

    def next(self, what: str) -> bytes:
        """Return the next line, which should be ``what``."""
        for line in self._lines:
            return line
        raise DataError(f"{self.path}: ends after line {self.number} where {what} should follow; is it truncated?")

    def numbers(self, words: list[bytes], what: str, *lengths: int) -> list[float]:
        """Return words as finite numbers, of which there must be one of these many."""
        if len(words) not in lengths:
            self.fail(f"has {len(words)} columns, {' or '.join(map(str, lengths))} expected for {what}")
        values = []
        for word in words:
            try:
                value = float(word)
            except ValueError:
                value = math.nan
            if not math.isfinite(value) or b"_" in word:  # Python reads 1_0 as 10
                self.fail(f"{_shown(word)} in {what} is not a finite number")
            values.append(value)
        return values

    def point(self) -> list[float]:
        """Return the coordinates in the next line, metres."""
        return self.numbers(self.next("a point").split(), "a point", 3)

    def count(self, word: bytes, what: str, bytes_each: int) -> int:
        """Return a word as a count, of things the rest of the file has room for."""
        if not _NUMBER.fullmatch(word):
            self.fail(f"{_shown(word)} is not a {what}")
        count = int(word)
        if count * bytes_each > self.left + 1:  # the last line may lack its end
            self.fail(f"announces {count} as the {what}, too many for the {self.left} bytes that follow")
        return count

    def fail(self, why: str) -> NoReturn:
        """Raise an error that names file and line."""
        raise DataError(f"{self.path}: line {self.number}: {why}")

    def end(self) -> None:
        """Check that nothing is left."""
        for line in self._lines:
            self.fail(f"{_shown(line)} follows after the last receiver")


def _parse(lines: _Lines) -> _Found:
    found = _Found()
    words = lines.next("the number of receivers").split()
    if len(words) != 1:
        lines.fail(f"has {len(words)} columns where the number of receivers is expected")
    for _ in range(lines.count(words[0], "number of receivers", _RECEIVER_BYTES)):
        words = lines.next("a receiver").split()
        if len(words) != 2:
            lines.fail(f"has {len(words)} columns; a receiver's number and its number of paths are expected")
        lines.count(words[0], "receiver number", 0)
        paths = lines.count(words[1], "number of paths", _PATH_BYTES)
        if paths == 0:
            found.silent += 1
            continue
        lines.numbers(lines.next("a receiver's sums").split(), "a receiver's power, delay and delay spread", 3)
        for nth in range(paths):
            _parse_path(lines, found, new_receiver=nth == 0)
        found.row_size.append(paths)
    lines.end()
    return found


def _parse_path(lines: _Lines, found: _Found, *, new_receiver: bool) -> None:
    words = lines.next("a path").split()
    numbers = lines.numbers(words, "a path", _PHASELESS, _WITH_PHASE)
    if found.columns not in (0, len(words)):
        lines.fail(f"has {len(words)} columns, the paths before have {found.columns}")
    found.columns = len(words)
    interactions = lines.count(words[1], "number of interactions", _POINT_BYTES)
    power, *phase, delay = numbers[2:-4]
    if delay < 0:
        lines.fail(f"time of arrival {delay:g} s is negative")
    found.power_dbm.append(power)
    found.phase_deg.append(phase[0] if phase else 0.0)
    found.delay_s.append(delay)
    found.interaction.append(_interactions(lines, interactions))
    start = lines.point()
    found.transmitter = found.transmitter or start
    _check_same(lines, start, found.transmitter, "starts")
    points = [lines.point() for _ in range(interactions)]
    found.first_point.extend(points[0] if points else [math.nan] * 3)
    end = lines.point()
    if new_receiver:
        found.receivers.extend(end)
    _check_same(lines, end, found.receivers[-3:], "ends")


def _check_same(lines: _Lines, point: Sequence[float], known: Sequence[float], what: str) -> None:
    drift_m = math.dist(point, known)
    if drift_m > _DRIFT_M:
        lines.fail(f"this path {what} {drift_m:g} m from where the first one does")


def _interactions(lines: _Lines, expected: int) -> int:
    """Bits of the interactions that the next line names."""
    line = lines.next("the interactions of a path")
    first, *letters, last = line.decode("ascii", "replace").split("-") if b"-" in line else ("", "")
    if (first, last) != ("Tx", "Rx"):
        lines.fail(f"{_shown(line)} is not a list of interactions from Tx to Rx, such as Tx-R-Rx")
    if len(letters) != expected:
        lines.fail(f"{_shown(line)} names {len(letters)} interactions, the line before {expected}")
    bits = 0
    for letter in letters:
        if letter not in _LETTERS:
            lines.fail(f"unknown interaction {letter[:20]!r}; allowed: {', '.join(_LETTERS)}")
        bits |= _LETTERS[letter]
    return bits


def _shown(line: bytes) -> str:
    """Show a word or line of the file, short and printable."""
    return repr(line[:40].decode("ascii", "replace"))


def _assemble(path: Path, found: _Found, transmit_power_dbm: float) -> PairPaths:
    row_size = np.array(found.row_size, np.int64)
    receivers, delay = np.array(found.receivers).reshape(-1, 3), np.array(found.delay_s)
    order = np.lexsort((delay, np.repeat(np.arange(row_size.size), row_size)))
    with np.errstate(over="ignore"):  # PairPaths refuses what is not finite
        amplitude = np.float_power(10, (np.array(found.power_dbm) - transmit_power_dbm) / 20)
        first_point = np.array(found.first_point).reshape(-1, 3).astype(np.float32)
        gain = amplitude * np.exp(1j * np.deg2rad(np.array(found.phase_deg)))
    return PairPaths(
        transmitters_m=np.tile(np.array(found.transmitter or [math.nan] * 3), (row_size.size, 1)),
        receivers_m=receivers,
        row_size=row_size,
        gain=gain[order],
        delay_s=delay[order],
        interaction=np.array(found.interaction, np.uint8)[order],
        first_point_m=first_point[order],
        carrier_hz=None,
        source={
            "format": "Wireless InSite paths (.p2m)",
            "file": path.name,
            "transmit_power_dbm": f"{transmit_power_dbm:g}",
            "phase": "not in the file, taken as 0" if found.columns == _PHASELESS else "as in the file",
            "receivers_without_paths": str(found.silent),
        },
    )
