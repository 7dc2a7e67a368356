"""Shares of variance against closed forms, and when a claim holds."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import qmc

from mvla_sim.paper.effects import conditions, effects


@pytest.fixture(scope="module")
def samples():
    """y = 2a + b·c + noise, with a, b, c, d of two or four values and e a number between 0 and 1."""
    unit = qmc.Sobol(5, rng=1).random(1024)
    a, b, c = np.where(unit[:, 0] < 0.5, -1, 1), np.where(unit[:, 1] < 0.5, -1, 1), np.where(unit[:, 2] < 0.5, -1, 1)
    table = pd.DataFrame({"a": a, "b": np.where(b < 0, "low", "high"), "c": c > 0, "d": (4 * unit[:, 3]).astype(int)})
    table["e"] = unit[:, 4]
    noise = np.random.default_rng(0).standard_normal(len(table))
    return table.assign(y=2.0 * a + b * c + noise, steep=np.where(table["e"] > 0.75, 1.0, -1.0), flat=3.0)


SETTINGS = ("a", "b", "c", "d", "e")


def share_of(table, setting, partner="", figure="y"):
    rows = table[(table["figure"] == figure) & (table["setting"] == setting) & (table["partner"] == partner)]
    return rows.iloc[0]


def test_shares_of_variance_are_those_of_the_closed_form(samples):
    """Var(y) = 4 + 1 + 1: two thirds are a's, a sixth is that of b and c together and of neither alone."""
    found = effects(samples, SETTINGS, ["y"])
    assert share_of(found, "a").share == pytest.approx(4 / 6, abs=0.03)
    assert share_of(found, "b", "c").share == pytest.approx(1 / 6, abs=0.03)
    for name in ("b", "c", "d", "e"):
        assert share_of(found, name).share < 0.01
    assert share_of(found, "a", "d").share < 0.01
    assert found.iloc[0]["setting"] == "a"


def test_intervals_hold_the_share_and_shrink_with_the_samples(samples):
    wide, narrow = (share_of(effects(part, SETTINGS, ["y"], pairs=False), "a") for part in (samples[:128], samples))
    for row in (wide, narrow):
        assert row.low < 4 / 6 < row.high
    assert narrow.high - narrow.low < wide.high - wide.low


def test_a_number_of_many_values_is_divided_into_quartiles(samples):
    assert share_of(effects(samples, SETTINGS, ["steep"], pairs=False), "e", figure="steep").share > 0.99


def test_a_figure_that_does_not_vary_has_no_effects_and_gaps_are_left_out(samples):
    lost = samples.assign(y=samples["y"].where(samples["d"] > 0))
    found = effects(lost, SETTINGS, ["flat", "y"], pairs=False)
    assert set(found["figure"]) == {"y"}
    assert share_of(found, "a").share == pytest.approx(4 / 6, abs=0.05)


def test_conditions_name_what_a_claim_needs(samples):
    """It holds where a and e are both large, so each alone brings it from an eighth to half or a quarter."""
    holds = ((samples["a"] > 0) & (samples["e"] > 0.75)).astype(float)
    (_, base), (first, half), (second, whole) = conditions(samples.assign(c1=holds), SETTINGS, "c1")
    assert base == pytest.approx(1 / 8, abs=0.01)
    assert "e ≤" in first
    assert second == "a = 1"
    assert (half, whole) == (pytest.approx(0.5, abs=0.05), 1.0)


def test_conditions_end_where_nothing_adds(samples):
    assert conditions(samples.assign(c1=1.0), SETTINGS, "c1") == [("all readings", 1.0)]
