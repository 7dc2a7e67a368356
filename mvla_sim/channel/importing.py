"""Foreign data become channels: the reader of their kind, then positions, antennas and provenance."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    ConfigDict,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)  # fmt: skip
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from mvla_sim.channel.header import Channel
from mvla_sim.channel.overview import check_swept
from mvla_sim.channel.readers.angles import closing_view
from mvla_sim.channel.readers.arrays import ArrayReader
from mvla_sim.channel.readers.nearby import is_deepmimo_3
from mvla_sim.channel.readers.pairs import PairReader
from mvla_sim.channel.readers.source import READERS, Foreign, GivenRadio, Reader, note
from mvla_sim.channel.readers.touchstone import TouchstoneFolder
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import ConfigError, DataError, check_argument
from mvla_sim.scene.antenna import ANTENNAS, Antenna
from mvla_sim.scene.antennas.omni import Omni
from mvla_sim.scene.columns import PLACE, RECEIVER
from mvla_sim.scene.pointing import PointingSettings, pointed, side_by_side
from mvla_sim.scene.trajectories.positions import read_positions, views_of_columns
from mvla_sim.scene.trajectories.turntable import on_turntable
from mvla_sim.scene.trajectory import views_on_circle
from mvla_sim.scene.views import Views
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside

__all__ = ["GeometrySettings", "ImportSettings", "import_channel", "import_settings", "resolve_files", "source_kind"]


class GeometrySettings(Settings):
    """Where the views were measured, for data that say an angle a view at most.

    The sensor is at ``radius_m`` from the centre. ``angles = "target"``: the target has turned counter-clockwise by the
    angle before a fixed sensor (a turntable); ``"sensor"``: the sensor stands in that direction.
    """

    angles: Literal["target", "sensor"] = Field(
        "target", description="angles are of the turning target, or of the sensor"
    )
    radius_m: PositiveFloat | None = Field(None, description="horizontal distance from centre to sensor")
    height_m: float = Field(0.0, description="height of the sensor in the target's frame")
    zero_deg: float = Field(0.0, description="direction of the sensor from the centre where the angle is 0")
    clockwise: bool = Field(False, description="angles are counted clockwise")
    center_m: tuple[float, float] = Field(
        (0.0, 0.0), description="that the sensor goes about, or the target turns about, x and y"
    )
    pair_separation_m: NonNegativeFloat = Field(0.0, description="distance of transmitter and receiver, side by side")
    pointing: PointingSettings = PointingSettings()
    positions: str | None = Field(
        None, description="CSV file instead: x_m,y_m[,z_m] and, where they differ, rx_x_m,rx_y_m[,rx_z_m], a row a view"
    )


class ImportSettings(Settings):
    """How to read foreign data. Everything but ``source`` has a default that fits the kind.

    Readers of other packages have a block of their own name, as ``[import.NAME]``.
    """

    model_config = ConfigDict(extra="allow")

    source: str = Field(description="folder or file")
    kind: str | None = Field(None, description="reader; by default told from the source's name and contents")
    name: str | None = Field(None, description="of the measurement; by default that of the source")
    geometry: GeometrySettings = GeometrySettings()
    antenna: Annotated[Antenna, ANTENNAS] = Field(Omni(), description="pattern of both antennas: omni, horn or file")
    sweeps: TouchstoneFolder = Field(TouchstoneFolder(), description="of touchstone")
    arrays: ArrayReader = Field(ArrayReader(), description="of arrays")
    pairs: PairReader = Field(PairReader(), description="of deepmimo and insite")
    carrier_hz: PositiveFloat | None = Field(None, description="where the data do not say it")
    bandwidth_hz: PositiveFloat | None = Field(None, description="where the data do not say it")
    extent_m: PositiveFloat | None = Field(None, description="largest extent D of the target, if it is known")

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str | None) -> str | None:
        if kind is not None:
            READERS.find(kind)
        return kind

    @model_validator(mode="after")
    def _check_blocks(self, info: ValidationInfo) -> Self:
        """Validate blocks of other packages' readers, which are no fields; any other key is unknown."""
        blocks = self.__pydantic_extra__ or {}
        for key, value in tuple(blocks.items()):
            try:
                if key not in READERS.names():
                    unknown = InitErrorDetails(type="extra_forbidden", loc=(), input=value)
                    raise ValidationError.from_exception_data(key, [unknown])
                model = READERS.find(key)
                as_json = info.mode == "json"
                blocks[key] = (
                    model.model_validate_json(json.dumps(value), strict=True)
                    if as_json
                    else model.model_validate(value)
                )
            except ValidationError as error:
                raise ValidationError.from_exception_data(
                    key, [_inside(key, item) for item in error.errors()]
                ) from error
        return self

    def reader(self, kind: str) -> Reader:
        """The reader of a kind, with its settings."""
        model = READERS.find(kind)
        block = getattr(self, getattr(model, "block", kind), None)
        return model() if block is None else model(**dict(block))


def _inside(key: str, item: ErrorDetails) -> InitErrorDetails:
    """An error of a block as one of the settings that hold it."""
    known = item["type"] in ("extra_forbidden", "missing")  # the types that have a wording of their own
    kind = item["type"] if known else PydanticCustomError("block", "{message}", {"message": item["msg"]})
    return InitErrorDetails(type=kind, loc=(key, *item["loc"]), input=item["input"])


_FILES: tuple[tuple[str, ...], ...] = (
    ("source",),
    ("geometry", "positions"),
    ("antenna", "file"),
    *((model.block, *keys) for model in (TouchstoneFolder, ArrayReader, PairReader) for keys in model.setting_files),
)
"""Keys that name files."""


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
    _rename_files(table, lambda name: resolve_beside(name, folder))


def _rename_files(table: dict[str, Any], rename: Callable[[str], str]) -> None:
    for keys in _FILES:
        node: Any = table
        for key in keys[:-1]:
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, dict) and isinstance(node.get(keys[-1]), str):
            node[keys[-1]] = rename(node[keys[-1]])


def import_channel(settings: ImportSettings) -> Channel:
    """Read foreign data into a channel dataset.

    Parameters
    ----------
    settings
        What to read and how; see :func:`import_settings`.

    Returns
    -------
    Cir, FrequencyResponse or Components
        Paths of ray tracers, responses of analysers, components that were detected elsewhere.

    Raises
    ------
    ConfigError, DataError
        One line that names the file or setting, its value and what is allowed.
    """
    check_argument("settings", settings, ImportSettings, "see import_settings")
    kind = settings.kind or source_kind(settings.source)
    found = settings.reader(kind).read(Path(settings.source), GivenRadio(settings.carrier_hz, settings.bandwidth_hz))
    if found.kind is FrequencyResponse:
        check_swept(found.data["response"], settings.source)
    settings.antenna.pattern()  # read now: the channel holds it, though its file may go
    radio = {} if found.kind is FrequencyResponse else _radio(settings, found.carrier_hz)
    config = settings.model_dump(mode="json")
    _rename_files(config, lambda name: Path(name).name)  # names alone, never where files lay
    channel = found.kind(
        **found.data,
        **radio,
        views=_views(settings, found),
        extent_m=float("nan") if settings.extent_m is None else settings.extent_m,
        antenna=settings.antenna,
        config=config | {"name": settings.name or Path(settings.source).stem},
        provenance={
            **provenance(), "importer": kind, **{f"source.{key}": text for key, text in found.facts.items()}
        },
    )  # fmt: skip
    at_angles = settings.geometry.positions is None and found.positions_m is None
    return _without_closing_view(channel, settings, found) if at_angles else channel


def _without_closing_view(channel: Channel, settings: ImportSettings, found: Foreign) -> Channel:
    """Leave out the view that closes a whole turn, and say so."""
    closing = None if found.angles_deg is None else closing_view(found.angles_deg)
    if found.angles_deg is None or closing is None:
        return channel
    first, last = found.angles_deg.min(), found.angles_deg.max()
    note(
        f"{settings.source}: the views at {first:g}° and {last:g}° are one direction; view {closing} from 0 is left out"
    )
    kept = channel.select(np.delete(np.arange(found.n_view), closing))
    return replace(kept, provenance={**kept.provenance, "source.left_out": f"view {closing}, which closes the turn"})


def source_kind(source: str | os.PathLike[str]) -> str:
    """Tell from a source's name, or from what a folder holds, which reader it is for.

    Raises
    ------
    DataError
        It is none of what can be imported.
    """
    place = Path(source)
    if not place.exists():
        raise DataError(f"{place}: no such file or folder")
    if re.fullmatch(r"\.s\d+p|\.ts", place.suffix.lower()) and place.is_file():
        raise DataError(f"{place}: is one sweep; give the folder that holds a file a view")
    if is_deepmimo_3(place.name) and place.is_file():
        raise DataError(f"{place}: is of a DeepMIMO scenario of version 3; give the folder of one of version 4")
    own = {model.name for model in READERS.own()}
    for name in sorted(READERS.names(), key=lambda name: (name in own, name)):  # touchstone is last: any folder
        if READERS.find(name).recognises(place):
            return name
    takes = "; ".join(READERS.find(name).takes for name in READERS.names())
    raise DataError(f"{place}: unknown kind of source; allowed: {takes}; or say kind =")


def _radio(settings: ImportSettings, carrier_hz: float | None) -> dict[str, Any]:
    """Carrier and bandwidth, from the settings or the data."""
    carrier = settings.carrier_hz or carrier_hz
    if carrier is None or settings.bandwidth_hz is None:
        missing = "carrier_hz" if carrier is None else "bandwidth_hz"
        raise ConfigError(f"{missing}: missing key; {Path(settings.source).name} does not say it")
    return {"carrier_hz": carrier, "bandwidth_hz": settings.bandwidth_hz}


def _views(settings: ImportSettings, found: Foreign) -> Views:
    """Where the views were measured: as a file of positions says, else as the data do."""
    geometry = settings.geometry
    if geometry.positions is not None:
        numbers = read_positions(geometry.positions)
        if len(numbers["x_m"]) != found.n_view:
            count = len(numbers["x_m"])
            raise DataError(f"{geometry.positions}: {count} positions for {found.n_view} views of the data")
        return views_of_columns(
            numbers, geometry.center_m, geometry.pointing, geometry.pair_separation_m, geometry.positions
        )
    if found.positions_m is not None:
        columns = dict(zip(PLACE, found.positions_m.T, strict=True))
        separation = geometry.pair_separation_m
        if found.receivers_m is not None:
            columns |= dict(zip(RECEIVER, found.receivers_m.T, strict=True))
        return views_of_columns(columns, geometry.center_m, geometry.pointing, separation, settings.source)
    if found.angles_deg is None:
        raise ConfigError(
            f"geometry: {Path(settings.source).name} says neither angles nor positions of its {found.n_view} views; "
            "give geometry.positions, a CSV file with x_m,y_m[,z_m]"
        )
    return _at_angles(geometry, found.angles_deg)


def _at_angles(geometry: GeometrySettings, angles_deg: NDArray[np.float64]) -> Views:
    """Views at the angles of a turntable or of a sensor on a circle."""
    if geometry.radius_m is None:
        raise ConfigError("geometry.radius_m: missing key; the data say angles only")
    turned = -angles_deg if geometry.clockwise else angles_deg
    directions = geometry.zero_deg + (-turned if geometry.angles == "target" else turned)
    views = views_on_circle(geometry.center_m, geometry.radius_m, directions, (geometry.height_m,))
    if geometry.angles == "target":
        return on_turntable(views, turned, geometry.pointing, geometry.pair_separation_m, "geometry.pointing")
    return side_by_side(pointed(views, geometry.pointing, "geometry.pointing"), geometry.pair_separation_m)
