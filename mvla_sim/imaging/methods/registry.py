"""Methods by name: those of this package, those that installed packages offer, and functions of a Python file.

A method from elsewhere is a function that takes an :class:`~mvla_sim.imaging.observation.Observation` and returns a
score, ``[nz, ny, nx]``, or the pair of a score and an angular support in degrees. It is named

* ``file.py:function``, or ``file.py`` where the function is called ``image``;
* by an entry point of the group ``mvla_sim.methods`` of a package that is installed.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from mvla_sim.errors import ConfigError, DataError, MvlaError, reason
from mvla_sim.imaging.imaging_settings import METHOD_GROUP, METHOD_NAMES, split_method
from mvla_sim.imaging.methods.base import Method
from mvla_sim.imaging.observation import Estimate, Observation

__all__ = ["find_method", "phase_free_methods", "title_of"]

Function = Callable[[Observation], Any]


def find_method(name: str) -> Method:
    """Return a method.

    Raises
    ------
    ConfigError
        There is none of this name, its file cannot be imported or lacks the function; one line.
    """
    if name in METHOD_NAMES:
        method: Method = importlib.import_module(f"mvla_sim.imaging.methods.{name.replace('-', '_')}").METHOD
        return method
    if (parts := split_method(name)) is not None:
        file, function = parts
        try:
            stamp = file.stat()
        except OSError as error:
            raise ConfigError(f"method = '{name}': {file} cannot be read ({error.strerror})") from error
        return _from_file(name, file.resolve(), function, (stamp.st_mtime_ns, stamp.st_size))
    return _from_package(name)


def phase_free_methods() -> tuple[str, ...]:
    """Names of the package's methods that need no phase, in their usual order."""
    return tuple(name for name in METHOD_NAMES if not find_method(name).uses_amplitude)


def title_of(name: str) -> str:
    """Name of a method in figures and tables; the name itself where it is from elsewhere."""
    return find_method(name).title if name in METHOD_NAMES else name


class _Function(Method):
    """A function from elsewhere as a method."""

    uses_pdp = True

    def __init__(self, name: str, function: Function, digest: str) -> None:
        self.name = name
        self.function = function
        self.digest = digest

    def image(self, seen: Observation) -> Estimate:
        """Call the function, and check what it returns."""
        try:
            found = self.function(seen)
        except MvlaError:
            raise
        except (Exception, SystemExit) as error:  # a method must not end the program, or its other samples
            frame = traceback.extract_tb(error.__traceback__)[-1]
            raise DataError(
                f"method {self.name}: {reason(error)} ({Path(frame.filename).name}, line {frame.lineno})"
            ) from error
        if isinstance(found, Estimate):
            found = (found.score, found.support_deg)
        score, support = found if isinstance(found, tuple) and len(found) == 2 else (found, None)
        return Estimate(self._checked("score", score, seen), self._support(support, seen))

    def _support(self, values: Any, seen: Observation) -> Any:
        if values is None:
            return None
        support = self._checked("angular support", values, seen)
        if support.min() < 0:
            raise DataError(f"method {self.name}: its angular support has a value of {support.min():g}; at least 0")
        return support

    def _checked(self, what: str, values: Any, seen: Observation) -> Any:
        try:
            array = np.asarray(values, np.float32)
        except (TypeError, ValueError) as error:
            raise DataError(f"method {self.name}: its {what} is {type(values).__name__}, not an array") from error
        if array.shape != seen.grid.shape:
            raise DataError(f"method {self.name}: its {what} has shape {array.shape}, must be {seen.grid.shape}")
        if not np.isfinite(array).all():
            count = int(np.count_nonzero(~np.isfinite(array)))
            raise DataError(f"method {self.name}: {count} of {array.size} values of its {what} are not finite")
        return array


@lru_cache(maxsize=32)
def _from_file(name: str, file: Path, function: str, stamp: tuple[int, int]) -> Method:
    """Import a file under a name of its own, once for each of its versions."""
    del stamp
    source = file.read_bytes()
    digest = hashlib.sha256(source).hexdigest()
    module_name = f"mvla_method_{digest[:16]}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    assert spec is not None  # the name ends with .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses and pickle look there
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[module_name]
        raise ConfigError(f"method = '{name}': {file.name} cannot be imported ({reason(error)})") from error
    return _Function(name, _callable(name, module, function), digest)


@lru_cache(maxsize=32)
def _from_package(name: str) -> Method:
    found = [point for point in entry_points(group=METHOD_GROUP) if point.name == name]
    if not found:
        raise ConfigError(f"method = '{name}': there is none; allowed: {', '.join(METHOD_NAMES)}, or file.py:function")
    try:
        value = found[0].load()
    except Exception as error:
        raise ConfigError(f"method = '{name}': {found[0].value} cannot be imported ({reason(error)})") from error
    if isinstance(value, Method):
        return value
    if not callable(value):
        raise ConfigError(f"method = '{name}': {found[0].value} is {type(value).__name__}, not a function")
    return _Function(name, value, _source_digest(value))


def _callable(name: str, module: Any, function: str) -> Function:
    value = getattr(module, function, None)
    if not callable(value):
        raise ConfigError(f"method = '{name}': the file has no function '{function}'")
    checked: Function = value
    return checked


def _source_digest(value: Function) -> str:
    """Digest of the file that a function is defined in."""
    try:
        source = Path(inspect.getfile(inspect.unwrap(value))).read_bytes()
    except (OSError, TypeError):
        return ""
    return hashlib.sha256(source).hexdigest()
