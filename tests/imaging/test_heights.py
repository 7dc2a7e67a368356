"""The grid lies in the imaging plane unless it is set elsewhere, and no truth of another height is scored."""

from __future__ import annotations

import dataclasses
import json
import warnings

import numpy as np
import pytest
import shapely
from cases import ring, scatterers

import mvla_sim as mv
from mvla_sim.errors import DataError, MvlaWarning
from mvla_sim.grid import GridSettings, VoxelGrid

GRID = {"size_m": [4.0, 4.0, 0.0], "spacing_m": 0.1}
HERE = [[1.0, 0.5, 0.9], [-1.0, 0.0, 0.9]]


def channel(plane=0.9, **fields):
    return scatterers(HERE, ring(24, height_m=0.9), outline=shapely.box(-1, -1, 1, 1), plane_height_m=plane, **fields)


def test_the_grid_follows_the_plane():
    cir = channel()
    followed, given = (
        mv.reconstruct(cir, snr_db=None, grid=grid) for grid in (GRID, GRID | {"center_m": [0.0, 0.0, 0.9]})
    )
    assert followed.grid == given.grid
    assert followed.grid.center_m == (0.0, 0.0, 0.9)
    assert np.array_equal(followed.score, given.score)
    assert followed.config["imaging"]["grid"]["center_m"] == [0.0, 0.0, 0.9]  # what was used, not that it was left out
    assert mv.observe(cir, snr_db=None, grid=GRID).grid == followed.grid
    assert mv.evaluate(followed).truth.any()


def test_without_a_plane_the_grid_is_at_the_origin_as_ever():
    assert VoxelGrid.from_settings(GridSettings()).center_m == (0.0, 0.0, 0.0)
    assert VoxelGrid.from_settings(GridSettings(), 0.9).center_m == (0.0, 0.0, 0.9)
    assert VoxelGrid.from_settings(GridSettings(center_m=(1.0, 2.0, 3.0)), 0.9).center_m == (1.0, 2.0, 3.0)


def test_a_grid_above_the_target_is_not_scored():
    image = mv.reconstruct(channel(), snr_db=None, grid=GRID | {"center_m": [0.0, 0.0, 3.9]})
    with pytest.raises(DataError, match=(
        r"the grid is at z = 3\.9 m and the truth is that of the imaging plane z = 0\.9 m; leave out grid\.center_m or "
        r"set its z to 0\.9"
    )):  # fmt: skip
        mv.evaluate(image)
    near = mv.reconstruct(channel(), snr_db=None, grid=GRID | {"center_m": [0.0, 0.0, 0.95]})  # half a voxel
    assert mv.evaluate(near).truth.any()


def test_files_carry_the_plane(tmp_path):
    cir = channel()
    cir.save(tmp_path / "cir.nc")
    assert mv.Cir.load(tmp_path / "cir.nc").plane_height_m == 0.9
    image = mv.reconstruct(cir, snr_db=None, grid=GRID)
    image.save(tmp_path / "image.nc")
    assert mv.Image.load(tmp_path / "image.nc").plane_height_m == 0.9
    assert mv.Cir.from_dataset(channel(None).to_dataset()).plane_height_m is None
    older = channel(None, config={"name": "old", "plane_height_m": 0.9}).to_dataset()  # before the attribute
    assert "imaging_plane_height_m" not in older.attrs
    assert json.loads(older.attrs["config"])["plane_height_m"] == 0.9
    assert mv.Cir.from_dataset(older).plane_height_m == 0.9


def test_a_sensor_at_another_height_than_a_measured_channels_grid_is_said():
    measured = dataclasses.replace(channel(None), outline=None)
    with pytest.warns(
        MvlaWarning, match=r"the sensor is at z = 0\.9 m and the grid at 0 m: .*set the z of grid\.center_m"
    ):
        mv.reconstruct(measured, snr_db=None, grid=GRID)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mv.reconstruct(measured, snr_db=None, grid=GRID | {"center_m": [0.0, 0.0, 0.9]})
        mv.reconstruct(measured, snr_db=None, grid=GRID | {"size_m": [4.0, 4.0, 1.0]})  # a volume
