"""Text files as other programs write them: their encoding by its mark, their lines by line ends alone."""

from __future__ import annotations

import codecs
import os
import re
from pathlib import Path
from typing import Final

from mvla_sim.errors import DataError

__all__ = ["lines_of", "read_text"]

_MARKS: Final = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # before UTF-16, whose mark it begins with
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_LINE_END: Final = re.compile(r"\r\n|\n|\r")


def read_text(file: str | os.PathLike[str], most_bytes: int = -1) -> str:
    """Read a text file: UTF-8, UTF-16 or UTF-32 by its byte order mark, else UTF-8, else an 8-bit code of Windows.

    UTF-16 without a mark is known by its zeros: in a text of numbers every second byte is one. What an 8-bit byte
    stands for beyond ASCII is a guess (Windows-1252), which numbers never depend on. Of a long file ``most_bytes`` may
    be enough.

    Raises
    ------
    DataError
        It is marked as an encoding that it is not in.
    """
    path = Path(file)
    with path.open("rb") as stream:
        raw = stream.read(most_bytes)
    for mark, encoding in _MARKS:
        if raw.startswith(mark):
            try:
                return raw[len(mark) :].decode(encoding)
            except UnicodeDecodeError as error:
                name = encoding[:6].rstrip("-").upper()
                raise DataError(f"{path}: is marked as {name} and is not ({error.reason})") from error
    head = raw[:200]
    for encoding, zeros, others in (("utf-16-le", head[1::2], head[::2]), ("utf-16-be", head[::2], head[1::2])):
        if zeros and not any(zeros) and all(others):
            return raw.decode(encoding, "replace")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace")


def lines_of(text: str) -> list[str]:
    r"""Lines of a text: only ``\n``, ``\r\n`` and ``\r`` end one.

    :meth:`str.splitlines` also ends them at a form feed, at U+0085 and at U+2028, which may stand in a comment.
    """
    return _LINE_END.split(text)
