"""Errors that a user can fix: one line that names the file or key, the value and what is allowed."""

from __future__ import annotations

import typing
from typing import Any

__all__ = [
    "ConfigError", "DataError", "MvlaError", "MvlaWarning", "OutputError", "RuntimeUnfitError", "check_argument",
    "reason",
]  # fmt: skip


class MvlaError(Exception):
    """Base of every error this package raises on purpose.

    The command line prints it as one line and leaves with :attr:`exit_code`; a traceback never reaches the user.

    Attributes
    ----------
    setting
        Name of the argument or setting that helps, as ``workers``; None where there is none. The command line names
        its option for it.
    """

    exit_code = 2

    def __init__(self, message: str = "", *, setting: str | None = None) -> None:
        super().__init__(message)
        self.setting = setting


class ConfigError(MvlaError, ValueError):
    """A setting is unknown, of the wrong type, or outside what is allowed."""


class DataError(MvlaError, ValueError):
    """An input file or array cannot be used: missing, truncated, of another schema, or physically impossible."""


class OutputError(MvlaError, OSError):
    """An output cannot be written: read-only, disk full, or not a place for files."""


class RuntimeUnfitError(MvlaError, RuntimeError):
    """This machine cannot run the compiled kernels as it is set up; the message says how to fix it."""


class MvlaWarning(UserWarning):
    """Something was assumed, or is allowed and seldom meant; the command line prints it as a note of one line."""


def check_argument(name: str, value: object, kind: Any, remedy: str) -> None:
    """Refuse an argument that is of another class than it must be.

    Parameters
    ----------
    name
        The argument's.
    value
        What was given.
    kind
        Class that it must be of, or a union of classes.
    remedy
        How to come by one, for the message.

    Raises
    ------
    ConfigError
        It is none.
    """
    if not isinstance(value, kind):
        names = " or ".join(one.__name__ for one in typing.get_args(kind) or (kind,))
        raise ConfigError(f"{name}: {type(value).__name__} is no {names}; {remedy}")


def reason(error: BaseException) -> str:
    """Type and message of an error in one line."""
    name = type(error).__name__
    return f"{name}: {' '.join(str(error).split())}" if str(error) else name
