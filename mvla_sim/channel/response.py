"""The dataset of measured channels: one complex frequency response a view, as a VNA sweeps it."""

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
from mvla_sim.constants import SPEED_OF_LIGHT
from mvla_sim.errors import DataError, MvlaError
from mvla_sim.netcdf import open_netcdf, write_netcdf
from mvla_sim.scene.antenna_settings import AntennaSettings, Omni
from mvla_sim.scene.views import Views

__all__ = ["RESPONSE_SCHEMA", "FrequencyResponse"]

RESPONSE_SCHEMA = "mvla-sim frequency response"
RESPONSE_VERSION = 1
_VARIABLES = ("response_real", "response_imag", "frequency", *HEADER)


@dataclass(frozen=True)
class FrequencyResponse:
    """Frequency responses H_m(f_k) of M views at K uniform frequencies; window, inverse FFT and gate belong to imaging.

    Attributes
    ----------
    response
        ``[n_view, n_frequency]`` complex128; the received over the transmitted wave, so |H|² is a path gain.
    start_hz, step_hz
        First frequency f_0 and spacing Δf, hertz. Delays are unambiguous up to 1/Δf.
    views
        Positions and angles of the sensor.
    carrier_hz, bandwidth_hz
        Middle of the band and its width K·Δf, hertz.
    extent_m, outline, antenna, config, provenance
        As in :class:`~mvla_sim.channel.cir.Cir`.
    """

    response: NDArray[np.complex128]
    start_hz: float
    step_hz: float
    views: Views
    extent_m: float = float("nan")
    outline: Any = None
    antenna: AntennaSettings = field(default_factory=Omni)
    config: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check shape, finiteness and the axis."""
        if self.response.ndim != 2 or self.response.shape[1] < 2:
            raise DataError(f"response: shape {self.response.shape}; allowed: [n_view, n_frequency >= 2]")
        if len(self.response) != len(self.views):
            raise DataError(f"response: {len(self.response)} responses for {len(self.views)} views")
        bad = np.argwhere(~np.isfinite(self.response))
        if len(bad):
            raise DataError(f"response: view {bad[0][0]}, frequency {bad[0][1]} is not finite ({len(bad)} such)")
        if not (self.step_hz > 0 and np.isfinite(self.start_hz)):
            raise DataError(f"response: start {self.start_hz:g} Hz and step {self.step_hz:g} Hz; the step must be > 0")
        check_radio(self, "response")

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return len(self.views)

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Frequencies, ``[n_frequency]`` hertz."""
        return np.asarray(self.start_hz + self.step_hz * np.arange(self.response.shape[1]), np.float64)

    @property
    def carrier_hz(self) -> float:
        """Middle of the band, hertz."""
        return float(self.start_hz + self.step_hz * (self.response.shape[1] - 1) / 2)

    @property
    def bandwidth_hz(self) -> float:
        """Width of the band, K·Δf, hertz: each frequency stands for an equal share of it."""
        return float(self.step_hz * self.response.shape[1])

    @property
    def unambiguous_range_m(self) -> float:
        """One-way range beyond which echoes fold back to 0, c/(2Δf), metres."""
        return SPEED_OF_LIGHT / (2 * self.step_hz)

    def with_phases(self, phase_rad: NDArray[np.float64]) -> FrequencyResponse:
        """Return a copy with a phase added to each view, ``[n_view]`` radians."""
        return replace(self, response=self.response * np.exp(1j * phase_rad)[:, None])

    def select(self, indices: NDArray[np.intp]) -> FrequencyResponse:
        """Return the given views, in the given order."""
        return replace(self, response=self.response[indices], views=self.views.select(indices))

    def to_dataset(self) -> xr.Dataset:
        """Return the labelled dataset that :meth:`save` writes."""
        axes = ("view", "frequency")
        return xr.Dataset(
            {
                "response_real": (axes, self.response.real, {"long_name": "frequency response, real part"}),
                "response_imag": (axes, self.response.imag, {"long_name": "frequency response, imaginary part"}),
                **header_variables(self),
            },
            coords={
                "frequency": ("frequency", self.frequency_hz, {"units": "Hz"}),
                "xyz": ("xyz", ["x", "y", "z"]),
                "view": np.arange(self.n_view),
                "xy": ["x", "y"],
            },
            attrs=header_attributes(self, RESPONSE_SCHEMA, RESPONSE_VERSION),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write NetCDF-4 under a temporary name and rename it.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        write_netcdf(self.to_dataset(), path, ("response_real", "response_imag", "position", "angle"))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> FrequencyResponse:
        """Read a file of frequency responses and check it.

        Raises
        ------
        DataError
            Missing, empty, truncated, not NetCDF-4, of another schema or version, or inconsistent.
        """
        dataset = open_netcdf(path, RESPONSE_SCHEMA, RESPONSE_VERSION, _VARIABLES)
        try:
            frequency = dataset["frequency"].values.astype(np.float64)
            step = (frequency[-1] - frequency[0]) / (frequency.size - 1)
            fields = header_fields(dataset)
            for derived in ("carrier_hz", "bandwidth_hz"):
                del fields[derived]
            return cls(
                response=dataset["response_real"].values + 1j * dataset["response_imag"].values,
                start_hz=float(frequency[0]),
                step_hz=float(step),
                **fields,
            )
        except MvlaError as error:
            raise DataError(f"{path}: {error}") from error
        except (ValueError, TypeError, IndexError, ZeroDivisionError, shapely.GEOSException) as error:
            raise DataError(f"{path}: not a readable file of frequency responses ({error})") from error
