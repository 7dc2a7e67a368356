"""Readings of the paper: presets of all that it leaves open, which settings of one's own go on top of."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from typing import Any, Final

from mvla_sim.errors import ConfigError, MvlaWarning
from mvla_sim.settings import read_toml
from mvla_sim.shipped import find

__all__ = ["ReadingWarning", "load_reading", "on_reading"]

BLOCKS: Final = ("imaging", "evaluation")
"""What a reading may set."""
_TAGS: Final = ("kind", "rule")
"""Keys that tell kinds apart; what belongs to another kind is no preset."""


class ReadingWarning(MvlaWarning):
    """A setting of a reading gives way to one that is set by hand."""


def load_reading(name: str) -> dict[str, Any]:
    """Read a reading: ``paper``, ``physical``, or a file of one's own.

    Returns
    -------
    dict
        Its tables ``imaging`` and ``evaluation``, as they are in the file.

    Raises
    ------
    DataError
        There is no such reading; the message lists those there are.
    ConfigError
        The file has other keys.
    """
    file = find("readings", name)
    data = read_toml(file, "reading")
    for key, value in data.items():
        if key == "description" or (key in BLOCKS and isinstance(value, dict)):
            continue
        raise ConfigError(f"{file}: {key}: unknown key of a reading; allowed: description, {', '.join(BLOCKS)}")
    return {key: data[key] for key in BLOCKS if key in data}


def on_reading(name: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Put one's own settings on top of a reading's.

    What is set by hand wins; where it differs, a :class:`ReadingWarning` says so. A kind set by hand, as of noise,
    takes nothing of another kind.

    Raises
    ------
    DataError, ConfigError
        As :func:`load_reading`.
    """
    preset = load_reading(name)
    for key, theirs, ours in _clashes(preset, own, ""):
        warnings.warn(
            f"{key} = {ours!r} is set by hand and wins over {theirs!r} of the reading '{name}'",
            ReadingWarning,
            stacklevel=3,
        )
    return _merged(preset, own)


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    if any(tag in above and above[tag] != below.get(tag) for tag in _TAGS):
        return dict(above)
    both = {key: _merged(below[key], above[key]) for key in below.keys() & above.keys() if _tables(below, above, key)}
    return {**below, **above, **both}


def _clashes(below: Mapping[str, Any], above: Mapping[str, Any], path: str) -> Iterator[tuple[str, Any, Any]]:
    for key in below.keys() & above.keys():
        if _tables(below, above, key):
            yield from _clashes(below[key], above[key], f"{path}{key}.")
        elif below[key] != above[key]:
            yield f"{path}{key}", below[key], above[key]


def _tables(below: Mapping[str, Any], above: Mapping[str, Any], key: str) -> bool:
    return isinstance(below[key], Mapping) and isinstance(above[key], Mapping)
