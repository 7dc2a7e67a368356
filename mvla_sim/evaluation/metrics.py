"""How near a binary reconstruction is to the ground truth: Chamfer distance and the field's other scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mvla_sim.errors import DataError
from mvla_sim.evaluation.ground_truth import whole_coordinates
from mvla_sim.grid import VoxelGrid

__all__ = ["Scores", "chamfer_db", "chamfer_of_sums", "decibel", "score"]

Floats = NDArray[np.float64]

EMPTY = "the reconstruction is empty: no voxel passed the thresholds"
SAME_DISTANCE = 1e-9  # relative; a voxel at 5 cm counts as within 0.05 m whatever the rounding of either


@dataclass(frozen=True)
class Scores:
    """Scores of one binary reconstruction; NaN where it is empty, with the reason.

    Attributes
    ----------
    cd_db
        Chamfer distance (``eq:chamfer_ch4``), dB(m²); −inf for identical sets.
    accuracy_m
        Mean distance from a reconstructed voxel to the nearest truth voxel, metres.
    completeness_m
        Mean distance from a truth voxel to the nearest reconstructed voxel, metres.
    hausdorff95_m
        The larger of the 95th percentiles of the two sets of distances, metres.
    distances_m
        Distances d of the next three, metres.
    precision
        Share of reconstructed voxels with a truth voxel within d, one entry a distance.
    recall
        Share of truth voxels with a reconstructed voxel within d.
    f1
        Harmonic mean of precision and recall; 0 where both are 0.
    n_truth, n_reconstruction
        Numbers of voxels.
    area_m2
        Retained area n_reconstruction·spacing², m².
    reason
        Why scores are NaN; empty where they are not.
    """

    cd_db: float
    accuracy_m: float
    completeness_m: float
    hausdorff95_m: float
    distances_m: tuple[float, ...]
    precision: tuple[float, ...]
    recall: tuple[float, ...]
    f1: tuple[float, ...]
    n_truth: int
    n_reconstruction: int
    area_m2: float
    reason: str = ""

    def __repr__(self) -> str:
        """One line: Chamfer distance and F1."""
        if self.reason:
            return f"Scores({self.reason})"
        f1 = ", ".join(f"{v:.2f} at {100 * d:g} cm" for d, v in zip(self.distances_m, self.f1, strict=True))
        return f"Scores(CD {self.cd_db:.2f} dB(m²), F1 {f1})"

    def as_dict(self) -> dict[str, Any]:
        """Return one flat row; precision, recall and F1 carry their distance in the name, as in ``f1_5cm``."""
        row: dict[str, Any] = {
            name: getattr(self, name) for name in ("cd_db", "accuracy_m", "completeness_m", "hausdorff95_m")
        }
        for name in ("precision", "recall", "f1"):
            for distance, value in zip(self.distances_m, getattr(self, name), strict=True):
                row[f"{name}_{100 * distance:g}cm"] = value
        return row | {name: getattr(self, name) for name in ("n_truth", "n_reconstruction", "area_m2", "reason")}


def chamfer_db(truth: Floats, reconstruction: Floats) -> float:
    """Chamfer distance of two sets of points in dB(m²) (``eq:chamfer_ch4``).

    Parameters
    ----------
    truth, reconstruction
        Voxel centres, ``[n, 3]`` metres.

    Returns
    -------
    float
        10·log10 of the sum of both mean squared nearest distances; NaN for an empty reconstruction, −inf for
        identical sets.

    Raises
    ------
    DataError
        The truth is empty, or an array is not ``[n, 3]`` or not finite.

    Examples
    --------
    >>> chamfer_db(np.zeros((1, 3)), np.array([[0.0, 0.3, 0.4]]))  # 10·log10(2·0.25)
    -3.010299956639812
    """
    for name, points in (("truth", truth), ("reconstruction", reconstruction)):
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise DataError(f"{name}: shape {points.shape}; finite points [n, 3] in metres are needed")
    if len(truth) == 0:
        raise DataError("truth: holds no point; at least one is needed")
    if len(reconstruction) == 0:
        return float("nan")
    forth, back = _nearest(truth, reconstruction), _nearest(reconstruction, truth)
    return float(decibel(np.mean(forth**2) + np.mean(back**2)))


def score(
    truth: NDArray[np.bool_],
    reconstruction: NDArray[np.bool_],
    grid: VoxelGrid,
    distances_m: Sequence[float] = (0.05, 0.10),
) -> Scores:
    """Score a binary reconstruction against the ground truth.

    Parameters
    ----------
    truth, reconstruction
        Masks ``[nz, ny, nx]`` bool on ``grid``.
    grid
        The voxel grid.
    distances_m
        Distances for precision, recall and F1, metres.

    Raises
    ------
    DataError
        A mask has another shape than the grid, the truth is empty, or a distance is not positive.
    """
    for name, mask in (("ground truth", truth), ("reconstruction", reconstruction)):
        if mask.shape != grid.shape:
            raise DataError(f"{name}: shape {mask.shape} is not the grid's {grid.shape}")
    distances = tuple(float(distance) for distance in distances_m)
    if not all(0 < distance < np.inf for distance in distances):
        raise DataError(f"distances_m = {distances}: each must be a positive length")
    # In voxels all coordinates are whole numbers, so squared distances and the comparisons below are exact.
    x, y = (whole_coordinates(np.flatnonzero(mask), grid) for mask in (truth, reconstruction))
    if len(x) == 0:
        raise DataError("ground truth: holds no voxel; at least one is needed")
    area = len(y) * grid.spacing_m**2
    if len(y) == 0:
        nothing = (float("nan"),) * len(distances)
        nan = float("nan")
        return Scores(nan, nan, nan, nan, distances, nothing, nothing, nothing, len(x), 0, area, EMPTY)
    forth, back = np.rint(_nearest(x, y) ** 2), np.rint(_nearest(y, x) ** 2)
    cd = chamfer_of_sums(forth.sum(), back.sum(), len(x), len(y)) * grid.spacing_m**2
    limits = [(distance / grid.spacing_m) ** 2 * (1 + SAME_DISTANCE) for distance in distances]
    precision = tuple(float(np.mean(back <= limit)) for limit in limits)
    recall = tuple(float(np.mean(forth <= limit)) for limit in limits)
    forth_m, back_m = grid.spacing_m * np.sqrt(forth), grid.spacing_m * np.sqrt(back)
    return Scores(
        cd_db=float(decibel(cd)),
        accuracy_m=float(back_m.mean()),
        completeness_m=float(forth_m.mean()),
        hausdorff95_m=float(max(np.percentile(forth_m, 95), np.percentile(back_m, 95))),
        distances_m=distances,
        precision=precision,
        recall=recall,
        f1=tuple(2 * p * r / (p + r) if p + r else 0.0 for p, r in zip(precision, recall, strict=True)),
        n_truth=len(x),
        n_reconstruction=len(y),
        area_m2=area,
    )


def chamfer_of_sums(truth: Any, back: Any, truth_size: Any, kept: Any) -> Any:
    """A/U + B/k as one quotient (A·k + B·U)/(U·k): for whole numbers, equal values come out equal to the bit.

    Parameters
    ----------
    truth, back
        A and B: sums of squared distances truth → reconstruction and reconstruction → truth; numbers or arrays.
    truth_size, kept
        U and k: numbers of truth voxels and of reconstructed ones.
    """
    return (truth * kept + back * truth_size) / (truth_size * kept)


def decibel(value: Any) -> Any:
    """10·log10 of a number or array; −inf for 0."""
    with np.errstate(divide="ignore"):
        return 10 * np.log10(value)


def _nearest(points: Floats, others: Floats) -> Floats:
    """Distance of each point to the nearest of the others, ``[n]``."""
    return np.asarray(cKDTree(others).query(points)[0], np.float64)
