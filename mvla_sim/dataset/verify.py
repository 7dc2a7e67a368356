"""Checking a dataset: checksums, schema, counts, splits, truth, and a few samples made again."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.simulate import SimulationInterruptedError
from mvla_sim.dataset.index import Index, ShardEntry, file_sha256
from mvla_sim.dataset.reader import ShardReader
from mvla_sim.dataset.sample import family_of, split_of
from mvla_sim.dataset.shard import Sample, make_sample, occupancy_of
from mvla_sim.errors import ConfigError, DataError, MvlaError
from mvla_sim.progress import progress
from mvla_sim.scene.world import SceneSettings
from mvla_sim.streams import Stream, stream

__all__ = ["Report", "unmatched_share", "verify"]

PLACE_M: Final = 1e-4
"""How far two paths may differ in range and first interaction point, metres: rays are traced in single precision, whose
rounding at ten metres is 1e-6, and points on edges are found iteratively."""
LEVEL: Final = 1e-3
"""How much they may differ in |gain|, relative: the rounding of a pattern where a face is seen at a slant."""
STRAY: Final = 2e-3
"""Share of paths that may have no partner. The engine promises the same set of paths, not the same bits; on another
processor, a ray that just meets an edge may just miss it."""


@dataclass(frozen=True)
class Report:
    """What a check found."""

    shards: int  # that were looked at
    samples: int
    failed: int  # samples that the index lists as failed
    recomputed: tuple[int, ...]  # numbers of the samples made again
    stray: float  # largest share of paths without a partner in any of these
    problems: tuple[str, ...]  # one line each

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems


def verify(folder: str | os.PathLike[str], recompute: int = 3, seed: int = 0) -> Report:
    """Check a dataset.

    Every shard: its file's checksum, its schema, campaign, counts, the checksum over its data, and of every sample
    the channel, family, split, and the occupancy against the outline. Then a random few are made again: their scenes
    must be equal, and their paths the same within :data:`PLACE_M`, :data:`LEVEL` and :data:`STRAY`. Phases are not
    compared: those of diffuse paths go with the order of paths, in which equal ones may change places.

    Parameters
    ----------
    folder
        The dataset's directory.
    recompute
        How many samples are made again.
    seed
        Decides which.

    Raises
    ------
    DataError, ConfigError
        There is no index, or it cannot be used; all else is a problem in the report.
    SimulationInterruptedError
        Ctrl-C.
    """
    if recompute < 0:
        raise ConfigError(f"recompute = {recompute}; at least 0")
    index = Index.load(folder)
    problems = list(_completeness(index))
    samples = 0
    with progress(f"checking {index.campaign.name}", len(index.shards), "shards") as advance:
        for number, entry in sorted(index.shards.items()):
            try:
                samples += _check_shard(index, number, entry)
            except MvlaError as error:
                problems.append(str(error))
            advance(1)
    chosen = _chosen(index.numbers(), recompute, seed)
    stray = 0.0
    with progress("making samples again", len(chosen), "samples") as advance:
        for number in chosen:
            try:
                stray = max(stray, _recompute(index, number))
            except SimulationInterruptedError:
                raise
            except MvlaError as error:
                problems.append(f"sample {number}: {error}")
            advance(1)
    return Report(len(index.shards), samples, len(index.failed), chosen, stray, tuple(problems))


def _completeness(index: Index) -> Iterator[str]:
    """Shards that are missing from the index, and files that are not in it."""
    missing = index.campaign.shards - len(index.shards)
    if missing:
        yield f"{index.folder}: {missing} of {index.campaign.shards} shards are not made yet"
    listed = {entry.name for entry in index.shards.values()}
    for file in sorted(index.folder.glob("*.nc")):
        if file.name not in listed and not file.name.startswith("."):
            yield f"{file}: is not in the index"


def _check_shard(index: Index, number: int, entry: ShardEntry) -> int:
    """Check one shard and return how many samples it holds; raises at the first thing that is wrong."""
    file = index.file(number)
    with ShardReader(file, index.campaign, number) as reader:
        if file_sha256(file) != entry.sha256:
            raise DataError(f"{file}: its checksum is not that of the index")
        if not reader.digest() == reader.stored_digest() == entry.data_sha256:
            raise DataError(f"{file}: the checksum of its data is not that of the index")
        if [failure.sample for failure in reader.failed] != [failure.sample for failure in entry.failed]:
            raise DataError(f"{file}: its failed samples are not those of the index")
        for row in range(reader.samples.size):
            _check_sample(index, reader.sample(row), file)
        return int(reader.samples.size)


def _check_sample(index: Index, made: Sample, file: Path) -> None:
    campaign, number = index.campaign, made.number
    wanted = {"family": family_of(campaign, number).name, "split": split_of(campaign, number)}
    for key, value in wanted.items():
        if made.metadata.get(key) != value:
            raise DataError(f"{file}: sample {number}: {key} is {made.metadata.get(key)!r}, must be {value!r}")
    for name, told in (("carrier", made.cir.carrier_hz), ("bandwidth", made.cir.bandwidth_hz)):
        if told != (right := getattr(campaign.radio, f"{name}_hz")):
            raise DataError(f"{file}: sample {number}: {name} is {told:g} Hz, must be {right:g} Hz")
    if not np.array_equal(made.occupancy, occupancy_of(made.outline, made.grid)):
        raise DataError(f"{file}: sample {number}: the occupancy is not that of the outline")


def _chosen(numbers: list[int], count: int, seed: int) -> tuple[int, ...]:
    order = np.argsort(stream(seed, Stream.RECOMPUTE).random(len(numbers)), kind="stable")
    return tuple(sorted(numbers[k] for k in order[:count]))


def _recompute(index: Index, number: int) -> float:
    """Make a sample again and compare; returns the share of paths without a partner."""
    shard = number // index.campaign.samples_per_shard
    with ShardReader(index.file(shard), index.campaign, shard) as reader:
        stored = reader.sample(reader.row_of(number))
    again = make_sample(index.campaign, number)
    scenes = [SceneSettings.model_validate(sample.metadata["settings"]) for sample in (stored, again)]
    if scenes[0] != scenes[1]:
        raise DataError("its scene is not the one that the campaign's seed gives")
    if not stored.outline.equals_exact(again.outline, 1e-6):
        raise DataError("its outline is not that of its scene")
    if not np.array_equal(stored.occupancy, again.occupancy):
        raise DataError("its occupancy is not that of its scene")
    for name in ("positions_m", "angles_deg", "center_m", "receivers_m", "boresights"):
        if not _same(getattr(stored.cir.views, name), getattr(again.cir.views, name)):
            raise DataError("its views are not those of its scene")
    if not _same(stored.cir.extent_m, again.cir.extent_m):
        raise DataError("its largest extent is not that of its scene")
    share = unmatched_share(stored.cir, again.cir)
    if share > STRAY:
        raise DataError(f"{100 * share:.2g} % of its paths are not found again; at most {100 * STRAY:g} % are allowed")
    return share


def _same(one: Any, other: Any) -> bool:
    """Whether two arrays of lengths or directions agree, or both are absent."""
    if one is None or other is None:
        return one is other
    return np.shape(one) == np.shape(other) and np.allclose(one, other, rtol=0, atol=1e-9)


def unmatched_share(one: Cir, other: Cir) -> float:
    """Share of the paths of two channels of the same views that have no partner in the other one.

    Partners belong to the same view, had the same interactions, and differ by at most :data:`PLACE_M` in range and in
    each coordinate of the first point, and by :data:`LEVEL` in |gain|.
    """
    total = one.gain.size + other.gain.size
    if not (one.gain.size and other.gain.size):
        return float(total > 0)
    here, there = _features(one), _features(other)
    lost = 0
    for points, others in ((here, there), (there, here)):
        distance, _ = cKDTree(others).query(points, p=np.inf, distance_upper_bound=1.0)
        lost += int(np.count_nonzero(~np.isfinite(distance)))
    return lost / total


def _features(cir: Cir) -> NDArray[np.float64]:
    """What two paths must agree in, each in units of its tolerance, ``[n_path, 7]``."""
    view = np.repeat(np.arange(cir.n_view), cir.row_size)
    level = np.log(np.maximum(np.abs(cir.gain), 1e-30))
    columns = [10.0 * view, 10.0 * cir.interaction, cir.range_m / PLACE_M, level / LEVEL]
    return np.column_stack([*columns, np.nan_to_num(cir.first_point_m.astype(np.float64), nan=1e6) / PLACE_M])
