"""Settings of ``mvla import``: what foreign files hold, and where they were measured."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from mvla_sim.scene.antenna import ANTENNAS, Antenna
from mvla_sim.scene.antennas.omni import Omni
from mvla_sim.scene.pointing import PointingSettings
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside

__all__ = [
    "ArraySettings",
    "BackgroundSettings",
    "GeometrySettings",
    "ImportSettings",
    "PairSelectionSettings",
    "ReferenceSettings",
    "SweepSettings",
    "import_settings",
    "resolve_files",
]

SourceKind = Literal["touchstone", "arrays", "components", "deepmimo", "insite"]
Gate = tuple[NonNegativeFloat, PositiveFloat]


def _check_gate(name: str, gate: Gate | None) -> None:
    if gate is not None and gate[0] >= gate[1]:
        raise ValueError(f"{name} = {list(gate)} must be [near, far] with near below far")


class GeometrySettings(Settings):
    """Where the views were measured, for data that say an angle a view at most.

    The sensor is at ``radius_m`` from the centre. ``angles = "target"``: the target has turned counter-clockwise by the
    angle before a fixed sensor (a turntable); ``"sensor"``: the sensor stands in that direction.
    """

    angles: Literal["target", "sensor"] = "target"
    radius_m: PositiveFloat | None = Field(None, description="horizontal distance from centre to sensor")
    height_m: float = Field(0.0, description="height of the sensor in the target's frame")
    zero_deg: float = Field(0.0, description="direction of the sensor from the centre where the angle is 0")
    clockwise: bool = Field(False, description="angles are counted clockwise")
    center_m: tuple[float, float] = (0.0, 0.0)
    pair_separation_m: NonNegativeFloat = Field(0.0, description="distance of transmitter and receiver, side by side")
    pointing: PointingSettings = PointingSettings()
    positions: str | None = Field(
        None, description="CSV file instead: x_m,y_m[,z_m] and, where they differ, rx_x_m,rx_y_m[,rx_z_m], a row a view"
    )


class BackgroundSettings(Settings):
    """A sweep without the target, subtracted from every view.

    Oscillators drift between sweeps. ``align_m`` is a range interval that holds only what the target cannot change,
    such as the leakage from antenna to antenna: the background is turned to each view's phase there.
    """

    file: str
    align_m: Gate | None = None

    @model_validator(mode="after")
    def _check(self) -> BackgroundSettings:
        _check_gate("align_m", self.align_m)
        return self


class ReferenceSettings(Settings):
    """A sweep of a target of known range and echo: it fixes the zero of the range axis and the level.

    Levels become path gains between isotropic antennas: λ/(8πR) of a large flat plate at right angles, λ·a/(8πR(R + a))
    of a sphere of radius a, R to the nearest point of its surface; that is the radar equation where R is much larger.
    """

    file: str
    kind: Literal["sphere", "plate"]
    range_m: PositiveFloat = Field(description="from the middle of the antennas to the nearest point of the target")
    radius_m: PositiveFloat | None = Field(None, description="of the sphere")
    background: str | None = Field(None, description="sweep without the reference; by default background.file")
    gate_m: Gate | None = Field(None, description="measured ranges its echo is looked for in; by default all")

    @model_validator(mode="after")
    def _check(self) -> ReferenceSettings:
        _check_gate("gate_m", self.gate_m)
        if (self.kind == "sphere") != (self.radius_m is not None):
            raise ValueError(f"radius_m = {self.radius_m}: a sphere needs it, a plate has none")
        return self


class SweepSettings(Settings):
    """A folder of Touchstone files, one a view."""

    files: str = Field("*.s[12]p", description="which files of the folder are views")
    parameter: Annotated[str, Field(pattern=r"^[sS][12][12]$")] = Field("S21", description="S11, S21, S12 or S22")
    angle_pattern: str | None = Field(
        "{angle}", description="where a file's name says its angle, as in car_{angle}deg.s2p"
    )
    angle_file: str | None = Field(None, description="or a CSV file with the columns file,angle_deg")
    background: BackgroundSettings | None = None
    reference: ReferenceSettings | None = None


class ArraySettings(Settings):
    """Named arrays in a .mat, .npz, HDF5 or NetCDF file."""

    data: str = Field("response", description="name of the complex array [view, frequency] or [view, delay]")
    data_imag: str | None = Field(None, description="name of the imaginary part, where it is apart")
    axis: str = Field("frequency", description="name of the frequency or delay axis")
    axis_kind: Literal["frequency", "delay"] = "frequency"
    axis_unit: PositiveFloat = Field(1.0, description="Hz or s per unit of the axis: 1e9 for GHz, 1e-9 for ns")
    angles: str | None = Field(None, description="name of the angles, degrees, one a view")
    positions: str | None = Field(None, description="name of the positions, [view, 2 or 3] metres")
    receivers: str | None = Field(None, description="name of the receivers' positions, where they differ")


class PairSelectionSettings(Settings):
    """Which pairs of transmitter and receiver of a ray-tracing scenario become views."""

    which: Literal["auto", "co-located", "all"] = Field("auto", description="auto: co-located pairs if there are any")
    tolerance_m: NonNegativeFloat = Field(1.0, description="pairs this near to each other count as co-located")
    line_of_sight: bool = Field(False, description="keep direct paths, which are no echo of a target")
    transmit_power_dbm: float = Field(0.0, description="insite: what received powers are relative to")


class ImportSettings(Settings):
    """How to read foreign data. Everything but ``source`` has a default that fits the kind."""

    source: str = Field(description="folder or file")
    kind: SourceKind | None = Field(None, description="by default told from the source's name and contents")
    name: str | None = None
    geometry: GeometrySettings = GeometrySettings()
    antenna: Annotated[Antenna, ANTENNAS] = Field(Omni(), description="pattern of both antennas: omni, horn or file")
    sweeps: SweepSettings = SweepSettings()
    arrays: ArraySettings = ArraySettings()
    pairs: PairSelectionSettings = PairSelectionSettings()
    carrier_hz: PositiveFloat | None = Field(None, description="where the data do not say it")
    bandwidth_hz: PositiveFloat | None = Field(None, description="where the data do not say it")
    extent_m: PositiveFloat | None = Field(None, description="largest extent D of the target, if it is known")


_FILES = (
    ("source",),
    ("geometry", "positions"),
    ("antenna", "file"),
    ("sweeps", "angle_file"),
    ("sweeps", "background", "file"),
    ("sweeps", "reference", "file"),
    ("sweeps", "reference", "background"),
)


def import_settings(
    source: str | os.PathLike[str] | None = None,
    file: str | os.PathLike[str] | None = None,
    overrides: Sequence[str] = (),
    data: dict[str, Any] | None = None,
) -> ImportSettings:
    """Build import settings from a source, a TOML file, ``dotted.key=value`` overrides, or plain data.

    Parameters
    ----------
    source
        Folder or file to read; wins over that of the TOML file.
    file
        TOML file with the keys of :class:`ImportSettings`; names of files inside it are relative to it.
    overrides
        ``dotted.key=value`` texts, as with ``--set``.
    data
        Plain data instead of a TOML file.

    Raises
    ------
    ConfigError, DataError
        One line that names the file, the key, its value and what is allowed.
    """
    table = dict(data or {}) if file is None else read_toml(file, "import settings file")
    if file is not None:
        resolve_files(table, Path(file).parent)
    if source is not None:
        table["source"] = str(source)
    table = apply_overrides(table, overrides)
    return parse(ImportSettings, table, str(file) if file is not None else "import settings")


def resolve_files(table: dict[str, Any], folder: Path) -> None:
    """Make every file name in plain import settings relative to a folder, in place."""
    for keys in _FILES:
        node: Any = table
        for key in keys[:-1]:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(keys[-1]), str):
            node[keys[-1]] = resolve_beside(node[keys[-1]], folder)
