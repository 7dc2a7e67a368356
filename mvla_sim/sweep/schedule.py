"""Which cases run together, and about how long they take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from mvla_sim.imaging.methods.registry import find_method
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.batch import ChannelKey, channel_key
from mvla_sim.sweep.case import Case
from mvla_sim.sweep.plan import Plan

__all__ = ["CASE_S", "PREPARE_S", "TRACE_VIEW_S", "Task", "case_seconds", "tasks_of"]

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


@dataclass(frozen=True)
class Task:
    """All cases of one channel.

    Attributes
    ----------
    scene
        Its scene.
    key
        CIR, PDP settings, range gate, and impairments of the CIR.
    with_amplitude
        Whether a case needs complex amplitudes.
    batches
        The cases, in pieces for the workers.
    """

    scene: Scene
    key: ChannelKey
    with_amplitude: bool
    batches: tuple[tuple[Case, ...], ...]

    @property
    def cases(self) -> tuple[Case, ...]:
        """All cases."""
        return tuple(case for batch in self.batches for case in batch)


def case_seconds(case: Case, n_view: int) -> float:
    """Guess of the time a case takes on one core, seconds; ``n_view`` is the number of views of its scene."""
    settings = case.imaging
    interval = settings.views.interval_deg
    views = n_view if interval is None else min(n_view, 360 / interval)
    voxels = 1.0
    for size in settings.grid.size_m:
        voxels *= max(1.0, size / settings.grid.spacing_m)
    return CASE_S * max(1.0, voxels / 40_000) + VOXEL_VIEW_S[find_method(settings.method).uses_peaks] * views * voxels


def tasks_of(plan: Plan, cases: Sequence[Case], workers: int) -> list[Task]:
    """Group cases by channel, and cut the groups into batches for so many workers.

    Within a group cases are put in an order in which those with the same noise, peaks and profiles are neighbours.
    """
    groups: dict[ChannelKey, list[Case]] = {}
    keys: dict[object, ChannelKey] = {}
    for case in cases:
        own = case.imaging.impairments.of_channel(case.imaging.noise.seed)
        place = (case.channel, case.imaging.pdp, case.imaging.grid, own)
        if place not in keys:
            keys[place] = channel_key(case, plan.scenes[case.channel].views)
        groups.setdefault(keys[place], []).append(case)
    target = max(BATCH_S, workers / BATCHES_PER_S)
    return [
        Task(
            scene=plan.scenes[key[0]],
            key=key,
            with_amplitude=any(_needs_amplitude(case) for case in group),
            batches=tuple(_cut(_ordered(group), len(plan.scenes[key[0]].views), target)),
        )
        for key, group in groups.items()
    ]


def _needs_amplitude(case: Case) -> bool:
    """Whether complex amplitudes must be kept: for complex noise, and for methods that look at them."""
    return case.imaging.noise.kind == "complex" or find_method(case.imaging.method).uses_amplitude


def _ordered(cases: Sequence[Case]) -> list[Case]:
    """Neighbours share as much as possible; otherwise in the order of the plan."""
    places: dict[object, int] = {}

    def place(case: Case) -> tuple[int, ...]:
        settings = case.imaging
        parts = (settings.noise, settings.peaks, (settings.method, settings.mvla), case.evaluation)
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
