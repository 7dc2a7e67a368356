"""The image: a score per voxel, its angular support, and everything that made it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely
import xarray as xr
from numpy.typing import NDArray

from mvla_sim.errors import DataError, MvlaError
from mvla_sim.grid import VoxelGrid
from mvla_sim.netcdf import check_schema, read_netcdf, table_of, write_netcdf

__all__ = ["SCHEMA", "SCHEMA_VERSION", "Image"]

SCHEMA = "mvla-sim image"
SCHEMA_VERSION = 1


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """A continuous image on a grid.

    Attributes
    ----------
    score
        s_n of MVLA-GR and the hard vote, in [0, 1]; for BP the sum of PDPs over their largest value;
        ``[nz, ny, nx]`` float32.
    support_deg
        Θ_n, ``[nz, ny, nx]`` float32, degrees; None for methods without peaks.
    grid
        The voxel grid.
    method
        Name of the method.
    n_view
        Views used.
    occupied
        Binary image, ``[nz, ny, nx]`` bool, if thresholds were given.
    outline
        The target's outline carried along from the CIR for evaluation; imaging never looks at it.
    plane_height_m
        Height at which the outline was cut, metres; None where it is not known.
    resolution_m
        ΔR = c/(2B), metres; None in files of earlier versions.
    config, provenance
        Settings of simulation and imaging, versions, as plain data.
    """

    score: NDArray[np.float32]
    support_deg: NDArray[np.float32] | None
    grid: VoxelGrid
    method: str
    n_view: int
    occupied: NDArray[np.bool_] | None = None
    outline: Any = None
    resolution_m: float | None = None
    plane_height_m: float | None = None
    config: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        nx, ny, nz = self.grid.counts
        binary = "" if self.occupied is None else f", {self.occupied.sum()} occupied"
        return f"Image({self.method}, {self.n_view} views, {nx} × {ny} × {nz} voxels{binary})"

    def __post_init__(self) -> None:
        """Check shapes against the grid."""
        for name in ("score", "support_deg", "occupied"):
            array = getattr(self, name)
            if array is not None and array.shape != self.grid.shape:
                raise DataError(f"image: {name} has shape {array.shape}, the grid {self.grid.shape}")

    def to_dataset(self) -> xr.Dataset:
        """Return the labelled dataset that :meth:`save` writes."""
        x, y, z = self.grid.axes()
        axes = ("z", "y", "x")
        variables: dict[str, Any] = {"score": (axes, self.score, {"long_name": f"{self.method} score", "units": "1"})}
        if self.support_deg is not None:
            variables["support"] = (axes, self.support_deg, {"long_name": "angular support", "units": "degree"})
        if self.occupied is not None:
            variables["occupied"] = (axes, self.occupied.astype(np.uint8), {"long_name": "binary reconstruction"})
        attributes = {
            "Conventions": "CF-1.11",
            "title": f"{self.method} image from {self.n_view} views",
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "method": self.method,
            "views": self.n_view,
            "spacing_m": self.grid.spacing_m,
            "config": json.dumps(dict(self.config), sort_keys=True),
            "provenance": json.dumps(dict(self.provenance), sort_keys=True),
        }
        if self.resolution_m is not None:
            attributes["resolution_m"] = self.resolution_m
        if self.plane_height_m is not None:
            attributes["imaging_plane_height_m"] = self.plane_height_m
        if self.outline is not None:
            attributes["target_outline_wkt"] = shapely.to_wkt(self.outline, rounding_precision=9)
        metres = {"units": "m"}
        return xr.Dataset(variables, {"x": ("x", x, metres), "y": ("y", y, metres), "z": ("z", z, metres)}, attributes)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write NetCDF-4 under a temporary name and rename it.

        Raises
        ------
        OutputError
            The file cannot be written.
        """
        dataset = self.to_dataset()
        write_netcdf(dataset, path, [str(name) for name in dataset.data_vars])

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Image:
        """Read an image file and check it.

        Raises
        ------
        DataError
            Missing, empty, truncated, not NetCDF-4, no image file, of another schema version, or inconsistent.
        """
        dataset = read_netcdf(path)
        check_schema(dataset, path, SCHEMA, SCHEMA_VERSION, ("score", "x", "y", "z"))
        try:
            axes = [dataset[name].values.astype(np.float64) for name in "xyz"]
            center = tuple(float((a[0] + a[-1]) / 2) for a in axes)
            grid = VoxelGrid(center, tuple(a.size for a in axes), float(dataset.attrs["spacing_m"]))  # type: ignore[arg-type]
            wkt = dataset.attrs.get("target_outline_wkt")
            return cls(
                score=dataset["score"].values.astype(np.float32),
                support_deg=dataset["support"].values.astype(np.float32) if "support" in dataset else None,
                grid=grid,
                method=str(dataset.attrs["method"]),
                n_view=int(dataset.attrs["views"]),
                occupied=dataset["occupied"].values.astype(bool) if "occupied" in dataset else None,
                outline=shapely.from_wkt(wkt) if wkt else None,
                resolution_m=_number(dataset, "resolution_m"),
                plane_height_m=_number(dataset, "imaging_plane_height_m"),
                config=table_of(dataset, "config"),
                provenance=table_of(dataset, "provenance"),
            )
        except KeyError as error:
            raise DataError(f"{path}: attribute {error} is missing from this image file") from error
        except (ValueError, TypeError, IndexError, MvlaError, shapely.GEOSException) as error:
            raise DataError(f"{path}: not a readable image file ({error})") from error


def _number(dataset: xr.Dataset, name: str) -> float | None:
    return float(dataset.attrs[name]) if name in dataset.attrs else None
