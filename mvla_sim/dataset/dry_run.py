"""What a build will take, from shards that are there or from a timed probe of a few samples."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mvla_sim.channel.simulate import SimulationInterruptedError, simulate
from mvla_sim.dataset.build import stored_shards
from mvla_sim.dataset.campaign import CampaignSettings
from mvla_sim.dataset.sample import check_room, draw_sample, family_of
from mvla_sim.dataset.shard import Sample, encode, numbers_of, occupancy_of, scene_of
from mvla_sim.engine.backend import set_threads
from mvla_sim.engine.machine import core_count
from mvla_sim.errors import DataError, RuntimeUnfitError, reason
from mvla_sim.grid import VoxelGrid

__all__ = ["BuildForecast", "estimate"]

PROBED: Final = 8
"""Samples of a probe, the same number of each family, of eight families at most."""
PROBED_VIEWS: Final = 8
"""Views of each that are traced, twice: the second time tells what a view takes, the first what is compiled once."""
LOOKED_AT: Final = 2000
"""Samples among which those to probe are looked for."""


@dataclass(frozen=True, eq=False)
class _Probe:
    """A part of a sample: some of its views."""

    weight: float  # how many samples it stands for, relative to the others
    made: Sample
    views: int  # of the whole
    compiling_s: float  # what the first pass took longer than the second
    seconds: float  # of the whole


@dataclass(frozen=True)
class BuildForecast:
    """What a build will make."""

    samples: int  # of the whole dataset
    shards: int
    stored: int  # shards that are whole already
    bytes: float  # of the whole dataset on disk
    seconds: float  # for what is missing, with the workers given
    basis: str  # what bytes and seconds were found from


def estimate(campaign: CampaignSettings, folder: Path | None = None, workers: int | None = None) -> BuildForecast:
    """Say what a build would do; arguments and errors as those of :func:`~mvla_sim.dataset.build.build_dataset`.

    Nothing is written.

    Seconds of several workers are those of one with its share of the cores, divided: what they share, such as memory
    bandwidth, is left out.
    """
    check_room(campaign)
    workers = core_count() if workers is None else workers
    kept = {} if folder is None or not folder.exists() else stored_shards(campaign, folder)[0]
    missing = campaign.samples - sum(len(numbers_of(campaign, number)) for number in kept)
    known = sum(entry.samples for entry in kept.values())
    starting_s = 0.0
    if known:
        sample_s = sum(entry.seconds for entry in kept.values()) / known
        sample_bytes = sum(entry.bytes for entry in kept.values()) / known
        basis = f"from {len(kept)} stored shards"
    else:
        with _threads_of(workers):
            probes = _probes(campaign)
        weights = [probe.weight for probe in probes]
        sample_s = float(np.average([probe.seconds for probe in probes], weights=weights))
        sample_bytes = _sample_bytes(campaign, probes)
        starting_s = sum(probe.compiling_s for probe in probes)
        basis = f"from a probe: {PROBED_VIEWS} views each of {len(probes)} samples"
    return BuildForecast(
        campaign.samples,
        campaign.shards,
        len(kept),
        sample_bytes * campaign.samples,
        starting_s * (missing > 0) + sample_s * missing / max(1, workers),
        basis,
    )


@contextlib.contextmanager
def _threads_of(workers: int) -> Iterator[None]:
    """Within the block, trace with as many threads as each of so many worker processes has."""
    if not workers:
        yield
        return
    set_threads(max(1, core_count() // workers))
    try:
        yield
    finally:
        set_threads(core_count())


def _probes(campaign: CampaignSettings) -> list[_Probe]:
    """Trace a part of the first samples of each family; raises where none can be made."""
    each = max(1, PROBED // len(campaign.families))
    chosen: dict[str, list[int]] = {}
    for k in range(min(campaign.samples, LOOKED_AT)):
        found = chosen.setdefault(family_of(campaign, k).name, [])
        if len(chosen) <= PROBED and len(found) < each:
            found.append(k)
    weights = {family.name: family.weight for family in campaign.families}
    probes: list[_Probe] = []
    last = ""
    for name, numbers in chosen.items():
        for number in numbers:
            try:
                probes.append(_probe(campaign, number, weights[name] / len(numbers)))
            except (RuntimeUnfitError, SimulationInterruptedError):
                raise
            except Exception as error:  # noqa: BLE001 - a build lists such a sample as failed and goes on
                last = reason(error)
    if not probes:
        raise DataError(f"{campaign.name}: none of its first samples can be made: {last}")
    return probes


def _probe(campaign: CampaignSettings, number: int, weight: float) -> _Probe:
    """Trace some views of a sample."""
    settings = draw_sample(campaign, number)
    whole = scene_of(settings)
    views = len(whole.views)
    chosen = np.unique(np.linspace(0, views - 1, min(PROBED_VIEWS, views)).astype(np.intp))
    part = whole.select(chosen)
    times = [time.perf_counter()]
    for _ in range(2):
        cir = simulate(part, cache=False)
        times.append(time.perf_counter())
    first, again = np.diff(times)
    grid = VoxelGrid.from_settings(campaign.grid)
    metadata = {"sample": number, "settings": settings.model_dump(mode="json")}
    made = Sample(cir, occupancy_of(whole.outline, grid), grid, metadata)
    return _Probe(weight, made, views, max(0.0, float(first - again)), float(again) / chosen.size * views)


def _sample_bytes(campaign: CampaignSettings, probes: list[_Probe]) -> float:
    """Bytes of a sample: shards of all parts with all of their views, and with half of them, tell the rest."""

    def size(parts: list[Sample]) -> int:
        return len(encode(campaign, 0, parts, 0.0).content)

    parts = [probe.made for probe in probes]
    halves = [replace(part, cir=part.cir.select(np.arange((part.cir.n_view + 1) // 2))) for part in parts]
    full, half, one = size(parts), size(halves), size(halves[:1])
    own = (half - one) / (len(parts) - 1) if len(parts) > 1 else one - size([])
    traced, fewer = (sum(part.cir.n_view for part in some) for some in (parts, halves))
    a_view = (full - half) / max(1, traced - fewer)
    untraced = float(np.mean([probe.views for probe in probes])) - fewer / len(parts)
    return (one - own) / campaign.samples_per_shard + own + a_view * untraced
