"""Folders of Touchstone files, one sweep a view, less a background and put to scale by a reference."""

from __future__ import annotations

import fnmatch
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.channel.readers.angles import angles_of_files, missing_angles
from mvla_sim.channel.readers.array_values import AXIS_TOLERANCE
from mvla_sim.channel.readers.nearby import what_to_give
from mvla_sim.channel.readers.source import Foreign, GivenRadio, Reader, note
from mvla_sim.channel.readers.touchstone_files import PARAMETER, Sweep, read_touchstone
from mvla_sim.channel.references import BackgroundSettings, ReferenceSettings, calibrate, subtract_background
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import ConfigError, DataError

__all__ = ["FolderSweeps", "TouchstoneFolder", "read_folder"]


class TouchstoneFolder(Reader):
    """A folder of Touchstone files, one a view."""

    name: ClassVar = "touchstone"
    block: ClassVar = "sweeps"
    takes: ClassVar = "a folder of .s1p/.s2p files"
    setting_files: ClassVar = (
        ("angle_file",),
        ("background", "file"),
        ("reference", "file"),
        ("reference", "background"),
    )

    files: str = Field("*.s[1-9]*p", description="which files of the folder are views")
    parameter: Annotated[str, Field(pattern=f"^{PARAMETER}$")] = Field(
        "S21", description="as S21: port received at, port transmitted from; S12,3 from ten ports on"
    )
    angle_pattern: str | None = Field(
        "{angle}", description="where a file's name says its angle, as in car_{angle}deg.s2p"
    )
    angle_file: str | None = Field(None, description="or a CSV file with the columns file,angle_deg")
    background: BackgroundSettings | None = Field(
        None, description="sweep without the target, subtracted from every view"
    )
    reference: ReferenceSettings | None = Field(
        None, description="sweep of a target of known cross-section, for delay and gain"
    )

    @classmethod
    def recognises(cls, source: Path) -> bool:
        """Whether it is a folder: of sweeps, if no other reader knows it."""
        return source.is_dir()

    def read(self, source: Path, radio: GivenRadio) -> Foreign:
        """Read every view, subtract the background, and calibrate by the reference."""
        del radio
        swept = read_folder(self, source)
        files, response, start, step = swept.files, swept.response, swept.start_hz, swept.step_hz
        facts = {"files": f"{files[0].name} to {files[-1].name}"}
        if lacking := missing_angles(swept.angles_deg):
            shown = ", ".join(f"{angle:g}" for angle in lacking[:8])
            note(f"{source}: no file for {len(lacking)} of the evenly spaced angles: {shown}°")
        background = None
        if self.background is not None:
            background = self._like(swept, self.background.file)
            less = subtract_background(response, background, start, step, self.background.align_m)
            response = less.response
            facts["background"] = f"{Path(self.background.file).name}, residual {np.median(less.residual_db):.1f} dB"
        if self.reference is not None:
            echo = self._like(swept, self.reference.file)
            empty = (
                self._like(swept, self.reference.background) if self.reference.background is not None else background
            )
            if empty is not None:
                align = self.background.align_m if self.background is not None else None
                echo = subtract_background(echo[None], empty, start, step, align).response[0]
            scaled = calibrate(response, echo, self.reference, start, step)
            response, gain_db = scaled.response, 20 * np.log10(scaled.gain_correction)
            facts["calibration"] = f"{scaled.delay_offset_s * 1e9:.4f} ns and {gain_db:.2f} dB by {self.reference.kind}"
        data = {"response": response, "start_hz": start, "step_hz": step}
        return Foreign(FrequencyResponse, data, len(files), angles_deg=swept.angles_deg, facts=facts)

    def _like(self, views: FolderSweeps, file: str) -> NDArray[np.complex128]:
        """Another sweep, which must have the views' axis."""
        other = read_touchstone(file, self.parameter)
        _refuse_other_axis(Sweep(views.start_hz, views.step_hz, views.response[0]), views.files[0], other, Path(file))
        return other.response


@dataclass(frozen=True, eq=False)
class FolderSweeps:
    """The sweeps of a folder by rising angle, degrees as the names or the angle file say it: a file and a row a view.

    Frequencies ``start_hz + step_hz·k``; ``response`` is ``[n_view, n_frequency]``.
    """

    files: tuple[Path, ...]
    angles_deg: NDArray[np.float64]
    start_hz: float
    step_hz: float
    response: NDArray[np.complex128]


def read_folder(settings: TouchstoneFolder, folder: str | os.PathLike[str]) -> FolderSweeps:
    """Read every sweep of a folder, with its angle.

    Parameters
    ----------
    settings
        Which files, which parameter, and where the angles are; sweeps of background and reference are no views.
    folder
        The folder. Only its own files count, none of its subfolders; case does not matter in the glob, and hidden
        files count only where the glob starts with a dot.

    Raises
    ------
    ConfigError
        A glob or an angle pattern that can match nothing.
    DataError
        No file; a file without an angle, an angle without a file, an angle twice (also a full turn apart); files of
        different frequencies; or a file that cannot be read.

    Notes
    -----
    How an angle stands in a name is with :func:`~mvla_sim.channel.readers.angles.angles_of_files`.
    """
    files = _view_files(settings, Path(folder))
    angles = angles_of_files(files, settings.angle_pattern, settings.angle_file)
    order = np.argsort(angles)
    files, angles = [files[i] for i in order], angles[order]
    first: Sweep | None = None
    rows: list[NDArray[np.complex128]] = []
    for file in files:
        sweep = read_touchstone(file, settings.parameter)
        first = first or sweep
        _refuse_other_axis(first, files[0], sweep, file)
        rows.append(sweep.response)
    assert first is not None
    if first.rounded:
        note(f"{files[0]}: frequencies are rounded by more than {AXIS_TOLERANCE:.0%} of a step; read as even steps of "
              f"{first.step_hz:.9g} Hz from {first.start_hz:.12g} Hz")  # fmt: skip
    return FolderSweeps(tuple(files), angles, first.start_hz, first.step_hz, np.stack(rows))


def _view_files(settings: TouchstoneFolder, folder: Path) -> list[Path]:
    if "/" in settings.files or "\\" in settings.files:
        raise ConfigError(f"sweeps.files = '{settings.files}': allowed: a pattern of names in the folder, without '/'")
    if not folder.is_dir():
        raise DataError(f"{folder}: {'is no folder' if folder.exists() else 'no such folder'}")
    try:
        names = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
    except OSError as error:
        raise DataError(f"{folder}: not readable ({error.strerror})") from error
    pattern = settings.files.lower()
    names = [name for name in names if not name.startswith(".") or pattern.startswith(".")]
    matching = [folder / name for name in names if fnmatch.fnmatchcase(name.lower(), pattern)]
    others = {settings.background and settings.background.file}
    if settings.reference:
        others |= {settings.reference.file, settings.reference.background}
    apart = {Path(name).resolve() for name in others if name}
    files = [file for file in matching if file.resolve() not in apart]
    if not files:
        if not matching and (advice := what_to_give(folder)):
            raise DataError(f"{folder}: {advice}")
        found = f"{len(names)} files: {', '.join(names[:3])}{', …' * (len(names) > 3)}" if names else "no file"
        if matching:
            found = f"only {', '.join(file.name for file in matching)} of background and reference"
        raise DataError(f"{folder}: no file matches sweeps.files = '{settings.files}'; the folder holds {found}")
    return files


def _refuse_other_axis(first: Sweep, first_file: Path, sweep: Sweep, file: Path) -> None:
    count, points = len(first.response), len(sweep.response)
    if points != count:
        raise DataError(f"{file}: has {points} frequencies, {first_file.name} has {count}; they must be the same")
    allowed = AXIS_TOLERANCE * first.step_hz
    for name, ours, theirs in (
        ("starts", sweep.start_hz, first.start_hz),
        ("ends", sweep.start_hz + sweep.step_hz * (points - 1), first.start_hz + first.step_hz * (count - 1)),
    ):
        if abs(ours - theirs) > allowed:
            raise DataError(f"{file}: {name} at {ours:.12g} Hz, {first_file.name} at {theirs:.12g} Hz; allowed: equal")
