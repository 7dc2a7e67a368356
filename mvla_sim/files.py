"""Writing files so that nothing half-written is ever left under a final name."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mvla_sim.errors import DataError, OutputError
from mvla_sim.interrupt import interruptible

__all__ = ["as_path", "atomic_output", "check_writable", "existing_file", "locked_folder", "make_folder"]

LOCK: Final = ".lock"
"""Name of the file by which a folder is locked."""
FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What writing to an open file raises, without the file's name."""


def as_path(name: str | os.PathLike[str]) -> Path:
    """Return the name of a file or folder as a :class:`~pathlib.Path`.

    Raises
    ------
    DataError
        It is of another type.
    """
    try:
        return Path(name)
    except TypeError as error:
        raise DataError(f"{type(name).__name__} is no name of a file or folder; give text or a Path") from error


@contextlib.contextmanager
def atomic_output(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` and rename it to ``path`` when the block ends without error.

    The temporary name keeps the suffix, so writers that choose a format by it work. On any exception,
    Ctrl-C included, the temporary file is removed and ``path`` is left as it was.

    Raises
    ------
    OutputError
        The folder is missing, read-only or full, or ``path`` is a folder; the message names ``path``. Other errors of
        the block, such as those of a file that it reads, pass unchanged.
    """
    target = as_path(path)
    with interruptible():
        temporary = _temporary_beside(target)
        try:
            try:
                yield temporary
            except OSError as error:
                if not isinstance(error, OutputError) and _is_about(error, temporary):
                    raise _refusal(target, error) from error
                raise
            try:
                temporary.replace(target)
            except OSError as error:
                raise _refusal(target, error) from error
        finally:
            temporary.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Find out, before anything is computed, whether a file of this name can be written.

    Raises
    ------
    OutputError
        As :func:`atomic_output` would later.
    """
    with interruptible():
        _temporary_beside(as_path(path)).unlink()


def make_folder(path: str | os.PathLike[str]) -> Path:
    """Make a folder, and those it lies in, where they are missing.

    Raises
    ------
    OutputError
        It cannot be made.
    """
    folder = as_path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made ({error.strerror or error})") from error
    return folder


def _temporary_beside(target: Path) -> Path:
    """Make an empty file beside ``target``, with its suffix and the permissions of any new file."""
    if os.path.isdir(target):  # noqa: PTH112 - Path.is_dir raises where a folder on the way may not be searched
        raise OutputError(f"{target}: is a folder; give the name of a file")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    while True:
        temporary = target.with_name(f".{target.stem[:40]}-{secrets.token_hex(8)}{target.suffix}")
        try:
            os.close(os.open(temporary, flags, 0o666))
        except FileExistsError:
            continue
        except OSError as error:
            raise _refusal(target, error) from error
        return temporary


def _is_about(error: OSError, temporary: Path) -> bool:
    """Whether an error is one of writing the temporary file; HDF5 names the file in its text alone."""
    if error.filename is not None:
        return str(error.filename) == str(temporary)
    return error.errno in FULL or temporary.name in str(error)


def existing_file(path: str | os.PathLike[str], what: str) -> Path:
    """Return ``path`` as a :class:`~pathlib.Path` if it is a readable, non-empty file.

    Parameters
    ----------
    path
        The file's name.
    what
        What the file should be, for the message ("CIR file", "scene").

    Raises
    ------
    DataError
        Missing, a folder, unreadable or empty.
    """
    file = as_path(path)
    try:
        size = file.stat().st_size
    except FileNotFoundError as error:
        raise DataError(f"{file}: no such {what}") from error
    except OSError as error:
        raise DataError(f"{file}: not readable ({error.strerror})") from error
    if file.is_dir():
        raise DataError(f"{file}: is a folder, not a {what}")
    if not os.access(file, os.R_OK):
        raise DataError(f"{file}: not readable")
    if size == 0:
        raise DataError(f"{file}: is empty, not a {what}")
    return file


@contextlib.contextmanager
def locked_folder(folder: Path, what: str) -> Iterator[None]:
    """Make a folder and hold it; the system lets go of it when the process ends, however it ends.

    Parameters
    ----------
    folder
        The folder.
    what
        What one process at a time may do in it, for the message ("run").

    Raises
    ------
    OutputError
        Another process holds it, or it cannot be written.
    """

    def refused(why: str) -> OutputError:
        return OutputError(f"{folder}: {why}; choose another folder", setting="output")

    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise refused(f"cannot be written ({error.strerror})") from error
    with os.fdopen(descriptor, "r+", encoding="utf-8", errors="replace") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            owner = handle.read(20).strip() or "unknown"
            raise refused(f"another {what} is at work here (process {owner})") from error
        except OSError as error:
            raise refused(f"cannot be locked ({error.strerror})") from error
        handle.truncate(0)
        handle.write(str(os.getpid()))
        handle.flush()
        yield


def _refusal(target: Path, error: OSError) -> OutputError:
    if error.errno == errno.ENOSPC:
        return OutputError(f"{target}: no space left on the disk; nothing was written under this name")
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return OutputError(f"{target}: not writable ({error.strerror}); choose another place", setting="output")
    if error.errno == errno.ENOENT and not target.parent.exists():
        return OutputError(f"{target}: the folder {target.parent} does not exist")
    return OutputError(f"{target}: cannot be written ({error.strerror or error})")
