"""Methods under several ways to choose thresholds, and the report's sections beyond the paper."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mvla_sim.errors import DataError
from mvla_sim.imaging.method import phase_free_methods
from mvla_sim.paper.ablation import BESIDE, LADDER
from mvla_sim.paper.beyond import sections_beyond
from mvla_sim.paper.fair import EXPLAINED, WAYS, automatic_cost, fair_table, plot_fair
from mvla_sim.paper.report import write_report
from mvla_sim.sweep.experiment import load_experiment


def rows(levels, scenes=("circle", "star"), **more):
    """Cases of methods at two intervals; CD is the method's level, 2 dB more at 20 degrees, 1 dB more on the star."""
    return pd.DataFrame(
        [
            {"scene": scene, "method": method, "snr_db": snr, "seed": 0, "interval_deg": interval, "status": "done",
             "cd_db": level + (2.0 if interval == 20 else 0.0) + (scene == "star")} | more
            for scene in scenes for method, level in levels.items() for interval in (5.0, 20.0) for snr in (0.0, 20.0)
        ]
    )  # fmt: skip


def ways():
    """Under the oracle MVLA-GR is first, held out BP is; no result at 20 degrees there."""
    found = {
        "oracle": rows({"mvla-gr": -20.0, "bp": -10.0}, ap_10cm=0.5),
        "held out: averages": rows({"mvla-gr": -5.0, "bp": -8.0}),
    }
    found["held out: averages"].loc[found["held out: averages"]["interval_deg"] == 20, "cd_db"] = np.nan
    return found


def test_methods_are_ranked_under_each_way():
    found = fair_table(ways())
    assert list(found.index) == ["mvla-gr", "bp"]  # by the first way
    assert list(found["oracle"]) == [-18.0, -8.0]
    assert list(found["held out: averages"]) == [-4.0, -7.0]
    assert list(found["held out: averages rank"]) == [2, 1]
    assert list(found["ap_10cm rank"]) == [1, 1]
    assert list(found["lacking"]) == [2, 2]
    assert fair_table({"oracle": ways()["oracle"]}, least_interval_deg=10.0).loc["bp", "oracle"] == -7.0
    lost = ways()
    lost["oracle"].loc[lost["oracle"]["method"] == "bp", "cd_db"] = np.nan  # all of them, on the star 4
    lost["held out: averages"].loc[lost["held out: averages"]["method"] == "bp", "status"] = "failed"  # 4 more
    assert fair_table(lost)["lacking"].to_dict() == {"mvla-gr": 2}  # bp has no result in any way, so no row
    lost["oracle"] = ways()["oracle"]
    assert fair_table(lost)["lacking"].to_dict() == {"mvla-gr": 2, "bp": 4}
    lost["held out: averages"]["ap_10cm"] = 0.9  # the first way's counts
    assert fair_table(lost).loc["mvla-gr", "ap_10cm"] == 0.5
    with pytest.raises(DataError, match="no finished case of moon in oracle"):
        fair_table(ways(), "moon")
    with pytest.raises(DataError, match="no table"):
        fair_table({})


def test_every_way_has_a_marker_for_every_method():
    figure = plot_fair(fair_table(ways()))
    left, right = figure.axes
    assert [text.get_text() for text in left.get_yticklabels()] == ["MVLA-GR", "Backprojection"]
    drawn = {line.get_label(): list(line.get_xdata()) for line in left.lines}
    assert drawn == {"oracle": [-18.0, -8.0], "held out: averages": [-4.0, -7.0]}
    assert [bar.get_width() for bar in right.patches] == [0.5, 0.5]


def test_the_cost_of_not_knowing_the_truth_is_a_mean_over_the_same_cases():
    optimal, automatic = rows({"mvla-gr": -20.0, "bp": -10.0}), rows({"mvla-gr": -17.0, "bp": -9.0})
    automatic.loc[automatic["scene"] == "star", "cd_db"] += 1.0
    automatic.loc[automatic["snr_db"] == 20.0, "status"] = "failed"  # and so left out of both
    optimal.loc[optimal["snr_db"] == 20.0, "cd_db"] = -99.0
    cost = automatic_cost(optimal, automatic)
    assert list(cost.index) == ["bp", "mvla-gr"]
    assert cost.loc["mvla-gr"].tolist() == [3.0, 4.0, 3.5]
    with pytest.raises(DataError, match="no finished case in common"):
        automatic_cost(optimal, automatic.assign(status="failed"))
    with pytest.raises(DataError, match="lacks the column method"):
        automatic_cost(optimal, automatic.drop(columns="method"))
    with pytest.raises(DataError, match="several cases of one"):
        automatic_cost(pd.concat([optimal, optimal]), automatic)
    offsets = [table.assign(offset=0, cd_db=table["cd_db"]) for table in (optimal, automatic)]
    more = [pd.concat([table, table.assign(offset=1, cd_db=table["cd_db"] + 10)]) for table in offsets]
    assert automatic_cost(*more).loc["mvla-gr"].tolist() == [3.0, 4.0, 3.5]  # not of one offset against the other
    automatic.loc[(automatic["method"] == "bp") & (automatic["scene"] == "star"), "status"] = "failed"
    assert np.isnan(automatic_cost(optimal, automatic).loc["bp", "mean"])  # not the mean of fewer scenes


def test_every_way_is_explained_and_has_its_experiment():
    assert set(EXPLAINED) == set(WAYS)
    folder = Path(__file__).parents[2] / "experiments"
    settings = {way: load_experiment(folder / f"{name}.toml") for way, name in WAYS.items()}
    assert len({one.axes["method"] for one in settings.values()}) == 1  # all compare the same methods
    assert set(settings["oracle"].axes["method"]) == set(phase_free_methods())
    assert settings["oracle"].evaluation.threshold_map
    assert settings["automatic"].evaluation.threshold.rule == "auto"
    for way in ("held out: averages", "held out: least mean"):
        assert "star" not in settings[way].calibration.scenes


def stored(folder, name, table):
    (folder / name).mkdir(parents=True)
    table = table.assign(case=range(len(table)), key=[f"{name}{n}" for n in range(len(table))])
    table.to_csv(folder / name / "table.csv", index=False)


@pytest.fixture
def results(tmp_path):
    """Every experiment beyond the paper, with made-up numbers."""
    levels = {method: -10.0 - n for n, method in enumerate((*LADDER, *BESIDE))}
    stored(tmp_path, "ablation", rows(levels))
    for number, name in enumerate(WAYS.values()):
        stored(tmp_path, name, rows({"mvla-gr": -20.0 + number, "bp": -10.0}, **({} if number else {"ap_10cm": 0.5})))
    impaired = pd.DataFrame(
        itertools.product(("mvla-gr", "bp"), (0, 1), (0.0, 0.01, 0.1)),
        columns=["method", "seed", "imaging.impairments.position_error_m"],
    ).assign(scene="star", status="done", cd_db=-15.0, f1_5cm=0.4, f1_10cm=0.8)
    stored(tmp_path, "robustness", impaired)
    (tmp_path / "benchmark-small").mkdir()
    pd.DataFrame(
        {"method": ["mvla-em", "mine"], "cd_db": [-18.0, -9.0], "cd_db_lo": [-20.0, -11.0], "cd_db_hi": [-16.0, -7.0],
         "behind_db": [0.0, 9.0], "f1_10cm": [0.9, 0.5], "top_percent": [1.0, 2.0], "min_support_deg": [15.0, 0.0]}
    ).to_csv(tmp_path / "benchmark-small" / "leaderboard.csv", index=False)  # fmt: skip
    return tmp_path


def test_what_is_stored_has_its_section_and_its_files(results):
    sections = sections_beyond(results)
    assert [section.title for section in sections] == [
        "Which ingredient brings how much",
        "Methods under fair thresholds",
        "What not knowing the truth costs",
        "Robustness",
        "The benchmark of unseen scenes",
    ]
    fair = pd.read_csv(results / "fair.csv").set_index("method")
    assert fair.loc["mvla-gr", ["oracle", "automatic"]].tolist() == [-19.0 + 1, -15.0 + 1]
    assert pd.read_csv(results / "automatic.csv").set_index("method").loc["mvla-gr", "mean"] == 4.0
    assert (results / "fair.png").read_bytes().startswith(b"\x89PNG")
    assert "mine" in sections[-1].tables[0]
    assert "MVLA-EM" in sections[-1].tables[0]


def test_the_report_shows_them_beside_the_papers(results):
    stored(results / "paper", "kappa-eta", rows({"mvla-gr": -20.0}).assign(kappa=0.5, eta=[0.0, 0.04] * 4))
    text = write_report(results).read_text(encoding="utf-8")
    assert "Methods under fair thresholds" in text
    assert text.count("<img") >= 4


def test_what_is_not_stored_has_no_section(tmp_path):
    assert sections_beyond(tmp_path) == []
    stored(tmp_path, "fair-thresholds", rows({"mvla-gr": -20.0}))
    stored(tmp_path, "fair-auto", rows({"mvla-gr": -20.0}).assign(status="missing"))
    assert sections_beyond(tmp_path) == []


def test_what_is_half_stored_is_left_out(results):
    """An experiment that was stopped, or is of another sort, must not keep the report from being written."""
    for name in ("fair-calibrated", "robustness"):
        table = pd.read_csv(results / name / "table.csv")
        other = table.assign(scene="circle", key="x" + table["key"])
        table["status"] = "missing"
        pd.concat([table, other]).to_csv(results / name / "table.csv", index=False)
    table = pd.read_csv(results / "ablation" / "table.csv")
    table.loc[(table["method"] == "bp") & (table["scene"] == "star"), "status"] = "failed"
    table.to_csv(results / "ablation" / "table.csv", index=False)
    table = pd.read_csv(results / "fair-heldout" / "table.csv").drop(columns="interval_deg")
    table.to_csv(results / "fair-heldout" / "table.csv", index=False)
    sections = {section.title: section for section in sections_beyond(results)}
    assert [caption for _, caption in sections["Robustness"].figures] == ["circle: every 5° on a circle, 20 dB"]
    assert set(pd.read_csv(results / "fair.csv").columns) & set(WAYS) == {"oracle", "held out: least mean", "automatic"}
    assert "Backprojection" in sections["Which ingredient brings how much"].tables[0]


def test_only_cases_that_all_ways_have_are_compared():
    """Held-out thresholds at 5° alone are compared with the oracle's at 5°, not with its mean over 5° and 20°."""
    found = ways()
    found["held out: averages"] = rows({"mvla-gr": -5.0, "bp": -8.0}).query("interval_deg == 5")
    table = fair_table(found)
    assert table.loc["mvla-gr", ["oracle", "held out: averages"]].tolist() == [-19.0, -4.0]
    found["held out: averages"] = rows({"mvla-gr": -5.0}).assign(interval_deg=10.0)
    with pytest.raises(DataError, match="no finished case of star in oracle"):
        fair_table(found)


def test_a_report_of_them_alone_is_written(results):
    """Nothing of the paper is stored, and the record of the run is no record."""
    (results / "run.json").write_text('{"total_s": "x", "seconds": 3}')
    text = write_report(results).read_text(encoding="utf-8")
    assert "Methods under fair thresholds" in text
    assert "AP 10 cm" in text


def test_a_damaged_table_is_named_before_anything_is_written(results):
    (results / "fair-leastmean" / "table.csv").write_text("garbage")
    with pytest.raises(DataError, match=r"fair-leastmean.table\.csv"):
        write_report(results)
    assert not (results / "claims.csv").exists()


def test_a_damaged_leaderboard_is_named(results):
    (results / "benchmark-small" / "leaderboard.csv").write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match=r"leaderboard\.csv: not a leaderboard"):
        sections_beyond(results)
