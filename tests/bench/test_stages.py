"""The points, and that what is run at them is what they say. Sizes are tiny; no time is judged."""

from __future__ import annotations

import dataclasses
import importlib
import os
from pathlib import Path

import pytest

from mvla_sim.bench.child import perform
from mvla_sim.bench.measure import Measured, measure
from mvla_sim.bench.stages import SIZES, STAGES, points_of, series_of
from mvla_sim.engine.backend import set_threads
from mvla_sim.engine.machine import core_count
from mvla_sim.errors import ConfigError


@pytest.mark.parametrize("quick", [False, True], ids=["full", "quick"])
def test_points(quick):
    points = points_of(STAGES, quick=quick)
    assert {point.series.stage for point in points} == set(STAGES)
    keys = [(point.series.stage, point.series.name, tuple(sorted(point.size.items()))) for point in points]
    assert len(set(keys)) == len(keys)
    for point in points:
        assert set(point.size) <= set(SIZES)
        assert set(point.series.counted) <= set(point.size)
        assert sum(point.size[key] != value for key, value in point.series.base.items()) <= 1
        module, _, name = point.work.target.partition(":")
        assert callable(getattr(importlib.import_module(module), name))


def test_full_measures_what_is_asked_for():
    axes = {stage: {axis for one in series_of(stage) for axis in one.axes} for stage in STAGES}
    assert axes["tracing"] >= {"rays", "views", "facets"}
    assert axes["projection"] >= {"voxels", "views"}
    assert axes["search"] >= {"voxels", "thresholds"}
    sweep = {point.size["workers"] for point in points_of(["sweep"]) if point.series.name == "cases"}
    assert sweep == {1, 2}
    assert len(points_of(STAGES, quick=True)) < len(points_of(STAGES)) / 2


def test_an_unknown_stage_is_one_line():
    with pytest.raises(ConfigError, match=r"^stage = imaging: no such stage; allowed: tracing, projection, search, sw"):
        points_of(["imaging"])


def test_workers_have_a_core_each_and_others_are_not_pinned():
    for point in points_of(STAGES):
        pinned = (point.series.stage, point.series.name) == ("sweep", "cases")
        assert point.work.cores == (point.size["workers"] if pinned else None)


def here(target, params, engine="none"):
    """What :func:`measure` finds, of work that is done in this process; see ``test_measure`` for the others."""
    order = {"params": params, "warmups": 1, "repeats": 2, "budget_s": 4.0, "cores": None, "engine": engine}
    try:
        return Measured(**perform(order | {"target": f"mvla_sim.bench.{target}"}))
    finally:
        if engine != "none":
            set_threads(core_count())


@pytest.mark.parametrize(
    ("target", "params", "engine"),
    [
        ("imaging_jobs:ProjectionJob", {"method": "mvla-gr", "voxels": 100, "views": 4}, "projector"),
        ("imaging_jobs:ProjectionJob", {"method": "bp", "voxels": 100, "views": 4}, "projector"),
        ("imaging_jobs:FrontEndJob", {"part": "pdp", "views": 4, "paths_per_view": 50}, "none"),
        ("imaging_jobs:FrontEndJob", {"part": "peaks", "views": 4, "paths_per_view": 50}, "none"),
    ],
)
def test_jobs_run(target, params, engine):
    found = here(target, params, engine)
    assert found.repeats == 2
    assert found.first_s > 0
    assert found.median_s > 0
    assert found.core_s > 0


def test_a_search_sees_the_thresholds_it_is_said_to():
    for image in ("contour", "unrelated"):
        params = {"voxels": 10_000, "thresholds": 12, "image": image}
        found = here("search_jobs:SearchJob", params)
        assert found.facts["distinct_thresholds"] == 12


def test_the_truth_grows_with_the_side_of_the_grid():
    counts = [here("search_jobs:TruthJob", {"voxels": n}).facts["truth_voxels"] for n in (10_000, 40_000)]
    assert counts[1] == pytest.approx(2 * counts[0], rel=0.05)


def test_tracing_counts_paths_and_bytes():
    """A path is complex64, float64, uint8 and three float32: 29 bytes, and its share of the rows."""
    facts = here("tracing_jobs:TracingJob", {"rays": 1300, "views": 2, "facets": 12}, "tracer").facts
    assert facts["paths_per_view"] > 10
    assert facts["memory_bytes_per_path"] == pytest.approx(29 + 8 / facts["paths_per_view"])
    assert facts["disk_bytes_per_path"] > 10


@pytest.mark.slow
def test_a_sweep_runs_every_case(tmp_path):
    (point,) = [one for one in points_of(["sweep"], quick=True) if one.size["workers"] == 2]
    size = {**point.size, "cases": 6.0, "views": 4.0}
    work = dataclasses.replace(point.work, params=size)
    kernels = Path(os.environ.get("DRJIT_CACHE_DIR", Path.home() / ".drjit"))  # compiled by other tests already
    found = measure(work, kernels=kernels, cache=tmp_path / "cache")
    assert found.facts["failed"] == 0
    assert found.facts["batches"] >= 1
    assert found.facts["startup_s"] > 0
    assert found.loaded_bytes > 50e6  # of a worker
