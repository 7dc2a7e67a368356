"""The voxel grid: where the image lives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from mvla_sim.errors import ConfigError
from mvla_sim.settings import Settings

__all__ = ["GridSettings", "VoxelGrid"]


class GridSettings(Settings):
    """The voxel grid: centre, size and spacing. A vertical size of 0 is one layer at the centre's height.

    The paper divides its region "into a uniform voxel grid" and does not say where the voxels lie. With even counts
    voxel edges lie on the grid's centre, and so on multiples of the spacing from it; with odd ones voxel centres do. An
    outline along such a multiple touches the voxels on both of its sides in the first case, so that its contour is two
    voxels thick, and runs through one row of voxels in the second. ``align`` chooses: a size that gives a count of the
    other parity is made one voxel larger. One layer is one layer in either case.
    """

    center_m: tuple[float, float, float] | None = Field(
        None, description="of the grid, x, y and z; by default the origin, at the height of the imaging plane"
    )
    size_m: tuple[PositiveFloat, PositiveFloat, NonNegativeFloat] = Field(
        (10.0, 10.0, 0.0), description="along x, y and z; a height of 0 is one layer"
    )
    spacing_m: PositiveFloat = Field(0.05, description="side of a voxel")
    align: Literal["edges", "centers"] | None = Field(
        None, description="which of voxel edges and centres lie on the grid's centre; by default as the size gives"
    )

    @model_validator(mode="after")
    def _check(self) -> GridSettings:
        for axis, size in zip("xyz", self.size_m, strict=True):
            if 0 < size < self.spacing_m:
                raise ValueError(f"size_m along {axis} = {size:g} is below spacing_m = {self.spacing_m:g}")
        return self

    def middle_m(self, plane_height_m: float | None = None) -> tuple[float, float, float]:
        """The centre, metres: as set, or else the origin at the height of the imaging plane, or at 0."""
        return self.center_m or (0.0, 0.0, plane_height_m or 0.0)


@dataclass(frozen=True)
class VoxelGrid:
    """A regular grid of cubic voxels; everything follows from its centre, its counts and its spacing.

    Images on the grid are arrays of shape ``[nz, ny, nx]``; flattened in C order, voxel n of the paper is
    ``(iz·ny + iy)·nx + ix``.

    Attributes
    ----------
    center_m
        Centre of the grid (x, y, z), metres.
    counts
        Numbers of voxels (nx, ny, nz).
    spacing_m
        Edge of a voxel, metres.
    """

    center_m: tuple[float, float, float]
    counts: tuple[int, int, int]
    spacing_m: float

    def __post_init__(self) -> None:
        """Refuse empty grids and spacings that are no length."""
        if min(self.counts) < 1:
            raise ConfigError(f"grid: counts = {self.counts}; each must be at least 1")
        if not (np.isfinite(self.spacing_m) and self.spacing_m > 0):
            raise ConfigError(f"grid: spacing_m = {self.spacing_m} must be a positive length")

    @classmethod
    def from_settings(cls, settings: GridSettings, plane_height_m: float | None = None) -> VoxelGrid:
        """Build the grid of a settings block.

        Without a centre it is about the origin, at the height of the imaging plane, or at 0 where that is not known.
        A size that is no multiple of the spacing is rounded to voxels, then up to the parity that ``align`` asks for.
        """
        counts = [max(1, round(size / settings.spacing_m)) for size in settings.size_m]
        if settings.align is not None:
            odd = settings.align == "centers"
            counts = [
                count + (count % 2 != odd) if size > 0 else count
                for count, size in zip(counts, settings.size_m, strict=True)
            ]
        return cls(settings.middle_m(plane_height_m), (counts[0], counts[1], counts[2]), settings.spacing_m)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of an image on the grid, ``(nz, ny, nx)``."""
        nx, ny, nz = self.counts
        return nz, ny, nx

    @property
    def size(self) -> int:
        """Number of voxels N."""
        nx, ny, nz = self.counts
        return nx * ny * nz

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Centre of voxel 0, metres."""
        x, y, z = (c - (n - 1) / 2 * self.spacing_m for c, n in zip(self.center_m, self.counts, strict=True))
        return x, y, z

    def axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Voxel centres along x [nx], y [ny] and z [nz], metres."""
        x, y, z = (
            np.asarray(o + self.spacing_m * np.arange(n), np.float64)
            for o, n in zip(self.origin_m, self.counts, strict=True)
        )
        return x, y, z

    def centers(self, indices: NDArray[np.intp] | None = None) -> NDArray[np.float64]:
        """Voxel centres p_n, ``[n, 3]`` metres: all of them, or those of the given flat indices."""
        flat = np.arange(self.size) if indices is None else np.asarray(indices)
        nx, ny, _ = self.counts
        triple = np.stack([flat % nx, flat // nx % ny, flat // (nx * ny)], axis=-1)
        return np.asarray(np.asarray(self.origin_m) + self.spacing_m * triple, np.float64)

    def bounds_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper corner of the grid's box, voxel edges included, ``[3]`` metres each."""
        half = np.asarray(self.counts) * self.spacing_m / 2
        center = np.asarray(self.center_m)
        return center - half, center + half

    def range_span_m(
        self, positions: NDArray[np.float64], receivers: NDArray[np.float64] | None = None
    ) -> tuple[float, float]:
        """Nearest and farthest range from any of the positions ``[n, 3]`` to a voxel centre, metres.

        With receivers ``[n, 3]`` ranges are bistatic, and the interval is a bound: no voxel lies outside it.
        """
        spans = [self._spans(positions)] if receivers is None else [self._spans(positions), self._spans(receivers)]
        nearest, farthest = (sum(span[k] for span in spans) / len(spans) for k in (0, 1))
        return float(np.min(nearest)), float(np.max(farthest))

    def _spans(self, positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Nearest and farthest distance of each position to a voxel centre, ``[n]`` metres."""
        lower, upper = (np.array([a[0] for a in self.axes()]), np.array([a[-1] for a in self.axes()]))
        nearest = np.linalg.norm(np.clip(positions, lower, upper) - positions, axis=1)
        farthest = np.linalg.norm(np.maximum(positions - lower, upper - positions), axis=1)
        return nearest, farthest
