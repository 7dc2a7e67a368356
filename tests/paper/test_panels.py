"""Figures of the paper's experiments: what is drawn is what the table says."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest
import shapely

from mvla_sim.errors import DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.paper.panels import parameter_maps, plot_cd_panels, plot_examples, plot_parameter_maps
from mvla_sim.plot.style import save_figure


def star():
    rows = itertools.product((0.0, 20.0), (1.0, 5.0, 30.0), ("mvla-gr", "bp"), range(4))
    table = pd.DataFrame(rows, columns=["snr_db", "interval_deg", "method", "offset"])
    return table.assign(cd_db=-20 + table["interval_deg"] / 3 + table["offset"] - (table["method"] == "mvla-gr"))


def test_parameter_maps_mark_the_minimum_and_the_papers_point():
    grid = itertools.product(("circle", "square"), (0.3, 0.5, 0.7), (0.02, 0.04))
    table = pd.DataFrame(grid, columns=["scene", "kappa", "eta"])
    table["cd_db"] = np.where((table["kappa"] == 0.7) & (table["eta"] == 0.02), -30.0, -20.0)
    figure = plot_parameter_maps(table)
    panels = figure.axes[:3]
    assert [p.get_title().split(":")[0] for p in panels] == ["average", "circle", "square"]
    for panel in panels:
        marks = {(line.get_marker(), *line.get_xydata()[0]) for line in panel.lines}
        assert marks == {("o", 0.0, 2.0), ("x", 1.0, 1.0)}  # (column of η, row of κ)


def test_cd_panels_draw_means_over_offsets():
    figure = plot_cd_panels(star())
    assert [axes.get_title() for axes in figure.axes] == ["SNR 0 dB", "SNR 20 dB"]
    line = next(line for line in figure.axes[0].lines if line.get_label() == "BP")
    np.testing.assert_allclose(line.get_xydata(), [(i, -20 + i / 3 + 1.5) for i in (1.0, 5.0, 30.0)])


def test_one_panel_has_the_axes_of_all():
    both = plot_cd_panels(star())
    for snr in (0.0, 20.0):
        alone = plot_cd_panels(star(), only=snr)
        assert [axes.get_title() for axes in alone.axes] == [f"SNR {snr:g} dB"]
        assert alone.axes[0].get_ylim() == both.axes[0].get_ylim()
    with pytest.raises(DataError, match="no finite CD at 5 dB"):
        plot_cd_panels(star(), only=5.0)
    with pytest.raises(DataError, match="no finite CD"):
        plot_cd_panels(star().assign(cd_db=np.nan))


def parameter_table():
    grid = itertools.product(("circle", "square"), (0.3, 0.5, 0.7), (0.02, 0.04))
    table = pd.DataFrame(grid, columns=["scene", "kappa", "eta"])
    return table.assign(cd_db=-20 - table["kappa"] - 2 * (table["scene"] == "circle"))


def test_one_map_writes_its_values_on_the_colours_of_all():
    table = parameter_table()
    alone, limits = plot_parameter_maps(table, "square"), plot_parameter_maps(table).axes[0].images[0].get_clim()
    axes = alone.axes[0]
    assert axes.images[0].get_clim() == limits
    written = {text.get_position(): text.get_text() for text in axes.texts}
    assert len(written) == 6
    assert written[1, 2] == "−20.7"  # column η = 0.04, row κ = 0.7
    with pytest.raises(DataError, match="no map 'star'; there are average, circle, square"):
        plot_parameter_maps(table, "star")


@pytest.mark.parametrize("lost", [np.nan, -np.inf])
def test_a_cell_that_lacks_a_scene_has_no_average(lost):
    table = parameter_table()
    table.loc[(table["scene"] == "square") & (table["kappa"] == 0.7) & (table["eta"] == 0.04), "cd_db"] = lost
    maps = parameter_maps(table)
    assert np.isnan(maps["average"].loc[0.7, 0.04])
    assert maps["circle"].loc[0.7, 0.04] == pytest.approx(-22.7)
    assert int(maps["average"].isna().to_numpy().sum()) == 1
    assert np.isfinite(plot_parameter_maps(table).axes[0].images[0].get_clim()).all()
    with pytest.raises(DataError, match="no finite CD"):
        plot_parameter_maps(table.assign(cd_db=np.nan))


def test_infinite_distances_are_left_out_of_the_panels():
    table = star()
    table.loc[0, "cd_db"] = -np.inf
    line = plot_cd_panels(table).axes[0].lines[0]
    assert np.isfinite(line.get_ydata()).all()


def test_examples_are_a_panel_each(tmp_path):
    grid = VoxelGrid((0, 0, 0), (8, 8, 1), 0.5)
    image = Image(np.zeros(grid.shape, np.float32), None, grid, "bp", 3, outline=shapely.box(-1, -1, 1, 1))
    mask = np.zeros(grid.shape, bool)
    mask[0, 2, 3] = True
    figure = plot_examples([image] * 5, [mask] * 5, [mask] * 5, list("abcde"))
    assert [axes.get_title() for axes in figure.axes[:5]] == list("abcde")
    save_figure(figure, tmp_path / "examples.png")
    assert (tmp_path / "examples.png").stat().st_size > 5000
    with pytest.raises(DataError, match="equally many"):
        plot_examples([image], [], [mask], ["a"])
