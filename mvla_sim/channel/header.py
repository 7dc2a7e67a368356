"""What every channel file carries beside its data: views, radio, antenna, target, settings, origin."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import shapely
import xarray as xr

from mvla_sim.errors import DataError
from mvla_sim.netcdf import table_of
from mvla_sim.scene.antenna import self_contained
from mvla_sim.scene.antenna_settings import AntennaSettings, Omni
from mvla_sim.scene.views import Views
from mvla_sim.settings import Settings, parse

__all__ = ["HEADER", "Described", "check_radio", "header_attributes", "header_fields", "header_variables"]

HEADER = ("position", "angle", "center", "carrier_frequency", "bandwidth", "target_extent")
"""Variables that every channel file has."""


class Described(Protocol):
    """Any channel dataset, as far as its header goes."""

    @property
    def views(self) -> Views: ...  # noqa: D102
    @property
    def carrier_hz(self) -> float: ...  # noqa: D102
    @property
    def bandwidth_hz(self) -> float: ...  # noqa: D102
    @property
    def extent_m(self) -> float: ...  # noqa: D102
    @property
    def outline(self) -> Any: ...  # noqa: D102
    @property
    def antenna(self) -> AntennaSettings: ...  # noqa: D102
    @property
    def config(self) -> Mapping[str, Any]: ...  # noqa: D102
    @property
    def provenance(self) -> Mapping[str, str]: ...  # noqa: D102


class _Holder(Settings):
    antenna: AntennaSettings = Omni()


def header_variables(channel: Described) -> dict[str, Any]:
    """Variables of the header, for :class:`xarray.Dataset`."""
    views = channel.views
    variables: dict[str, Any] = {
        "position": (("view", "xyz"), views.positions_m, {"long_name": "sensor position", "units": "m"}),
        "angle": (
            "view",
            views.angles_deg,
            {"long_name": "direction of the sensor from center, counter-clockwise from +x", "units": "degree"},
        ),
        "carrier_frequency": ((), channel.carrier_hz, {"units": "Hz"}),
        "bandwidth": ((), channel.bandwidth_hz, {"units": "Hz"}),
        "target_extent": ((), channel.extent_m, {"long_name": "largest extent D of the target", "units": "m"}),
        "center": (
            "xy",
            np.asarray(views.center_m, np.float64),
            {"long_name": "centre of circle, arc or turntable, else of the target", "units": "m"},
        ),
    }
    if views.receivers_m is not None:
        meaning = {"long_name": "receiver position; position is then the transmitter's", "units": "m"}
        variables["receiver"] = (("view", "xyz"), views.receivers_m, meaning)
    if views.boresights is not None:
        meaning = {"long_name": "unit vector in which the antennas point", "units": "1"}
        variables["boresight"] = (("view", "xyz"), views.boresights, meaning)
    return variables


def header_attributes(channel: Described, schema: str, version: int) -> dict[str, Any]:
    """Global attributes of the file."""
    attributes = {
        "Conventions": "CF-1.11",
        "title": f"{channel.config.get('name', 'channel')}: {schema.removeprefix('mvla-sim ')}",
        "schema": schema,
        "schema_version": version,
        "config": json.dumps(dict(channel.config), sort_keys=True),
        "provenance": json.dumps(dict(channel.provenance), sort_keys=True),
        "antenna": self_contained(channel.antenna).model_dump_json(),
    }
    if channel.outline is not None:
        attributes["target_outline_wkt"] = shapely.to_wkt(channel.outline, rounding_precision=9)
    return attributes


def header_fields(dataset: xr.Dataset) -> dict[str, Any]:
    """Read the header back: the fields that every channel dataset has, by name.

    Raises
    ------
    DataError, ValueError, TypeError, shapely.GEOSException
        A damaged file.
    """
    wkt = dataset.attrs.get("target_outline_wkt")
    center = dataset["center"].values
    if center.shape != (2,):
        raise DataError(f"center has shape {center.shape}, must be (2,)")
    return {
        "views": Views(
            dataset["position"].values,
            dataset["angle"].values,
            (float(center[0]), float(center[1])),
            dataset["receiver"].values if "receiver" in dataset else None,
            dataset["boresight"].values if "boresight" in dataset else None,
        ),
        "carrier_hz": float(dataset["carrier_frequency"]),
        "bandwidth_hz": float(dataset["bandwidth"]),
        "extent_m": float(dataset["target_extent"]),
        "outline": shapely.from_wkt(wkt) if wkt else None,
        "antenna": parse(
            _Holder, {"antenna": json.loads(dataset.attrs.get("antenna", '{"kind": "omni"}'))}, "antenna"
        ).antenna,
        "config": table_of(dataset, "config"),
        "provenance": table_of(dataset, "provenance"),
    }


def check_radio(channel: Described, what: str) -> None:
    """Refuse a carrier or bandwidth that is none."""
    if not (channel.carrier_hz > 0 and channel.bandwidth_hz > 0):
        raise DataError(
            f"{what}: carrier {channel.carrier_hz:g} Hz and bandwidth {channel.bandwidth_hz:g} Hz must be above 0"
        )
