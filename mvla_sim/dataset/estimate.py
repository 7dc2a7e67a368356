"""What a build will take, from shards that are there or from a timed probe of a few samples."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from mvla_sim.channel.simulate import simulate
from mvla_sim.config.campaign import CampaignSettings
from mvla_sim.dataset.build import stored_shards
from mvla_sim.dataset.sample import draw_sample
from mvla_sim.dataset.shard import Made, encode, numbers_of, occupancy_of
from mvla_sim.errors import MvlaError
from mvla_sim.scene.grid import VoxelGrid
from mvla_sim.scene.world import Scene

__all__ = ["Estimate", "estimate"]

PROBED: Final = 3
"""Samples of a probe; the first one's time is left out, for what is loaded and compiled once is in it."""
PROBED_VIEWS: Final = 8
"""Views of each that are traced, twice: the second time tells what a view takes, the first what a scene adds to it."""


@dataclass(frozen=True)
class Estimate:
    """What a build will make.

    Attributes
    ----------
    samples, shards
        Of the whole dataset.
    stored
        Shards that are whole already.
    bytes
        Of the whole dataset on disk.
    seconds
        For what is missing, with the workers given.
    basis
        What bytes and seconds were found from.
    """

    samples: int
    shards: int
    stored: int
    bytes: float
    seconds: float
    basis: str


def estimate(campaign: CampaignSettings, folder: Path | None = None, workers: int = 0) -> Estimate:
    """Say what a build would do; errors as :func:`~mvla_sim.dataset.build.build_dataset`, nothing is written.

    Seconds of several workers are those of one, divided: what they share, such as memory bandwidth, is left out.
    """
    kept = {} if folder is None or not folder.exists() else stored_shards(campaign, folder)[0]
    missing = campaign.samples - sum(len(numbers_of(campaign, number)) for number in kept)
    known = sum(entry.samples for entry in kept.values())
    if known:
        sample_s = sum(entry.seconds for entry in kept.values()) / known
        sample_bytes = sum(entry.bytes for entry in kept.values()) / known
        basis = f"from {len(kept)} stored shards"
    else:
        sample_s, sample_bytes, probed = _probe(campaign)
        basis = f"from a probe: {PROBED_VIEWS} views each of {probed} samples"
    return Estimate(
        campaign.samples,
        campaign.shards,
        len(kept),
        sample_bytes * campaign.samples,
        sample_s * missing / max(1, workers),
        basis,
    )


def _probe(campaign: CampaignSettings) -> tuple[float, float, int]:
    """Seconds and bytes of a sample, and how many were traced; raises where none can be made."""
    seconds: list[float] = []
    sizes: list[float] = []
    last: MvlaError | None = None
    for number in range(min(PROBED + 2, campaign.samples)):
        if len(seconds) == PROBED:
            break
        try:
            took, size = _probe_one(campaign, number)
        except MvlaError as error:
            last = error
            continue
        seconds.append(took)
        sizes.append(size)
    if not seconds:
        assert last is not None
        raise last
    return float(np.mean(seconds[1:] or seconds)), float(np.mean(sizes)), len(seconds)


def _probe_one(campaign: CampaignSettings, number: int) -> tuple[float, float]:
    """Seconds and bytes of one sample: a few of its views traced, and both scaled to all of them."""
    settings = draw_sample(campaign, number)
    whole = Scene.from_settings(settings, settings.name)
    views = len(whole.views)
    chosen = np.unique(np.linspace(0, views - 1, min(PROBED_VIEWS, views)).astype(np.intp))
    part = replace(whole, views=whole.views.select(chosen))
    times = [time.perf_counter()]
    for _ in range(2):
        cir = simulate(part, cache=False)
        times.append(time.perf_counter())
    first, again = np.diff(times)
    took = max(0.0, first - again) + again / chosen.size * views
    occupancy = occupancy_of(whole.outline, VoxelGrid.from_settings(campaign.grid))
    metadata = {"settings": settings.model_dump(mode="json")}

    def size(copies: int, count: int) -> int:
        made = Made(number, cir.select(np.arange(count)), occupancy, metadata)
        return len(encode(campaign, number // campaign.samples_per_shard, [made] * copies, [], 0.0).content)

    few = max(1, chosen.size // 2)
    own = {count: size(2, count) - size(1, count) for count in (few, chosen.size)}  # what a sample adds to a shard
    shared = size(1, few) - own[few]
    slope = (own[chosen.size] - own[few]) / max(1, chosen.size - few)
    return float(took), shared / campaign.samples_per_shard + own[few] + slope * (views - few)
