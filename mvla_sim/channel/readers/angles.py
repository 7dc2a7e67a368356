"""Angles of sweeps: told by the names of files or by a list, each once, and what an even grid of them lacks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.readers.source import note
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.columns import read_columns

__all__ = ["angles_of_files", "closing_view", "missing_angles"]

ANGLE_TOLERANCE_DEG: Final = 1e-6
"""Angles this near to each other are one angle."""

CLOSING_TOLERANCE_DEG: Final = 1e-3
"""How far the ends of a whole turn may be from 360° apart; angles in radians of single precision miss it by 1e-5."""

_NUMBER = r"\d+(?:[.,pP]\d+)?(?![\d.]*\d)"
_MARKS: Final = re.compile(r"[,pP]")


def angles_of_files(files: Sequence[Path], pattern: str | None, angle_file: str | None) -> NDArray[np.float64]:
    """Angle of each file by its name or by the angle file, ``[n_file]`` degrees.

    Raises
    ------
    ConfigError
        An angle pattern that says no place for the angle.
    DataError
        A file without an angle, an angle without a file, or an angle twice, also a full turn apart; but the view that
        closes a whole turn may repeat the first.

    Notes
    -----
    In ``pattern`` ``{angle}`` is a decimal number with or without a sign, all else is literal. Its mark is a point, a
    comma or, where file names allow neither, a ``p`` between digits (``car_12p5deg``); a note says so. It is searched
    for anywhere in the name without its suffix (a pattern may end in the suffix) and must fit in one place only.
    A sign right after a letter or digit is a hyphen (``car-10``), unless the pattern has text there (``car{angle}``).
    ``angle_file`` wins over the pattern.
    """
    if angle_file is not None:
        listed = _listed_angles(angle_file, files)
    elif pattern is None or pattern.count("{angle}") != 1:
        raise ConfigError(f"sweeps.angle_pattern = {pattern!r}: must hold {{angle}} once, or give sweeps.angle_file")
    else:
        texts = [_angle_in_name(file, pattern) for file in files]
        listed = [float(_MARKS.sub(".", text)) for text in texts]
        marked = next((i for i, text in enumerate(texts) if _MARKS.search(text)), None)
        if marked is not None:
            note(f"{files[marked]}: '{texts[marked]}' in its name is read as {listed[marked]:g}°")
        _check_finite(listed, files)
    angles = np.array(listed, np.float64)
    _refuse_equal(angles, files)
    return angles


def closing_view(angles_deg: NDArray[np.float64]) -> int | None:
    """View that repeats another at the end of a whole turn, as of a turntable that goes from 0° to 360° inclusive.

    Of the first and the last angle, ``[n_view]`` degrees in any order, the one that comes later; None where these are
    not one direction. Every import leaves this view out.
    """
    angles = np.asarray(angles_deg, np.float64)
    if angles.size < 3:
        return None
    ends = int(angles.argmin()), int(angles.argmax())
    return max(ends) if abs(angles[ends[1]] - angles[ends[0]] - 360) <= CLOSING_TOLERANCE_DEG else None


def missing_angles(angles_deg: NDArray[np.float64]) -> list[float]:
    """Angles that an even grid lacks, where all but a few steps of ``angles_deg`` [n_view] are equal; else none.

    A few are a tenth of the steps, or one. The step across 0°/360° counts where it lacks no more than that either;
    a wider one is the open side of an arc.
    """
    angles = np.sort(np.asarray(angles_deg, np.float64))
    if len(angles) < 4:
        return []
    steps = np.diff(angles)
    few = max(1, len(steps) // 10)
    regular = float(np.median(steps))
    if regular <= 0:
        return []
    closing = angles[0] + 360 - angles[-1]
    if regular < closing < (few + 1.5) * regular:
        angles, steps = np.append(angles, angles[0] + 360), np.append(steps, closing)
    count = np.rint(steps / regular)
    if (count < 1).any() or (abs(steps / regular - count) > 0.05).any() or (count > 1).sum() > few:
        return []  # 5 %: angles in names are rounded
    gaps = np.flatnonzero(count > 1)
    lacking = [angles[i] + steps[i] * k / count[i] for i in gaps for k in range(1, int(count[i]))]
    return [float(np.round(angle % 360, 6)) for angle in lacking]


def _angle_in_name(file: Path, pattern: str) -> str:
    if file.suffix and pattern.lower().endswith(file.suffix.lower()):
        pattern = pattern[: -len(file.suffix)]
    before, after = pattern.split("{angle}")
    sign = "[+-]?" if before else r"(?:(?<![^\W_])[+-])?(?<![\d.,])(?<!\dp)(?<!\dP)"
    end = re.escape(after) or r"(?![.,pP\d]*\d)"
    expression = f"{re.escape(before)}({sign}{_NUMBER}){end}"
    found = [match[1] for match in re.finditer(expression, file.stem, re.ASCII)]
    if len(found) != 1:
        what = f"{len(found)} angles ({', '.join(found)})" if found else "no angle"
        raise DataError(
            f"{file}: its name has {what} by sweeps.angle_pattern = '{pattern}'; set the text around the angle, as in "
            "'car_{angle}deg', or an angle_file"
        )
    return found[0]


def _check_finite(angles_deg: Sequence[float], files: Sequence[Path]) -> None:
    for file, angle in zip(files, angles_deg, strict=True):
        if not np.isfinite(angle):
            raise DataError(f"{file}: its name's angle is not a finite number")


def _listed_angles(angle_file: str, files: Sequence[Path]) -> list[float]:
    table = read_columns(angle_file, "angles file", ("angle_deg",), texts=("file",))
    names = table.words["file"]
    known = dict(zip(names, table.numbers["angle_deg"].tolist(), strict=True))
    if len(known) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DataError(f"{angle_file}: lists file '{twice}' twice")
    views = {file.name for file in files}
    for name in names:
        if name not in views:
            raise DataError(f"{angle_file}: file '{name}' is none of the {len(views)} views in {files[0].parent}")
    for file in files:
        if file.name not in known:
            raise DataError(f"{file}: has no angle in {angle_file}")
    return [known[file.name] for file in files]


def _refuse_equal(angles_deg: NDArray[np.float64], files: Sequence[Path]) -> None:
    closing = closing_view(angles_deg)
    if closing is not None:
        angles_deg, files = np.delete(angles_deg, closing), [*files[:closing], *files[closing + 1 :]]
    turned = np.mod(angles_deg, 360)
    order = np.argsort(turned, kind="stable")
    gaps = np.diff(turned[order], append=turned[order[0]] + 360)
    same = np.flatnonzero(gaps < ANGLE_TOLERANCE_DEG)
    if len(files) > 1 and len(same):
        i, j = sorted((order[same[0]], order[(same[0] + 1) % len(order)]))
        raise DataError(
            f"{files[i]}: has the angle {angles_deg[i]:g}°, {files[j].name} has {angles_deg[j]:g}°: the same view "
            "twice; leave one out"
        )
