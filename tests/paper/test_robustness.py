"""Curves of robustness: what is drawn is what the table says."""

from __future__ import annotations

import io
import itertools

import numpy as np
import pandas as pd
import pytest

from mvla_sim.errors import DataError
from mvla_sim.paper.robustness import SWEPT, plot_robustness, robustness_curves
from mvla_sim.plot.style import save_figure

BLOCK = "imaging.impairments."
LEVELS = {
    "position_error_m": (1e-4, 1e-3, 1e-1),
    "timing_offset_s": (1e-10, 1e-9),
    "timing_jitter_s": (1e-10, 1e-9),
    "random_phase": (1.0,),
    "missing_share": (0.3, 0.9),
    "blocked_sector_deg": (30.0, 180.0),
    "clutter_paths": (3.0, 30.0),
}


def rows(scene="star"):
    """CD falls by 1 dB a step of strength from −20 dB, BP 5 dB worse; seeds are 0.5 dB apart."""
    for method, seed in itertools.product(("mvla-gr", "bp"), range(3)):
        for name, levels in ({"": (0.0,)} | LEVELS).items():
            for step, level in enumerate(levels, start=int(bool(name))):
                row = {"scene": scene, "method": method, "seed": seed, "status": "done"}
                row |= {BLOCK + other: 0.0 for other in LEVELS if other != "blocked_sector_deg"}
                row |= {f"{BLOCK}blocked_sector_deg.0": 350.0, f"{BLOCK}blocked_sector_deg.1": 350.0}
                row[BLOCK + "random_phase"] = name == "random_phase"
                if name == "blocked_sector_deg":
                    row[f"{BLOCK}blocked_sector_deg.1"] = (350 + level) % 360
                elif name and name != "random_phase":
                    row[BLOCK + name] = level
                cd = -20 + step + 5 * (method == "bp") + 0.5 * seed
                yield row | {"cd_db": cd, "f1_10cm": -cd / 40}


def table():
    return pd.DataFrame(rows())


def test_curves_are_means_and_ranges_over_seeds_from_the_unimpaired_case_on():
    curves = robustness_curves(table())
    assert list(dict.fromkeys(curves["impairment"])) == list(SWEPT) == list(LEVELS)
    for (name, method), part in curves.groupby(["impairment", "method"]):
        assert part["strength"].tolist() == pytest.approx([0.0, *LEVELS[name]])
        middle = -20 + np.arange(len(part)) + 5 * (method == "bp") + 0.5
        np.testing.assert_allclose(part["cd_db"], middle)
        np.testing.assert_allclose(part["cd_db_low"], middle - 0.5)
        np.testing.assert_allclose(part["cd_db_high"], middle + 0.5)
        np.testing.assert_allclose(part["f1"], -middle / 40)


def test_two_impairments_at_once_are_no_point_of_either():
    both = table()
    both.loc[both[BLOCK + "missing_share"] > 0.5, BLOCK + "clutter_paths"] = 3.0
    part = robustness_curves(both)
    assert part[part["impairment"] == "missing_share"]["strength"].max() == pytest.approx(0.3)
    assert part[part["impairment"] == "clutter_paths"]["strength"].tolist() == [0.0, 3.0, 30.0] * 2


def test_absent_settings_and_tables_from_files_are_understood():
    """Where a block is at its defaults, a table has no value; a file holds words for truth values."""
    text = table().to_csv(index=False)
    pd.testing.assert_frame_equal(robustness_curves(pd.read_csv(io.StringIO(text))), robustness_curves(table()))
    bare = table()
    unimpaired = bare[[c for c in bare if c.startswith(BLOCK)]].apply(
        lambda row: not row[BLOCK + "random_phase"] and row.sum() == 700.0, axis=1
    )
    bare = bare.astype({BLOCK + "random_phase": object})
    bare.loc[unimpaired, [c for c in bare if c.startswith(BLOCK)]] = np.nan
    pd.testing.assert_frame_equal(robustness_curves(bare), robustness_curves(table()))
    few = table().drop(columns=[c for c in bare if c.startswith(BLOCK) and "missing" not in c])
    assert set(robustness_curves(few)["impairment"]) == {"missing_share"}


def test_cases_without_a_finite_cd_are_left_out():
    holes = table()
    holes.loc[holes["seed"] == 2, "cd_db"] = np.inf
    holes.loc[holes["seed"] == 1, "status"] = "failed"
    curves = robustness_curves(holes)
    np.testing.assert_allclose(curves["cd_db_low"], curves["cd_db_high"])


def test_a_panel_for_each_impairment_and_measure_a_line_a_method(tmp_path):
    figure = plot_robustness(table(), title="star")
    panels = {axes.get_xlabel(): axes for axes in figure.axes if axes.axison and axes.get_xlabel()}
    assert set(panels) == {kind.label for kind in SWEPT.values()}
    drawn = [axes for axes in figure.axes if axes.axison]
    assert len(drawn) == 2 * len(SWEPT)
    error = panels["position error (mm)"]
    assert error.get_xscale() == "log"
    dotted = [line for line in error.lines if line.get_linestyle() == ":"]
    assert [line.get_ydata()[0] for line in dotted] == pytest.approx([19.5 / 40, 14.5 / 40])  # unimpaired
    whole = [line for line in error.lines if line.get_linestyle() == "-"]
    assert whole[0].get_xdata() == pytest.approx([0.1, 1.0, 100.0])
    assert panels["missing views (%)"].lines[0].get_xdata() == pytest.approx([0, 30, 90])
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"MVLA-GR", "Backprojection"}
    save_figure(figure, tmp_path / "robustness.png")
    assert (tmp_path / "robustness.png").stat().st_size > 10_000


def test_one_impairment_alone_is_a_figure_too(tmp_path):
    few = table()
    few = few[(few[BLOCK + "missing_share"] > 0) | (few.index % 15 == 0)]
    save_figure(plot_robustness(few), tmp_path / "few.pdf")


@pytest.mark.parametrize(
    ("change", "arguments", "said"),
    [
        (lambda t: t.drop(columns="cd_db"), {}, "no column 'cd_db'"),
        (lambda t: t, {"f1": "f1_1cm"}, "no column 'f1_1cm'"),
        (lambda t: pd.concat([t, t.assign(scene="box")]), {}, "several scenes; give one of star, box"),
        (lambda t: t, {"scene": "box"}, "no scene 'box'; there are star"),
        (lambda t: t.assign(status="failed"), {}, "no finished case"),
        (lambda t: t.head(1), {}, "no finished case"),
    ],
)
def test_tables_without_what_is_needed_are_refused(change, arguments, said):
    with pytest.raises(DataError, match=said) as raised:
        plot_robustness(change(table()), **arguments)
    assert "\n" not in str(raised.value)


def test_a_scene_is_drawn_alone():
    two = pd.concat([table(), table().assign(scene="box", cd_db=-3.0)])
    pd.testing.assert_frame_equal(robustness_curves(two, scene="star"), robustness_curves(table()))
    assert set(robustness_curves(two, scene="box")["cd_db"]) == {-3.0}


@pytest.mark.parametrize("names", [1, 2, 7])
def test_the_legend_of_five_methods_fits_into_the_figure(names):
    """With few panels the figure is narrow; long titles then stand beneath each other instead of being cut off."""
    kept = list(LEVELS)[:names]
    part = table()
    part = part[[robust for robust in part if not robust.startswith(BLOCK) or robust.split(".")[2] in kept]]
    methods = ("mvla-gr", "mvla-em", "bp-normalised", "bp-coherent", "rpm")
    few = part[(part["method"] == "bp") & (part["seed"] == 0)].drop_duplicates(part.columns[part.columns != "cd_db"])
    figure = plot_robustness(pd.concat([few.assign(method=name) for name in methods]), scene="star")
    figure.draw_without_rendering()
    box, whole = figure.legends[0].get_window_extent(), figure.bbox
    assert whole.x0 <= box.x0
    assert box.x1 <= whole.x1
    assert len(figure.legends[0].get_texts()) == len(methods)
