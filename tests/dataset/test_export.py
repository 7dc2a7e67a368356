"""Exports: written, read back with the readers of these formats, and equal."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from campaigns import built, count_paths
from scipy.io import loadmat

from mvla_sim.channel.importing import import_channel, import_settings
from mvla_sim.channel.readers.deepmimo import read_deepmimo
from mvla_sim.channel.readers.pairs import select_pairs
from mvla_sim.dataset import exports as module
from mvla_sim.dataset.access import open_dataset
from mvla_sim.dataset.exports import export_mat, export_npz
from mvla_sim.errors import ConfigError, OutputError

GAIN = 1e-6
"""Relative: power and phase are kept in single precision, 1e-5 dB of 100 dB and 1e-5 of 180 degrees."""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = built(tmp_path_factory.mktemp("built"), "trajectory.pair_separation_m={choices=[0, 0.3]}")
    return open_dataset(folder, "test")


def by_delay(cir):
    """Order of the paths of each view by rising delay, as the reader has them."""
    view = np.repeat(np.arange(cir.n_view), cir.row_size)
    return np.lexsort((cir.delay_s, view))


def test_scenarios_are_read_back_by_the_reader_of_deepmimo(dataset, tmp_path):
    folders = export_npz(dataset, tmp_path / "npz")
    assert [folder.name for folder in folders] == [f"sample-{number:06d}" for number in dataset.numbers]
    assert sorted(path.name for path in (tmp_path / "npz").iterdir()) == [folder.name for folder in folders]
    for folder, sample in zip(folders, dataset, strict=True):
        cir, order = sample.cir, by_delay(sample.cir)
        pairs = select_pairs(read_deepmimo(folder), "co-located", 0.4)
        receivers = cir.views.positions_m if cir.views.receivers_m is None else cir.views.receivers_m
        assert np.array_equal(pairs.transmitters_m, cir.views.positions_m)
        assert np.array_equal(pairs.receivers_m, receivers)
        assert np.array_equal(pairs.row_size, cir.row_size)
        assert np.array_equal(pairs.delay_s, cir.delay_s[order])
        assert np.array_equal(pairs.interaction, cir.interaction[order])
        assert np.array_equal(pairs.first_point_m, cir.first_point_m[order])
        np.testing.assert_allclose(pairs.gain, cir.gain[order], rtol=GAIN)
        assert pairs.carrier_hz == cir.carrier_hz
        with np.load(folder / "truth.npz", allow_pickle=False) as truth:
            assert np.array_equal(truth["occupancy"], sample.occupancy)
        assert json.loads((folder / "metadata.json").read_text()) == sample.metadata


def test_a_scenario_can_be_imported(dataset, tmp_path):
    (folder, *_) = export_npz(dataset, tmp_path)
    imported = import_channel(import_settings(folder, None, ["bandwidth_hz=3e9", "pairs.tolerance_m=0.4"]))
    assert imported.n_view == dataset[0].cir.n_view
    assert imported.gain.size == dataset[0].cir.gain.size


def test_angles_are_those_of_the_paths(dataset, tmp_path):
    (folder, *_) = export_npz(dataset, tmp_path)
    cir = dataset[0].cir
    with (
        np.load(folder / "aod_az_t000_tx002_r001.npz") as azimuth,
        np.load(folder / "aod_el_t000_tx002_r001.npz") as el,
    ):
        az, zenith = (
            np.deg2rad(file[name][2, : cir.row_size[2]]) for file, name in ((azimuth, "aod_az"), (el, "aod_el"))
        )
        assert np.isnan(azimuth["aod_az"][[0, 1, 3]]).all()
    towards = np.stack([np.cos(az) * np.sin(zenith), np.sin(az) * np.sin(zenith), np.cos(zenith)], axis=1)
    offset = cir.first_point_m[cir.rows(2)] - cir.views.positions_m[2]
    np.testing.assert_allclose(towards, offset / np.linalg.norm(offset, axis=1, keepdims=True), atol=1e-6)


def test_a_matlab_file_is_read_back_by_scipy(dataset, tmp_path):
    file = loadmat(export_mat(dataset, tmp_path / "test.mat"))
    samples = list(dataset)
    assert file["sample"].ravel().tolist() == list(dataset.numbers)
    assert file["gain"].dtype == np.complex64
    for name, of in {
        "gain": lambda c: c.gain, "delay": lambda c: c.delay_s, "interaction": lambda c: c.interaction,
        "row_size": lambda c: c.row_size, "angle": lambda c: c.views.angles_deg,
    }.items():  # fmt: skip
        assert np.array_equal(file[name].ravel(), np.concatenate([of(sample.cir) for sample in samples])), name
    assert np.array_equal(file["position"], np.concatenate([sample.cir.views.positions_m for sample in samples]))
    assert np.array_equal(file["first_point"], np.concatenate([sample.cir.first_point_m for sample in samples]))
    for number, sample in enumerate(samples):
        assert file["view_count"].ravel()[number] == sample.cir.n_view
        assert np.array_equal(file["occupancy"][..., number], sample.occupancy)
        assert json.loads(file["metadata"].ravel()[number][0]) == sample.metadata
        ring = file["outline"].ravel()[number]
        first = ring[: np.flatnonzero(np.isnan(ring[:, 0]))[0] if np.isnan(ring).any() else len(ring)]
        assert np.array_equal(first, shapely.get_coordinates(shapely.get_parts(sample.outline)[0]))


def test_bad_input_is_one_line_before_work(dataset, tmp_path, monkeypatch):
    (tmp_path / "there" / f"sample-{dataset.numbers[1]:06d}").mkdir(parents=True)
    with pytest.raises(OutputError, match="is there already"):
        export_npz(dataset, tmp_path / "there")
    assert len(list((tmp_path / "there").iterdir())) == 1
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be made"):
        export_npz(dataset, tmp_path / "file")
    with pytest.raises(ConfigError, match=r"the name must end in \.mat"):
        export_mat(dataset, tmp_path / "x.txt")
    with pytest.raises(OutputError, match="does not exist"):
        export_mat(dataset, tmp_path / "none" / "x.mat")
    changed = open_dataset(dataset.index.folder, "test", transform=count_paths)
    with pytest.raises(ConfigError, match="has a transform"):
        export_npz(changed, tmp_path / "changed")
    monkeypatch.setattr(module, "LARGEST_MAT_BYTES", 1000)
    monkeypatch.setattr(type(dataset), "__getitem__", None)  # no sample is read to find that out
    with pytest.raises(ConfigError, match="export one split, or read the shards with ncread"):
        export_mat(dataset, tmp_path / "x.mat")
    assert not (tmp_path / "x.mat").exists()


def test_a_full_disk_leaves_no_half_scenario(dataset, tmp_path, monkeypatch):
    original, count = module._save, []

    def save(folder, name, view, values):
        count.append(name)
        if len(count) == 150:
            raise OSError(28, "No space left on device")
        original(folder, name, view, values)

    monkeypatch.setattr(module, "_save", save)
    with pytest.raises(OutputError, match="No space left on device"):
        export_npz(dataset, tmp_path / "npz")
    left = sorted(path.name for path in (tmp_path / "npz").iterdir())
    assert left == [f"sample-{number:06d}" for number in dataset.numbers[: len(left)]]
    assert len(left) < len(dataset)
