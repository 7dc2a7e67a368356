"""Reading TOML into validated settings, and saying what is wrong with it in one line."""

from __future__ import annotations

import difflib
import json
import os
import re
import tomllib
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from mvla_sim.errors import ConfigError
from mvla_sim.files import existing_file

__all__ = ["Settings", "apply_overrides", "assign", "parse", "read_toml", "resolve_beside"]


class Settings(BaseModel):
    """Base of every settings model: immutable, no unknown keys, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


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


def parse(model: type[Model], data: dict[str, Any], source: str) -> Model:
    """Validate plain data strictly ("4" is not a number, 1 is not true) and return the model.

    TOML has no null, so the text ``"none"`` stands for it wherever a setting may be absent.

    Parameters
    ----------
    model
        The settings class to build.
    data
        Nested dictionaries, lists, strings and numbers, as read from TOML.
    source
        Where the data comes from, for messages: a file name or ``--set``.

    Raises
    ------
    ConfigError
        One line: source, key, value, and what is allowed.
    """
    try:
        return model.model_validate_json(json.dumps(_nulls(data), default=str), strict=True)
    except ValidationError as error:
        raise ConfigError(f"{source}: {describe(error, model)}") from error


def _nulls(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _nulls(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_nulls(value) for value in data]
    return None if data == "none" else data


def describe(error: ValidationError, model: type[BaseModel]) -> str:
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
    line = _describe_one(details[0], model)
    if len(details) > 1:
        line += f" (and {len(details) - 1} more)"
    return line


def apply_overrides(data: dict[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """Return a copy of ``data`` with ``dotted.key=value`` overrides applied.

    A value is read as TOML (``20``, ``true``, ``[1, 2]``, ``"text"``) and, where it is none, taken as text.
    A number addresses an element of a list: ``objects.0.radius_m=3``.

    Raises
    ------
    ConfigError
        The override is not of this form or goes through a value that has no keys.
    """
    result: dict[str, Any] = json.loads(json.dumps(data, default=str))
    for override in overrides:
        key, separator, text = override.partition("=")
        if not separator or not re.fullmatch(r"\w+(\.\w+)*", key.strip()):
            raise ConfigError(f"--set {override}: write dotted.key=value, for example --set noise.snr_db=10")
        assign(result, key.strip(), _value(text.strip()), f"--set {override}")
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


def _describe_one(item: ErrorDetails, model: type[BaseModel]) -> str:
    parent, path = _walk(model, item["loc"])
    value = item.get("input")
    shown = "" if isinstance(value, dict | list) else f" = {value!r}"
    if item["type"] == "extra_forbidden":
        allowed = sorted(field.alias or name for name, field in parent.model_fields.items()) if parent else []
        close = difflib.get_close_matches(str(item["loc"][-1]), allowed, n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        return f"{path}: unknown key{hint}" + (f"; allowed: {', '.join(allowed)}" if allowed else "")
    if item["type"] == "missing":
        return f"{path}: missing key"
    message = item["msg"].removeprefix("Value error, ").removeprefix("Input ")
    if item["type"] == "union_tag_not_found":
        message = f"missing key {item.get('ctx', {}).get('discriminator', '')}"
    return f"{path}{shown}: {message}" if path else message


def _walk(model: type[BaseModel], location: tuple[int | str, ...]) -> tuple[type[BaseModel] | None, str]:
    """Follow an error's location through nested models; drop the union tags that pydantic puts into it."""
    current: type[BaseModel] | None = model
    candidates: list[type[BaseModel]] = []
    path = ""
    for key in location:
        if isinstance(key, int):
            path += f"[{key}]"
            continue
        if current is not None and key == current.__name__:
            continue
        if candidates and (tagged := [c for c in candidates if key in _tags(c)]):
            current, candidates = tagged[0], []
            continue
        if candidates and key in {c.__name__ for c in candidates}:
            current, candidates = next(c for c in candidates if c.__name__ == key), []
            continue
        if key.startswith("literal[") or (candidates and key in ("str", "float", "int")):
            continue
        path += f".{key}" if path else key
        field = current.model_fields.get(key) if current else None
        if field is None and current is not None:
            field = next((f for f in current.model_fields.values() if f.alias == key), None)
        if field is None:
            continue
        candidates = _models(field.annotation)
        if len(candidates) == 1 and not isinstance(field.discriminator, str):
            current, candidates = candidates[0], []
    return current, path


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Every settings class named inside a type annotation, through tuples, unions and ``Annotated``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if typing.get_origin(annotation) is None and not isinstance(annotation, types.UnionType):
        return []
    return [found for argument in typing.get_args(annotation) for found in _models(argument)]


def _tags(model: type[BaseModel]) -> set[str]:
    """The literal values of a model's ``shape`` or ``kind`` field: its tag in a union."""
    tags: set[str] = set()
    for name in ("shape", "kind"):
        if name in model.model_fields:
            tags.update(str(value) for value in typing.get_args(model.model_fields[name].annotation))
    return tags


def resolve_beside(file: str, folder: Path) -> str:
    """Make a file name inside a TOML file relative to that file's folder."""
    path = Path(file)
    return str(path if path.is_absolute() else folder / path)
