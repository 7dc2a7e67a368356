"""Image files."""

from __future__ import annotations

import dataclasses

import h5py
import numpy as np
import pytest
import shapely

from mvla_sim.errors import DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import SCHEMA, SCHEMA_VERSION, Image

GRID = VoxelGrid((1.0, -2.0, 0.5), (5, 4, 3), 0.1)


def image(**changes):
    rng = np.random.default_rng(0)
    fields = {
        "score": rng.random(GRID.shape).astype(np.float32),
        "support_deg": rng.uniform(0, 360, GRID.shape).astype(np.float32),
        "grid": GRID,
        "method": "mvla-gr",
        "n_view": 36,
        "occupied": rng.random(GRID.shape) > 0.5,
        "outline": shapely.box(-1, -1, 1, 1),
        "config": {"imaging": {"noise": {"snr_db": None}}},
        "provenance": {"program": "test"},
    }
    return Image(**(fields | changes))


@pytest.mark.parametrize(
    "changes", [{}, {"support_deg": None}, {"occupied": None}, {"outline": None}, {"support_deg": None, "method": "bp"}]
)
def test_round_trip(tmp_path, changes):
    before = image(**changes)
    before.save(tmp_path / "a.nc")
    after = Image.load(tmp_path / "a.nc")
    for name in ("score", "support_deg", "occupied"):
        one, other = getattr(before, name), getattr(after, name)
        assert (one is None) == (other is None)
        if one is not None:
            assert one.dtype == other.dtype
            np.testing.assert_array_equal(one, other)
    assert after.grid.counts == GRID.counts
    assert after.grid.spacing_m == GRID.spacing_m
    np.testing.assert_allclose(after.grid.center_m, GRID.center_m, atol=1e-12)  # metres; half the sum of two ends
    assert (after.method, after.n_view) == (before.method, before.n_view)
    assert after.config == before.config
    assert after.provenance == before.provenance
    assert (after.outline is None) == (before.outline is None)
    if before.outline is not None:
        assert after.outline.equals_exact(before.outline, 1e-9)  # written with nine decimals


def test_single_voxel_survives(tmp_path):
    grid = VoxelGrid((0.0, 0.0, 0.0), (1, 1, 1), 0.25)
    one = np.ones(grid.shape, np.float32)
    image(grid=grid, score=one, support_deg=one, occupied=None).save(tmp_path / "a.nc")
    assert Image.load(tmp_path / "a.nc").grid == grid


def test_file_opens_in_plain_h5py(tmp_path):
    image().save(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        assert file["score"].shape == GRID.shape
        np.testing.assert_allclose(file["x"][:], GRID.axes()[0])
        assert file["support"].attrs["units"] == "degree"
        assert file.attrs["schema"] == SCHEMA
        assert file.attrs["schema_version"] == SCHEMA_VERSION


def change_attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


@pytest.mark.parametrize(
    ("edit", "match"),
    [
        (change_attribute("schema", "mvla-sim CIR"), "schema is 'mvla-sim CIR'"),
        (change_attribute("schema_version", 99), "version 99"),
        (change_attribute("spacing_m", -0.1), "spacing_m"),
        (change_attribute("config", "{"), "not a readable image file"),
        (lambda file: file.__delitem__("score"), "score"),
        (lambda file: file.attrs.__delitem__("method"), "method"),
    ],
    ids=["schema", "version", "spacing", "config", "no score", "no method"],
)
def test_unusable_files_are_refused_in_one_line_that_names_them(tmp_path, edit, match):
    path = tmp_path / "a.nc"
    image().save(path)
    with h5py.File(path, "a") as file:
        edit(file)
    with pytest.raises(DataError, match=match) as caught:
        Image.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["score", "support_deg", "occupied"])
def test_arrays_of_another_shape_are_refused(name):
    with pytest.raises(DataError, match=rf"{name} has shape \(2, 2\)"):
        dataclasses.replace(image(), **{name: np.ones((2, 2), np.float32)})
