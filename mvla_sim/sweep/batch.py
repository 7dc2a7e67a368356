"""The work itself: cases that share a channel, with everything they have in common done once.

:func:`prepare` and :func:`run_batch` are pure functions of values that can be pickled, so any scheduler can run them.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.impairments import ImpairmentSettings, assumed_views, impair
from mvla_sim.errors import reason
from mvla_sim.evaluation.candidates import pack_table
from mvla_sim.evaluation.evaluate import Evaluation, evaluate, ground_truth
from mvla_sim.evaluation.ground_truth import TruthGeometry
from mvla_sim.grid import GridSettings, VoxelGrid
from mvla_sim.imaging.beam import build_beam
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.imaging_settings import EvaluationSettings, ImagingSettings, PdpSettings
from mvla_sim.imaging.methods.base import Method
from mvla_sim.imaging.methods.registry import find_method
from mvla_sim.imaging.noise import add_noise
from mvla_sim.imaging.observation import FrontEnd, Observation
from mvla_sim.imaging.pdp import Pdp, compute_pdp, gate_for
from mvla_sim.imaging.peaks import Peaks, extract_peaks
from mvla_sim.imaging.pipeline import check_peaks, chosen_views
from mvla_sim.scene.antenna import Antenna
from mvla_sim.scene.views import Views
from mvla_sim.sweep.case import MAP, Case, Row

__all__ = ["Batch", "CaseRunner", "Channel", "Outcome", "channel_key", "prepare", "reason", "results", "run_batch"]

Value = TypeVar("Value")
ChannelKey = tuple[str, PdpSettings, tuple[float, float], ImpairmentSettings | None]


@dataclass(frozen=True)
class Channel:
    """What imaging and evaluation need of a channel impulse response.

    Attributes
    ----------
    views
        Views of the file, where imaging believes them to be.
    pdp
        Power delay profiles of all of them, without noise.
    extent_m
        The target's extent D, metres.
    outline
        The target's cross-section; imaging never looks at it.
    antenna
        Pattern of the antennas, which tells where their beam reaches.
    true_views
        Where the views were in fact; None: where they are believed to be.
    """

    views: Views
    pdp: Pdp
    extent_m: float
    outline: Any
    antenna: Antenna
    true_views: Views | None = None

    @property
    def nominal_views(self) -> Views:
        """Views at their true positions, which decide what is chosen of them."""
        return self.views if self.true_views is None else self.true_views


@dataclass(frozen=True)
class Batch:
    """Cases of one channel; those that share noise, peaks and profiles follow each other."""

    channel: Channel
    cases: tuple[Case, ...]


@dataclass(frozen=True)
class Outcome:
    """One case with its image, for pictures."""

    case: Case
    image: Image
    evaluation: Evaluation


def channel_key(case: Case, views: Views) -> ChannelKey:
    """What decides a case's profiles before noise: CIR, PDP settings, range gate in metres, impairments of the CIR."""
    own = case.imaging.impairments.of_channel(case.imaging.noise.seed)
    seen = views if own is None else assumed_views(views, own)
    gate = gate_for(VoxelGrid.from_settings(case.imaging.grid), seen, case.imaging.pdp)
    return case.channel, case.imaging.pdp, gate, own


def prepare(
    file: Path,
    settings: PdpSettings,
    gate_m: tuple[float, float],
    impairments: ImpairmentSettings | None = None,
    *,
    with_amplitude: bool = True,
) -> Channel:
    """Compute the profiles of a CIR file, impaired or not, without noise.

    Parameters
    ----------
    file
        A CIR file.
    settings
        Window and oversampling.
    gate_m
        (near, far), one-way metres.
    impairments
        What is wrong with delays, gains and positions.
    with_amplitude
        Keep the complex amplitudes, which complex noise alone needs.

    Raises
    ------
    DataError
        The file cannot be read (the message names it), or the gate holds no path.
    ConfigError
        An impairment does not fit the file.
    """
    stamp = file.stat().st_mtime_ns if file.exists() else 0
    loaded = _load(file, stamp)
    cir = loaded if impairments is None else impair(loaded, impairments, gate_m)
    pdp = compute_pdp(cir, settings, gate_m)
    if not with_amplitude:
        pdp = replace(pdp, amplitude=None)
    return Channel(cir.views, pdp, cir.extent_m, cir.outline, cir.antenna, loaded.views)


def run_batch(batch: Batch, runner: CaseRunner | None = None) -> list[Row]:
    """Image and score every case of a batch; a case that fails becomes a row that says why.

    A ``runner`` that has run other cases of the channel spares what it still has of them.
    """
    return [row for row, _ in results(batch, runner)]


def results(batch: Batch, runner: CaseRunner | None = None) -> Iterator[tuple[Row, Outcome | None]]:
    """Run a batch and yield each case as it finishes; the outcome is None where the case failed."""
    runner = runner or CaseRunner(batch.channel)
    for case in batch.cases:
        began = time.perf_counter()
        try:
            outcome = runner.run(case)
        except Exception as error:  # noqa: BLE001 - one bad case must not stop the others; its row says what happened
            yield Row(case.key, "failed", reason(error), time.perf_counter() - began), None
            continue
        metrics = {"views": outcome.image.n_view, **outcome.evaluation.as_dict()}
        if outcome.evaluation.threshold_map is not None:
            metrics[MAP] = pack_table(outcome.evaluation.threshold_map)
        yield Row(case.key, "done", "", time.perf_counter() - began, metrics), outcome


@functools.lru_cache(maxsize=1)
def _load(file: Path, stamp: int) -> Cir:
    """The last file read; ``stamp`` tells a file from one that was there before."""
    del stamp
    return Cir.load(file)


class _Last:
    """The last value of each stage with what it was made from: batches are ordered so that no more is needed."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[Hashable, Any]] = {}

    def get(self, stage: str, key: Hashable, make: Callable[[], Value]) -> Value:
        if stage not in self._kept or self._kept[stage][0] != key:
            self._kept[stage] = (key, make())
        value: Value = self._kept[stage][1]
        return value


class CaseRunner:
    """Runs cases of one channel, from noise to scores."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self.last = _Last()

    def run(self, case: Case) -> Outcome:
        """Image and score a case; raises what is wrong with it."""
        channel, imaging = self.channel, case.imaging
        grid = VoxelGrid.from_settings(imaging.grid)
        chosen = chosen_views(channel.nominal_views, imaging)
        method = find_method(imaging.method)
        result = method.image(self._observation(method, imaging, grid, chosen))
        known = {"outline": channel.outline, "resolution_m": channel.pdp.resolution_m}
        image = Image(result.score, result.support_deg, grid, imaging.method, chosen.size, **known)
        geometry = self._geometry(image, imaging.grid, case.evaluation)
        optimise = case.evaluation.threshold is None
        return Outcome(case, image, evaluate(image, case.evaluation, geometry, with_optimum=optimise))

    def _observation(
        self, method: Method, imaging: ImagingSettings, grid: VoxelGrid, chosen: NDArray[np.intp]
    ) -> Observation:
        """What the method sees of the chosen views. Profiles that views do not share are made for all of them."""
        channel = self.channel
        pdp = self.last.get("noise", imaging.noise, lambda: add_noise(channel.pdp, imaging.noise))
        peaks = Peaks.none(len(channel.views))
        if method.uses_peaks:
            peaks = self.last.get("peaks", (imaging.noise, imaging.peaks), lambda: extract_peaks(pdp, imaging.peaks))
        seen = Observation(
            front=FrontEnd(pdp, peaks, pdp.resolution_m),
            views=channel.views,
            grid=grid,
            settings=imaging,
            extent_m=channel.extent_m,
            span_m=grid.range_span_m(channel.views.positions_m, channel.views.receivers_m),
            beam=self.last.get("beam", imaging.beam, lambda: build_beam(channel.antenna, imaging.beam)),
        )
        check_peaks(method, seen.front.select(chosen))
        made = self.last.get(
            "profiles",
            (imaging.method, imaging.mvla, imaging.noise, imaging.peaks, seen.span_m),
            lambda: method.profiles(seen),
        )
        return replace(seen, made=made).select(chosen)

    def _geometry(self, image: Image, grid: GridSettings, settings: EvaluationSettings) -> TruthGeometry:
        return self.last.get(
            "truth",
            (grid, settings.truth),
            lambda: TruthGeometry.build(ground_truth(image, settings), image.grid),
        )
