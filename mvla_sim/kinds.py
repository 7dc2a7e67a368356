"""Kinds of things that settings name, as shapes, trajectories or methods: each one class in one file, found by name.

A kind is a :class:`Kind` with a :class:`Kinds` list. Whoever adds a shape writes a class in a file of the kind's own
package; other packages offer theirs as an entry point of the group; a script or notebook need only define the class.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import hashlib
import importlib
import importlib.util
import inspect
import json
import pkgutil
import sys
import types
import typing
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, TypeVar

from pydantic import BaseModel, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from mvla_sim.errors import ConfigError, reason
from mvla_sim.settings import Settings

__all__ = ["Kind", "Kinds", "module_of_file", "source_digest"]

OWN: Final = "mvla_sim."
"""Where the names of this package's modules begin."""


class Kind(Settings):
    """One kind of a thing: its settings, and the code that they set. Subclasses that have a name are found by it."""

    kinds: ClassVar[Kinds[Any]]
    """The list it is found in."""

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        super().__pydantic_init_subclass__(**kwargs)
        name = cls.kinds.name_of(cls)
        inherited = {cls.kinds.name_of(base) for base in cls.__mro__[1:] if issubclass(base, Kind) and base is not Kind}
        if name is not None and name not in inherited:
            cls.kinds.add(name, cls)

    def model_post_init(self, context: Any, /) -> None:
        """Count the tag as given, so that data without defaults still say which class they are of."""
        super().model_post_init(context)
        if self.kinds.key is not None:
            self.model_fields_set.add(self.kinds.key)


K = TypeVar("K", bound=Kind)


class Kinds(Generic[K]):
    """All classes of one kind by name, and the annotation of fields that hold one: ``Annotated[Shape, SHAPES]``.

    Parameters
    ----------
    what
        What one of them is called, for messages: "shape".
    group
        Entry points under which other packages offer theirs: "mvla_sim.shapes".
    home
        Package of this program with a module each: "mvla_sim.scene.shapes".
    key
        Field that names the class in settings, a ``Literal`` in each; None where the class itself has a ``name``.
    default
        Name that is meant where the key is missing.
    short
        Whether the name alone may stand for a table of defaults, as ``threshold = "auto"``.
    """

    def __init__(
        self, what: str, group: str, home: str, *, key: str | None, default: str | None = None, short: bool = False
    ) -> None:
        self.what = what
        self.group = group
        self.home = home
        self.key = key
        self.default = default
        self.short = short
        self.resolvers: list[Callable[[str], type[K] | None]] = []
        """Ways to find what goes by other names than classes, as ``file.py:function``."""
        self.adapters: list[Callable[[str, Any], type[K] | None]] = []
        """Ways to make a class of a name and of what an entry point offers that is none."""
        self._classes: dict[str, type[K]] = {}
        self._complete = False
        self._own: tuple[type[K], ...] | None = None

    def name_of(self, cls: type[Kind]) -> str | None:
        """The name a class is found by; None for a base of others."""
        if self.key is None:
            name: str | None = vars(cls).get("name")
            return name
        field = cls.model_fields.get(self.key)
        choices = typing.get_args(field.annotation) if field is not None else ()
        return str(choices[0]) if choices else None

    def add(self, name: str, cls: type[K]) -> None:
        """Make a class known by a name.

        Raises
        ------
        ConfigError
            The name is that of one of this package's own.
        """
        known = self._classes.get(name)
        same = known is None or (known.__module__, known.__qualname__) == (cls.__module__, cls.__qualname__)
        if known is not None and not same and known.__module__.startswith(OWN):
            raise ConfigError(f"{self.what} '{name}' is one of mvla-sim's own; give {cls.__qualname__} another name")
        self._classes[name] = cls
        self._own = None

    def names(self) -> tuple[str, ...]:
        """Names of all: this package's, those defined while it runs, those that installed packages offer."""
        self._load_own()
        return tuple(sorted({*self._classes, *(point.name for point in self._points())}))

    def own(self) -> tuple[type[K], ...]:
        """This package's classes, by name."""
        self._load_own()
        if self._own is None:  # asked for with every validation
            found = sorted(self._classes.items())
            self._own = tuple(cls for _, cls in found if cls.__module__.startswith(OWN))
        return self._own

    def installed(self) -> tuple[type[K], ...]:
        """This package's classes, then those that installed packages offer; without those that cannot be imported."""
        found = list(self.own())
        for point in self._points():
            with contextlib.suppress(ConfigError):
                found.append(self.find(point.name))
        return tuple(dict.fromkeys(found))

    def find(self, name: str) -> type[K]:
        """Return the class of a name.

        Raises
        ------
        ConfigError
            There is none, or the package that offers it cannot be imported; one line.
        """
        if name not in self._classes:
            self._load_own()
            found = next((cls for resolve in self.resolvers if (cls := resolve(name)) is not None), None)
            if found is not None:
                return found
        if name not in self._classes:
            point = next((point for point in self._points() if point.name == name), None)
            if point is None:
                close = difflib.get_close_matches(name, self.names(), n=1)
                hint = f" (did you mean '{close[0]}'?)" if close else ""
                raise ConfigError(f"'{name}' is no {self.what}{hint}; allowed: {', '.join(self.names())}")
            self.add(name, self.offered(point))
        return self._classes[name]

    def offered(self, point: EntryPoint) -> type[K]:
        """The class behind an entry point."""
        try:
            found = point.load()
        except Exception as error:
            raise ConfigError(
                f"{self.what} '{point.name}': {point.value} cannot be imported ({reason(error)})"
            ) from error
        if isinstance(found, type) and issubclass(found, Kind) and found.kinds is self:
            return typing.cast("type[K]", found)
        made = next((cls for adapt in self.adapters if (cls := adapt(point.name, found)) is not None), None)
        if made is None:
            raise ConfigError(f"{self.what} '{point.name}': {point.value} is no class of that kind")
        return made

    def model_of(self, value: Any) -> type[K] | None:
        """The class that plain data are settings of; None where they name none.

        Raises
        ------
        ConfigError
            They name one that there is not.
        """
        if isinstance(value, dict) and self.key is not None:
            value = value.get(self.key, self.default)
        return self.find(value) if isinstance(value, str) else None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate a table as the class it names; objects of the kind are taken as they are."""
        del handler
        return core_schema.with_info_plain_validator_function(
            lambda value, info: self._validated(value, source, info.mode),
            serialization=core_schema.simple_ser_schema("any"),
        )

    def _validated(self, value: Any, base: type[K], mode: str) -> Any:
        if isinstance(value, base):
            return value
        if isinstance(value, str) and self.short:
            value = {str(self.key): value}
        if not isinstance(value, dict):
            raise PydanticCustomError("kind", "{message}", {"message": self._wrong(value)})
        named = value.get(str(self.key), self.default)
        try:
            model = self.model_of(value)
        except ConfigError as error:
            raise self._of_key(named, str(error)) from error
        if model is None:
            missing = f"missing key '{self.key}'; allowed: {', '.join(self.names())}"
            message = missing if named is None else "must be a name"
            raise self._of_key(named, message)
        if mode == "json":
            return model.model_validate_json(json.dumps(value), strict=True)
        return model.model_validate(value)

    def _wrong(self, value: Any) -> str:
        """What to say about a value that is neither of the kind nor a table."""
        shown = f"{type(value).__name__} " if isinstance(value, BaseModel) else ""
        if isinstance(value, Kind):
            shown += f"is a {value.kinds.what} and "
        allowed = ", ".join(cls.__name__ for cls in self.own())
        return f"{shown}is no {self.what}; allowed: {allowed}, or a table of settings"

    def _of_key(self, named: Any, message: str) -> ValidationError:
        error = PydanticCustomError("kind", "{message}", {"message": message})
        details = InitErrorDetails(type=error, loc=(str(self.key),), input=named)
        return ValidationError.from_exception_data(self.what, [details])

    def _points(self) -> list[EntryPoint]:
        return sorted(entry_points(group=self.group), key=lambda point: point.name)

    def _load_own(self) -> None:
        if not self._complete:
            self._complete = True
            package = importlib.import_module(self.home)
            for module in pkgutil.iter_modules(package.__path__):
                importlib.import_module(f"{self.home}.{module.name}")


def module_of_file(file: Path, what: str) -> tuple[types.ModuleType, str]:
    """Import a Python file under a name of its own, once for each of its versions.

    Parameters
    ----------
    file
        The file.
    what
        The setting that names it, for messages: "method = 'mine.py:image'".

    Returns
    -------
    module, str
        The module, and the SHA-256 of the file in hexadecimal.

    Raises
    ------
    ConfigError
        The file cannot be read or imported; one line.
    """
    try:
        stamp = file.stat()
        return _imported(file.resolve(), (stamp.st_mtime_ns, stamp.st_size))
    except OSError as error:
        raise ConfigError(f"{what}: {file} cannot be read ({error.strerror})") from error
    except _BrokenFileError as error:
        raise ConfigError(f"{what}: {file.name} cannot be imported ({error})") from error


class _BrokenFileError(Exception):
    """Why a file cannot be imported."""


@functools.lru_cache(maxsize=32)
def _imported(file: Path, stamp: tuple[int, int]) -> tuple[types.ModuleType, str]:
    del stamp
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    name = f"mvla_file_{digest[:16]}"
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None  # the name ends with .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and pickle look there
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise _BrokenFileError(reason(error)) from error
    return module, digest


def source_digest(cls: type) -> str:
    """SHA-256, in hexadecimal, of the files in which a class and its bases outside of libraries are defined.

    Empty where there is no file, as of a class that was typed into a prompt.
    """
    files = []
    for base in cls.__mro__:
        if issubclass(base, Settings) and base not in (Settings, Kind):
            try:
                files.append(Path(inspect.getfile(base)))
            except (OSError, TypeError):
                return ""
    digest = hashlib.sha256()
    for file in dict.fromkeys(files):
        try:
            digest.update(file.read_bytes())
        except OSError:
            return ""
    return digest.hexdigest()
