"""The work itself: cases that share a channel, with everything they have in common done once.

:func:`load_profiles` and :func:`run_batch` are pure functions of values that can be pickled, so any scheduler can run
them.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from mvla_sim.channel.loading import Channel, load_channel
from mvla_sim.errors import reason
from mvla_sim.evaluation.candidates import pack_table
from mvla_sim.evaluation.evaluate import Evaluation, evaluate, ground_truth
from mvla_sim.evaluation.ground_truth import TruthGeometry
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.pipeline import Pipeline, ProfiledChannel, profile_channel
from mvla_sim.sweep.case import MAP, Case, Row

__all__ = ["Outcome", "ProfileArguments", "load_profiles", "results", "run_batch"]

MOST_TRUTHS: Final = 8
"""Kept at a time, if they are of no more than so many voxels in all."""
TRUTH_VOXELS: Final = 4_000_000


@dataclass(frozen=True, eq=False)
class Outcome:
    """One case with its image, for pictures."""

    case: Case
    image: Image
    evaluation: Evaluation


@dataclass(frozen=True)
class ProfileArguments:
    """How the profiles of a channel are made."""

    settings: ImagingSettings  # impairments, PDP and grid count
    only: tuple[int, ...] | None = None  # numbers of the views that are needed, rising; None: all
    with_amplitude: bool = True  # keep the complex amplitudes
    outline: Any = None  # the truth, where the file carries none
    plane_height_m: float | None = None  # the plane of that truth


def load_profiles(file: Path, wanted: ProfileArguments) -> ProfiledChannel:
    """Read a channel file of any kind and run the first stages on it.

    Raises
    ------
    DataError
        The file cannot be read (the message names it), or the gate holds no path.
    ConfigError
        An impairment or gate does not fit the file.
    """
    stamp = file.stat().st_mtime_ns if file.exists() else 0
    numbers = None if wanted.only is None else np.array(wanted.only, np.intp)
    channel = _load(file, stamp)
    if channel.outline is None:
        channel = replace(channel, outline=wanted.outline, plane_height_m=wanted.plane_height_m)
    return profile_channel(channel, wanted.settings, numbers, with_amplitude=wanted.with_amplitude)


def run_batch(stages: Pipeline, cases: Sequence[Case]) -> list[Row]:
    """Image and score cases of a channel; a case that fails becomes a row that says why.

    Stages that have run other cases of the channel spare what they still have of them.
    """
    return [row for row, _ in results(stages, cases)]


def results(stages: Pipeline, cases: Sequence[Case]) -> Iterator[tuple[Row, Outcome | None]]:
    """Run cases and yield each as it finishes; the outcome is None where the case failed."""
    for case in cases:
        began = time.perf_counter()
        try:
            outcome = _run(stages, case)
        except Exception as error:  # noqa: BLE001 - one bad case must not stop the others; its row says what happened
            yield Row(case.key, "failed", reason(error), time.perf_counter() - began), None
            continue
        metrics = {"views": outcome.image.n_view, **outcome.evaluation.as_dict()}
        if outcome.evaluation.threshold_map is not None:
            metrics[MAP] = pack_table(outcome.evaluation.threshold_map)
        yield Row(case.key, "done", "", time.perf_counter() - began, metrics), outcome


def _run(stages: Pipeline, case: Case) -> Outcome:
    """Image and score a case; raises what is wrong with it."""
    image = stages.image(case.imaging)
    geometry = _truth(stages, case, image)
    return Outcome(
        case, image, evaluate(image, case.evaluation, geometry, with_optimum=case.evaluation.threshold is None)
    )


def _truth(stages: Pipeline, case: Case, image: Image) -> TruthGeometry:
    """The truth of a case; the last few are kept, for samples of a design alternate between them."""
    settings = case.evaluation
    place = (case.imaging.grid, settings.truth, settings.thickness_m)
    kept: dict[Any, TruthGeometry] = stages.keep("truths", None, dict)
    if place not in kept:
        while len(kept) >= max(1, min(MOST_TRUTHS, TRUTH_VOXELS // image.grid.size)):
            del kept[next(iter(kept))]
        kept[place] = TruthGeometry.build(ground_truth(image, settings), image.grid)
    return kept[place]


@functools.lru_cache(maxsize=1)
def _load(file: Path, stamp: int) -> Channel:
    """The last file read; ``stamp`` tells a file from one that was there before."""
    del stamp
    return load_channel(file)
