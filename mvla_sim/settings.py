"""Reading TOML into validated settings, and saying what is wrong with it in one line."""

from __future__ import annotations

import contextlib
import copy
import difflib
import json
import os
import re
import reprlib
import tomllib
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from mvla_sim.errors import ConfigError, check_argument
from mvla_sim.files import existing_file

__all__ = ["Settings", "apply_overrides", "assign", "parse", "read_toml", "resolve_beside", "with_nulls"]


SHORT: Final = reprlib.Repr()
SHORT.maxtuple, SHORT.maxlist, SHORT.maxdict, SHORT.maxstring, SHORT.maxother = 4, 4, 4, 60, 200


class Settings(BaseModel):
    """Base of all settings: immutable, no unknown keys, no NaN or infinity; errors are one line.

    Raises
    ------
    ConfigError
        A value is not allowed, or a key is unknown.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ConfigError(f"{type(self).__name__}: {describe(error, type(self), values)}") from error

    def __setattr__(self, name: str, value: Any) -> None:
        raise ConfigError(f"{type(self).__name__}: {name} cannot be changed; settings are fixed, make others")

    def __repr__(self) -> str:
        told = [
            f"{name}={SHORT.repr(getattr(self, name))}"
            for name, field in type(self).model_fields.items()
            if field.is_required() or getattr(self, name) != field.get_default(call_default_factory=True)
        ]
        return f"{type(self).__name__}({', '.join(told)})"

    __str__ = __repr__

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # settings inside others are validated as ever


Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """Read a TOML file into plain dictionaries.

    Raises
    ------
    DataError
        The file is missing, empty or unreadable.
    ConfigError
        It is not TOML; the message gives the line.
    """
    file = existing_file(path, what)
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: is not a text file (byte {error.start} is not UTF-8)") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{file}: is not valid TOML: {error}") from error


def parse(model: type[Model], data: Mapping[str, Any], source: str) -> Model:
    """Validate data strictly ("4" is not a number, 1 is not true) and return the model.

    TOML has no null, so the text ``"none"`` stands for it wherever a setting may be absent.

    Parameters
    ----------
    model
        The settings class to build.
    data
        Nested dictionaries, lists, strings and numbers, as read from TOML; in Python also settings that are built
        already, anywhere in them.
    source
        Where the data comes from, for messages: a file name or ``--set``.

    Raises
    ------
    ConfigError
        One line: source, key, value, and what is allowed.
    """
    chosen = with_nulls(model, data)
    try:
        if _has_settings(chosen):  # JSON would lose their classes
            return model.model_validate(chosen)
        return model.model_validate_json(json.dumps(chosen, default=_as_json), strict=True)
    except ValidationError as error:
        raise ConfigError(f"{source}: {describe(error, model, data)}") from error


def with_nulls(annotated: Any, data: Any) -> Any:
    """Copy of plain data with None for the text ``"none"`` wherever what it is validated as may be None."""
    annotation = annotated[0] if isinstance(annotated, tuple) else annotated
    if isinstance(data, Mapping):
        model = _model_for(annotated, data)
        if model is None:
            return {key: _in_parts(annotation, key, value) for key, value in data.items()}
        fields = {field.alias or name: (field.annotation, field.metadata) for name, field in model.model_fields.items()}
        extra = getattr(model, "model_of_extra", lambda _key, _data: None)
        return {key: with_nulls(fields.get(key) or extra(key, data), value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_in_parts(annotation, index, item) for index, item in enumerate(data)]
    return None if isinstance(data, str) and data == "none" and type(None) in _alternatives(annotation) else data


def _in_parts(annotation: Any, key: Any, data: Any) -> Any:
    """:func:`with_nulls` of one element of a list or table."""
    for part in _alternatives(annotation):
        inside = typing.get_args(part)
        if typing.get_origin(part) is dict and isinstance(key, str):
            return with_nulls(inside[1], data)
        if typing.get_origin(part) in (tuple, list) and isinstance(key, int):
            place = min(key, len(inside) - (2 if inside[-1] is ... else 1))
            return with_nulls(inside[place], data)
    return with_nulls(None, data)


def _alternatives(annotation: Any) -> list[Any]:
    """The types of a union, without what is annotated about them; of any other annotation itself."""
    if hasattr(annotation, "__metadata__"):
        return _alternatives(annotation.__origin__)
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return [part for one in typing.get_args(annotation) for part in _alternatives(one)]
    return [annotation]


def _has_settings(data: Any) -> bool:
    if isinstance(data, dict | list):
        return any(_has_settings(item) for item in (data.values() if isinstance(data, dict) else data))
    return isinstance(data, BaseModel)


def _as_json(value: Any) -> Any:
    """Arrays and numbers of NumPy as numbers; times and dates of TOML as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def describe(error: ValidationError, model: type[BaseModel], data: Any) -> str:
    """Turn pydantic's report into one line; the first error in full, the others counted."""
    details = error.errors(include_url=False)
    places = [item["loc"] for item in details]
    details = [
        item
        for item in details
        if not any(len(p) > len(item["loc"]) and p[: len(item["loc"])] == item["loc"] for p in places)
    ]  # a container's complaint about its own parts
    details = [item for item in details if not _other_branch(item)] or details
    details.sort(key=lambda item: item["type"] != "extra_forbidden")  # a typo explains the missing key it caused
    line = _describe_one(details[0], model, data)
    if len(details) > 1:
        line += f" [the first of {len(details)} errors]"
    return line


def apply_overrides(
    data: dict[str, Any], overrides: Sequence[str], full_key: Callable[[str], str] = str
) -> dict[str, Any]:
    """Return a copy of ``data`` with ``dotted.key=value`` overrides applied.

    A value is read as TOML (``20``, ``true``, ``[1, 2]``, ``"text"``) and, where it is none, taken as text.
    A number addresses an element of a list: ``objects.0.radius_m=3``. ``full_key`` makes a key of a shorter name.

    Raises
    ------
    ConfigError
        The override is not of this form or goes through a value that has no keys.
    """
    check_argument("overrides", overrides, list | tuple, "dotted.key=value texts")
    result = copy.deepcopy(data)
    for override in overrides:
        check_argument("overrides", override, str, "dotted.key=value texts")
        key, separator, text = override.partition("=")
        if not separator or not re.fullmatch(r"[\w-]+(\.[\w-]+)*", key.strip()):
            raise ConfigError(f"--set {override}: write dotted.key=value, for example --set noise.snr_db=10")
        assign(result, full_key(key.strip()), _value(text.strip()), f"--set {override}")
    return result


def assign(data: dict[str, Any], dotted: str, value: Any, source: str = "settings") -> None:
    """Set ``data[a][b][c] = value`` for the dotted key ``a.b.c``, making missing tables on the way.

    Raises
    ------
    ConfigError
        The path goes through a single value, or past the end of a list.
    """
    keys = dotted.split(".")
    node: Any = data
    for position, key in enumerate(keys):
        index: Any = key
        if isinstance(node, list):
            if not key.isdigit() or int(key) >= len(node):
                raise ConfigError(
                    f"{source}: '{key}' is not an element of {'.'.join(keys[:position])}; allowed: 0 to {len(node) - 1}"
                )
            index = int(key)
        elif not isinstance(node, dict):
            raise ConfigError(f"{source}: '{'.'.join(keys[:position])}' is a single value and has no keys")
        if position == len(keys) - 1:
            node[index] = value
        else:
            if isinstance(node, dict) and node.get(index) is None:
                node[index] = {}
            node = node[index]


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _other_branch(item: ErrorDetails) -> bool:
    """Whether an error comes from the branch of a union that the given value's type does not point to."""
    return (item["type"] == "literal_error" and not isinstance(item.get("input"), str)) or (
        item["type"] == "model_type" and not isinstance(item.get("input"), dict)
    )


def _describe_one(item: ErrorDetails, model: type[BaseModel], data: Any) -> str:
    parent, path = _walk(model, item["loc"], data)
    value = item.get("input")
    shown = "" if value is None or isinstance(value, dict | list | tuple | BaseModel) else f" = {value!r}"
    if item["type"] == "extra_forbidden":
        allowed = sorted(field.alias or name for name, field in parent.model_fields.items()) if parent else []
        allowed += list(getattr(parent, "extra_models", dict)())
        inside = _inside(parent) | dict(zip(allowed, allowed, strict=True))
        close = difflib.get_close_matches(str(item["loc"][-1]), inside, n=1)
        hint = f" (did you mean '{inside[close[0]]}'?)" if close else ""
        return f"{path}: unknown key{hint}" + (f"; allowed: {', '.join(allowed)}" if allowed else "")
    if item["type"] == "missing":
        return f"{path}: missing key"
    message = item["msg"].removeprefix("Value error, ").removeprefix("Input ")
    return f"{path}{shown}: {message}" if path else message


def _inside(model: type[BaseModel] | None) -> dict[str, str]:
    """Keys one table further in by their last part, as "noise.snr_db" by "snr_db"."""
    blocks = model.model_fields.items() if model else ()
    return {name: f"{block}.{name}" for block, field in blocks
            for name in getattr(type(field.default), "model_fields", ())}  # fmt: skip


def _walk(model: type[BaseModel], location: tuple[int | str, ...], data: Any) -> tuple[type[BaseModel] | None, str]:
    """Follow an error's location through settings and the data they were given.

    Returns
    -------
    class, path
        The settings class whose field the location ends in, None where it is none's; and the dotted path. What pydantic
        puts into a location to tell the branches of a union apart is in neither.
    """
    current: type[BaseModel] | None = model
    inside: Any = None  # annotation of a field or of its elements, as long as it is not known to be settings
    path = ""
    for place, key in enumerate(location):
        if isinstance(key, int):
            path += f"[{key}]"
            data = data[key] if isinstance(data, list | tuple) and key < len(data) else None
            current = _model_for(inside, data)
            continue
        fields = current.model_fields if current is not None else {}
        field = fields.get(key) or next((f for f in fields.values() if f.alias == key), None)
        known = isinstance(data, dict) and key in data
        if field is None and not known:
            continue  # the tag of a branch
        path += f".{key}" if path else key
        before = data
        data = data[key] if known else None
        inside = None if field is None else (field.annotation, field.metadata)
        own = _model_for(inside, data)
        if field is None and current is not None and hasattr(current, "model_of_extra"):
            own = current.model_of_extra(key, before)
        parent, current = current, own
        if place == len(location) - 1:
            return parent, path
    return current, path


def _model_for(annotated: Any, data: Any) -> type[BaseModel] | None:
    """The settings class that data of an annotation is validated as; ``annotated`` may carry a field's metadata."""
    annotation, metadata = annotated if isinstance(annotated, tuple) else (annotated, ())
    for item in metadata:
        if hasattr(item, "model_of"):
            with contextlib.suppress(ConfigError):
                found: type[BaseModel] | None = item.model_of(data)
                return found
            return None
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if hasattr(annotation, "__metadata__"):
        return _model_for((annotation.__origin__, annotation.__metadata__), data)
    if typing.get_origin(annotation) is None and not isinstance(annotation, types.UnionType):
        return None
    models = [found for part in typing.get_args(annotation) if (found := _model_for(part, data)) is not None]
    return next((model for model in models if _is_of(model, data)), models[0] if models else None)


def _is_of(model: type[BaseModel], data: Any) -> bool:
    """Whether data have the values that tell a class apart from others: those of its ``Literal`` fields of one."""
    tags = {name: field for name, field in model.model_fields.items() if len(_choices(field.annotation)) == 1}
    return isinstance(data, dict) and all(
        data.get(name, field.default) == _choices(field.annotation)[0] for name, field in tags.items()
    )


def _choices(annotation: Any) -> tuple[Any, ...]:
    return typing.get_args(annotation) if typing.get_origin(annotation) is typing.Literal else ()


def resolve_beside(file: str, folder: Path) -> str:
    """Make a file name inside a TOML file relative to that file's folder."""
    return str(folder / file)
