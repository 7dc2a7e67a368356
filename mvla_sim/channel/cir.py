"""Channel impulse responses: paths of every view as one ragged array, with where they were seen from and how made.

On disk it is NetCDF-4 (hence HDF5): the paths are a CF *contiguous ragged array* along ``path``, ``row_size`` holds the
number of paths of each view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mvla_sim.channel.header import Channel
from mvla_sim.constants import delay_to_range
from mvla_sim.errors import DataError
from mvla_sim.netcdf import Variable
from mvla_sim.ragged import Ragged
from mvla_sim.scene.views import Views, wrapped

__all__ = ["INTERACTIONS", "Cir"]

INTERACTIONS: dict[str, int] = {"specular": 1, "diffuse": 2, "refraction": 4, "diffraction": 8}
"""Bits of ``interaction``; a path of several interactions has the bits of all of them."""

_SAME_PLACE_M: Final = 1e-3
"""How far a position may be from where paths begin; Sionna's are float32."""


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

    @classmethod
    def from_sionna(
        cls,
        paths: Any,
        positions_m: ArrayLike | None = None,
        *,
        carrier_hz: float,
        bandwidth_hz: float,
        center_m: tuple[float, float] = (0.0, 0.0),
        **fields: Any,
    ) -> Self:
        """Take over paths that Sionna RT has traced, between a transmitter and a receiver a view.

        Parameters
        ----------
        paths
            A ``sionna.rt.Paths`` of as many transmitters as receivers, whose n-th pair is view n (paths between others
            are left out), or a sequence of ``Paths`` of one pair each, a view each. Arrays have one antenna and one
            polarization.
        positions_m
            Transmitters, ``[n_view, 3]`` metres, checked against the paths; by default where the paths begin.
        carrier_hz
            Frequency the paths were traced at, hertz.
        bandwidth_hz
            Bandwidth that images are to be made with, hertz.
        center_m
            Point (x, y) that the views' angles are measured about, metres.
        **fields
            Others of the channel: ``extent_m``, ``outline``, ``antenna``, ``config``, ``provenance``.

        Returns
        -------
        Cir
            Gains with the carrier's phase, a·exp(−j2πf·τ), and absolute delays; within a view by rising delay. Direct
            paths, which a co-located pair has of length 0, are no echoes and left out.

        Raises
        ------
        DataError
            Other numbers of transmitters and receivers, arrays of several antennas, or positions that are not those of
            the paths.
        """
        parts = [_pair(one, view) for one in (paths if isinstance(paths, Sequence) else [paths])
                 for view in range(_pairs_of(one))]  # fmt: skip
        if not parts:
            raise DataError("paths: there is none; give a Paths of Sionna RT, or one a view")
        gain, delay, interaction, points, sources, targets = zip(*parts, strict=True)
        begin, end = np.array(sources), np.array(targets)
        if positions_m is not None:
            asked = np.asarray(positions_m, np.float64)
            if asked.shape != begin.shape:
                raise DataError(
                    f"positions_m has shape {asked.shape}; the paths are of {len(begin)} views, [n_view, 3]"
                )
            off = np.linalg.norm(asked - begin, axis=1)
            if not (off <= _SAME_PLACE_M).all():
                raise DataError(f"positions_m: view {off.argmax()} is {off.max():g} m from where its paths begin")
            end = np.where(end == begin, asked, end)
            begin = asked
        apart = bool((np.linalg.norm(end - begin, axis=1) > _SAME_PLACE_M).any())
        about = ((begin + end) / 2)[:, :2] - center_m
        angles = wrapped(np.rad2deg(np.arctan2(about[:, 1], about[:, 0])))
        turn = np.exp(-2j * np.pi * carrier_hz * np.concatenate(delay))
        return cls(
            gain=(np.concatenate(gain) * turn).astype(np.complex64),
            delay_s=np.concatenate(delay),
            interaction=np.concatenate(interaction),
            first_point_m=np.concatenate(points),
            row_size=np.array([part.size for part in gain], np.int64),
            views=Views(begin, angles, center_m, end if apart else None),
            carrier_hz=carrier_hz,
            bandwidth_hz=bandwidth_hz,
            **fields,
        )


def _pairs_of(paths: Any) -> int:
    """Number of pairs in a ``Paths`` of Sionna RT; refuses what has none."""
    shape = tuple(paths.a[0].shape)
    if shape[0] != shape[2]:
        raise DataError(f"paths: {shape[2]} transmitters and {shape[0]} receivers; allowed: one of each a view")
    if shape[1] != 1 or shape[3] != 1:
        raise DataError(f"paths: arrays of {shape[3]} and {shape[1]} antennas; allowed: one antenna, one polarization")
    return int(shape[0])


def _pair(paths: Any, n: int) -> tuple[NDArray[Any], ...]:
    """Amplitude, delay, interaction, first point, and the ends, of pair ``n`` of a ``Paths``, by rising delay."""

    def of_pair(tensor: Any, before: int = 0, after: int = 0) -> NDArray[Any]:
        """An array ``[…, n_path, …]`` of one with axes of receivers and transmitters, and antennas if not synthetic."""
        values = np.asarray(tensor.numpy())
        if values.ndim == before + 5 + after:
            values = values.take(0, before + 1).take(0, before + 2)
        pair: NDArray[Any] = values.take(n, before).take(n, before)
        return pair

    delay = of_pair(paths.tau).astype(np.float64)
    amplitude = of_pair(paths.a[0]).astype(np.float64) + 1j * of_pair(paths.a[1])
    ends = [np.asarray(place.numpy(), np.float64)[:, n] for place in (paths.sources, paths.targets)]
    if not delay.size:
        return amplitude, delay, np.zeros(0, np.uint8), np.zeros((0, 3), np.float32), *ends
    kinds = of_pair(paths.interactions, before=1).astype(np.uint8)
    interaction = np.bitwise_or.reduce(kinds & np.uint8(sum(INTERACTIONS.values())), axis=0)
    first = of_pair(paths.vertices, before=1, after=1)[0].astype(np.float32)
    kept = np.flatnonzero(of_pair(paths.valid).astype(bool) & (kinds > 0).any(axis=0))
    order = kept[np.lexsort((amplitude.imag[kept], amplitude.real[kept], delay[kept]))]
    return amplitude[order], delay[order], interaction[order], first[order], *ends
