"""What every reader of foreign ray-tracing files returns: the paths between pairs of transmitter and receiver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat

from mvla_sim.channel.cir import INTERACTIONS, Cir
from mvla_sim.channel.readers.source import Foreign, GivenRadio, Reader
from mvla_sim.errors import DataError
from mvla_sim.ragged import Ragged

__all__ = ["PairPaths", "PairReader", "PairSelection", "drop_line_of_sight", "join_pairs", "select_pairs"]

PairSelection = Literal["co-located", "all", "auto"]
"""Which pairs to keep: sensors that hear their own signal, every pair, or the former where there is one."""

_LONGEST_DELAY_S: Final = 1.0
_LARGEST_COORDINATE_M: Final = 1e9
_LARGEST_GAIN: Final = 1e10
"""Beyond these a file is damaged or in other units, and squares of its numbers could leave the range of float32."""
_OF_PAIRS: Final = ("transmitters_m", "receivers_m", "row_size")
_OF_PATHS: Final = ("gain", "delay_s", "interaction", "first_point_m")


@dataclass(frozen=True, eq=False)
class PairPaths(Ragged):
    """Paths between pairs of transmitter and receiver; pair after pair, within a pair by rising delay.

    Attributes
    ----------
    transmitters_m, receivers_m
        Position of the transmitter and the receiver of each pair, ``[n_pair, 3]`` float64, metres.
    row_size
        Paths of each pair, ``[n_pair]`` int64; may be 0.
    gain
        Complex baseband gain of each path, carrier phase included, ``[n_path]`` complex128; |gain|² is received over
        transmitted power.
    delay_s
        Absolute delay from transmitter by way of the target to receiver, ``[n_path]`` float64, seconds.
    interaction
        Bits of :data:`~mvla_sim.channel.cir.INTERACTIONS`, ``[n_path]`` uint8; 0 says that the path is direct, never
        that its interactions are unknown.
    first_point_m
        First interaction point, ``[n_path, 3]`` float32, metres; NaN where unknown and on direct paths.
    carrier_hz
        Carrier frequency, hertz; None where the file does not tell.
    source
        Where the paths are from and what was decided in reading them, as text.
    """

    transmitters_m: NDArray[np.float64]
    receivers_m: NDArray[np.float64]
    row_size: NDArray[np.int64]
    gain: NDArray[np.complex128]
    delay_s: NDArray[np.float64]
    interaction: NDArray[np.uint8]
    first_point_m: NDArray[np.float32]
    carrier_hz: float | None
    source: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check shapes, values and order."""
        self._check_shapes()
        for name in ("transmitters_m", "receivers_m"):
            if not (np.abs(getattr(self, name)) <= _LARGEST_COORDINATE_M).all():
                raise DataError(f"paths: {name} holds NaN or values beyond ±{_LARGEST_COORDINATE_M:g} m")
        wrong = ~((self.delay_s >= 0) & (self.delay_s <= _LONGEST_DELAY_S))
        if wrong.any():
            raise DataError(
                f"paths: delay {self.delay_s[wrong][0]:g} s; delays must be absolute, from 0 to {_LONGEST_DELAY_S:g} s"
            )
        with np.errstate(all="ignore"):
            strong = ~(np.abs(self.gain) <= _LARGEST_GAIN)
        if strong.any():
            raise DataError(f"paths: a gain is NaN or above {20 * np.log10(_LARGEST_GAIN):.0f} dB")
        if (np.diff(self.delay_s)[np.diff(self.row_index) == 0] < 0).any():
            raise DataError("paths: the paths of a pair are not in the order of rising delay")
        if (self.interaction > sum(INTERACTIONS.values())).any():
            raise DataError(f"paths: interaction {self.interaction.max()} has bits other than those of {INTERACTIONS}")
        unknown = np.isnan(self.first_point_m)
        if (unknown.any(axis=1) != unknown.all(axis=1)).any():
            raise DataError("paths: first_point_m has points that are NaN in one coordinate only")
        if (np.abs(self.first_point_m) > _LARGEST_COORDINATE_M).any():
            raise DataError(f"paths: first_point_m holds values beyond ±{_LARGEST_COORDINATE_M:g} m")
        if self.carrier_hz is not None and not 0 < self.carrier_hz < np.inf:
            raise DataError(f"paths: carrier {self.carrier_hz:g} Hz must be above 0 and finite")

    def _check_shapes(self) -> None:
        pairs, paths = self.row_size.size, self.gain.size
        wanted = {
            "transmitters_m": (pairs, 3), "receivers_m": (pairs, 3), "row_size": (pairs,), "gain": (paths,),
            "delay_s": (paths,), "interaction": (paths,), "first_point_m": (paths, 3),
        }  # fmt: skip
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise DataError(f"paths: {name} has shape {getattr(self, name).shape}, must be {shape}")
        self.check_rows("paths", pairs, paths)

    @property
    def n_pair(self) -> int:
        """Number of pairs."""
        return self.row_size.size


class PairReader(Reader):
    """A reader of paths between transmitters and receivers, of which some pairs become views."""

    block: ClassVar = "pairs"

    which: PairSelection = Field("auto", description="auto: co-located pairs if there are any")
    tolerance_m: NonNegativeFloat = Field(1.0, description="pairs this near to each other count as co-located")
    line_of_sight: bool = Field(False, description="keep direct paths, which are no echo of a target")
    transmit_power_dbm: float = Field(0.0, description="insite: what received powers are relative to")

    def paths(self, source: Path) -> PairPaths:
        """All pairs of a source, with all their paths."""
        raise NotImplementedError

    def read(self, source: Path, radio: GivenRadio) -> Foreign:
        """Read the pairs, choose among them, and drop direct paths unless they are to be kept."""
        del radio
        paths = select_pairs(self.paths(source), self.which, self.tolerance_m)
        if not self.line_of_sight:
            paths = drop_line_of_sight(paths)
        if paths.n_pair == 0 or not paths.gain.size:
            raise DataError(f"{source}: no echo in any of {paths.n_pair} pairs; nothing can be imaged")
        apart = bool((paths.receivers_m != paths.transmitters_m).any())
        data = {item.field: getattr(paths, item.field) for item in Cir.VARIABLES}
        return Foreign(
            Cir, data | {"gain": paths.gain.astype(np.complex64)}, paths.n_pair, None, paths.transmitters_m,
            paths.receivers_m if apart else None, paths.carrier_hz, paths.source,
        )  # fmt: skip


def join_pairs(parts: Sequence[PairPaths], source: Mapping[str, str]) -> PairPaths:
    """Return the pairs of several files as one, in the order given, with ``source`` as their provenance.

    Raises
    ------
    DataError
        There is none, or their carriers differ.
    """
    if not parts:
        raise DataError("paths: there is no pair of transmitter and receiver")
    carriers = sorted({str(part.carrier_hz) for part in parts})
    if len(carriers) > 1:
        raise DataError(f"paths: files of different carriers ({' and '.join(carriers[:2])} Hz) cannot be joined")
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in (*_OF_PAIRS, *_OF_PATHS)}
    return PairPaths(**joined, carrier_hz=parts[0].carrier_hz, source=dict(source))


def select_pairs(paths: PairPaths, which: PairSelection, tolerance_m: float) -> PairPaths:
    """Keep the pairs whose transmitter and receiver are one sensor, or all.

    Parameters
    ----------
    paths
        Any pairs.
    which
        ``"co-located"``: only pairs no further apart than the tolerance; ``"all"``: every pair; ``"auto"``: the
        co-located ones if there is any, else all.
    tolerance_m
        Largest distance of a co-located pair, metres.

    Raises
    ------
    DataError
        Co-located pairs are asked for and there is none.
    """
    distance = np.linalg.norm(paths.transmitters_m - paths.receivers_m, axis=1)
    near = distance <= tolerance_m
    if which == "all" or (which == "auto" and not near.any()):
        return replace(paths, source={**paths.source, "pairs": f"all {paths.n_pair}"})
    if not near.any():
        closest = f"the closest are {distance.min():g} m apart" if distance.size else "there is no pair at all"
        raise DataError(f"paths: no transmitter and receiver within {tolerance_m:g} m of each other; {closest}")
    chosen = f"the {np.count_nonzero(near)} of {paths.n_pair} that are co-located within {tolerance_m:g} m"
    return replace(
        _keep_paths(paths, near[paths.row_index]),
        **{name: getattr(paths, name)[near] for name in _OF_PAIRS},
        source={**paths.source, "pairs": chosen},
    )


def drop_line_of_sight(paths: PairPaths) -> PairPaths:
    """Remove the direct paths; a pair that has no other stays, with no path."""
    direct = paths.interaction == 0
    return replace(
        _keep_paths(paths, ~direct), source={**paths.source, "direct_paths_dropped": str(np.count_nonzero(direct))}
    )


def _keep_paths(paths: PairPaths, keep: NDArray[np.bool_]) -> PairPaths:
    """Return every pair with those of its paths that are to be kept, ``[n_path]``."""
    row_size = np.bincount(paths.row_index[keep], minlength=paths.n_pair).astype(np.int64)
    return replace(paths, row_size=row_size, **{name: getattr(paths, name)[keep] for name in _OF_PATHS})
