"""Channel impulse responses: paths of every view as one ragged array, with where they were seen from and how made.

On disk it is NetCDF-4 (hence HDF5): the paths are a CF *contiguous ragged array* along ``path``, ``row_size`` holds the
number of paths of each view.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.header import Channel
from mvla_sim.constants import delay_to_range
from mvla_sim.errors import DataError
from mvla_sim.netcdf import Variable
from mvla_sim.ragged import Ragged

__all__ = ["INTERACTIONS", "Cir"]

INTERACTIONS: dict[str, int] = {"specular": 1, "diffuse": 2, "refraction": 4, "diffraction": 8}
"""Bits of ``interaction``; a path of several interactions has the bits of all of them."""


@dataclass(frozen=True, eq=False, repr=False)
class Cir(Ragged, Channel):
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
    views, carrier_hz, bandwidth_hz, extent_m, outline, antenna, config, provenance
        As of any :class:`~mvla_sim.channel.header.Channel`.
    """

    SCHEMA: ClassVar = "mvla-sim CIR"
    VERSION: ClassVar = 2
    WHAT: ClassVar = "channel impulse responses"
    VARIABLES: ClassVar = (
        Variable("gain_real", "gain", ("path",), "f4", "complex baseband path gain, real part", "1", "real"),
        Variable("gain_imag", "gain", ("path",), "f4", "complex baseband path gain, imaginary part", "1", "imag"),
        Variable("delay", "delay_s", ("path",), "f8", "round-trip propagation delay", "s"),
        Variable("interaction", "interaction", ("path",), "u1", "interactions along the path", flags=INTERACTIONS),
        Variable("first_point", "first_point_m", ("path", "xyz"), "f4", "first interaction point", "m"),
        Variable("row_size", "row_size", ("view",), "i8", "number of paths of the view", sample_dimension="path"),
    )

    gain: NDArray[np.complex64]
    delay_s: NDArray[np.float64]
    interaction: NDArray[np.uint8]
    first_point_m: NDArray[np.float32]
    row_size: NDArray[np.int64]

    def __post_init__(self) -> None:
        """Check shapes, finiteness and that the rows add up."""
        super().__post_init__()
        paths = self.gain.size
        if self.delay_s.shape != (paths,) or self.interaction.shape != (paths,):
            raise DataError(
                f"CIR: gain, delay and interaction have lengths {paths}, {self.delay_s.size} and "
                f"{self.interaction.size}; they must be equal"
            )
        if self.first_point_m.shape != (paths, 3):
            raise DataError(f"CIR: first_point_m has shape {self.first_point_m.shape}, must be ({paths}, 3)")
        self.check_rows("CIR", self.n_view, paths)
        if not (np.isfinite(self.gain).all() and np.isfinite(self.delay_s).all()):
            raise DataError("CIR: gain or delay holds NaN or infinity; every path needs finite values")
        if (self.delay_s < 0).any():
            raise DataError(f"CIR: delay {self.delay_s.min():g} s is negative; delays must be absolute and at least 0")

    @property
    def range_m(self) -> NDArray[np.float64]:
        """One-way range of each path, ``[n_path]`` metres."""
        return delay_to_range(self.delay_s)

    @property
    def summary(self) -> str:
        """How many views and paths there are, in a few words."""
        return f"{self.n_view} views, {self.gain.size} paths"

    def with_phases(self, phase_rad: NDArray[np.float64]) -> Cir:
        """Return a copy with a phase added to every path of each view, ``[n_view]`` radians."""
        factor = np.exp(1j * np.repeat(phase_rad, self.row_size))
        return replace(self, gain=(self.gain * factor).astype(np.complex64))
