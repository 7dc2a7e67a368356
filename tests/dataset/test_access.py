"""Opening: what was written comes back, lazily, in any process, and nothing outside the directory is touched."""

from __future__ import annotations

import json
import multiprocessing
import pickle
import re
import shutil
import time

import campaigns
import h5py
import numpy as np
import pytest
import shapely
from campaigns import count_paths, equal, fake_simulate

import mvla_sim as mv
from mvla_sim.dataset import access as module
from mvla_sim.dataset.access import open_dataset
from mvla_sim.dataset.index import INDEX, Index
from mvla_sim.dataset.sample import draw_sample, split_of
from mvla_sim.errors import ConfigError, DataError, MvlaError
from mvla_sim.evaluation.ground_truth import rasterize
from mvla_sim.scene.world import Scene


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A dataset with receivers apart in some samples: campaign and directory."""
    folder = campaigns.built(tmp_path_factory.mktemp("built"), "trajectory.pair_separation_m={choices=[0, 0.3]}")
    return Index.load(folder).campaign, folder


@pytest.fixture
def copy(built, tmp_path):
    """A copy that a test may spoil."""
    shutil.copytree(built[1], tmp_path / "copy")
    return tmp_path / "copy"


def test_samples_come_back_as_they_were_made(built):
    campaign, folder = built
    dataset = mv.open_dataset(folder)
    assert len(dataset) == 10
    apart = set()
    for k, sample in enumerate(dataset):
        settings = draw_sample(campaign, k)
        made = fake_simulate(Scene(settings))
        assert equal(sample.cir, made)
        assert sample.metadata["settings"] == settings.model_dump(mode="json")
        assert (sample.metadata["sample"], sample.metadata["split"]) == (k, split_of(campaign, k))
        assert sample.outline.equals_exact(made.outline, 1e-8)
        assert np.array_equal(sample.filled, rasterize(made.outline, sample.grid, "filled"))
        assert np.array_equal(sample.contour, rasterize(made.outline, sample.grid, "contour"))
        assert sample.occupancy.shape == (40, 60)
        facts = dataset.metadata(k)
        assert (facts["views"], facts["paths"], facts["extent_m"]) == (made.n_view, made.gain.size, made.extent_m)
        apart.add(sample.cir.views.receivers_m is not None)
    assert apart == {True, False}


def test_splits_are_what_they_say(built):
    folder = built[1]
    numbers = {}
    for split, count in (("train", 5), ("validation", 2), ("test", 3)):
        dataset = open_dataset(folder, split)
        numbers[split] = dataset.numbers
        assert len(dataset) == count
        assert all(sample.metadata["split"] == split for sample in dataset)
        assert dataset[-1].metadata["sample"] == dataset.numbers[-1]
        assert dataset.by_number(dataset.numbers[1]).metadata["sample"] == dataset.numbers[1]
    assert sorted(sum(numbers.values(), ())) == list(range(10))
    with pytest.raises(IndexError, match="allowed: 0 to 2"):
        dataset[3]
    with pytest.raises(DataError, match=f"no sample {numbers['train'][0]} in test"):
        dataset.by_number(numbers["train"][0])
    with pytest.raises(ConfigError, match="split = 'tset': there is none; allowed: train, validation, test"):
        open_dataset(folder, "tset")


def test_nothing_is_read_before_it_is_asked_for(built, monkeypatch):
    opened = []
    original = module.ShardReader

    def watched(file, campaign, number):
        opened.append(number)
        return original(file, campaign, number)

    monkeypatch.setattr(module, "ShardReader", watched)
    dataset = open_dataset(built[1])
    assert opened == []
    assert dataset[9].metadata["sample"] == 9
    assert dataset[8].metadata["sample"] == 8
    assert opened == [2]
    monkeypatch.setattr(module, "OPEN_SHARDS", 1)
    assert [dataset[k].metadata["sample"] for k in (0, 9, 0)] == [0, 9, 0]
    assert opened == [2, 0, 2, 0]


def test_labelled_arrays_are_lazy(built):
    campaign, folder = built
    with open_dataset(folder).to_xarray() as tree:
        assert list(tree.children) == ["shard-00000", "shard-00001", "shard-00002"]
        first = tree["shard-00000"].dataset
        assert not first["gain_real"].variable._in_memory
        assert not first["occupancy"].variable._in_memory
        assert list(first["split"].values) == [split_of(campaign, k) for k in range(4)]
        sample = open_dataset(folder)[1]
        views = slice(int(first["view_count"][0]), int(first["view_count"][:2].sum()))
        start = int(first["row_size"][: views.start].sum())
        gain = (first["gain_real"] + 1j * first["gain_imag"])[start : start + sample.cir.gain.size]
        assert np.array_equal(gain.values, sample.cir.gain)
        assert np.array_equal(first["position"][views].values, sample.cir.views.positions_m)


@pytest.mark.parametrize("split", ["train", "test"])
def test_labelled_arrays_of_a_split_hold_nothing_of_another(built, split):
    """The paths of the split's samples, one after another, and no more."""
    dataset = open_dataset(built[1], split)
    with dataset.to_xarray() as tree:
        assert {int(name[-5:]) for name in tree.children} == {number // 4 for number in dataset.numbers}
        nodes = [tree[name].dataset for name in sorted(tree.children)]
        assert not any(node["gain_real"].variable._in_memory for node in nodes)
        assert [number for node in nodes for number in node["sample"].values] == list(dataset.numbers)
        assert {str(item) for node in nodes for item in node["split"].values} == {split}
        samples = list(dataset)
        for name, wanted in (
            ("view_count", [[sample.cir.n_view] for sample in samples]),
            ("row_size", [sample.cir.row_size for sample in samples]),
            ("delay", [sample.cir.delay_s for sample in samples]),
            ("position", [sample.cir.views.positions_m for sample in samples]),
            ("occupancy", [sample.occupancy[None] for sample in samples]),
        ):
            found = np.concatenate([node[name].values for node in nodes])
            np.testing.assert_array_equal(found, np.concatenate(wanted))


def read_in_child(dataset, queue):
    queue.put([dataset[k] for k in (0, 9)])


def test_what_is_pickled_holds_no_open_file(built):
    dataset = open_dataset(built[1], transform=count_paths)
    expected = [dataset[k] for k in (0, 9)]
    assert dataset._open
    copy = pickle.loads(pickle.dumps(dataset))
    assert not copy._open
    assert [copy[0], copy[9]] == expected


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_other_processes_can_read_it(built, method):
    """As a DataLoader's workers do, while this process has shards open."""
    dataset = open_dataset(built[1], transform=count_paths)
    expected = [dataset[k] for k in (0, 9)]
    context = multiprocessing.get_context(method)
    queue = context.SimpleQueue()
    child = context.Process(target=read_in_child, args=(dataset, queue))
    child.start()
    assert queue.get() == expected
    child.join()
    assert child.exitcode == 0
    assert [dataset[0], dataset[9]] == expected


def edit(folder, change):
    data = json.loads((folder / INDEX).read_text())
    change(data)
    (folder / INDEX).write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["shards"][0].update(name="../other/shard-00000.nc"), "must be the plain name of a .nc file"),
        (lambda d: d["shards"][0].update(name="/etc/shard-00000.nc"), "must be the plain name of a .nc file"),
        (lambda d: d["shards"][0].update(name="..\\x.nc"), "must be the plain name"),
        (lambda d: d["shards"][0].update(name="shard-00001.nc"), "is no shard of this campaign"),
        (lambda d: d["shards"][0].update(number=99), "is no shard of this campaign"),
        (lambda d: d["shards"][0].update(number=1), "a number is used twice"),
        (lambda d: d["shards"][0].update(samples=3), "3 samples and 0 failed ones do not make the 4"),
        (lambda d: d["shards"][0].update(sha256="0"), "sha256"),
        (lambda d: d["shards"][0].update(extra=1), "extra: unknown key"),
        (lambda d: d.update(schema="other"), "schema is 'other', not 'mvla-sim dataset'"),
        (lambda d: d.update(schema_version=99), "schema version 99; this program reads version 1"),
        (lambda d: d["splits"]["train"].append(d["splits"]["test"][0]), "is in train and in test"),
        (lambda d: d["splits"]["train"].pop(), "splits.train is not the train split"),
        (lambda d: d["splits"].pop("test"), "splits are train, validation; must be"),
        (lambda d: d["campaign"].update(samples=-1), "campaign.samples = -1"),
    ],
)
def test_an_index_that_lies_is_one_line(copy, change, message):
    edit(copy, change)
    with pytest.raises(MvlaError, match=message) as told:
        open_dataset(copy)
    assert str(copy / INDEX) in str(told.value)
    assert "\n" not in str(told.value)


def test_no_dataset_is_one_line(tmp_path, copy):
    with pytest.raises(DataError, match="no such dataset"):
        open_dataset(tmp_path / "none")
    with pytest.raises(DataError, match="no such dataset index"):
        open_dataset(tmp_path)
    for content in ("", "{", "[]", "[" * 100_000, "\x00"):
        (copy / INDEX).write_text(content)
        with pytest.raises(DataError):
            open_dataset(copy)


def test_links_are_refused(built, copy):
    """Also a link to a whole shard, and one inside a shard."""
    shard = copy / "shard-00000.nc"
    shard.unlink()
    shard.symlink_to(built[1] / "shard-00000.nc")
    with pytest.raises(DataError, match=r"shard-00000\.nc: is a link"):
        open_dataset(copy)[0]
    with pytest.raises(DataError, match=r"shard-00000\.nc: is a link"):
        open_dataset(copy).to_xarray()
    other = copy / "shard-00001.nc"
    with h5py.File(other, "r+") as file:
        del file["delay"]
        file["delay"] = h5py.ExternalLink(str(built[1] / "shard-00001.nc"), "delay")
    with pytest.raises(DataError, match="'delay' is a link to elsewhere"):
        open_dataset(copy)[4]
    index = copy / INDEX
    index.rename(copy / "kept.json")
    index.symlink_to(copy / "kept.json")
    with pytest.raises(DataError, match=r"index\.json: is a link"):
        open_dataset(copy)


def test_data_kept_outside_a_shard_are_refused(copy):
    with h5py.File(copy / "shard-00000.nc", "r+") as file:
        values = file["target_extent"][()]
        del file["target_extent"]
        file.create_dataset("target_extent", values.shape, values.dtype, external=[("/etc/passwd", 0, 8 * values.size)])
    with pytest.raises(DataError, match="'target_extent' is stored elsewhere"):
        open_dataset(copy)[0]


@pytest.mark.parametrize("how", ["missing", "truncated", "no path", "rows", "text", "NaN", "shape"])
def test_a_damaged_shard_is_one_line(copy, how):
    file = copy / "shard-00000.nc"
    if how == "missing":
        file.unlink()
    elif how == "truncated":
        file.write_bytes(file.read_bytes()[:-5000])
    else:
        with h5py.File(file, "r+") as opened:
            if how == "no path":
                del opened["gain_real"]
            elif how == "rows":
                opened["row_size"][0] += 1
            elif how == "text":
                opened["metadata"][0] = "{"
            elif how == "NaN":
                opened["gain_real"][0] = np.nan
            else:
                del opened["angle"]
                opened["angle"] = np.zeros((3, 3))
    with pytest.raises(DataError, match=r"shard-00000\.nc") as told:
        open_dataset(copy)[0]
    assert "\n" not in str(told.value)
    assert open_dataset(copy)[5].metadata["sample"] == 5


class Bomb:
    """Pickled, it would leave a mark where it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (open, (str(self.mark), "w"))


@pytest.mark.parametrize("what", ["shard", "index", "metadata", "values"])
def test_nothing_is_unpickled(copy, tmp_path, what):
    mark = tmp_path / "mark"
    content = pickle.dumps(Bomb(mark))
    file = copy / "shard-00000.nc"
    if what == "shard":
        np.save(copy / "x.npy", np.array([Bomb(mark)], object), allow_pickle=True)
        (copy / "x.npy").rename(file)
    elif what == "index":
        (copy / INDEX).write_bytes(content)
    else:
        name = "metadata" if what == "metadata" else "gain_real"
        with h5py.File(file, "r+") as opened:
            shape = opened[name].shape
            del opened[name]
            opened.create_dataset(name, data=np.full(shape, np.void(content)))
    with pytest.raises(DataError) as told:
        open_dataset(copy)[0]
    assert "\n" not in str(told.value)
    assert not mark.exists()


def without_storage(file, name, shape, dtype):
    """A variable that claims to be huge, of which nothing is stored."""
    del file[name]
    file.create_dataset(name, shape, dtype, chunks=(1 << 16, *shape[1:]))


def packed_twice(file):
    del file["delay"]
    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_chunk((1 << 16,))
    creation.set_deflate(9)
    creation.set_deflate(9)
    space = h5py.h5s.create_simple((1 << 16,))
    h5py.h5d.create(file.id, b"delay", h5py.h5t.IEEE_F64LE, space, creation)


def one_text_many_times(file):
    """Of four failed samples with long errors; a shard of ten thousand could claim gigabytes so."""
    del file["failed_sample"], file["failed_error"]
    file["failed_sample"] = np.arange(4)
    file.create_dataset("failed_error", (4,), h5py.string_dtype(), fillvalue="x" * 400_000)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: without_storage(f, "row_size", (10**13,), "i8"), "'row_size' claims to hold 10000000000000 values"),
        (lambda f: without_storage(f, "delay", (10**13,), "f8"), "'delay' claims to hold"),
        (lambda f: without_storage(f, "first_point", (10**12, 3), "f4"), "'first_point' claims to hold"),
        (lambda f: without_storage(f, "sample", (10**13,), "i8"), "'sample' claims to hold"),
        (packed_twice, "'delay' is packed in a way that shards are not"),
        (one_text_many_times, "'failed_error' claims to hold more text than a file of"),
        (lambda f: f["x"].__setitem__(0, 99.0), "x is not that of the campaign's grid"),
        (lambda f: f["metadata"].__setitem__(0, '{"sample": 0}'), "metadata of sample 0: family is 'None', no str"),
    ],
)
def test_a_shard_that_lies_about_its_size_or_content_is_one_line(copy, change, message):
    with h5py.File(copy / "shard-00000.nc", "r+") as file:
        change(file)
    began = time.process_time()
    with pytest.raises(DataError, match=re.escape(message)) as told:
        open_dataset(copy)[0]
    assert "\n" not in str(told.value)
    assert time.process_time() - began < 2


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.pop("settings"),
        lambda d: d["settings"].pop("objects"),
        lambda d: d["settings"].update(extra=1),
        lambda d: d.update(objects=99),
        lambda d: d.update(family=["a"]),
    ],
)
def test_metadata_are_what_they_promise(copy, change):
    with h5py.File(copy / "shard-00000.nc", "r+") as file:
        data = json.loads(file["metadata"].asstr()[0])
        change(data)
        file["metadata"][0] = json.dumps(data)
    dataset = open_dataset(copy)
    for read in (lambda: dataset[0], lambda: dataset.metadata(0)):
        with pytest.raises(DataError, match="sample 0"):
            read()


@pytest.mark.parametrize(
    "text", ["POINT (0 0)", "LINESTRING (0 0, 1 1)", "POLYGON EMPTY", "POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))",
             "POLYGON ((0 0, 9 0, 0 1, 0 0))", "POLYGON ((0 0, 1", ""],
)  # fmt: skip
def test_an_outline_that_is_no_area_inside_the_grid_is_refused(copy, text):
    with h5py.File(copy / "shard-00000.nc", "r+") as file:
        file["outline_wkt"][0] = text
    with pytest.raises(DataError, match=r"shard-00000\.nc: "):
        open_dataset(copy)[0]


def test_labelled_arrays_of_a_damaged_file_are_one_line(copy):
    """What only xarray looks at is damaged."""
    with h5py.File(copy / "shard-00000.nc", "r+") as file:
        file["view"].attrs["NAME"] = h5py.Empty("S1")
        file["position"].attrs["units"] = np.bytes_(b"\xff\xfe")
        del file["position"].attrs["_Netcdf4Dimid"], file["position"].attrs["DIMENSION_LIST"]
        del file["view"]
    assert open_dataset(copy)[0].metadata["sample"] == 0
    with pytest.raises(DataError, match=r"shard-00000\.nc: not a readable shard"):
        open_dataset(copy).to_xarray()


def test_a_part_of_a_dataset_can_be_used(copy):
    """While a build is at work the index lists what is there."""
    index = Index.load(copy)
    Index(copy, index.campaign, {1: index.shards[1]}).save()
    (copy / "shard-00000.nc").unlink()
    dataset = open_dataset(copy)
    assert dataset.numbers == (4, 5, 6, 7)
    assert not dataset.index.complete
    assert shapely.get_parts(dataset[0].outline).size >= 1


def test_a_heap_that_never_ends_is_refused(copy):
    """Texts lie in heaps without a checksum; HDF5 itself would walk on the spot for ever in one that is damaged so."""
    file = copy / "shard-00000.nc"
    content = bytearray(file.read_bytes())
    heap = content.index(b"GCOL")
    content[heap + 16 : heap + 32] = bytes(16)  # its first object: index 0, size 0
    file.write_bytes(content)
    with pytest.raises(DataError, match=r"shard-00000\.nc: not a readable NetCDF-4 file"):
        open_dataset(copy)[0]
