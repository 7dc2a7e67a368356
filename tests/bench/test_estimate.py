"""Fits recover known laws, and the estimate follows from them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rows import LOADED, measured_rows

from mvla_sim.bench.estimate import CostScenario, costs_from, estimate, fit_affine, fit_power_law
from mvla_sim.errors import ConfigError, DataError


@pytest.fixture(scope="module")
def costs():
    return costs_from(measured_rows())


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.0])
def test_the_exponent_of_a_power_law_is_found(exponent):
    x = np.array([1e3, 1e4, 1e5, 1e6])
    law = fit_power_law(x, 3e-7 * x**exponent)
    assert law.exponent == pytest.approx(exponent, abs=1e-9)
    assert law.scale == pytest.approx(3e-7)
    assert law.spread < 1e-9
    assert law(2e5) == pytest.approx(3e-7 * 2e5**exponent)
    noisy = fit_power_law(x, 3e-7 * x**exponent * np.exp([0.1, -0.1, -0.1, 0.1]))
    assert noisy.exponent == pytest.approx(exponent)
    assert noisy.spread == pytest.approx(0.1)


def test_fixed_cost_and_cost_a_unit_are_found():
    x = np.array([1.0, 4, 16, 64, 1e6])
    law = fit_affine(x, 0.3 + 0.02 * x)
    assert (law.fixed, law.per_unit) == pytest.approx((0.3, 0.02))
    assert law(10) == pytest.approx(0.5)


def test_neither_part_of_a_cost_is_negative():
    law = fit_affine([1, 2, 3], [1, 4, 9])
    assert law.fixed == 0
    assert law.per_unit > 0
    assert fit_affine([1, 2, 3], [3, 2, 1]).per_unit == 0


@pytest.mark.parametrize("fit", [fit_affine, fit_power_law])
@pytest.mark.parametrize(
    ("x", "y"), [([1, 1], [1, 2]), ([1], [1]), ([0, 1], [1, 1]), ([1, 2], [1, -1]), ([1, 2], [1, np.nan])]
)
def test_what_cannot_be_fitted_is_refused(fit, x, y):
    with pytest.raises(DataError, match=r"^fit: .+$"):
        fit(x, y)


def test_costs_are_those_of_the_rows(costs):
    assert costs.trace(360) == pytest.approx(0.1 + 0.2 * 360)
    assert costs.project_s(1e6, 10) == pytest.approx(1e-2)
    assert costs.search_s(40_000, 72) == pytest.approx(0.04)
    assert costs.search_s(40_000, 288) == pytest.approx(0.08)
    assert costs.handing_out_s == pytest.approx(0.004)
    assert costs.efficiency == pytest.approx(0.8)
    # a case of the sweep, less 36 views' peaks, their projection, and the search at 36 thresholds
    assert costs.rest_s == pytest.approx(0.1 - 0.036 - 40_000 * 36e-9 - 0.04 * 0.5**0.5)


def test_the_estimate_adds_up(costs):
    campaign = CostScenario(scenes=1000, views=100, nodes=2, cores=10, voxels=10_000)
    found = estimate(costs, campaign)
    by_name = {stage.name: stage for stage in found.stages}
    assert by_name["tracing"].core_s == pytest.approx(20.1)
    assert by_name["tracing"].hours == pytest.approx(20.1 * 1000 / 20 / 0.8 / 3600)
    assert found.computing_hours == pytest.approx(sum(stage.hours for stage in found.stages))
    assert found.coordinating_hours == pytest.approx(3 * 1000 * 0.004 / 3600)
    assert found.disk_bytes == pytest.approx(1000 * 100 * 1000 * 20)
    assert found.disk_bytes_per_s == pytest.approx(found.disk_bytes / found.hours / 3600)
    assert found.worker_bytes == pytest.approx(LOADED + 10e6 + 100e6)
    assert found.node_bytes == pytest.approx(10 * found.worker_bytes)
    assert all(text.endswith(".") for text in found.assumptions)


def test_twice_the_scenes_take_twice_as_long_and_twice_the_nodes_half(costs):
    one = estimate(costs, CostScenario())
    scenes = estimate(costs, CostScenario(scenes=2_000_000))
    assert scenes.computing_hours == pytest.approx(2 * one.computing_hours)
    assert scenes.disk_bytes == pytest.approx(2 * one.disk_bytes)
    assert scenes.disk_bytes_per_s == pytest.approx(one.disk_bytes_per_s)
    for more in (CostScenario(nodes=128), CostScenario(cores=64)):
        found = estimate(costs, more)
        assert found.computing_hours == pytest.approx(one.computing_hours / 2)
        assert found.coordinating_hours == pytest.approx(one.coordinating_hours)
        assert found.disk_bytes == one.disk_bytes


@pytest.mark.parametrize(
    ("slow", "bound"),
    [
        (("tracing", "star"), "tracing"),
        (("projection", "mvla-gr"), "projection"),
        (("search", "image of the target"), "search"),
        (("projection", "read and PDP"), "reading and PDP"),
        (("projection", "noise, peaks, profiles"), "noise, peaks, profiles"),
        (("sweep", "empty tasks"), "coordination"),
    ],
)
def test_the_slowest_stage_bounds(slow, bound):
    rows = measured_rows(factor=lambda series: 1e4 if (series.stage, series.name) == slow else 1.0)
    found = estimate(costs_from(rows))
    assert found.bound == bound
    times = {stage.name: stage.hours for stage in found.stages}
    if bound == "coordination":
        assert found.hours == found.coordinating_hours > found.computing_hours
    else:
        assert max(times, key=lambda name: times[name]) == bound
        assert found.hours == found.computing_hours


def test_workers_that_help_each_other_are_not_believed():
    rows = measured_rows()
    (two,) = [row for row in rows if row.size.get("workers") == 2]
    rows[rows.index(two)] = dataclasses.replace(two, measured=dataclasses.replace(two.measured, core_s=1.0))
    assert costs_from(rows).efficiency == 1


def test_a_machine_that_was_not_quiet_is_told_of():
    rows = measured_rows()
    assert not any("Other programs" in text for text in estimate(costs_from(rows)).assumptions)
    slow = dataclasses.replace(rows[0].measured, median_s=10 * rows[0].measured.core_s)
    rows[0] = dataclasses.replace(rows[0], measured=slow)
    assert f"at 1 of {len(rows)} points" in estimate(costs_from(rows)).assumptions[0]


def test_all_stages_are_needed():
    with pytest.raises(DataError, match=r"^no estimate without the measured points of search, sweep$"):
        costs_from(measured_rows(("tracing", "projection")))


def test_quick_points_are_enough_for_an_estimate():
    assert estimate(costs_from(measured_rows(quick=True))).bound == "tracing"


@pytest.mark.parametrize("name", ["scenes", "views", "nodes", "cores", "voxels"])
def test_no_empty_campaign(name):
    with pytest.raises(ConfigError, match=f"^{name} = 0; at least 1$"):
        CostScenario(**{name: 0})
