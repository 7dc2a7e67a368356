"""What a method sees of a target: power delay profiles and peaks of some views, and where to look. Never the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import Beam
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.projection import Projection, RangeProfiles, project
from mvla_sim.scene.views import Views

if TYPE_CHECKING:
    from mvla_sim.imaging.imaging_settings import ImagingSettings

__all__ = ["Estimate", "FrontEnd", "Observation"]


@dataclass(frozen=True, eq=False, repr=False)
class FrontEnd:
    """What every method starts from, for all views of a file.

    Attributes
    ----------
    pdp
        Noisy profiles; None for channels that hold components alone.
    peaks
        The components found in them, or the channel's own.
    resolution_m
        ΔR, metres.
    """

    pdp: Pdp | None
    peaks: Peaks
    resolution_m: float

    def __repr__(self) -> str:
        return f"FrontEnd({self.pdp!r}, {self.peaks!r}, ΔR = {self.resolution_m:g} m)"

    def select(self, indices: NDArray[np.intp]) -> FrontEnd:
        """Return the given views, in the given order."""
        pdp = None if self.pdp is None else self.pdp.select(indices)
        return FrontEnd(pdp, self.peaks.select(indices), self.resolution_m)


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """What a method returns.

    Attributes
    ----------
    score
        The larger, the more likely a voxel is part of the target; ``[nz, ny, nx]`` float32, any unit.
    support_deg
        Θ_n, ``[nz, ny, nx]`` float32, degrees; None for methods without angular support.
    """

    score: NDArray[np.float32]
    support_deg: NDArray[np.float32] | None = None

    def __repr__(self) -> str:
        support = "" if self.support_deg is None else ", with angular support"
        return f"Estimate({' × '.join(map(str, self.score.shape[::-1]))} voxels{support})"


@dataclass(frozen=True, eq=False, repr=False)
class Observation:
    """What a method sees.

    Attributes
    ----------
    front
        Profiles and peaks of M views.
    views
        Positions T_m and angles φ_m of the same views.
    grid
        Voxel centres p_n, N = nz·ny·nx of them.
    settings
        All settings of imaging.
    extent_m
        The target's extent D, metres; NaN where it is not known.
    span_m
        Ranges at which the grid is seen from any view of the file, metres.
    beam
        The sector that each view's antennas cover; None: everywhere.
    made
        Range profiles of the method, where they were made before; see :meth:`Method.profiles
        <mvla_sim.imaging.method.Method.profiles>`.
    """

    front: FrontEnd
    views: Views
    grid: VoxelGrid
    settings: ImagingSettings
    extent_m: float
    span_m: tuple[float, float]
    beam: Beam | None = None
    made: RangeProfiles | None = None

    def __repr__(self) -> str:
        return f"Observation({self.n_view} views, {self.peaks.range_m.size} peaks, {self.grid.size} voxels)"

    @property
    def pdp(self) -> Pdp:
        """Noisy power delay profiles: ``power`` ``[n_view, n_range]``, ``range_m`` ``[n_range]`` metres, one way."""
        assert self.front.pdp is not None  # methods that need profiles are refused where there are none
        return self.front.pdp

    @property
    def peaks(self) -> Peaks:
        """Components found in the profiles: ``range_m``, ``power``, ``view``, each ``[n_peak]``."""
        return self.front.peaks

    @property
    def resolution_m(self) -> float:
        """ΔR = c/(2B), metres."""
        return self.front.resolution_m

    @property
    def n_view(self) -> int:
        """Number of views M."""
        return len(self.views)

    def range_m(self, view: int) -> NDArray[np.float64]:
        """One-way range of every voxel from a view, of a pair half the way there and back, ``[nz, ny, nx]`` metres."""
        x, y, z = self.grid.axes()
        z, y, x = np.meshgrid(z, y, x, indexing="ij")
        ends = [self.views.positions_m[view]]
        if self.views.receivers_m is not None:
            ends.append(self.views.receivers_m[view])
        distances = [np.sqrt((x - end[0]) ** 2 + (y - end[1]) ** 2 + (z - end[2]) ** 2) for end in ends]
        return np.asarray(np.mean(distances, axis=0), np.float64)

    def project(self, profiles: RangeProfiles) -> Projection:
        """Project range profiles, one a view, onto the grid: sums and, with the ranges of peaks, angular support."""
        return project(self.grid, self.views, profiles, beam=self.beam)

    def select(self, indices: NDArray[np.intp]) -> Observation:
        """Return the given views, in the given order."""
        made = None if self.made is None else self.made.select(indices)
        return replace(self, front=self.front.select(indices), views=self.views.select(indices), made=made)
