"""Table and figure of the ablation."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from mvla_sim.errors import DataError
from mvla_sim.paper.ablation import LADDER, ablation_table, markdown, plot_ablation


def rows(levels, scenes=("circle", "star"), **more):
    """Cases of methods at two intervals; CD is the method's level, 2 dB more at 20 degrees, 1 dB more on the star."""
    return pd.DataFrame(
        [
            {"scene": scene, "method": method, "interval_deg": interval, "status": "done",
             "cd_db": level + (2.0 if interval == 20 else 0.0) + (scene == "star")} | more
            for scene in scenes for method, level in levels.items() for interval in (5.0, 20.0)
        ]
    )  # fmt: skip


LEVELS = {"mvla-gr": -20.0, "bp": -10.0, "hard-vote": -12.0, "soft-kernel": -14.0, "power-weights": -15.0}


def test_the_table_has_the_ladder_in_order_and_means_by_hand():
    found = ablation_table(rows(LEVELS))
    assert tuple(found.index[:4]) == LADDER
    assert found.loc["bp", "circle"] == -9.0
    assert found.loc["bp", "star"] == -8.0
    assert found.loc["bp", "mean"] == -8.5
    assert "| MVLA-GR |" in markdown(found)


def test_cases_without_a_result_are_left_out():
    table = rows(LEVELS)
    table.loc[(table["method"] == "bp") & (table["interval_deg"] == 20), "cd_db"] = np.nan
    table.loc[table["method"] == "hard-vote", "status"] = "failed"
    found = ablation_table(table)
    assert found.loc["bp", "circle"] == -10.0
    assert "hard-vote" not in found.index
    with pytest.raises(DataError, match="no case is finished"):
        ablation_table(table.assign(status="missing"))
    with pytest.raises(DataError, match="lacks the column method"):
        ablation_table(table.drop(columns="method"))


def test_the_figure_has_a_panel_a_scene_and_a_line_a_method():
    figure = plot_ablation(rows(LEVELS))
    assert [axis.get_title() for axis in figure.axes] == ["circle", "star"]
    assert all(len(axis.lines) == len(LEVELS) for axis in figure.axes)
