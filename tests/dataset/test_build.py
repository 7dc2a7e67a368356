"""Building: whatever happens on the way, the dataset is that of a build that nothing happened to."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest
import shapely
from campaigns import digests, failing_simulate, fake_simulate, tiny, write

from mvla_sim.channel.simulate import SimulationInterruptedError
from mvla_sim.dataset import build as module
from mvla_sim.dataset.access import BenchmarkDataset
from mvla_sim.dataset.build import BuildInterruptedError, build_dataset
from mvla_sim.dataset.card import card_text
from mvla_sim.dataset.dry_run import estimate
from mvla_sim.dataset.index import INDEX, Index, file_sha256
from mvla_sim.dataset.shard import make_shard, shard_name
from mvla_sim.dataset.verify import verify
from mvla_sim.errors import ConfigError, DataError, OutputError, RuntimeUnfitError
from mvla_sim.files import locked_folder
from mvla_sim.scene.world import Scene

pytestmark = pytest.mark.usefixtures("fake")

CHILD = """
import sys, time
from pathlib import Path
sys.path.append(sys.argv[3])
import campaigns
import mvla_sim.dataset.shard as shard
def until(scene, *, cache=True):
    if int(scene.name.rpartition("-")[2]) >= int(sys.argv[4]):
        time.sleep(600)  # until it is killed
    return campaigns.fake_simulate(scene)
shard.simulate = until
from mvla_sim.dataset import build
build.SAVE_S = 1e9
build.build_dataset(sys.argv[1], sys.argv[2], workers=0)
"""


@pytest.fixture
def undisturbed(tiny_dataset):
    """Checksums of the data of a build that nothing happened to."""
    return digests(Index.load(tiny_dataset))


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_build_is_its_files_and_nothing_else(tmp_path):
    result = build_dataset(write(tmp_path), tmp_path / "out", workers=0)
    assert names(tmp_path / "out") == [".lock", INDEX, "shard-00000.nc", "shard-00001.nc", "shard-00002.nc"]
    index = Index.load(tmp_path / "out")
    assert (result.made, result.notes, index) == (3, (), result.index)
    assert index.complete
    assert [entry.samples for entry in index.shards.values()] == [4, 4, 2]
    numbers = [k for name in ("train", "validation", "test") for k in index.numbers(name)]
    assert sorted(numbers) == index.numbers() == list(range(10))
    for number, entry in index.shards.items():
        assert file_sha256(index.file(number)) == entry.sha256
    text = (tmp_path / "out" / INDEX).read_text()
    assert str(tmp_path) not in text  # no place of this machine


def test_a_shard_made_twice_has_the_same_data(tmp_path):
    """In any order. The files differ, for they tell when they were made."""
    campaign = tiny(tmp_path)
    first = [make_shard(campaign, number) for number in range(3)]
    again = [make_shard(campaign, number) for number in (2, 0, 1)]
    assert [first[shard.number].data_sha256 for shard in again] == [shard.data_sha256 for shard in again]


def test_a_finished_build_makes_nothing(tmp_path, monkeypatch, undisturbed):
    monkeypatch.setattr(module, "make_shard", None)
    again = build_dataset(tiny(tmp_path), tmp_path / "undisturbed", workers=0)
    assert (again.made, again.notes, digests(again.index)) == (0, (), undisturbed)


def spoil(file: Path, how: str) -> None:
    content = bytearray(file.read_bytes())
    if how == "missing":
        file.unlink()
    elif how == "truncated":
        file.write_bytes(content[: len(content) // 2])
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "another format":
        file.write_bytes(b"no shard at all, " * 500)
    elif how == "a link":
        file.rename(file.with_suffix(".kept"))
        file.symlink_to(file.with_suffix(".kept"))
    elif how == "a flipped bit":
        with h5py.File(file) as opened:
            content[opened["delay"].id.get_chunk_info(0).byte_offset + 5] ^= 1
        file.write_bytes(content)
    elif how == "other data":
        with h5py.File(file, "r+") as opened:
            opened["target_extent"][0] = 99.0
    elif how == "another shard":
        file.write_bytes((file.parent / shard_name(0)).read_bytes())


SPOILT = ("missing", "truncated", "empty", "another format", "a link", "a flipped bit", "other data", "another shard")


@pytest.mark.parametrize("how", SPOILT)
@pytest.mark.parametrize("indexed", [True, False])
def test_a_spoilt_shard_is_made_again_and_the_others_are_kept(tmp_path, undisturbed, how, indexed):
    """With the index by the file's checksum, without it by the one that the shard itself holds."""
    folder = tmp_path / "undisturbed"
    kept = [(folder / shard_name(number)).stat().st_mtime_ns for number in (0, 2)]
    spoil(folder / shard_name(1), how)
    if not indexed:
        (folder / INDEX).unlink()
    result = build_dataset(tiny(tmp_path), folder, workers=0)
    assert result.made == 1
    assert len(result.notes) == (indexed or how != "missing")
    assert all(note.startswith("shard-00001.nc: ") for note in result.notes)
    assert digests(result.index) == undisturbed
    assert [(folder / shard_name(number)).stat().st_mtime_ns for number in (0, 2)] == kept
    assert not (folder / shard_name(1)).is_symlink()
    assert verify(folder, recompute=1).ok


def test_a_build_killed_in_the_middle_goes_on(tmp_path, undisturbed):
    """kill -9 after the first shard; also where the index is lost with it."""
    folder = tmp_path / "killed"
    command = [sys.executable, "-c", CHILD, str(tmp_path / "tiny.toml"), str(folder), str(Path(__file__).parent), "4"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as child:
        deadline = time.monotonic() + 60
        while not (folder / shard_name(0)).exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        child.send_signal(signal.SIGKILL)
    assert (folder / shard_name(0)).exists()
    assert not (folder / shard_name(1)).exists()
    assert Index.load(folder).shards == {}  # it is not written after every shard
    shutil.copytree(folder, tmp_path / "lost")
    (tmp_path / "lost" / INDEX).unlink()
    for place in (folder, tmp_path / "lost"):
        made = build_dataset(tiny(tmp_path), place, workers=0)
        assert made.made == 2
        assert digests(made.index) == undisturbed
        assert [name for name in names(place) if name.startswith(".shard")] == []


def test_ctrl_c_keeps_whole_shards(tmp_path, undisturbed, monkeypatch):
    def trace(scene, *, cache=True):
        if scene.name.endswith("5"):
            raise SimulationInterruptedError("stopped after 3 of 8 views")
        return fake_simulate(scene)

    with monkeypatch.context() as patch:
        patch.setattr("mvla_sim.dataset.shard.simulate", trace)
        with pytest.raises(BuildInterruptedError, match=r"stopped; 1 of 3 shards are whole .* same command") as told:
            build_dataset(tiny(tmp_path), tmp_path / "out", workers=0)
    assert told.value.exit_code == 130
    assert Index.load(tmp_path / "out").numbers() == [0, 1, 2, 3]
    result = build_dataset(tiny(tmp_path), tmp_path / "out", workers=0)
    assert (result.made, digests(result.index)) == (2, undisturbed)


@pytest.mark.parametrize("numbers", [(5,), (4, 5, 6, 7)])
def test_a_sample_that_raises_is_recorded_and_the_others_go_on(tmp_path, monkeypatch, undisturbed, numbers):
    """Nothing is renumbered, also where all of a shard fail; tried again on request, the build is whole."""
    folder = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("mvla_sim.dataset.shard.simulate", failing_simulate(*numbers))
        result = build_dataset(tiny(tmp_path), folder, workers=0)
    index = Index.load(folder)
    assert index == result.index
    assert [(failure.sample, failure.error) for failure in index.failed] == [
        (number, "DataError: no path was found at any view") for number in numbers
    ]
    assert index.numbers() == [k for k in range(10) if k not in numbers]
    assert digests(index)[0::2] == undisturbed[0::2]
    report = verify(folder, recompute=2)
    assert report.ok, report.problems
    assert (report.samples, report.failed) == (10 - len(numbers), len(numbers))
    (folder / INDEX).unlink()
    assert build_dataset(tiny(tmp_path), folder, workers=0).index.failed == index.failed  # the shard knows it too
    again = build_dataset(tiny(tmp_path), folder, retry_failed=True, workers=0)
    assert (again.made, again.index.failed, digests(again.index)) == (1, (), undisturbed)


def test_samples_without_room_fail_alone(tmp_path):
    result = build_dataset(tiny(tmp_path, "families.1.objects={choices=[1, 9]}"), tmp_path / "out", workers=0)
    failed = result.index.failed
    assert 0 < len(failed) < 10
    assert all("no room for 9 objects" in failure.error for failure in failed)


def test_a_machine_that_cannot_trace_ends_the_build(tmp_path, monkeypatch):
    def unfit(scene, *, cache=True):
        raise RuntimeUnfitError("no libLLVM")

    monkeypatch.setattr("mvla_sim.dataset.shard.simulate", unfit)
    with pytest.raises(RuntimeUnfitError, match=r"^no libLLVM$"):
        build_dataset(tiny(tmp_path), tmp_path / "out", workers=0)
    assert Index.load(tmp_path / "out").shards == {}


def test_a_full_disk_leaves_nothing_half_written(tmp_path, undisturbed):
    """A limit on the size of files stands for the disk; the index fits, the shards do not."""
    folder = tmp_path / "full"
    limit = "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
    limit += "resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))\n"
    command = [
        sys.executable,
        "-c",
        limit + CHILD,
        str(tmp_path / "tiny.toml"),
        str(folder),
        str(Path(__file__).parent),
    ]
    done = subprocess.run([*command, "10"], capture_output=True, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1
    assert last.startswith("mvla_sim.errors.OutputError: ")
    assert str(folder / shard_name(0)) in last
    assert names(folder) == [".lock", INDEX]
    result = build_dataset(tiny(tmp_path), folder, workers=0)
    assert digests(result.index) == undisturbed


def test_a_disk_that_fills_up_keeps_what_was_there(tmp_path, undisturbed, monkeypatch):
    folder, original = tmp_path / "out", module._write

    def write_until(place, campaign, shard):
        if shard.number == 1:
            raise OutputError(f"{place}: no space left on the disk; nothing was written under this name")
        return original(place, campaign, shard)

    with monkeypatch.context() as patch:
        patch.setattr(module, "_write", write_until)
        with pytest.raises(OutputError, match="no space left"):
            build_dataset(tiny(tmp_path), folder, workers=0)
    assert list(Index.load(folder).shards) == [0]
    result = build_dataset(tiny(tmp_path), folder, workers=0)
    assert (result.made, digests(result.index)) == (2, undisturbed)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("seed=8", "seed = 7 there, 8 here"),
        ("samples=20", "samples = 10 there, 20 here"),
        ("families.0.size_m=0.7", r"families\.0\.size_m\.min = 0\.5 there, absent here \(and 2 more\)"),
    ],
)
def test_a_directory_of_another_campaign_is_refused(tmp_path, undisturbed, change, said):
    with pytest.raises(DataError, match=f"holds a dataset of other settings: {said}") as told:
        build_dataset(tiny(tmp_path, change), tmp_path / "undisturbed", workers=0)
    assert "\n" not in str(told.value)
    assert digests(Index.load(tmp_path / "undisturbed")) == undisturbed


def test_new_words_about_a_campaign_make_nothing_again(tmp_path, undisturbed):
    result = build_dataset(tiny(tmp_path, "licence=MIT", "description=new"), tmp_path / "undisturbed", workers=0)
    assert (result.made, Index.load(tmp_path / "undisturbed").campaign.licence) == (0, "MIT")


def test_bad_input_is_told_before_work(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "make_shard", None)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be written"):
        build_dataset(tiny(tmp_path), tmp_path / "file", workers=0)
    with pytest.raises(DataError, match="no such campaign file"):
        build_dataset(tmp_path / "none.toml", tmp_path / "out", workers=0)
    with pytest.raises(ConfigError, match="workers = -1; at least 0"):
        build_dataset(tiny(tmp_path), tmp_path / "out", workers=-1)
    with pytest.raises(ConfigError, match="family 'boxes': no room for 1 object"):
        build_dataset(tiny(tmp_path, "families.0.size_m=7", "families.0.objects=1"), tmp_path / "crowded", workers=0)
    assert not (tmp_path / "crowded").exists()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / INDEX).write_text("{")
    with pytest.raises(DataError, match="is not readable JSON"):
        build_dataset(tiny(tmp_path), tmp_path / "broken", workers=0)


def test_a_second_build_is_refused_at_once(tmp_path):
    with locked_folder(tmp_path / "out", "build"), pytest.raises(OutputError, match="another build is at work here"):
        build_dataset(tiny(tmp_path), tmp_path / "out", workers=0)


def test_a_lock_that_is_a_link_is_not_followed(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="cannot be written"):
        build_dataset(tiny(tmp_path), tmp_path / "out", workers=0)
    assert not (tmp_path / "elsewhere").exists()


def test_the_card_tells_what_made_the_shards_what_is_missing_and_twins(tmp_path, monkeypatch):
    """Not the versions of the program that writes the card; and where all is fixed, that scenes repeat."""
    monkeypatch.setattr("mvla_sim.dataset.shard.provenance", lambda: {"program": "mvla-sim 0.0.7", "drjit": "9.9"})
    fixed = ("families.0.size_m=1", "families.0.objects=1", "families.0.x_m=0", "families.0.y_m=0",
             "families.0.rotation_deg=0", "families.0.material=metal", "families.1.weight=1e-9",
             "trajectory.radius_m=5", "trajectory.interval_deg=30")  # fmt: skip
    index = build_dataset(tiny(tmp_path, *fixed), tmp_path / "out", workers=0).index
    text = card_text(BenchmarkDataset(index))
    assert "mvla-sim 0.0.7 with sionna-rt unknown, mitsuba unknown, drjit 9.9" in text
    assert "But 1 scene was drawn several times, in several splits." in text
    assert "not made yet" not in text
    part = card_text(BenchmarkDataset(Index(index.folder, index.campaign, {0: index.shards[0]})))
    assert "6 of 10 samples are not made yet" in part
    other = card_text(BenchmarkDataset(build_dataset(tiny(tmp_path), tmp_path / "other", workers=0).index))
    assert "Splits are by scene, never by view.\n" in other


def test_the_occupancy_is_that_of_the_outline_in_the_file(tmp_path, monkeypatch):
    """Also where rounding the outline to a nanometre decides which voxels it touches."""
    campaign = tiny(tmp_path, "samples=2", "samples_per_shard=2", "split.test=0.5", "split.validation=0.0")

    def shifted(settings, *, source="scene"):
        scene = Scene(settings, source=source)
        square = shapely.box(-0.5, -0.5, 0.5 + 4e-10, 0.5)  # touches the voxels at +x only as far as it is not rounded
        object.__setattr__(scene, "outline", square)
        return scene

    monkeypatch.setattr("mvla_sim.dataset.shard.Scene", shifted)
    monkeypatch.setattr("mvla_sim.evaluation.ground_truth.TOUCH", -1e-9)
    result = build_dataset(campaign, tmp_path / "out", workers=0)
    assert verify(tmp_path / "out", recompute=0).ok
    assert result.made == 1


def test_estimates_come_from_a_probe_and_then_from_stored_shards(tmp_path):
    """A probe's bytes are those of a real build within a fifth, also for such small shards."""
    campaign = tiny(tmp_path)
    probe = estimate(campaign, tmp_path / "out", workers=0)
    assert not (tmp_path / "out").exists()
    assert (probe.samples, probe.shards, probe.stored) == (10, 3, 0)
    assert probe.basis == "from a probe: 8 views each of 7 samples"
    index = build_dataset(campaign, tmp_path / "out", workers=0).index
    real = sum(entry.bytes for entry in index.shards.values())
    assert probe.bytes / real == pytest.approx(1, abs=0.2)
    (tmp_path / "out" / shard_name(2)).unlink()
    stored = estimate(campaign, tmp_path / "out", workers=0)
    assert (stored.stored, stored.basis) == (2, "from 2 stored shards")
    seconds = sum(index.shards[number].seconds for number in (0, 1)) / 8
    assert stored.seconds == pytest.approx(2 * seconds)
    assert json.loads((tmp_path / "out" / INDEX).read_text())["schema_version"] == 1
