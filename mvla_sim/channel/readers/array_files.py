"""Named arrays of numbers in the files of MATLAB, NumPy, HDF5 and NetCDF.

=================  ===========================================================  =================
suffix             format                                                       name of an array
=================  ===========================================================  =================
``.mat``           MATLAB 5 to 7 (``save -v6``, ``-v7``) and 7.3 (``-v7.3``)    ``s.t.field`` in structs
``.npz``           NumPy, without Python objects
``.h5``, ``.hdf5`` HDF5                                                         ``group/name``
``.nc``            NetCDF-4 and NetCDF-3                                        ``group/name``
=================  ===========================================================  =================

Arrays of one shape in the cells of a MATLAB cell array, or in one field of an array of structs, are one array.

The libraries for MATLAB and HDF5 files crash the process, or never return, on some damaged files. A process of its own
therefore reads these, with bounds on its memory and time; what kills it is an error of the file.
"""

from __future__ import annotations

import io
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import psutil
from numpy.typing import NDArray

from mvla_sim.channel.readers.array_values import (
    MOST_TEXTS,
    ArrayEntry,
    Arrays,
    Entries,
    check_claim,
    check_number,
    plain_values,
    refusal_of,
    shown,
    words_of,
)  # fmt: skip
from mvla_sim.channel.readers.hdf5_arrays import is_hdf5, read_classic_netcdf, read_hdf5
from mvla_sim.channel.readers.matlab_arrays import read_matlab
from mvla_sim.errors import DataError
from mvla_sim.files import existing_file
from mvla_sim.memory import USABLE

__all__ = ["SUFFIXES", "ArrayFile", "read_array_file", "read_single_arrays"]

SUFFIXES: Final = (".mat", ".npz", ".h5", ".hdf5", ".nc")
"""Of files that are read."""

_PATIENCE_S: Final = 30.0  # of computing for any file, and a second more for each of the following
_WAITING: Final = 4  # of a busy machine: seconds that pass for one of computing
_BYTES_A_SECOND: Final = 20e6
_MOST_LISTED: Final = 20
_HEADER_BYTES: Final = 4096  # of .npy; those of plain arrays take 128
_CHILD: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from mvla_sim.channel.readers import array_files; "
    "array_files._answer(json.loads(sys.argv[2]))"
)


@dataclass(frozen=True, eq=False)
class ArrayFile:
    """The named arrays of a file: what it holds, by name, and those that are in memory already."""

    file: Path
    entries: Mapping[str, ArrayEntry]
    loaded: Mapping[str, NDArray[Any]] = field(default_factory=dict, repr=False)

    def get(self, name: str) -> NDArray[Any]:
        """Return an array of integers, floats or complex numbers without its lengths of 1; it may be read-only.

        Raises
        ------
        DataError
            There is none of this name, it is not numbers, or the file does not bear out what it says of it.
        """
        name = name.strip("/")
        entry = self.entries.get(name)
        if entry is None:
            raise DataError(f"{self.file}: has no variable '{shown(name)}'; it has {self._contents()}")
        if entry.refusal:
            remedy = entry.remedy or "must be an array of numbers"
            raise DataError(f"{self.file}: variable '{shown(name)}' is {entry.refusal}, {remedy}")
        values = self.loaded[name] if name in self.loaded else _read(self.file, [name])[1][name]
        return values.squeeze()

    def axes(self, name: str) -> tuple[str, ...]:
        """Names of the axes of what :meth:`get` returns; empty where the file gives none."""
        entry = self.entries[name.strip("/")]
        axes = zip(entry.shape, entry.axes, strict=True) if entry.axes else ()
        return tuple(axis for length, axis in axes if length != 1)

    def _contents(self) -> str:
        texts = [f"{shown(name)} {entry.refusal or entry.shape}" for name, entry in self.entries.items()]
        more = f" and {len(texts) - _MOST_LISTED} more" if len(texts) > _MOST_LISTED else ""
        return ", ".join(texts[:_MOST_LISTED]) + more or "none"


def read_array_file(file: str | os.PathLike[str], ahead: Sequence[str] = ()) -> ArrayFile:
    """List the arrays of a file; they are read when they are asked for.

    Links in an HDF5 file are not followed, nor are datasets read whose values are in another file.

    Parameters
    ----------
    file
        The file; its suffix says what it is.
    ahead
        Names of arrays to read at once where they are numbers, for another opening costs up to half a second.

    Raises
    ------
    DataError
        No such file, of another format, damaged, with too many arrays, or one of ``ahead`` is larger than the file can
        hold or the memory.
    """
    path = existing_file(file, "file of arrays")
    return ArrayFile(path, *_read(path, [name.strip("/") for name in ahead]))


def read_single_arrays(files: Mapping[str, Path]) -> Arrays:
    """Read from each of several files the array it is for: files of one array each, as DeepMIMO's.

    Parameters
    ----------
    files
        ``.mat``, ``.npz`` or ``.npy`` files by the name of the array in them; in an ``.npy`` it has none.

    Returns
    -------
    dict
        The arrays by name, with all their lengths.

    Raises
    ------
    DataError
        As :func:`read_array_file` and :meth:`ArrayFile.get`.
    """
    apart = {existing_file(file, "file of arrays"): [name] for name, file in files.items() if file.suffix == ".mat"}
    read = _read_apart(apart) if apart else {}
    arrays = Arrays()
    for name, file in files.items():
        entries, loaded = read[file] if file in read else _read(existing_file(file, "file of arrays"), [name])
        arrays[name] = ArrayFile(file, entries, loaded).get(name).reshape(entries[name].shape)
    return arrays


def _read(file: Path, wanted: Sequence[str]) -> tuple[Entries, Arrays]:
    suffix = file.suffix.lower()
    if suffix not in (*SUFFIXES, ".npy"):
        raise DataError(f"{file}: unknown suffix '{file.suffix}'; allowed: {', '.join(SUFFIXES)}")
    try:
        if suffix not in (".npz", ".npy"):
            return _read_apart({file: wanted})[file]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy warns of odd headers; here they are right or refused
            if suffix == ".npz":
                return _read_npz(file, wanted)
            with file.open("rb") as stream:
                entry, values = _read_npy(file, wanted[0], stream, file.stat().st_size, load=True)
            return {wanted[0]: entry}, {} if values is None else {wanted[0]: values}
    except DataError:
        raise
    except Exception as error:  # zipfile and NumPy raise whatever a broken file trips over
        raise DataError(f"{file}: is not a readable {suffix} file ({shown(error)})") from error


def _read_npz(file: Path, wanted: Sequence[str]) -> tuple[Entries, Arrays]:
    entries, loaded = Entries(), Arrays()
    with zipfile.ZipFile(file) as archive:
        members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
        check_number(file, len(members))
        for member in members:
            name = member.filename.removesuffix(".npy")
            if name in entries:
                raise DataError(f"{file}: has two arrays of the name '{shown(name)}'")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others grow without a bound
                raise DataError(f"{file}: is packed by method {member.compress_type}, which NumPy does not write")
            with archive.open(member) as stream:
                entries[name], values = _read_npy(file, name, stream, member.file_size, load=name in wanted)
            if values is not None:
                loaded[name] = values
    return entries, loaded


def _read_npy(
    file: Path, name: str, stream: IO[bytes], size: int, *, load: bool
) -> tuple[ArrayEntry, NDArray[Any] | None]:
    """Entry of an array in a stream that should have ``size`` bytes, and the array if it is to be loaded."""
    start = io.BytesIO(stream.read(_HEADER_BYTES))
    version = np.lib.format.read_magic(start)
    if version not in ((1, 0), (2, 0)):
        return ArrayEntry((), f"of .npy version {version[0]}.{version[1]}"), None
    older, newer = np.lib.format.read_array_header_1_0, np.lib.format.read_array_header_2_0
    shape, fortran, dtype = (older if version == (1, 0) else newer)(start)
    entry = ArrayEntry(shape, refusal_of(dtype))
    if entry.refusal == "text" and math.prod(shape) <= MOST_TEXTS and dtype.itemsize <= _HEADER_BYTES:
        return replace(entry, texts=_npy_words(start.getvalue() + stream.read(), start.tell(), shape, dtype)), None
    if entry.refusal or not load:
        return entry, None
    check_claim(file, name, shape, dtype.itemsize)
    offset, count = start.tell(), math.prod(shape)
    if min(shape, default=0) < 0 or offset + count * dtype.itemsize != size:
        raise DataError(f"{file}: variable '{shown(name)}' announces shape {shape}, its {size} bytes do not hold that")
    content = start.getvalue() + stream.read(max(size - _HEADER_BYTES, 0))
    return entry, plain_values(
        np.frombuffer(content, dtype, count, offset).reshape(shape, order="F" if fortran else "C")
    )


def _npy_words(content: bytes, offset: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[str, ...]:
    """Words of a list of texts in an .npy; none where they are not all there."""
    count = math.prod(shape)
    whole = min(shape, default=0) >= 0 and len(content) == offset + count * dtype.itemsize
    return words_of(np.frombuffer(content, dtype, count, offset)) if whole and count else ()


def _read_apart(wanted: Mapping[Path, Sequence[str]]) -> dict[Path, tuple[Entries, Arrays]]:
    """Read arrays of MATLAB or HDF5 files in another process, which may crash."""
    path = json.dumps([place or str(Path.cwd()) for place in sys.path])
    asked = json.dumps([(str(file), list(names)) for file, names in wanted.items()])
    command = [sys.executable, "-I", "-c", _CHILD, path, asked]
    file = next(iter(wanted))
    quiet = os.environ | {"OPENBLAS_NUM_THREADS": "1", "HDF5_PLUGIN_PRELOAD": "::"}  # "::": load no foreign filters
    with tempfile.TemporaryFile() as answer, tempfile.TemporaryFile() as complaint:
        limit_s = _WAITING * _patience_s(wanted)
        try:
            code = subprocess.run(  # noqa: S603 - this very interpreter
                command, stdin=subprocess.DEVNULL, stdout=answer, stderr=complaint, env=quiet, timeout=limit_s,
                check=False,
            ).returncode  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise DataError(f"{file}: is not read within {limit_s:g} s; it is damaged or of another format") from error
        answer.seek(0)
        complaint.seek(0)
        if code and len(wanted) > 1:  # one at a time, for the message to name the one
            return {one: _read_apart({one: names})[one] for one, names in wanted.items()}
        if code:
            lines = complaint.read(1 << 20).decode(errors="replace").split("\n")
            said = next((line for line in reversed(lines) if line.strip()), f"exit code {code}")
            reason = f"reading it ends with signal {-code}" if code < 0 else shown(said)
            raise DataError(f"{file}: is damaged or not a {file.suffix} file ({reason})")
        found = {}
        for one in wanted:
            told = json.loads(answer.readline())
            if isinstance(told, str):
                raise DataError(told)
            entries = {
                name: ArrayEntry(tuple(shape), refusal, tuple(texts), tuple(axes), remedy)
                for name, shape, refusal, texts, axes, remedy in told["entries"]
            }
            loaded = {name: np.lib.format.read_array(answer, allow_pickle=False) for name in told["loaded"]}
            found[one] = entries, loaded
        return found


def _patience_s(files: Iterable[Path]) -> float:
    return math.ceil(_PATIENCE_S + sum(file.stat().st_size for file in files) / _BYTES_A_SECOND)


def _answer(wanted: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Be the other process: of each file write a line of JSON, its entries or an error, and then each array."""
    files = [Path(file) for file, _ in wanted]
    memory = psutil.virtual_memory().available * USABLE + psutil.Process().memory_info().vms
    limits = {resource.RLIMIT_AS: memory, resource.RLIMIT_CORE: 0, resource.RLIMIT_CPU: _patience_s(files)}
    for kind, limit in limits.items():
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (int(limit) if hard == resource.RLIM_INFINITY else min(int(limit), hard), hard))
    warnings.simplefilter("ignore")
    out = sys.stdout.buffer
    for path, (_, names) in zip(files, wanted, strict=True):
        try:
            entries, loaded = _reader(path)(path, names)
        except DataError as error:
            out.write(json.dumps(str(error)).encode())
            return
        told = {"entries": [(name, *astuple(e)) for name, e in entries.items()], "loaded": list(loaded)}
        out.write(json.dumps(told).encode() + b"\n")
        for values in loaded.values():
            np.lib.format.write_array(out, values, allow_pickle=False)


def _reader(file: Path) -> Callable[[Path, Sequence[str]], tuple[Entries, Arrays]]:
    """What reads a file, by its first bytes."""
    if is_hdf5(file):
        return read_hdf5
    with file.open("rb") as handle:
        start = handle.read(128)
    if start.startswith((b"CDF\x01", b"CDF\x02")):
        return read_classic_netcdf
    if file.suffix.lower() == ".mat" and start[124:128] in (b"\x00\x01IM", b"\x01\x00MI"):
        return read_matlab
    kind = {".mat": "MATLAB 5 to 7.3", ".nc": "NetCDF"}.get(file.suffix.lower(), "HDF5")
    raise DataError(f"{file}: is no {kind} file")
