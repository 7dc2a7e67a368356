"""Where intermediate results are kept between runs: a folder, and optionally a place that several machines share."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import platformdirs

from mvla_sim.engine.machine import environment_kept
from mvla_sim.errors import ConfigError, OutputError, reason
from mvla_sim.files import atomic_output

__all__ = [
    "URL_VARIABLE", "VARIABLE", "cache_folder", "cache_url", "discard", "is_shared", "pull", "push", "shared_cache",
]  # fmt: skip

VARIABLE: Final[str] = "MVLA_CACHE_DIR"
"""The environment variable that names another cache folder."""
URL_VARIABLE: Final[str] = "MVLA_CACHE_URL"
"""The environment variable that names the shared cache: a URL that fsspec knows, as file:///nfs/mvla or s3://…"""


def cache_folder() -> Path:
    """Return the cache folder, made if it is not there: ``MVLA_CACHE_DIR``, else the user's cache of ``mvla-sim``.

    Raises
    ------
    OutputError
        It cannot be made or written to.
    """
    named = os.environ.get(VARIABLE)
    try:
        folder = Path(named).expanduser() if named else platformdirs.user_cache_path("mvla-sim")
    except RuntimeError as error:  # no HOME, and no entry in the password file: as in some batch jobs
        raise OutputError(
            f"the cache folder is unknown, for user {os.getuid()} has no home folder (no HOME, no entry in the "
            f"password file); set {VARIABLE} to a folder of yours"
        ) from error
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be used as the cache folder ({error.strerror}); set {VARIABLE} to a folder of yours"
        ) from error
    return folder


@contextlib.contextmanager
def shared_cache(url: str | None) -> Iterator[None]:
    """Within the block the shared cache is at ``url``; where that is None, as the environment says.

    Raises
    ------
    ConfigError
        No such place can be used: unknown protocol, or its package is not installed.
    """
    with environment_kept(URL_VARIABLE):
        if url is not None:
            os.environ[URL_VARIABLE] = url
        _place()
        yield


def cache_url() -> str | None:
    """The shared cache, None where there is none."""
    return os.environ.get(URL_VARIABLE) or None


def pull(file: Path) -> None:
    """Copy a file of the cache folder from the shared cache, if it is not here and there is one.

    Raises
    ------
    OutputError
        The shared cache cannot be read, or the file cannot be written here.
    """
    if file.exists() or (place := _place()) is None:
        return
    system, root = place
    file.parent.mkdir(parents=True, exist_ok=True)
    with (
        _explained("read"),
        contextlib.suppress(FileNotFoundError),
        system.open(_there(root, file), "rb") as source,
        atomic_output(file) as temporary,
        temporary.open("wb") as target,
    ):
        shutil.copyfileobj(source, target)


def push(file: Path) -> None:
    """Copy a file of the cache folder to the shared cache, unless it is there; it appears there when it is whole.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    if (place := _place()) is None:
        return
    system, root = place
    target = _there(root, file)
    with _explained("written"):
        if system.exists(target):
            return
        system.makedirs(target.rpartition("/")[0], exist_ok=True)
        with system.transaction, system.open(target, "wb") as copy, file.open("rb") as source:
            shutil.copyfileobj(source, copy)


def is_shared(file: Path) -> bool:
    """Whether the shared cache has a file of the cache folder. Raises as :func:`pull`."""
    if (place := _place()) is None:
        return False
    system, root = place
    with _explained("read"):
        return bool(system.exists(_there(root, file)))


def discard(file: Path) -> None:
    """Delete a damaged file of the cache folder, here and in the shared cache."""
    file.unlink(missing_ok=True)
    if (place := _place()) is not None:
        system, root = place
        with _explained("written"), contextlib.suppress(FileNotFoundError):
            system.rm(_there(root, file))


def _place() -> tuple[Any, str] | None:
    """File system and root of the shared cache."""
    url = cache_url()
    if url is None:
        return None
    import fsspec  # noqa: PLC0415 - only where a shared cache is used

    try:
        system, root = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise ConfigError(f"cache URL {url}: cannot be used ({error})") from error
    return system, root.rstrip("/")


def _there(root: str, file: Path) -> str:
    return f"{root}/{file.relative_to(cache_folder()).as_posix()}"


@contextlib.contextmanager
def _explained(what: str) -> Iterator[None]:
    try:
        yield
    except OutputError:
        raise
    except Exception as error:  # each file system has errors of its own
        raise OutputError(f"cache URL {cache_url()}: cannot be {what} ({reason(error)})") from error
