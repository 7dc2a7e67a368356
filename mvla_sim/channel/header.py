"""The base of all channels: the header (views, radio, antenna, target, settings, origin) and how files are kept."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
import shapely
import xarray as xr
from numpy.typing import NDArray

from mvla_sim.errors import DataError, MvlaError
from mvla_sim.netcdf import Variable, check_schema, read_netcdf, table_of, write_netcdf
from mvla_sim.ragged import Ragged
from mvla_sim.scene.antenna import ANTENNAS, Antenna
from mvla_sim.scene.antennas.omni import Omni
from mvla_sim.scene.views import Views
from mvla_sim.settings import parse

__all__ = ["HEADER", "Channel"]

HEADER = (
    Variable("position", "views.positions_m", ("view", "xyz"), "f8", "sensor position", "m"),
    Variable(
        "angle", "views.angles_deg", ("view",), "f8",
        "direction of the sensor from center, counter-clockwise from +x", "degree",
    ),
    Variable("carrier_frequency", "carrier_hz", (), "f8", units="Hz"),
    Variable("bandwidth", "bandwidth_hz", (), "f8", units="Hz"),
    Variable("target_extent", "extent_m", (), "f8", "largest extent D of the target", "m"),
    Variable("center", "views.center_m", ("xy",), "f8", "centre of circle, arc or turntable, else of the target", "m"),
    Variable(
        "receiver", "views.receivers_m", ("view", "xyz"), "f8",
        "receiver position; position is then the transmitter's", "m", optional=True,
    ),
    Variable(
        "boresight", "views.boresights", ("view", "xyz"), "f8",
        "unit vector in which the antennas point", "1", optional=True,
    ),
)  # fmt: skip
"""Variables that every channel file has, the last two only where views have them."""

_DAMAGED = (ValueError, TypeError, IndexError, KeyError, ZeroDivisionError, shapely.GEOSException)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Channel:
    """A channel of M views: paths, frequency responses, or ready-made components. Two are equal if they are one.

    Attributes
    ----------
    views
        Positions and angles of the sensor.
    carrier_hz, bandwidth_hz
        Radio settings, hertz.
    extent_m
        Largest extent D of the target, metres; NaN where unknown.
    outline
        Cross-section of the target at the imaging plane, or None where unknown; only evaluation looks at it.
    plane_height_m
        Height of the imaging plane, at which the outline was cut and the grid lies by default, metres; None where
        unknown.
    antenna
        Pattern of both antennas; it is part of the data already, and tells imaging where the beam reaches.
    config
        Every setting that decided the data, as plain data.
    provenance
        Versions and origin, as text.
    """

    SCHEMA: ClassVar[str]
    """What its files say they are."""
    VERSION: ClassVar[int]
    WHAT: ClassVar[str]
    """What it is called, in the title of files."""
    VARIABLES: ClassVar[tuple[Variable, ...]]
    """Its own variables, beside :data:`HEADER`."""

    views: Views
    carrier_hz: float
    bandwidth_hz: float
    extent_m: float = float("nan")
    outline: Any = None
    plane_height_m: float | None = None
    antenna: Antenna = field(default_factory=Omni)
    config: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a carrier or bandwidth that is none."""
        if not (self.carrier_hz > 0 and self.bandwidth_hz > 0):
            kind = self.SCHEMA.removeprefix("mvla-sim ")
            raise DataError(
                f"{kind}: carrier {self.carrier_hz:g} Hz and bandwidth {self.bandwidth_hz:g} Hz must be above 0"
            )

    def __repr__(self) -> str:
        extent = "" if np.isnan(self.extent_m) else f", D = {self.extent_m:g} m"
        radio = f"{self.carrier_hz / 1e9:g} GHz, B = {self.bandwidth_hz / 1e9:g} GHz"
        return f"{type(self).__name__}({self.summary}, {radio}{extent})"

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return len(self.views)

    @property
    def summary(self) -> str:
        """How many views there are, and of what, in a few words."""
        return f"{self.n_view} views"

    def select(self, indices: NDArray[np.intp]) -> Self:
        """Return the given views, in the given order."""
        taken: dict[str, Any] = {}
        for variable in self.VARIABLES:
            values = getattr(self, variable.field)
            if variable.dims[0] == "view":
                taken[variable.field] = values[indices]
            elif isinstance(self, Ragged):
                taken[variable.field] = values[self.elements(indices)]
        return replace(self, views=self.views.select(indices), **taken)

    def to_dataset(self) -> xr.Dataset:
        """Return the labelled dataset that :meth:`save` writes."""
        entries = {}
        for variable in (*self.VARIABLES, *HEADER):
            if (values := variable.of(self)) is not None:
                entries[variable.name] = variable.entry(values)
        attributes = {
            "Conventions": "CF-1.11",
            "title": f"{self.config.get('name', 'channel')}: {self.WHAT}",
            "schema": self.SCHEMA,
            "schema_version": self.VERSION,
            "config": json.dumps(dict(self.config), sort_keys=True),
            "provenance": json.dumps(dict(self.provenance), sort_keys=True),
            "antenna": self.antenna.self_contained().model_dump_json(),
        }
        if self.outline is not None:
            attributes["target_outline_wkt"] = shapely.to_wkt(self.outline, rounding_precision=9)
        if self.plane_height_m is not None:
            attributes["imaging_plane_height_m"] = self.plane_height_m
        axes = {"xyz": ["x", "y", "z"], "view": np.arange(self.n_view), "xy": ["x", "y"]}
        return xr.Dataset(entries, axes, attributes)

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset, source: str | os.PathLike[str] = "dataset") -> Self:
        """Build it from a labelled dataset, as :meth:`to_dataset` returns it and xarray opens its files.

        Parameters
        ----------
        dataset
            Its variables, and the attributes of the file; open files with ``decode_timedelta=False``.
        source
            Where it is from, for messages.

        Raises
        ------
        DataError
            Of another schema or version, incomplete or inconsistent.
        """
        needed = [variable.name for variable in (*cls.VARIABLES, *HEADER) if not variable.optional]
        check_schema(dataset, source, cls.SCHEMA, cls.VERSION, needed)
        try:
            return cls(**cls._fields(dataset))
        except MvlaError as error:
            raise DataError(f"{os.fspath(source)}: {error}") from error
        except _DAMAGED as error:
            raise DataError(f"{os.fspath(source)}: not a readable {cls.SCHEMA} file ({error})") from error

    @classmethod
    def _fields(cls, dataset: xr.Dataset) -> dict[str, Any]:
        """Fields of a dataset by name; raises MvlaError or a built-in error where it is damaged."""
        wkt = dataset.attrs.get("target_outline_wkt")
        antenna = json.loads(dataset.attrs.get("antenna", '{"kind": "omni"}'))
        return cls.fields_of({str(name): item.values for name, item in dataset.variables.items()}) | {
            "outline": shapely.from_wkt(wkt) if wkt else None,
            "plane_height_m": _plane_height(dataset),
            "antenna": parse(ANTENNAS.model_of(antenna) or Omni, antenna, "antenna"),
            "config": table_of(dataset, "config"),
            "provenance": table_of(dataset, "provenance"),
        }

    @classmethod
    def fields_of(cls, stored: Mapping[str, Any]) -> dict[str, Any]:
        """Fields by name that variables hold, as files and shards store them; those that are not there are None.

        Raises
        ------
        DataError, ValueError, TypeError
            They hold what they cannot.
        """
        found: dict[str, Any] = {}
        for variable in (*cls.VARIABLES, *HEADER):
            values: Any = stored.get(variable.name)
            if values is not None:
                values = variable.checked(values)
            found[variable.field] = found[variable.field] + 1j * values if variable.part == "imag" else values
        of_views = {name.removeprefix("views."): found.pop(name) for name in tuple(found) if name.startswith("views.")}
        if of_views["center_m"].shape != (2,):
            raise DataError(f"center has shape {of_views['center_m'].shape}, must be (2,)")
        scalars = {name: float(found[name]) for name in ("carrier_hz", "bandwidth_hz", "extent_m")}
        return found | scalars | {"views": Views(**of_views)}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write NetCDF-4 under a temporary name and rename it.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        dataset = self.to_dataset()
        packed = [item.name for item in (*self.VARIABLES, *HEADER) if item.packed and item.name in dataset]
        write_netcdf(dataset, path, packed)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file and check it.

        Raises
        ------
        DataError
            Missing, empty, truncated, not NetCDF-4, of another schema or version, or inconsistent.
        """
        return cls.from_dataset(read_netcdf(path), path)


def _plane_height(dataset: xr.Dataset) -> float | None:
    """Height of the imaging plane; files of earlier versions have it among the settings of their scene."""
    config = table_of(dataset, "config")
    height = dataset.attrs.get("imaging_plane_height_m", config.get("plane_height_m"))
    return None if height is None else float(height)
