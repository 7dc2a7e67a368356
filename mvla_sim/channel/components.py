"""The dataset of ready-made multipath components: ranges and powers a view, which enter after the peak detector."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely
import xarray as xr
from numpy.typing import NDArray

from mvla_sim.channel.header import HEADER, check_radio, header_attributes, header_fields, header_variables
from mvla_sim.errors import DataError, MvlaError
from mvla_sim.netcdf import open_netcdf, write_netcdf
from mvla_sim.scene.antenna_settings import AntennaSettings, Omni
from mvla_sim.scene.views import Views

__all__ = ["COMPONENT_SCHEMA", "Components"]

COMPONENT_SCHEMA = "mvla-sim components"
COMPONENT_VERSION = 1
_VARIABLES = ("range", "power", "row_size", *HEADER)


@dataclass(frozen=True)
class Components:
    """Multipath components C_m = {(R_mi, p_mi)} of M views (``eq:obs``), measured or detected elsewhere.

    Attributes
    ----------
    range_m
        R_mi, ``[n_component]`` float64, metres; view after view, rising within a view.
    power
        p_mi, ``[n_component]`` float64, above 0, linear; only ratios within a view count.
    row_size
        Components of each view, ``[n_view]`` int64.
    views
        Positions and angles of the sensor.
    carrier_hz, bandwidth_hz
        Radio settings, hertz; the bandwidth decides ΔR and so the kernel.
    extent_m, outline, antenna, config, provenance
        As in :class:`~mvla_sim.channel.cir.Cir`.
    """

    range_m: NDArray[np.float64]
    power: NDArray[np.float64]
    row_size: NDArray[np.int64]
    views: Views
    carrier_hz: float
    bandwidth_hz: float
    extent_m: float = float("nan")
    outline: Any = None
    antenna: AntennaSettings = field(default_factory=Omni)
    config: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check shapes, finiteness, that the rows add up, and that ranges rise within them."""
        if self.range_m.shape != self.power.shape or self.row_size.sum() != self.range_m.size:
            raise DataError(
                f"components: {self.range_m.size} ranges, {self.power.size} powers, rows add up to "
                f"{self.row_size.sum()}; these must agree"
            )
        if self.row_size.shape != (len(self.views),) or (self.row_size < 0).any():
            raise DataError(f"components: row_size has {self.row_size.size} entries for {len(self.views)} views")
        if not (np.isfinite(self.range_m).all() and (self.range_m >= 0).all()):
            raise DataError("components: ranges must be finite and at least 0")
        if not (np.isfinite(self.power).all() and (self.power > 0).all()):
            raise DataError("components: powers must be finite and above 0")
        view = np.repeat(np.arange(self.row_size.size), self.row_size)
        falls = np.flatnonzero((np.diff(self.range_m) < 0) & (np.diff(view) == 0))
        if len(falls):
            raise DataError(f"components: ranges of view {view[falls[0]]} do not rise; sort them within each view")
        check_radio(self, "components")

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return len(self.views)

    def select(self, indices: NDArray[np.intp]) -> Components:
        """Return the given views, in the given order."""
        start = np.concatenate([[0], np.cumsum(self.row_size)])
        rows = [np.arange(start[i], start[i + 1]) for i in indices]
        taken = np.concatenate(rows) if rows else np.zeros(0, np.intp)
        return replace(
            self,
            range_m=self.range_m[taken],
            power=self.power[taken],
            row_size=self.row_size[indices],
            views=self.views.select(indices),
        )

    def to_dataset(self) -> xr.Dataset:
        """Return the labelled dataset that :meth:`save` writes."""
        return xr.Dataset(
            {
                "range": ("component", self.range_m, {"long_name": "one-way range of the component", "units": "m"}),
                "power": ("component", self.power, {"long_name": "power of the component", "units": "1"}),
                "row_size": (
                    "view",
                    self.row_size,
                    {"long_name": "number of components of the view", "sample_dimension": "component"},
                ),
                **header_variables(self),
            },
            coords={"xyz": ("xyz", ["x", "y", "z"]), "view": np.arange(self.n_view), "xy": ["x", "y"]},
            attrs=header_attributes(self, COMPONENT_SCHEMA, COMPONENT_VERSION),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write NetCDF-4 under a temporary name and rename it.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        write_netcdf(self.to_dataset(), path, ("range", "power", "row_size", "position", "angle"))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Components:
        """Read a file of components and check it.

        Raises
        ------
        DataError
            Missing, empty, truncated, not NetCDF-4, of another schema or version, or inconsistent.
        """
        dataset = open_netcdf(path, COMPONENT_SCHEMA, COMPONENT_VERSION, _VARIABLES)
        try:
            return cls(
                range_m=dataset["range"].values.astype(np.float64),
                power=dataset["power"].values.astype(np.float64),
                row_size=dataset["row_size"].values.astype(np.int64),
                **header_fields(dataset),
            )
        except MvlaError as error:
            raise DataError(f"{path}: {error}") from error
        except (ValueError, TypeError, IndexError, shapely.GEOSException) as error:
            raise DataError(f"{path}: not a readable file of components ({error})") from error
