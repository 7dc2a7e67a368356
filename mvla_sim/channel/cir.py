"""The CIR dataset: paths of every view as one ragged array, with where they were seen from and how they were made.

On disk it is NetCDF-4 (hence HDF5): the paths are a CF *contiguous ragged array* along ``path``, ``row_size`` holds the
number of paths of each view.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
import xarray as xr
from numpy.typing import NDArray

from mvla_sim.channel.header import HEADER, check_radio, header_attributes, header_fields, header_variables
from mvla_sim.constants import delay_to_range
from mvla_sim.errors import DataError, MvlaError
from mvla_sim.netcdf import open_netcdf, write_netcdf
from mvla_sim.scene.antenna_settings import AntennaSettings, Omni
from mvla_sim.scene.views import Views

__all__ = ["INTERACTIONS", "SCHEMA", "SCHEMA_VERSION", "Cir"]

SCHEMA = "mvla-sim CIR"
SCHEMA_VERSION = 2
"""Version 2 knows receivers apart from transmitters, boresights and antennas; files of version 1 have none."""
INTERACTIONS: dict[str, int] = {"specular": 1, "diffuse": 2, "refraction": 4, "diffraction": 8}
"""Bits of ``interaction``; a path of several interactions has the bits of all of them."""

_VARIABLES = ("gain_real", "gain_imag", "delay", "interaction", "first_point", "row_size", *HEADER)


@dataclass(frozen=True)
class Cir:
    """Channel impulse responses of M views: h_m(τ) = Σ_i gain_i·δ(τ − delay_i).

    Attributes
    ----------
    gain
        Complex baseband gain of each path, carrier phase included, ``[n_path]`` complex64; |gain|² is a path gain
        (received over transmitted power).
    delay_s
        Absolute round-trip delay, ``[n_path]`` float64, seconds.
    interaction
        Bits of :data:`INTERACTIONS`, ``[n_path]`` uint8; 0 where unknown (measured data).
    first_point_m
        First interaction point, ``[n_path, 3]`` float32, metres; NaN where unknown.
    row_size
        Paths of each view, ``[n_view]`` int64; paths are stored view after view.
    views
        Positions and angles of the sensor.
    carrier_hz, bandwidth_hz
        Radio settings, hertz.
    extent_m
        Largest extent D of the target, metres; NaN where unknown.
    outline
        Cross-section of the target at the imaging plane, or None where unknown; only evaluation looks at it.
    antenna
        Pattern of both antennas; it is part of the gains already, and tells imaging where the beam reaches.
    config
        Every setting that decided the data, as plain data.
    provenance
        Versions and origin, as text.
    """

    gain: NDArray[np.complex64]
    delay_s: NDArray[np.float64]
    interaction: NDArray[np.uint8]
    first_point_m: NDArray[np.float32]
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
        """Check shapes, finiteness and that the rows add up."""
        paths = self.gain.size
        if self.delay_s.shape != (paths,) or self.interaction.shape != (paths,):
            raise DataError(
                f"CIR: gain, delay and interaction have lengths {paths}, {self.delay_s.size} and "
                f"{self.interaction.size}; they must be equal"
            )
        if self.first_point_m.shape != (paths, 3):
            raise DataError(f"CIR: first_point_m has shape {self.first_point_m.shape}, must be ({paths}, 3)")
        if self.row_size.shape != (len(self.views),):
            raise DataError(f"CIR: row_size has {self.row_size.size} entries for {len(self.views)} views")
        if self.row_size.sum() != paths or (self.row_size < 0).any():
            raise DataError(f"CIR: row_size adds up to {self.row_size.sum()} paths, the file holds {paths}")
        if not (np.isfinite(self.gain).all() and np.isfinite(self.delay_s).all()):
            raise DataError("CIR: gain or delay holds NaN or infinity; every path needs finite values")
        if (self.delay_s < 0).any():
            raise DataError(f"CIR: delay {self.delay_s.min():g} s is negative; delays must be absolute and at least 0")
        check_radio(self, "CIR")

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return len(self.views)

    @cached_property
    def row_start(self) -> NDArray[np.int64]:
        """Index of each view's first path and, last, the number of paths, ``[n_view + 1]``."""
        return np.concatenate([[0], np.cumsum(self.row_size)]).astype(np.int64)

    @property
    def range_m(self) -> NDArray[np.float64]:
        """One-way range of each path, ``[n_path]`` metres."""
        return delay_to_range(self.delay_s)

    def rows(self, view: int) -> slice:
        """Slice of the paths of one view."""
        return slice(int(self.row_start[view]), int(self.row_start[view + 1]))

    def with_phases(self, phase_rad: NDArray[np.float64]) -> Cir:
        """Return a copy with a phase added to every path of each view, ``[n_view]`` radians."""
        factor = np.exp(1j * np.repeat(phase_rad, self.row_size))
        return replace(self, gain=(self.gain * factor).astype(np.complex64))

    def select(self, indices: NDArray[np.intp]) -> Cir:
        """Return the given views, in the given order."""
        rows = [np.arange(self.row_start[i], self.row_start[i + 1]) for i in indices]
        paths = np.concatenate(rows) if rows else np.zeros(0, np.int64)
        return replace(
            self,
            gain=self.gain[paths],
            delay_s=self.delay_s[paths],
            interaction=self.interaction[paths],
            first_point_m=self.first_point_m[paths],
            row_size=self.row_size[indices],
            views=self.views.select(indices),
        )

    def to_dataset(self) -> xr.Dataset:
        """Return the labelled dataset that :meth:`save` writes."""
        flags = np.array(list(INTERACTIONS.values()), np.uint8)
        xyz = ("xyz", ["x", "y", "z"])
        dataset = xr.Dataset(
            {
                "gain_real": (
                    "path",
                    self.gain.real,
                    {"long_name": "complex baseband path gain, real part", "units": "1"},
                ),
                "gain_imag": (
                    "path",
                    self.gain.imag,
                    {"long_name": "complex baseband path gain, imaginary part", "units": "1"},
                ),
                "delay": ("path", self.delay_s, {"long_name": "round-trip propagation delay", "units": "s"}),
                "interaction": (
                    "path",
                    self.interaction,
                    {
                        "long_name": "interactions along the path",
                        "flag_masks": flags,
                        "flag_meanings": " ".join(INTERACTIONS),
                    },
                ),
                "first_point": (
                    ("path", "xyz"),
                    self.first_point_m,
                    {"long_name": "first interaction point", "units": "m"},
                ),
                "row_size": (
                    "view",
                    self.row_size,
                    {"long_name": "number of paths of the view", "sample_dimension": "path"},
                ),
                **header_variables(self),
            },
            coords={"xyz": xyz, "view": np.arange(self.n_view), "xy": ["x", "y"]},
            attrs=header_attributes(self, SCHEMA, SCHEMA_VERSION),
        )
        dataset.attrs["title"] = f"{self.config.get('name', 'channel')}: channel impulse responses"
        return dataset

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write NetCDF-4 under a temporary name and rename it.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        packed = ("gain_real", "gain_imag", "delay", "interaction", "first_point", "row_size", "position", "angle")
        write_netcdf(self.to_dataset(), path, packed)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Cir:
        """Read a CIR file and check it.

        Raises
        ------
        DataError
            Missing, empty, truncated, not NetCDF-4, no CIR file, of another schema version, or inconsistent.
        """
        dataset = open_netcdf(path, SCHEMA, SCHEMA_VERSION, _VARIABLES, earlier=(1,))
        try:
            return cls(
                gain=(dataset["gain_real"].values + 1j * dataset["gain_imag"].values).astype(np.complex64),
                delay_s=dataset["delay"].values.astype(np.float64),
                interaction=_flags(dataset["interaction"].values),
                first_point_m=dataset["first_point"].values.astype(np.float32).reshape(-1, 3),
                row_size=dataset["row_size"].values.astype(np.int64),
                **header_fields(dataset),
            )
        except MvlaError as error:
            raise DataError(f"{path}: {error}") from error
        except (ValueError, TypeError, shapely.GEOSException) as error:
            raise DataError(f"{path}: not a readable CIR file ({error})") from error


def _flags(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Interaction bits; anything else is a damaged file."""
    if not np.isin(values, np.arange(sum(INTERACTIONS.values()) + 1)).all():
        raise ValueError(f"interaction holds values other than sums of {list(INTERACTIONS.values())}")
    return values.astype(np.uint8)
