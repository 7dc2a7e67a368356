"""The distance of a reading from the paper, on hand-made tables; and the counted work of claim C15."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest

from mvla_sim.paper.checks import count_work
from mvla_sim.paper.claims import PAPER_THRESHOLDS
from mvla_sim.paper.reading_score import UNITS, reading_score

PAPER = PAPER_THRESHOLDS.set_index("snr_db")
INTERVALS = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0)


def cd_of(method, snr, interval):
    growth = 8 * np.log10(interval)
    return -25 + (2 * growth if method == "bp" else growth - 0.05 * snr * np.log10(interval))


def star(grid_m2=100.0, p_factor=1.0, protocol="optimal", cost=0.0):
    """The star as published, with the paper's thresholds on a grid of an area."""
    rows = []
    for method, snr, interval in itertools.product(("mvla-gr", "bp"), PAPER.index, INTERVALS):
        mvla = method == "mvla-gr"
        p = p_factor * PAPER.loc[snr, "mvla_top_percent" if mvla else "bp_top_percent"]
        rows.append(
            {
                "scene": "star", "method": method, "snr_db": snr, "interval_deg": interval, "protocol": protocol,
                "offset": 0, "seed": 0,
                "cd_db": cd_of(method, snr, interval) + cost * (2 + 0.1 * (20 - snr) * mvla),
                "top_percent": p,
                "min_support_deg": PAPER.loc[snr, "mvla_min_support_deg"] * mvla,
                "area_m2": p / 100 * grid_m2,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def canonical(best=(0.5, 0.04)):
    cells = itertools.product(("circle", "square", "triangle"), (0.3, 0.5, 0.7, 0.9), (0.02, 0.04, 0.06))
    rows = [(s, k, e, "optimal", -20 + 10 * (k - best[0]) ** 2 + 1e3 * (e - best[1]) ** 2) for s, k, e in cells]
    return pd.DataFrame(rows, columns=["scene", "kappa", "eta", "protocol", "cd_db"])


def whole(**changed):
    return pd.concat([canonical(), star(**changed), star(protocol="given", cost=1.0)], ignore_index=True)


def test_the_paper_itself_is_at_distance_zero():
    found = reading_score(whole())
    assert (found["held"], found["tested"]) == (13, 13)
    assert found["table_error"] == pytest.approx(0, abs=1e-12)
    assert found["score"] == pytest.approx(0, abs=1e-12)
    assert found["mvla_support_20db"] == pytest.approx(96.8477)
    assert found["bp_area_0db"] == pytest.approx(0.3)


def test_a_narrower_grid_counts_by_its_area_where_that_is_nearer():
    """0.61 % of 400 m² are 2.44 m², which are 2.44 % of 100 m²."""
    found = reading_score(whole(p_factor=4.0))
    assert found["table_error"] == found["table_error_wide"] == pytest.approx(0, abs=1e-12)
    assert found["table_error_own"] == pytest.approx(2.0)  # ten of the 15 are four times too large
    assert found["mvla_area_0db"] == pytest.approx(2.436)


def test_each_term_is_weighed_as_it_is_written():
    base = {"held": 13.0}
    away = reading_score(pd.concat([canonical((0.7, 0.04)), star(), star(protocol="given", cost=1.0)]))
    assert away["held"] == base["held"] - 1
    assert (away["kappa"], away["eta"], away["cells_away"]) == (0.7, 0.04, 1.0)
    assert away["gap_db"] == pytest.approx(0.4)
    assert away["score"] == pytest.approx((0.5 + 0.5 * 0.4 / UNITS["C1"]) + 2 * 0.4 / 6 + 1 / 4)
    larger = reading_score(whole(p_factor=1.5))
    assert larger["score"] == pytest.approx(4 * (10 * np.log(1.5)) / 15 / np.log(4))
    assert larger["table_error"] == larger["table_error_own"] == pytest.approx(10 / 15 * 0.5)


def test_what_was_not_run_does_not_count_and_what_failed_does():
    alone = reading_score(star())
    assert alone["tested"] == 10  # no map, no calibrated thresholds: C1, C8, C9
    assert alone["score"] == pytest.approx(0, abs=1e-12)
    assert np.isnan(alone["gap_db"])
    lost = star()
    lost.loc[(lost["interval_deg"] == 1.0) & (lost["method"] == "bp"), "cd_db"] = np.nan
    failed = reading_score(lost)
    assert failed["tested"] == 10
    assert failed["score"] >= 7  # C2 to C7 and C13 cannot be told


def test_an_empty_map_is_as_far_as_can_be():
    table = canonical()
    found = reading_score(table.assign(cd_db=np.nan))
    assert found["score"] == pytest.approx(1 + 2 + 1)


def test_the_work_of_the_projector_is_counted_not_timed():
    """N·M reads whatever K is, and some 210 samples of a kernel a peak."""
    work = count_work()
    assert work["base_updates"] == 500 * 500 * 90 + 900 * 211
    assert work["views_x4"] == 4.0
    assert work["voxels_x4"] == pytest.approx(4, abs=0.03)
    assert 1 < work["peaks_x4"] < 1.03
    assert work == count_work()
