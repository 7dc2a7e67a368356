"""Which cases run together, and about how long they take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mvla_sim.errors import ConfigError
from mvla_sim.imaging.pipeline import profile_key, views_needed
from mvla_sim.scene.views import Views
from mvla_sim.sweep.batch import ProfileArguments
from mvla_sim.sweep.case import Case, Once, as_text
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.sources import Source

__all__ = ["CASE_S", "PREPARE_S", "TRACE_VIEW_S", "CaseGroup", "case_seconds", "groups_of"]

# Guesses for one core of 2020, good to a factor of two or so; they order and size the work, and estimate its time as
# long as nothing was measured.
TRACE_VIEW_S: Final = 0.1
"""Tracing a view on all cores, seconds."""
PREPARE_S: Final = 3.0
"""Reading a CIR and computing its profiles, seconds."""
CASE_S: Final = 0.025
"""Threshold search and scores of a case, seconds."""
VOXEL_VIEW_S: Final = {True: 1.3e-8, False: 2e-9}
"""Projecting a view onto a voxel, with and without angular support, seconds."""

BATCH_S: Final = 2.0
"""Cases that run together take about so long: what a lost worker or a stopped run costs, and far above the milliseconds
that handing them out takes."""
BATCHES_PER_S: Final = 200
"""No more of them a second, from all workers together: what a scheduler can hand out at its ease."""


@dataclass(frozen=True, eq=False)
class CaseGroup:
    """All cases of one channel that share profiles."""

    source: Source  # where the channel comes from
    wanted: ProfileArguments  # how its profiles are made
    batches: tuple[tuple[Case, ...], ...]  # the cases, in pieces for the workers

    @property
    def share_of_views(self) -> float:
        """Share of the channel's views whose profiles are needed."""
        return 1.0 if self.wanted.only is None else len(self.wanted.only) / len(self.source.views)

    @property
    def cases(self) -> tuple[Case, ...]:
        """All cases."""
        return tuple(case for batch in self.batches for case in batch)


def case_seconds(case: Case, n_view: int) -> float:
    """Guess of the time a case takes on one core, seconds; ``n_view`` is the number of views of its channel."""
    settings = case.imaging
    method = settings.chosen
    interval = settings.views.interval_deg
    views = n_view if interval is None else min(n_view, 360 / interval)
    voxels = 1.0
    for size in settings.grid.size_m:
        voxels *= max(1.0, size / settings.grid.spacing_m)
    projection = VOXEL_VIEW_S[method.uses_peaks] * views * voxels
    return CASE_S * max(1.0, voxels / 40_000) + method.projections * projection


def groups_of(plan: Plan, cases: Sequence[Case], workers: int) -> list[CaseGroup]:
    """Group cases by what decides their profiles, and cut the groups into batches for so many workers.

    Groups of one channel are neighbours, so that a worker reads its file once. Within a group cases are put in an order
    in which those with the same noise, peaks and profiles are neighbours.
    """
    groups: dict[object, list[Case]] = {}
    keys: dict[object, object] = {}
    for case in cases:
        own = case.imaging.impairments.of_channel(case.imaging.noise.seed)
        place = (case.channel, case.imaging.paths, case.imaging.pdp, case.imaging.grid, own)
        source = plan.sources[case.channel]
        if place not in keys:
            keys[place] = (case.channel, *profile_key(case.imaging, source.views, source.plane_height_m))
        groups.setdefault(keys[place], []).append(case)
    target, once = max(BATCH_S, workers / BATCHES_PER_S), Once()
    channels = {channel: place for place, channel in enumerate(dict.fromkeys(case.channel for case in cases))}
    ordered = sorted(groups.values(), key=lambda group: channels[group[0].channel])
    return [_group(plan.sources[group[0].channel], group, target, once) for group in ordered]


def _group(source: Source, cases: Sequence[Case], target_s: float, once: Once) -> CaseGroup:
    wanted = ProfileArguments(
        cases[0].imaging,
        _needed(source.views, cases),
        any(case.imaging.noise.uses_amplitude or case.imaging.chosen.uses_amplitude for case in cases),
        source.outline,
        source.plane_height_m,
    )
    return CaseGroup(source, wanted, tuple(_cut(_ordered(cases, once), len(source.views), target_s)))


def _needed(views: Views, cases: Sequence[Case]) -> tuple[int, ...] | None:
    """Numbers of the views that any case needs; None for all of them, and where a case's choice is not possible."""
    needed = np.zeros(len(views), bool)
    choices = {
        (case.imaging.views, case.imaging.impairments, case.imaging.noise.reference, case.imaging.noise.seed): case
        for case in cases
    }
    for case in choices.values():
        try:
            needed[views_needed(views, case.imaging)] = True
        except ConfigError:  # told with the case
            continue
        if needed.all():
            return None
    return tuple(np.flatnonzero(needed).tolist()) if needed.any() else None


def _ordered(cases: Sequence[Case], once: Once) -> list[Case]:
    """Neighbours share as much as possible; otherwise in the order of the plan."""
    places: dict[object, int] = {}

    def place(case: Case) -> tuple[int, ...]:
        settings = case.imaging
        method = (settings.method, once(as_text, settings.chosen), once(as_text, settings.mvla))
        stages = (once(as_text, stage) for stage in (settings.noise, settings.peaks, settings.grid))
        parts = (*stages, method, once(as_text, case.evaluation))
        return tuple(places.setdefault((index, part), len(places)) for index, part in enumerate(parts))

    return sorted(cases, key=place)


def _cut(cases: Sequence[Case], n_view: int, target_s: float) -> Iterator[tuple[Case, ...]]:
    """Pieces of about equal time, none much below the target but the last."""
    piece: list[Case] = []
    seconds = 0.0
    for case in cases:
        piece.append(case)
        seconds += case_seconds(case, n_view)
        if seconds >= target_s:
            yield tuple(piece)
            piece, seconds = [], 0.0
    if piece:
        yield tuple(piece)
