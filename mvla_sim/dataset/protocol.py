"""The protocol that methods are compared under, sample by sample.

Every sample is imaged from all its views at 20 dB, with noise of the sample's number as seed, on the dataset's grid. A
method has one pair of thresholds, p and T_θ, for all samples: the one with the least mean Chamfer distance, in dB, over
the validation split. The test split is scored at that pair; no threshold ever sees its truth.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.dataset.access import Sample
from mvla_sim.dataset.campaign import CampaignSettings
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import ConfigError, MvlaError, reason
from mvla_sim.evaluation.candidates import best_db, best_pair, chamfer_table, worst_db
from mvla_sim.evaluation.ground_truth import TruthGeometry
from mvla_sim.evaluation.metrics import Scores, score
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.imaging.threshold_rules.given import GivenThresholds
from mvla_sim.imaging.thresholds import joint_threshold

__all__ = [
    "DISTANCES_M", "PROTOCOL", "SNR_DB", "Attempt", "best_thresholds", "failed_metrics", "protocol_settings",
    "score_sample",
]  # fmt: skip

PROTOCOL: Final = 1
"""Version of the protocol; results of different versions are not compared."""
SNR_DB: Final = 20.0
DISTANCES_M: Final = (0.05, 0.10)
FIXED: Final = ("method", "grid", "noise", "views", "threshold")
"""Blocks of settings that are the protocol's."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """What a method made of a sample."""

    sample: int  # its number
    error: str = ""  # why there is no image, in one line
    seconds: float = 0.0  # from the CIR to the image
    table: NDArray[np.float32] | None = None  # validation: CD of every pair, [n_support, n_percent] dB(m²)
    metrics: Mapping[str, float] = field(default_factory=dict)  # test: scores at the thresholds, by name


def protocol_settings(campaign: CampaignSettings, method: str, overrides: Sequence[str] = ()) -> ImagingSettings:
    """Settings of imaging under the protocol; ``overrides`` are dotted keys of what is the method's own.

    Raises
    ------
    ConfigError
        No such method or setting, or one that the protocol fixes.
    """
    for text in overrides:
        block = text.partition("=")[0].strip().split(".")[0]
        if block in FIXED:
            raise ConfigError(f"{text}: the protocol fixes {block}; allowed: the method's own settings")
    return imaging_settings(
        overrides, method=method, grid=campaign.grid.model_dump(mode="json"), noise={"snr_db": SNR_DB}
    )


def score_sample(
    sample: Sample, settings: Sequence[ImagingSettings], thresholds: Sequence[GivenThresholds | None]
) -> list[Attempt]:
    """Apply methods to a sample: score each at its thresholds, or where they are None try every pair of candidates."""
    provenance()  # asks git once a process, which is no time of a method
    geometry = TruthGeometry.build(sample.contour, sample.grid)
    return [_attempt(sample, one, pair, geometry) for one, pair in zip(settings, thresholds, strict=True)]


def _attempt(
    sample: Sample, settings: ImagingSettings, thresholds: GivenThresholds | None, geometry: TruthGeometry
) -> Attempt:
    number = sample.number
    noise = settings.noise.model_copy(update={"seed": number})
    began = time.perf_counter()
    try:
        image = reconstruct(sample.cir, settings.model_copy(update={"noise": noise}))
    except MvlaError as error:
        return Attempt(number, reason(error), time.perf_counter() - began)
    seconds = time.perf_counter() - began
    if thresholds is None:
        return Attempt(number, seconds=seconds, table=chamfer_table(image, geometry))
    support = thresholds.min_support_deg if image.support_deg is not None else 0.0
    occupied = joint_threshold(image.score, image.support_deg, thresholds.top_percent, support)
    metrics = _metrics(score(sample.contour, occupied, sample.grid, DISTANCES_M), sample.grid)
    return Attempt(number, seconds=seconds, metrics=metrics)


def best_thresholds(attempts: Sequence[Attempt], grid: VoxelGrid) -> tuple[GivenThresholds, float]:
    """The pair with the least mean CD over validation samples, and that mean, dB(m²).

    Where several are equal, the smallest T_θ, then the smallest p. A sample without an image counts as worst.

    Raises
    ------
    ConfigError
        No sample has an image.
    """
    tables = [attempt.table for attempt in attempts if attempt.table is not None]
    if not tables:
        first = next((attempt.error for attempt in attempts if attempt.error), "there are no validation samples")
        raise ConfigError(f"no image of any validation sample: {first}")
    shape = tables[0].shape
    failures = [np.full(shape, worst_db(grid), np.float32)] * (len(attempts) - len(tables))
    mean = np.mean(np.array([*tables, *failures], np.float64), axis=0)
    return best_pair(mean)


def failed_metrics(grid: VoxelGrid) -> dict[str, float]:
    """Scores that stand for an image that is not there."""
    return {"cd_db": worst_db(grid), **{f"f1_{100 * d:g}cm": 0.0 for d in DISTANCES_M}, "empty": 1.0}


def _metrics(scores: Scores, grid: VoxelGrid) -> dict[str, float]:
    """CD and F1 at each distance; those of an empty reconstruction are the worst."""
    if scores.reason:
        return failed_metrics(grid)
    f1 = {f"f1_{100 * d:g}cm": value for d, value in zip(scores.distances_m, scores.f1, strict=True)}
    return {"cd_db": float(np.clip(scores.cd_db, best_db(grid), worst_db(grid))), **f1, "empty": 0.0}
