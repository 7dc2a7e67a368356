"""Every claim on hand-made tables on which it must hold, and on which it must not."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest

from mvla_sim.evaluation.claims import PAPER_THRESHOLDS, Tables, claims_table, judge, thresholds_table

INTERVALS = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0)
SNRS = (0.0, 5.0, 10.0, 15.0, 20.0)


def star(cd, p=lambda snr, method: 0.5 + snr / 100 * (method == "mvla-gr"), t=lambda snr: 30 + snr):
    """A table of the star whose CD is ``cd(method, snr, interval)``; offsets spread around it evenly."""
    rows = []
    for method, snr, interval in itertools.product(("mvla-gr", "bp"), SNRS, INTERVALS):
        for offset, shift in enumerate((-0.1, 0.1)):
            rows.append(
                {
                    "method": method, "snr_db": snr, "interval_deg": interval, "offset": offset, "seed": 0,
                    "cd_db": cd(method, snr, interval) + shift,
                    "top_percent": p(snr, method),
                    "min_support_deg": t(snr) * (method == "mvla-gr"),
                    "area_m2": 1.0,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def as_published(method, snr, interval):
    """The paper's findings: CD grows with Δθ, MVLA-GR gains with Δθ and needs SNR where views are few."""
    growth = 8 * np.log10(interval)
    if method == "bp":
        return -25 + 2 * growth
    return -25 + growth - 0.05 * snr * np.log10(interval)


def map_of(best):
    grid = itertools.product(("circle", "square", "triangle"), (0.3, 0.5, 0.7), (0.02, 0.04, 0.06), (0, 1))
    rows = [(s, k, e, n, -20 + 10 * (k - best[0]) ** 2 + 1e3 * (e - best[1]) ** 2) for s, k, e, n in grid]
    return pd.DataFrame(rows, columns=["scene", "kappa", "eta", "seed", "cd_db"])


def verdicts(**tables):
    return {claim.number: claim.verdict for claim in judge(Tables(**tables))}


GOOD = {
    "kappa_eta": map_of((0.5, 0.04)),
    "star_optimal": star(as_published),
    "star_calibrated": star(lambda m, s, i: as_published(m, s, i) + (1 + 0.1 * (20 - s) if m == "mvla-gr" else 1)),
    "checks": {
        "c15": {"voxels_x4": 4.1, "views_x4": 3.9, "peaks_x4": 1.05},
        "c16": {"largest_score_change": {"mvla-gr": 1e-7, "bp": 2e-7}},
    },
}


def test_every_claim_holds_on_what_the_paper_describes():
    found = verdicts(**GOOD)
    assert found.pop("C14") == "not tested"
    assert set(found.values()) == {"holds"}, found
    assert list(verdicts(**GOOD)) == [f"C{n}" for n in range(1, 17)]


SAME = star(lambda m, s, i: -20.0)
REVERSED = star(lambda m, s, i: as_published("bp" if m == "mvla-gr" else "mvla-gr", s, 31 - i))
BAD = {
    "C1": {"kappa_eta": map_of((0.7, 0.04))},
    "C2": {"star_optimal": REVERSED},
    "C3": {"star_optimal": SAME},
    "C4": {"star_optimal": SAME},
    "C5": {"star_optimal": star(lambda m, s, i: as_published(m, s, i) + 3 * (m == "bp"))},
    "C6": {"star_optimal": star(lambda m, s, i: as_published(m, s, i) - 0.3 * s * (m == "mvla-gr"))},
    "C7": {"star_optimal": star(lambda m, s, i: as_published(m, s, i) - 0.9 * s * (m == "bp"))},
    "C8": {"star_calibrated": GOOD["star_optimal"]},
    "C9": {"star_calibrated": star(lambda m, s, i: as_published(m, s, i) + 0.2 * s * (m == "mvla-gr"))},
    "C10": {"star_optimal": star(as_published, p=lambda snr, method: 1 - snr / 100)},
    "C11": {"star_optimal": star(as_published, t=lambda snr: 30 + snr * (snr != 10))},
    "C12": {"star_optimal": star(as_published, p=lambda snr, method: 0.3 + snr / 100)},
    "C13": {"star_optimal": star(lambda m, s, i: as_published(m, s, i) + 9 * (i == 5))},
    "C15": {"checks": {"c15": {"voxels_x4": 4.0, "views_x4": 4.0, "peaks_x4": 3.9}}},
    "C16": {"checks": {"c16": {"largest_score_change": {"mvla-gr": 1e-3, "bp": 0.0}}}},
}


@pytest.mark.parametrize(("number", "tables"), BAD.items(), ids=BAD)
def test_claim_does_not_hold_where_it_must_not(number, tables):
    assert verdicts(**(GOOD | tables))[number] == "does not hold"


def test_missing_tables_are_not_tested():
    assert set(verdicts().values()) == {"not tested"}
    found = verdicts(star_optimal=GOOD["star_optimal"])
    assert (found["C1"], found["C8"], found["C9"], found["C16"]) == ("not tested",) * 4
    assert found["C3"] == "holds"


def test_distances_that_are_not_finite_are_left_out_and_counted():
    table = GOOD["star_optimal"].copy()
    table.loc[[0, 7], "cd_db"] = np.nan
    table.loc[11, "cd_db"] = -np.inf
    claim = next(c for c in judge(Tables(star_optimal=table)) if c.number == "C3")
    assert claim.verdict == "holds"
    assert "3 cases" in claim.detail


def test_thresholds_stand_beside_the_papers():
    table = thresholds_table(GOOD["star_optimal"])
    assert table["snr_db"].tolist() == PAPER_THRESHOLDS["snr_db"].tolist()
    assert table["paper_mvla_min_support_deg"].tolist() == PAPER_THRESHOLDS["mvla_min_support_deg"].tolist()
    np.testing.assert_allclose(table["mvla_min_support_deg"], [30, 35, 40, 45, 50])


def test_thresholds_average_within_an_interval_first():
    """An interval with many offsets weighs as much as one with few."""
    table = GOOD["star_optimal"]
    table = table[table["interval_deg"].isin([1.0, 30.0])]
    many = table[(table["interval_deg"] == 30.0)].assign(top_percent=9.0)
    few = table[(table["interval_deg"] == 1.0)].assign(top_percent=1.0)
    joined = pd.concat([few, *[many] * 10])
    np.testing.assert_allclose(thresholds_table(joined)["bp_top_percent"], 5.0)


def test_table_of_claims_has_a_row_each():
    table = claims_table(judge(Tables(**GOOD)))
    assert len(table) == 16
    assert {"number", "text", "rule", "figure", "measured", "verdict", "detail"} == set(table.columns)


def test_a_table_without_what_a_claim_is_about_leaves_it_open():
    table = GOOD["star_optimal"]
    claim = next(c for c in judge(Tables(star_optimal=table[table["interval_deg"] != 5.0])) if c.number == "C13")
    assert claim.verdict == "not tested"
    assert "5°" in claim.detail
