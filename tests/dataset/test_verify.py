"""Verifying: a whole dataset passes, and whatever was tampered with is found."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import campaigns
import h5py
import numpy as np
import pytest

from mvla_sim.channel.simulate import SimulationInterruptedError
from mvla_sim.dataset.access import open_dataset
from mvla_sim.dataset.index import INDEX, Index, file_sha256
from mvla_sim.dataset.reader import ShardReader
from mvla_sim.dataset.verify import unmatched_share, verify
from mvla_sim.errors import ConfigError, DataError

pytestmark = pytest.mark.usefixtures("fake")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return campaigns.built(tmp_path_factory.mktemp("built"))


@pytest.fixture
def copy(built, tmp_path):
    shutil.copytree(built, tmp_path / "copy")
    return tmp_path / "copy"


def forge(folder, number, change):
    """Change a shard and make every checksum fit again, as somebody who wants to deceive would."""
    index = Index.load(folder)
    file = index.file(number)
    with h5py.File(file, "r+") as opened:
        change(opened)
    with ShardReader(file, index.campaign, number) as reader:
        digest = reader.digest()
    with h5py.File(file, "r+") as opened:
        opened.attrs["data_sha256"] = digest
    entry = index.shards[number].model_copy(
        update={"sha256": file_sha256(file), "data_sha256": digest, "bytes": file.stat().st_size}
    )
    replace(index, shards={**index.shards, number: entry}).save()


def test_a_whole_dataset_passes(built):
    report = verify(built, recompute=10)
    assert report.ok, report.problems
    assert (report.shards, report.samples, report.failed, report.recomputed) == (3, 10, 0, tuple(range(10)))
    assert report.stray == 0.0
    assert verify(built, recompute=2, seed=1).recomputed != verify(built, recompute=2, seed=2).recomputed
    assert verify(built, recompute=0).recomputed == ()


def test_ctrl_c_ends_it(built, monkeypatch):
    """It is no problem of the sample that was being made again."""

    def stopped(scene, *, cache):
        raise SimulationInterruptedError("stopped after 3 of 36 views")

    monkeypatch.setattr("mvla_sim.dataset.shard.simulate", stopped)
    with pytest.raises(SimulationInterruptedError):
        verify(built, recompute=1)


def scaled(name, factor):
    def change(file):
        file[name][0] = file[name][0] * factor

    return change


def emptied(file):
    file["occupancy"][0] = 0


def relabelled(file):
    text = json.loads(file["metadata"].asstr()[0])
    text["split"] = "train" if text["split"] != "train" else "test"
    file["metadata"][0] = json.dumps(text)


def fewer_views(file):
    """The first sample gives its last view to the second one."""
    file["view_count"][0] -= 1
    file["view_count"][1] += 1


def other_bandwidth(file):
    file["bandwidth"][()] = 2e9


def resized(file):
    text = json.loads(file["metadata"].asstr()[0])
    text["settings"]["objects"][0]["height_m"] = 3.0
    file["metadata"][0] = json.dumps(text)


@pytest.mark.parametrize("change", [scaled("gain_real", 1.01), scaled("delay", 1.001), emptied, relabelled, resized])
def test_a_changed_value_is_found_by_the_checksum(copy, change):
    with h5py.File(copy / "shard-00001.nc", "r+") as file:
        change(file)
    problems = verify(copy, recompute=0).problems
    assert len(problems) == 1
    assert problems[0].endswith("shard-00001.nc: its checksum is not that of the index")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled("gain_real", 1.01), "% of its paths are not found again"),
        (scaled("delay", 1.001), "% of its paths are not found again"),
        (scaled("position", 1.001), "its views are not those of its scene"),
        (fewer_views, "its views are not those of its scene"),
        (scaled("target_extent", 2.0), "its largest extent is not that of its scene"),
        (other_bandwidth, "bandwidth is 2e+09 Hz, must be 3e+09 Hz"),
        (emptied, "sample 4: the occupancy is not that of the outline"),
        (relabelled, "sample 4: split is"),
        (resized, "its scene is not the one that the campaign's seed gives"),
    ],
)
def test_a_forger_is_found_by_truth_or_by_making_samples_again(copy, change, message):
    """All checksums fit; sample 4 (and 5, which gets a view) is among those made again, for all of them are."""
    forge(copy, 1, change)
    report = verify(copy, recompute=10)
    assert not report.ok
    assert any(message in problem for problem in report.problems), report.problems
    assert all("\n" not in problem and ("4" in problem or "5" in problem) for problem in report.problems)


def test_missing_and_foreign_shards_are_told(copy):
    (copy / "shard-00007.nc").write_bytes((copy / "shard-00002.nc").read_bytes())
    (copy / "shard-00001.nc").unlink()
    problems = verify(copy, recompute=0).problems
    assert len(problems) == 2
    assert "shard-00007.nc: is not in the index" in problems[0]
    assert "shard-00001.nc: no such shard" in problems[1]
    index = Index.load(copy)
    Index(copy, index.campaign, {0: index.shards[0]}).save()
    assert "2 of 3 shards are not made yet" in verify(copy, recompute=0).problems[0]


def test_bad_input(tmp_path, copy):
    with pytest.raises(ConfigError, match="recompute = -1; at least 0"):
        verify(copy, recompute=-1)
    with pytest.raises(DataError, match="no such dataset"):
        verify(tmp_path / "none")
    (copy / INDEX).write_text("{")
    with pytest.raises(DataError, match="not readable JSON"):
        verify(copy)


def test_paths_are_compared_as_sets(built):
    """Their order and phases are not promised; everything else is, within the rounding of single precision."""
    cir = open_dataset(built)[0].cir
    rows = np.concatenate([np.arange(cir.row_start[m], cir.row_start[m + 1])[::-1] for m in range(cir.n_view)])
    shuffled = replace(cir, gain=-cir.gain[rows], delay_s=cir.delay_s[rows] * (1 + 1e-8),
                       interaction=cir.interaction[rows], first_point_m=cir.first_point_m[rows])  # fmt: skip
    assert unmatched_share(cir, shuffled) == 0
    one = 1 / cir.gain.size
    for name, change in (("gain", 1.01), ("delay_s", 1.0001), ("first_point_m", 1.001)):
        values = getattr(cir, name).copy()
        values[3] *= change
        assert unmatched_share(cir, replace(cir, **{name: values})) == pytest.approx(one), name
    kinds = cir.interaction.copy()
    kinds[3] ^= 1
    assert unmatched_share(cir, replace(cir, interaction=kinds)) == pytest.approx(one)
    none = replace(cir, gain=cir.gain[:0], delay_s=cir.delay_s[:0], interaction=cir.interaction[:0],
                   first_point_m=cir.first_point_m[:0], row_size=0 * cir.row_size)  # fmt: skip
    assert (unmatched_share(cir, none), unmatched_share(none, none)) == (1.0, 0.0)
