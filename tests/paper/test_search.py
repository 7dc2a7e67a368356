"""What the report says of a search for readings, on a made-up one."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from mvla_sim.errors import DataError
from mvla_sim.paper.reading_score import UNITS
from mvla_sim.paper.search_sections import load_readings, search_sections

CLAIMS = [number.lower() for number in UNITS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """64 readings of two settings, the best 8 in a second round: C1 needs the window, C2 excludes C3."""
    folder = tmp_path_factory.mktemp("results")
    rows = []
    for number in range(64):
        window, sigma = ("hann", "rectangular")[number % 2], 3.0 + number // 2 % 4
        margins = {f"margin_{claim}": 1.0 - 0.01 * number for claim in CLAIMS}
        margins |= {"margin_c1": 1.0 if window == "rectangular" else -2.0, "margin_c2": sigma - 4.5}
        margins |= {"margin_c3": 4.5 - sigma, "margin_c9": np.nan}
        holds = {
            name.replace("margin", "holds"): np.nan if np.isnan(v) else float(v >= 0) for name, v in margins.items()
        }
        held = float(np.nansum(list(holds.values())))
        figures = {"score": 13 - held + 0.001 * number, "held": held, "tested": 12.0, "gap_db": 0.1 * number,
                   "table_error": 0.5, "mvla_support_0db": 10 * sigma}  # fmt: skip
        head = {"sample": f"s{number:02d}", "cases": 4, "failed": 0, "invalid": "", "window": window, "sigma": sigma}
        rows.append(head | {"round": 1} | figures | margins | holds)
        if number % 8 == 1:
            rows.append(head | {"round": 2} | figures | {"score": 1.0 + number} | margins | holds)
    design = pd.DataFrame(rows)
    design = design[["sample", "round", *(name for name in design if name not in ("sample", "round"))]]
    (folder / "readings").mkdir()
    design.to_csv(folder / "readings" / "design.csv", index=False)
    return folder


@pytest.fixture(scope="module")
def sections(folder):
    """Its sections."""
    return search_sections(folder)


def test_a_row_a_reading_with_the_figures_of_every_round(folder, sections):
    table, settings = load_readings(folder / "readings.csv")
    assert settings == ["window", "sigma"]
    assert len(table) == table["sample"].nunique() == 64
    assert (table["rounds"] == 2).sum() == table["score_2"].notna().sum() == 8
    assert "margin_c9" not in table  # what screening could not tell of any reading
    assert len(sections) == 3


def test_the_nearest_of_the_last_round_come_first(sections):
    found = sections[0]
    assert "64 readings of 2 settings" in found.text
    assert "the nearest 8 run in a finer round" in found.text
    cells = found.tables[0].split("<tr>")[2]
    assert ">s01<" in cells
    assert ">2<" in cells  # its score in the second round, 1 + 1


def test_what_decides_each_claim_is_one_figure_and_one_table(folder, sections):
    decides = sections[1]
    assert (folder / "effects.png").stat().st_size > 10_000
    assert len(decides.figures) == 1
    shares = pd.read_csv(folder / "effects.csv", keep_default_na=False).set_index(["figure", "setting", "partner"])
    assert float(shares.loc[("margin_c1", "window", ""), "share"]) == pytest.approx(1, abs=0.02)
    assert float(shares.loc[("margin_c1", "sigma", ""), "share"]) < 0.1
    assert "window = rectangular: 100 %" in decides.tables[0]
    assert "50 % of readings" in decides.tables[0]


def test_claims_that_exclude_each_other_are_named_first(sections):
    rows = sections[2].tables[0].split("<tr>")
    assert ">C2 and C3<" in rows[2]
    assert ">0<" in rows[2]
    assert re.search(r"sigma: [56] for C2, [34] for C3", rows[2])


def test_the_report_needs_no_more_than_the_readings(folder, sections, tmp_path):
    (tmp_path / "readings.csv").write_bytes((folder / "readings.csv").read_bytes())
    assert [section.text for section in search_sections(tmp_path)] == [section.text for section in sections]
    assert search_sections(tmp_path / "nothing") == []


def test_other_tables_are_refused(tmp_path):
    (tmp_path / "readings.csv").write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match="not a table of readings"):
        search_sections(tmp_path)
