"""Objects that hold arrays compare by identity: arrays have no truth value, so a comparison by fields would raise."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil

import numpy as np
import pytest

from mvla_sim.channel.readers.touchstone import FolderSweeps
from mvla_sim.channel.references import ReferenceCalibration, Subtraction
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.observation import Estimate, FrontEnd, Observation
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.projection import Projection, RangeProfiles
from mvla_sim.scene.trajectory import views_on_circle

ROOMS = ("channel", "dataset", "evaluation", "imaging")
HOLD_ARRAYS = ("NDArray", "Cir", "Channel", "Views", "Image", "FrequencyResponse")
HOLD_ARRAYS += ("Pdp", "Peaks", "FrontEnd", "RangeProfiles", "AntennaPattern")


def holders():
    """Every dataclass of these rooms with a field that is an array, or that holds arrays itself."""
    for room in ROOMS:
        package = importlib.import_module(f"mvla_sim.{room}")
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            module = importlib.import_module(found.name)
            for name, item in vars(module).items():
                if getattr(item, "__module__", "") == found.name and (
                    dataclasses.is_dataclass(item) or hasattr(item, "_fields")
                ):
                    fields = [str(text) for text in inspect.get_annotations(item).values()]
                    if any(part in text for text in fields for part in HOLD_ARRAYS):
                        yield pytest.param(item, id=f"{room}-{name}")


@pytest.mark.parametrize("holder", list(holders()))
def test_objects_with_arrays_compare_by_identity(holder):
    assert holder.__eq__ is object.__eq__
    assert holder.__hash__ is object.__hash__


def one_of_each():
    """An object of every kind with many views or voxels."""
    grid, views = (
        VoxelGrid((0.0, 0.0, 0.0), (80, 80, 1), 0.1),
        views_on_circle((0.0, 0.0), 10.0, np.arange(500) * 0.72),
    )
    score, table = np.zeros(grid.shape, np.float32), np.ones((500, 400), np.float32)
    peaks = Peaks(np.full(1000, 9.0), np.ones(1000), np.full(500, 2))
    pdp = Pdp(table.astype(np.float64), None, 5.0, 0.025, 0.05, 1.0)
    profiles = RangeProfiles(table, 5.0, 0.025)
    front = FrontEnd(pdp, peaks, 0.05)
    seen = Observation(front, views, grid, ImagingSettings(), 4.0, (5.0, 15.0), made=profiles)
    image = Image(score, score, grid, "bp", 500)
    return image, pdp, peaks, profiles, Projection(score, score), seen, Estimate(score, score), front


@pytest.mark.parametrize("item", one_of_each(), ids=lambda item: type(item).__name__)
def test_what_imaging_makes_equals_itself_and_prints_in_one_line(item):
    assert item == item  # noqa: PLR0124 - by fields it would raise
    assert item != dataclasses.replace(item)
    assert {item: 1}[item] == 1
    assert repr(item).startswith(f"{type(item).__name__}(")
    assert "\n" not in repr(item)
    assert len(repr(item)) < 120


@pytest.mark.parametrize(
    "item",
    [
        Subtraction(np.zeros((2, 3)), np.zeros(2)),
        ReferenceCalibration(np.zeros((2, 3)), 1e-9, 1.0),
        FolderSweeps((), np.zeros(2), 1e9, 1e6, np.zeros((2, 3))),
    ],
    ids=lambda item: type(item).__name__,
)
def test_what_sweeps_become_equals_itself(item):
    assert item == item  # noqa: PLR0124 - tuples of arrays raise
    assert item != dataclasses.replace(item)
    assert {item: 1}[item] == 1
