"""Score an image against the target's cross-section."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from mvla_sim.errors import DataError, check_argument
from mvla_sim.evaluation.candidates import chamfer_table
from mvla_sim.evaluation.ground_truth import check_inside, rasterize
from mvla_sim.evaluation.metrics import Scores, score
from mvla_sim.evaluation.ranking import average_precision
from mvla_sim.evaluation.scan import ScanSettings
from mvla_sim.evaluation.tuning import Optimum, TruthGeometry, optimal_thresholds
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.thresholds import THRESHOLD_RULES, ThresholdRule, joint_threshold
from mvla_sim.settings import Settings

__all__ = ["Evaluation", "EvaluationSettings", "evaluate", "ground_truth"]

HALF: Final = 0.5 + 1e-6
"""Of a voxel, but for rounding: so far a grid of one layer may be from the plane of its truth."""


class EvaluationSettings(Settings):
    """What the image is compared with, and how.

    The paper's truth is "ground-truth occupied voxel centers" (``eq:chamfer_ch4``) of a contour, of which it gives no
    thickness. With ``thickness_m`` every voxel whose centre lies within half of it from the outline is one, besides
    those that the outline passes through: a wall of that thickness, or a voxel model drawn with a wide pen.
    """

    truth: Literal["contour", "filled"] = Field("contour", description="voxels of the outline, or all inside it too")
    thickness_m: NonNegativeFloat = Field(0.0, description="of the contour; 0: the voxels it passes through alone")
    distances_m: tuple[PositiveFloat, ...] = Field((0.05, 0.10), description="for precision, recall and F1")
    average_precision: bool = Field(
        False, description="also the area under precision and recall at the largest of these distances; no thresholds"
    )
    threshold_map: bool = Field(
        False, description="also the CD at every candidate pair (p, T_θ), for a calibration by the least mean"
    )
    scan: ScanSettings = ScanSettings()
    threshold: Annotated[ThresholdRule, THRESHOLD_RULES] | None = Field(
        None, description="by default the optimum over every p and T_θ; 'auto': from the image, without the truth"
    )

    @model_validator(mode="after")
    def _check(self) -> EvaluationSettings:
        if self.thickness_m > 0 and self.truth != "contour":
            raise ValueError(f"thickness_m = {self.thickness_m:g}: is of a contour; with truth = '{self.truth}' give 0")
        return self


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How well an image fits its ground truth.

    Attributes
    ----------
    protocol
        ``optimal``: thresholds chosen with the ground truth (an oracle); ``given``: thresholds from the settings;
        ``auto``, or the name of another rule: from the image, without the truth.
    top_percent, min_support_deg
        The thresholds p (per cent of all voxels) and T_θ (degrees) that ``scores`` were measured at.
    scores
        CD, accuracy, completeness, precision, recall, F1 and Hausdorff-95 at those thresholds.
    optimum
        The exact optimum over every p and T_θ of the scan; None where it was not asked for.
    average_precision
        :func:`~mvla_sim.evaluation.ranking.average_precision` by column name; empty where it was not asked for.
    threshold_map
        :func:`~mvla_sim.evaluation.candidates.chamfer_table`; None where it was not asked for.
    truth, occupied
        Ground truth and binary reconstruction, ``[nz, ny, nx]`` bool.
    """

    protocol: str
    top_percent: float
    min_support_deg: float
    scores: Scores
    optimum: Optimum | None
    average_precision: Mapping[str, float]
    threshold_map: NDArray[np.float32] | None
    truth: NDArray[np.bool_]
    occupied: NDArray[np.bool_]

    def __repr__(self) -> str:
        """One line: the thresholds, and the distance at them."""
        pair = f"p = {self.top_percent:.4g} %, T_θ = {self.min_support_deg:.4g}°"
        return f"Evaluation({self.protocol} thresholds, {pair}: CD {self.cd_db:.2f} dB(m²))"

    @property
    def cd_db(self) -> float:
        """Chamfer distance at the thresholds used, dB(m²)."""
        return self.scores.cd_db

    def as_dict(self) -> dict[str, Any]:
        """Flat row for a table: thresholds, metrics, and the optimum if it is known."""
        row = {
            "protocol": self.protocol,
            "top_percent": self.top_percent,
            "min_support_deg": self.min_support_deg,
            **self.scores.as_dict(),
            **self.average_precision,
        }
        if self.optimum is not None:
            row["optimal_cd_db"] = self.optimum.cd_db
            row["optimal_top_percent"] = self.optimum.top_percent
            row["optimal_min_support_deg"] = self.optimum.min_support_deg
        return row


def ground_truth(image: Image, settings: EvaluationSettings) -> NDArray[np.bool_]:
    """Rasterise the outline that an image carries onto its grid, ``[nz, ny, nx]`` bool.

    Raises
    ------
    DataError
        The image has no outline (measured data), or the outline, with its thickness, reaches out of the grid, or is
        that of another height.
    """
    if image.outline is None:
        raise DataError("the image carries no outline of its target, so there is no ground truth to compare with")
    check_inside(image.outline, image.grid, settings.thickness_m)
    z, plane = image.grid.center_m[2], image.plane_height_m
    if plane is not None and image.grid.counts[2] == 1 and abs(z - plane) > HALF * image.grid.spacing_m:
        raise DataError(
            f"ground truth: the grid is at z = {z:g} m and the truth is that of the imaging plane z = {plane:g} m; "
            f"leave out grid.center_m or set its z to {plane:g}, or plane_height_m of the scene"
        )
    return rasterize(image.outline, image.grid, settings.truth, settings.thickness_m)


def evaluate(
    image: Image,
    settings: EvaluationSettings | None = None,
    geometry: TruthGeometry | None = None,
    *,
    with_optimum: bool = True,
) -> Evaluation:
    """Score an image.

    Parameters
    ----------
    image
        A continuous image.
    settings
        Kind of truth, distances for F1, and thresholds; without thresholds those of the exact optimum are used, over
        the thresholds of the scan.
    geometry
        The truth, prepared by :class:`TruthGeometry`; give it when many images share one truth and grid.
    with_optimum
        Search for the optimum even where thresholds are given; the search takes longer than all scores.

    Raises
    ------
    DataError
        No ground truth, or it does not fit the grid.
    ConfigError
        Thresholds that the method does not know, or a scan whose bounds hold no voxel.
    """
    check_argument("image", image, Image, "see reconstruct")
    settings = EvaluationSettings() if settings is None else settings
    check_argument("settings", settings, EvaluationSettings, "make one")
    if geometry is None:
        truth = ground_truth(image, settings)
        geometry = TruthGeometry.build(truth, image.grid)
    else:
        truth = np.zeros(image.grid.size, bool)
        truth[geometry.voxels] = True
        truth = truth.reshape(image.grid.shape)
    optimum = None
    if with_optimum or settings.threshold is None:
        optimum = optimal_thresholds(image.score, image.support_deg, geometry, settings.scan)
    if settings.threshold is not None:
        protocol = str(THRESHOLD_RULES.name_of(type(settings.threshold)))
        percent, support = settings.threshold.thresholds(image.score, image.support_deg, image.grid, image.resolution_m)
    else:
        assert optimum is not None
        protocol, percent, support = "optimal", optimum.top_percent, optimum.min_support_deg
    occupied = joint_threshold(image.score, image.support_deg, percent, support)
    scores = score(truth, occupied, image.grid, settings.distances_m)
    ranked = {}
    if settings.average_precision:
        distance = max(settings.distances_m)
        ranked[f"ap_{100 * distance:g}cm"] = average_precision(image.score, geometry, distance)
    tried = chamfer_table(image, geometry, settings.scan) if settings.threshold_map else None
    return Evaluation(protocol, percent, support, scores, optimum, ranked, tried, truth, occupied)
