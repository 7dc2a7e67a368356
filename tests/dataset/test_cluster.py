"""Builds on real Dask processes on this machine: whatever happens to them, the dataset is the same."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import clusters
import pytest
from campaigns import digests, fake_simulate, tiny
from existing_cluster import Existing

from mvla_sim.cluster import dask_cluster as dask_module
from mvla_sim.cluster.opening import open_cluster
from mvla_sim.dataset import build as module
from mvla_sim.dataset.build import build_dataset
from mvla_sim.dataset.index import Index
from mvla_sim.dataset.shard import shard_name
from mvla_sim.dataset.verify import verify
from mvla_sim.engine.cache import shared_cache
from mvla_sim.errors import OutputError, RuntimeUnfitError

pytestmark = pytest.mark.usefixtures("fake")
SMALL = ("samples_per_shard=1",)


@pytest.fixture
def undisturbed(tmp_path):
    """Checksums of the data of a build in this process."""
    return digests(build_dataset(tiny(tmp_path, *SMALL), tmp_path / "undisturbed", workers=0).index)


@pytest.fixture(autouse=True)
def formula(monkeypatch):
    """Have workers trace by formula."""
    monkeypatch.setattr(module, "make_shard", clusters.make_shard)
    monkeypatch.setattr(module, "make_one", clusters.make_one)


@pytest.fixture
def existing(tmp_path):
    cluster = Existing(tmp_path, Path(__file__).parent)
    yield cluster
    cluster.end()
    cluster.log.close()


def write_then(monkeypatch, count, act):
    """Let ``act`` happen when the build writes its ``count``-th shard."""
    original, written = module._write, []

    def write(folder, campaign, shard):
        entry = original(folder, campaign, shard)
        written.append(shard.number)
        if len(written) == count:
            act()
        return entry

    monkeypatch.setattr(module, "_write", write)
    return written


def test_a_worker_killed_in_the_middle_of_a_build_costs_nothing(tmp_path, undisturbed, monkeypatch):
    with open_cluster(2) as cluster:
        pids = {finished.value for _, finished in cluster.run(clusters.alone, [(n,) for n in range(8)], label="alone")}
        written = write_then(monkeypatch, 2, lambda: os.kill(max(pids), signal.SIGKILL))
        result = build_dataset(tiny(tmp_path, *SMALL), tmp_path / "out", cluster=cluster)
    assert sorted(written) == list(range(10))  # each once
    assert (result.made, digests(result.index), result.index.failed) == (10, undisturbed, ())
    assert all(note.startswith("a worker died once while it made shard-0000") for note in result.notes)


def test_the_sample_that_kills_its_workers_fails_alone(tmp_path, monkeypatch):
    """Its shard is made sample by sample; tried again where it does no harm, the dataset is whole."""
    monkeypatch.setattr(dask_module, "MOST_DEATHS", 1)  # a worker takes seconds to come back
    whole = digests(build_dataset(tiny(tmp_path), tmp_path / "whole", workers=0).index)
    with monkeypatch.context() as patch:
        patch.setenv(clusters.POISON, "5")
        result = build_dataset(tiny(tmp_path), tmp_path / "out", workers=1)
    assert [(failure.sample, failure.error) for failure in result.index.failed] == [(5, "worker died")]
    assert result.index.numbers() == [0, 1, 2, 3, 4, 6, 7, 8, 9]
    assert digests(result.index)[0::2] == whole[0::2]
    assert result.notes[-1] == "a worker died once while it made sample 5"
    again = build_dataset(tiny(tmp_path), tmp_path / "out", retry_failed=True, workers=0)
    assert (again.made, digests(again.index)) == (1, whole)


def test_workers_that_only_die_end_the_build(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_module, "MOST_DEATHS", 1)
    monkeypatch.setattr(module, "MOST_DEATHS", 1)
    monkeypatch.setenv(clusters.POISON, "0")
    with pytest.raises(RuntimeUnfitError, match="workers died 1 times and finished no shard meanwhile"):
        build_dataset(tiny(tmp_path, *SMALL), tmp_path / "out", workers=1)


@pytest.mark.slow
def test_a_scheduler_killed_and_started_again_a_full_disk_and_a_sample_that_raises(
    tmp_path, undisturbed, existing, monkeypatch
):
    """The workers share no disk with this machine; each fault ends in a build that equals the undisturbed one."""
    folder = tmp_path / "out"
    monkeypatch.setenv(clusters.BAD, "7")
    existing.start(workers=2)
    with open_cluster(None, existing.address) as cluster, monkeypatch.context() as patch:
        write_then(patch, 3, existing.kill_scheduler)
        with pytest.raises(RuntimeUnfitError, match="the connection is lost; what is finished is kept"):
            build_dataset(tiny(tmp_path, *SMALL), folder, cluster=cluster)
    kept = {number: entry.sha256 for number, entry in Index.load(folder).shards.items()}
    assert 3 <= len(kept) < 10
    existing.end()
    existing.start(workers=1)
    original = module._write

    def full(place, campaign, shard):
        if shard.number == max(set(range(10)) - set(kept)):
            raise OutputError(f"{place}: no space left on the disk; nothing was written under this name")
        return original(place, campaign, shard)

    with open_cluster(None, existing.address) as cluster:
        with monkeypatch.context() as patch:
            patch.setattr(module, "_write", full)
            with pytest.raises(OutputError, match="no space left"):
                build_dataset(tiny(tmp_path, *SMALL), folder, cluster=cluster)
        result = build_dataset(tiny(tmp_path, *SMALL), folder, cluster=cluster)
        assert [(failure.sample, failure.error) for failure in result.index.failed] == [
            (7, "DataError: no path was found at any view")
        ]
        assert [d for k, d in enumerate(digests(result.index)) if k != 7] == undisturbed[:7] + undisturbed[8:]
        assert {number: result.index.shards[number].sha256 for number in kept if number != 7} == {
            number: digest for number, digest in kept.items() if number != 7
        }  # not made again
        for number, content in ((2, b"cut"), (4, None)):  # truncated; a checksum that does not match
            file = folder / shard_name(number)
            data = bytearray(file.read_bytes())
            data[len(data) // 2] ^= 1
            file.write_bytes(data if content is None else data[: len(data) // 2])
        mended = build_dataset(tiny(tmp_path, *SMALL), folder, cluster=cluster)
    assert (mended.made, digests(mended.index)) == (2, digests(result.index))
    assert [note.partition(": ")[0] for note in mended.notes] == [shard_name(2), shard_name(4)]


def test_a_shared_cache_spares_tracing_and_changes_nothing(tmp_path, monkeypatch):
    """With a cache URL samples leave their CIRs there, and what is made again takes them from there."""
    monkeypatch.undo()
    traced = []

    def simulate(scene, *, cache):
        traced.append(cache)
        return fake_simulate(scene)

    monkeypatch.setattr("mvla_sim.dataset.shard.simulate", simulate)
    campaign = tiny(tmp_path, *SMALL, "samples=1", "split.train=1.0", "split.validation=0.0", "split.test=0.0")
    build_dataset(campaign, tmp_path / "without", workers=0)
    with shared_cache(f"file://{tmp_path}/shared"):
        build_dataset(campaign, tmp_path / "with", workers=0)
        assert verify(tmp_path / "with", recompute=1).ok
    assert traced == [False, True, False]  # a sample made again to be compared never comes from a cache


@pytest.mark.parametrize("kind", [OutputError, RuntimeUnfitError])
def test_a_machine_that_cannot_write_or_trace_ends_the_build_at_once(tmp_path, monkeypatch, kind):
    calls = []

    def fails(campaign, number):
        calls.append(number)
        raise kind("/there: no space")

    monkeypatch.setattr(module, "make_shard", fails)
    with pytest.raises(kind, match=r"^/there: no space$"):
        build_dataset(tiny(tmp_path, *SMALL), tmp_path / "out", workers=0)
    assert calls == [0]
