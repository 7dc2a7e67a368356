"""Other people's methods: functions of a Python file, of an installed package, or of a script or notebook.

Such a function takes an :class:`~mvla_sim.imaging.observation.Observation` and returns a score, ``[nz, ny, nx]``, or
the pair of a score and an angular support in degrees. Its other parameters are the method's settings, with their types
and defaults. It is named

* ``file.py:function``, or ``file.py`` where the function is called ``image``;
* by an entry point of the group ``mvla_sim.methods`` of a package that is installed;
* by itself: ``reconstruct(channel, method=function)``.

Its settings stand under ``[imaging.NAME]``, NAME that of the function or, for ``image``, that of the file.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import traceback
import types
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import PydanticUserError, create_model

from mvla_sim.errors import ConfigError, DataError, MvlaError, reason
from mvla_sim.imaging.method import METHODS, Method
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.kinds import module_of_file

__all__ = ["FunctionMethod", "named", "names_a_file", "of_file", "of_value"]

Function = Callable[..., Any]


class FunctionMethod(Method):
    """A function as a method; its parameters are the fields."""

    uses_pdp: ClassVar[bool] = True
    function: ClassVar[Function]
    source: ClassVar[str] = ""
    """SHA-256 of the file the function is in."""

    @classmethod
    def digest(cls) -> str:
        """SHA-256 of the file the function is in; empty where there is none."""
        return cls.source

    def __reduce__(self) -> tuple[Any, ...]:
        """Other processes find the class by its name."""
        return _again, (self.name, {name: getattr(self, name) for name in type(self).model_fields})

    def image(self, seen: Observation) -> Estimate:
        """Call the function, and check what it returns.

        Raises
        ------
        DataError
            It raised an error, or what it returned is no image of the grid; one line.
        """
        own = {name: getattr(self, name) for name in type(self).model_fields}
        try:
            found = type(self).function(seen, **own)
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


def names_a_file(name: str) -> bool:
    """Whether a method's name is that of a file's function."""
    return _split(name) is not None


def of_file(name: str) -> type[Method] | None:
    """The method of a name like ``file.py:function``; None for a name of another kind.

    Raises
    ------
    ConfigError
        The file cannot be read or imported, or lacks the function; one line.
    """
    parts = _split(name)
    if parts is None:
        return None
    file, function = parts
    module, digest = module_of_file(file, f"method = '{name}'")
    METHODS.of_files[name] = _of_module(name, module, file.stem, function, digest)
    return METHODS.of_files[name]


def of_value(name: str, value: Any) -> type[Method] | None:
    """The method that an entry point offers as a function; None where it is none."""
    return _method(name, name, value, _digest(value)) if callable(value) and not isinstance(value, type) else None


def named(function: Function) -> str:
    """Make a function known as a method by its own name, and return that.

    Raises
    ------
    ConfigError
        It has no name, or the name of one of this package's methods.
    """
    inner = function
    while isinstance(inner, functools.partial):
        inner = inner.func
    name = getattr(inner, "__name__", type(inner).__name__)
    if not name.isidentifier():
        raise ConfigError(f"method = {name}: a function without a name; define it with def")
    METHODS.add(name, _method(name, name, function, _digest(inner)))
    return name


def _split(name: str) -> tuple[Path, str] | None:
    """File and function of a method named ``file.py:function``; None for a name of another kind."""
    file, colon, function = name.rpartition(":")
    if not (colon and file.endswith(".py")):
        file, function = name, "image"
    return (Path(file).expanduser(), function) if file.endswith(".py") and function.isidentifier() else None


def _method(name: str, block: str, function: Function, digest: str) -> type[Method]:
    """Build the class of a function: a field for each parameter behind the first."""
    fields: dict[str, Any] = {}
    try:
        parameters = list(inspect.signature(function, eval_str=True).parameters.values())[1:]
    except (TypeError, ValueError, NameError) as error:
        raise ConfigError(f"method = '{name}': its parameters cannot be told ({reason(error)})") from error
    for parameter in parameters:
        if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        if hasattr(Method, parameter.name):
            raise ConfigError(f"method = '{name}': '{parameter.name}' is taken; give that parameter another name")
        default = ... if parameter.default is parameter.empty else parameter.default
        kind = parameter.annotation
        if kind is parameter.empty:
            kind = Any if default in (..., None) else type(default)
        fields[parameter.name] = (kind, default)
    try:
        cls = create_model(
            block, __base__=FunctionMethod, __module__=getattr(function, "__module__", __name__), **fields
        )
    except (PydanticUserError, NameError) as error:
        raise ConfigError(f"method = '{name}': a parameter's type cannot be checked ({reason(error)})") from error
    cls.name, cls.block, cls.source = name, block, digest
    cls.title = "" if names_a_file(name) else name
    cls.function = staticmethod(function)
    return cls


def _again(name: str, fields: dict[str, Any]) -> Method:
    return METHODS.find(name)(**fields)


@lru_cache(maxsize=32)
def _of_module(name: str, module: types.ModuleType, stem: str, function: str, digest: str) -> type[Method]:
    """The method of a file's function, one class for each version of the file."""
    return _method(name, stem if function == "image" else function, _callable(name, module, function), digest)


def _callable(name: str, module: types.ModuleType, function: str) -> Function:
    value = getattr(module, function, None)
    if not callable(value):
        raise ConfigError(f"method = '{name}': the file has no function '{function}'")
    checked: Function = value
    return checked


def _digest(function: Function) -> str:
    """Digest of the file that a function is defined in."""
    try:
        source = Path(inspect.getfile(inspect.unwrap(function))).read_bytes()
    except (OSError, TypeError):
        return ""
    return hashlib.sha256(source).hexdigest()


METHODS.resolvers.append(of_file)
METHODS.adapters.append(of_value)
