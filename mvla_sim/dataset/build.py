"""Building a dataset: whole shards are kept, what is missing or damaged is made, and nothing is left half-written."""

from __future__ import annotations

import contextlib
import hashlib
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from mvla_sim.channel.simulate import SimulationInterruptedError
from mvla_sim.cluster.interface import Cluster, Finished, WorkerDiedError
from mvla_sim.cluster.opening import open_cluster
from mvla_sim.dataset.campaign import CampaignSettings, load_campaign
from mvla_sim.dataset.index import INDEX, Index, ShardEntry, file_sha256
from mvla_sim.dataset.reader import ShardReader
from mvla_sim.dataset.sample import check_room
from mvla_sim.dataset.shard import FailedSample, Sample, Shard, encode, make_one, make_shard, numbers_of, shard_name
from mvla_sim.errors import DataError, MvlaError, OutputError, RuntimeUnfitError
from mvla_sim.files import as_path, atomic_output, check_writable, locked_folder
from mvla_sim.interrupt import interruptible
from mvla_sim.progress import Advance, progress
from mvla_sim.sweep.case import flatten

__all__ = ["BuildInterruptedError", "BuildResult", "build_dataset", "stored_shards"]

SAVE_S: Final = 5.0
"""The index is written at most this often while shards are being made; others are checked by their data."""
MOST_DEATHS: Final = 10
"""Workers lost since the last shard was finished before a build is given up: something is wrong with the machine."""


class BuildInterruptedError(MvlaError):
    """Ctrl-C; the shards finished so far are kept and the next build goes on from them."""

    exit_code = 130


@dataclass(frozen=True, eq=False)
class BuildResult:
    """What a build leaves.

    Attributes
    ----------
    index
        The dataset's index, as written.
    made
        Shards made by this build; the others were there.
    notes
        What to know: shards that were damaged and made again or could not be made, and workers that died.
    """

    index: Index
    made: int
    notes: tuple[str, ...]


def build_dataset(
    campaign: CampaignSettings | str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    cluster: Cluster | None = None,
    retry_failed: bool = False,
) -> BuildResult:
    """Make a dataset, or what is missing of it.

    Parameters
    ----------
    campaign
        Its settings, or the name of a campaign file.
    folder
        Directory of the dataset, made if it is not there.
    workers
        Number of processes, by default one a core, for which a script must call this under
        ``if __name__ == "__main__":``; 0 for none but this one. It changes no number.
    cluster
        Makes the shards instead of so many workers; it stays open. Its workers need not share a disk with this machine.
    retry_failed
        Make shards again in which a sample failed.

    Returns
    -------
    BuildResult
        A sample that raised is listed in ``index.failed`` with its error; the others keep their numbers.

    Raises
    ------
    ConfigError, DataError
        The campaign file, or the dataset that is there, cannot be used; one line, before work starts.
    OutputError
        The directory cannot be written, is full, or another build is at work in it.
    BuildInterruptedError
        Ctrl-C.
    RuntimeUnfitError
        Nothing can be traced here, or there are no workers, or they keep dying.
    """
    settings = campaign if isinstance(campaign, CampaignSettings) else load_campaign(campaign)
    check_room(settings)
    place = as_path(folder)
    with locked_folder(place, "build"):
        check_writable(place / INDEX)
        kept, notes = stored_shards(settings, place)
        if retry_failed:
            kept = {number: entry for number, entry in kept.items() if not entry.failed}
        builder = _Builder(Index(place, settings, kept), notes)
        builder.index.save()  # before work: it never lists a shard that is about to be replaced
        builder.make([number for number in range(settings.shards) if number not in kept], cluster, workers)
    return BuildResult(builder.index, len(builder.index.shards) - len(kept), tuple(notes))


def stored_shards(campaign: CampaignSettings, folder: Path) -> tuple[dict[int, ShardEntry], list[str]]:
    """Shards of a directory that are whole, by number, and a note on each that is not.

    A shard in the index is whole where its file has the checksum of the index; one that is not in it, where its data
    have the checksum that the file itself holds.

    Raises
    ------
    DataError
        The directory has an index that cannot be read, or one of another campaign.
    """
    listed: dict[int, ShardEntry] = {}
    if os.path.lexists(folder / INDEX):
        index = Index.load(folder)
        _check_same(index.campaign, campaign, folder)
        listed = dict(index.shards)
    kept: dict[int, ShardEntry] = {}
    notes: list[str] = []
    for number in range(campaign.shards):
        file = folder / shard_name(number)
        if not os.path.lexists(file):
            if number in listed:
                notes.append(f"{file.name}: was missing")
            continue
        try:
            kept[number] = _whole(file, campaign, number, listed.get(number))
        except DataError as error:
            notes.append(f"{str(error).removeprefix(f'{folder}/')}: made again")
    return kept, notes


class _Builder:
    """One build: the index as it grows, and what to tell about it."""

    def __init__(self, index: Index, notes: list[str]) -> None:
        self.index = index
        self.notes = notes
        self._saved, self._listed = time.monotonic(), len(index.shards)
        self._deaths = 0

    def make(self, missing: Sequence[int], cluster: Cluster | None, workers: int | None) -> None:
        """Make shards and write each as it is finished; whatever ends this, the index is saved."""
        if not missing:
            return
        campaign = self.index.campaign
        total = sum(len(numbers_of(campaign, number)) for number in missing)
        try:
            with (
                interruptible(),
                open_cluster(workers) if cluster is None else contextlib.nullcontext(cluster) as chosen,
            ):
                chosen.start()
                self._deaths = chosen.deaths
                with progress(f"building {campaign.name}", total, "samples") as advance:
                    for number in self._make_shards(missing, chosen, advance):
                        self._make_samples(number, chosen, advance)
        except KeyboardInterrupt as stop:
            self.index.save()
            raise BuildInterruptedError(
                f"stopped; {len(self.index.shards)} of {campaign.shards} shards are whole in {self.index.folder}: "
                "run the same command to go on"
            ) from stop
        except BaseException:
            with contextlib.suppress(OutputError):  # what ended the build may be in the way of its index too
                self.index.save()
            raise
        self.index.save()

    def _make_shards(self, missing: Sequence[int], cluster: Cluster, advance: Advance) -> list[int]:
        """Make shards, a task each; return those whose workers died too often."""
        tasks = ((self.index.campaign, number) for number in missing)
        deadly: list[int] = []
        finished = cluster.run(make_shard, tasks, label="shards", idle=self._save_if_due)
        with contextlib.closing(finished):  # what has not begun when the block ends is given up
            for task, result in finished:
                number = missing[task]
                self._note_deaths(result, shard_name(number))
                if isinstance(result.error, WorkerDiedError):
                    deadly.append(number)
                elif result.error is not None:
                    _raise_if_final(result.error)
                    self.notes.append(f"{shard_name(number)}: not made ({result.reason}); run the same command again")
                else:
                    self._keep(result.value, cluster, advance)
                self._check_deaths(cluster)
        return deadly

    def _make_samples(self, number: int, cluster: Cluster, advance: Advance) -> None:
        """Make the samples of a shard, a task each, so that the one that its workers die of fails alone."""
        campaign = self.index.campaign
        numbers = numbers_of(campaign, number)
        found: dict[int, Sample | FailedSample] = {}
        seconds = 0.0
        tasks = ((campaign, sample) for sample in numbers)
        finished = cluster.run(make_one, tasks, label="samples", idle=self._save_if_due)
        with contextlib.closing(finished):
            for task, result in finished:
                sample = numbers[task]
                self._note_deaths(result, f"sample {sample}")
                if result.error is not None:
                    _raise_if_final(result.error)
                failed = FailedSample(sample=sample, error=result.reason)
                found[sample] = failed if result.error else result.value
                seconds += result.seconds
        self._keep(encode(campaign, number, [found[sample] for sample in numbers], seconds), cluster, advance)

    def _keep(self, shard: Shard, cluster: Cluster, advance: Advance) -> None:
        entry = _write(self.index.folder, self.index.campaign, shard)
        self.index = replace(self.index, shards={**self.index.shards, shard.number: entry})
        advance(len(numbers_of(self.index.campaign, shard.number)))
        self._deaths = cluster.deaths
        self._save_if_due()

    def _save_if_due(self) -> None:
        if len(self.index.shards) > self._listed and time.monotonic() - self._saved > SAVE_S:
            self.index.save()
            self._saved, self._listed = time.monotonic(), len(self.index.shards)

    def _note_deaths(self, result: Finished, what: str) -> None:
        if result.deaths:
            times = "once" if result.deaths == 1 else f"{result.deaths} times"
            self.notes.append(f"a worker died {times} while it made {what}")

    def _check_deaths(self, cluster: Cluster) -> None:
        if (deaths := cluster.deaths - self._deaths) >= MOST_DEATHS:
            raise RuntimeUnfitError(
                f"workers died {deaths} times and finished no shard meanwhile; what is finished is kept. Is there "
                "enough memory? Try fewer workers, or fewer samples_per_shard",
                setting="workers",
            )


def _raise_if_final(error: MvlaError) -> None:
    """Raise where an error of a task ends the build."""
    if isinstance(error, SimulationInterruptedError):
        raise KeyboardInterrupt from error
    if isinstance(error, RuntimeUnfitError | OutputError):
        raise error


def _write(folder: Path, campaign: CampaignSettings, shard: Shard) -> ShardEntry:
    """Put a shard into its place under its final name."""
    name = shard_name(shard.number)
    with atomic_output(folder / name) as temporary:
        temporary.write_bytes(shard.content)
    return ShardEntry(
        number=shard.number,
        name=name,
        bytes=len(shard.content),
        sha256=hashlib.sha256(shard.content).hexdigest(),
        data_sha256=shard.data_sha256,
        samples=len(numbers_of(campaign, shard.number)) - len(shard.failed),
        failed=shard.failed,
        seconds=shard.seconds,
    )


def _whole(file: Path, campaign: CampaignSettings, number: int, listed: ShardEntry | None) -> ShardEntry:
    """Entry of a shard that is whole; raises DataError where it is not."""
    if listed is not None and not file.is_symlink() and file.is_file():
        size = file.stat().st_size
        if size != listed.bytes:
            raise DataError(f"{file}: has {size} bytes, the index says {listed.bytes}")
        if file_sha256(file) != listed.sha256:
            raise DataError(f"{file}: its checksum is not that of the index")
        return listed
    with ShardReader(file, campaign, number) as reader:
        digest = reader.digest()
        if digest != reader.stored_digest():
            raise DataError(f"{file}: its data do not have the checksum that it holds")
        return ShardEntry(
            number=number,
            name=file.name,
            bytes=file.stat().st_size,
            sha256=file_sha256(file),
            data_sha256=digest,
            samples=reader.samples.size,
            failed=reader.failed,
            seconds=reader.seconds,
        )


def _check_same(there: CampaignSettings, here: CampaignSettings, folder: Path) -> None:
    """Refuse a directory that holds another campaign's dataset, and say what differs."""
    one, other = (dict(flatten(campaign.identity(), longest=10**9)) for campaign in (there, here))
    keys = [key for key in {**one, **other} if one.get(key) != other.get(key)]
    if keys:
        key = keys[0]
        more = f" (and {len(keys) - 1} more)" if len(keys) > 1 else ""
        raise DataError(
            f"{folder}: holds a dataset of other settings: {key} = {_shown(one, key)} there, "
            f"{_shown(other, key)} here{more}; choose another directory"
        )


def _shown(settings: dict[str, Any], key: str) -> str:
    return str(settings[key])[:60] if key in settings else "absent"
