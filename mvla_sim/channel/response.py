"""Measured channels: one complex frequency response a view, as a network analyser sweeps it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mvla_sim.channel.header import Channel
from mvla_sim.constants import SPEED_OF_LIGHT
from mvla_sim.errors import DataError
from mvla_sim.netcdf import Variable

__all__ = ["FrequencyResponse"]


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(Channel):
    """Frequency responses H_m(f_k) of M views at K uniform frequencies; window, inverse FFT and gate belong to imaging.

    Attributes
    ----------
    response
        ``[n_view, n_frequency]`` complex128; the received over the transmitted wave, so |H|² is a path gain.
    start_hz, step_hz
        First frequency f_0 and spacing Δf, hertz. Delays are unambiguous up to 1/Δf.
    carrier_hz, bandwidth_hz
        Middle of the band and its width K·Δf, hertz: each frequency stands for an equal share of it. They follow from
        the frequencies.
    views, extent_m, outline, antenna, config, provenance
        As of any :class:`~mvla_sim.channel.header.Channel`.
    """

    SCHEMA: ClassVar = "mvla-sim frequency response"
    VERSION: ClassVar = 1
    WHAT: ClassVar = "frequency response"
    VARIABLES: ClassVar = (
        Variable("response_real", "response", ("view", "frequency"), "f8", "frequency response, real part",
                 part="real"),
        Variable("response_imag", "response", ("view", "frequency"), "f8", "frequency response, imaginary part",
                 part="imag"),
        Variable("frequency", "frequency_hz", ("frequency",), "f8", units="Hz"),
    )  # fmt: skip

    response: NDArray[np.complex128]
    start_hz: float
    step_hz: float
    carrier_hz: float = field(init=False)
    bandwidth_hz: float = field(init=False)

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
        count = self.response.shape[1]
        object.__setattr__(self, "carrier_hz", float(self.start_hz + self.step_hz * (count - 1) / 2))
        object.__setattr__(self, "bandwidth_hz", float(self.step_hz * count))
        super().__post_init__()

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Frequencies, ``[n_frequency]`` hertz."""
        return np.asarray(self.start_hz + self.step_hz * np.arange(self.response.shape[1]), np.float64)

    @property
    def unambiguous_range_m(self) -> float:
        """One-way range beyond which echoes fold back to 0, c/(2Δf), metres."""
        return SPEED_OF_LIGHT / (2 * self.step_hz)

    @property
    def summary(self) -> str:
        """How many views and frequencies there are, and which, in a few words."""
        return (
            f"{self.n_view} views, {self.response.shape[1]} frequencies from {self.start_hz / 1e9:.6g} GHz in steps of "
            f"{self.step_hz / 1e6:.6g} MHz, unambiguous to {self.unambiguous_range_m:.2f} m"
        )

    def with_phases(self, phase_rad: NDArray[np.float64]) -> FrequencyResponse:
        """Return a copy with a phase added to each view, ``[n_view]`` radians."""
        return replace(self, response=self.response * np.exp(1j * phase_rad)[:, None])

    @classmethod
    def _fields(cls, dataset: xr.Dataset) -> dict[str, Any]:
        fields = super()._fields(dataset)
        frequency = fields.pop("frequency_hz")
        del fields["carrier_hz"], fields["bandwidth_hz"]
        mean = (frequency[-1] - frequency[0]) / (frequency.size - 1)
        step = float(dataset["frequency"].attrs.get("step", mean))
        if not abs(step - mean) <= 1e-6 * abs(mean):
            raise DataError(f"frequency: step {step:g} Hz, the frequencies are {mean:g} Hz apart")
        return fields | {"start_hz": float(frequency[0]), "step_hz": step}

    def to_dataset(self) -> xr.Dataset:
        """Return the labelled dataset that :meth:`save` writes."""
        dataset = super().to_dataset()
        dataset["frequency"].attrs["step"] = self.step_hz  # the differences of the frequencies are rounded
        return dataset
