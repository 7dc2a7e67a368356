"""What a run would do, found out without doing it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mvla_sim.sweep.case import Row
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.schedule import PREPARE_S, TRACE_VIEW_S, case_seconds, groups_of
from mvla_sim.sweep.session import missing_cases
from mvla_sim.sweep.store import Store, identity

__all__ = ["ChannelState", "Survey", "survey", "survey_rows"]


@dataclass(frozen=True)
class ChannelState:
    """A scene that has cases to run: its name, its number of views, and whether its CIR is cached."""

    scene: str
    views: int
    cached: bool


@dataclass(frozen=True)
class Survey:
    """The state of an experiment."""

    cases: int  # in the plan
    done: int  # stored
    failed: int  # stored as failed; these are run again
    channels: tuple[ChannelState, ...]  # of the cases that would run
    seconds: float  # estimated
    measured: bool  # whether the estimate rests on cases that ran here, not on a guess


def survey(plan: Plan, folder: Path, workers: int) -> Survey:
    """Look at a plan, at what a folder holds of it and at the cache.

    Raises DataError: the folder's store does not fit the plan, or is damaged.
    """
    return survey_rows(plan, Store.peek(folder, identity(plan)), workers)


def survey_rows(plan: Plan, rows: Mapping[str, Row], workers: int) -> Survey:
    """Look at a plan and the rows that are stored of it."""
    missing = missing_cases(plan, rows)
    views = {key: len(source.views) for key, source in plan.sources.items()}
    stored = {case.key: case for case in plan.cases if case.key in rows}
    done = [case for case in stored.values() if rows[case.key].status == "done"]
    guessed = sum(case_seconds(case, views[case.channel]) for case in done)
    measured = sum(rows[case.key].seconds for case in done)
    ratio = measured / guessed if guessed else 1.0
    groups = groups_of(plan, missing, workers)
    needed = {group.source.key: group.source for group in groups}
    channels = [ChannelState(source.name, len(source.views), source.file.exists()) for source in needed.values()]
    seconds = sum(TRACE_VIEW_S * channel.views for channel in channels if not channel.cached)
    prepared = sum(PREPARE_S * group.share_of_views for group in groups)
    seconds += prepared / min(workers, max(1, len(groups)))
    work = ratio * sum(case_seconds(case, views[case.channel]) for case in missing)
    seconds += work / min(workers, max(1, sum(len(group.batches) for group in groups)))
    return Survey(
        cases=len(plan.cases),
        done=len(done),
        failed=len(stored) - len(done),
        channels=tuple(channels),
        seconds=seconds,
        measured=bool(done),
    )
