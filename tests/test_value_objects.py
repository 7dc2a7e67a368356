"""Objects that hold arrays compare by identity: arrays have no truth value, so a comparison by fields would raise."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil

import pytest

ROOMS = ("channel", "dataset", "evaluation")
HOLD_ARRAYS = ("NDArray", "Cir", "Channel", "Views", "Image", "FrequencyResponse")


def holders():
    """Every dataclass of these rooms with a field that is an array, or that holds arrays itself."""
    for room in ROOMS:
        package = importlib.import_module(f"mvla_sim.{room}")
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            module = importlib.import_module(found.name)
            for name, item in vars(module).items():
                if dataclasses.is_dataclass(item) and item.__module__ == found.name:
                    fields = [str(field.type) for field in dataclasses.fields(item)]
                    if any(part in text for text in fields for part in HOLD_ARRAYS):
                        yield pytest.param(item, id=f"{room}-{name}")


@pytest.mark.parametrize("holder", list(holders()))
def test_objects_with_arrays_compare_by_identity(holder):
    assert holder.__eq__ is object.__eq__
    assert holder.__hash__ is object.__hash__
