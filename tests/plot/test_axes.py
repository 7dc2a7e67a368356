"""Figures in notebooks and in other people's axes."""

from __future__ import annotations

import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from plot_data import PEAKS, PROFILES, VIEWS, curve_table, make_grid, make_image, make_masks, square_scene

from mvla_sim.errors import DataError
from mvla_sim.imaging.method import METHODS, title_of
from mvla_sim.plot.curves import plot_curves
from mvla_sim.plot.image_figures import plot_comparison, plot_image, plot_measured, score_caption
from mvla_sim.plot.scene_figures import plot_scene
from mvla_sim.plot.volume_figure import plot_volume
from mvla_sim.plot.waterfall import plot_waterfall

GRID = make_grid()
MASK = make_masks(GRID)[0]
IN_AXES = {
    "scene": lambda **more: plot_scene(square_scene(), MASK, GRID, **more),
    "waterfall": lambda **more: plot_waterfall(PROFILES, VIEWS, PEAKS, **more),
    "curves": lambda **more: plot_curves(curve_table(), "x", "y", "snr", style="method", **more),
}
IN_FIGURES = {
    "comparison": lambda **more: plot_comparison([make_image(GRID)], [MASK], [MASK], ["a"], **more),
    "measured": lambda **more: plot_measured(make_image(GRID), MASK, None, **more),
    "volume": lambda **more: plot_volume(make_image(make_grid(nz=3)), make_masks(make_grid(nz=3))[0], **more),
}


@pytest.mark.parametrize("name", IN_AXES)
def test_axes_that_are_given_are_drawn_into_and_returned(name):
    figure = Figure(layout="constrained")
    left, right = figure.subplots(1, 2)
    assert IN_AXES[name](ax=left) is left
    assert left.has_data()
    assert left.get_xlabel()
    assert not right.has_data()
    assert not figure.legends, "a legend of one panel stays in it"
    figure.canvas.draw()


def test_an_image_takes_axes_for_its_panels():
    figure = Figure(layout="constrained")
    axes = figure.subplots(1, 3)
    assert plot_image(make_image(GRID), MASK, MASK, axes=axes) is axes
    assert all(panel.images for panel in axes)
    figure.canvas.draw()
    with pytest.raises(DataError, match="3 axes; 2 are needed: Score, Angular support"):
        plot_image(make_image(GRID), axes=axes)


@pytest.mark.parametrize("name", IN_FIGURES)
def test_a_part_of_a_figure_is_drawn_into_and_returned(name):
    above, below = Figure(figsize=(8, 8)).subfigures(2, 1)
    assert IN_FIGURES[name](figure=above) is above
    assert above.axes
    assert not below.axes
    above.figure.canvas.draw()


@pytest.mark.parametrize("name", IN_AXES | IN_FIGURES)
def test_a_new_figure_shows_in_a_notebook(name):
    """By IPython's own formatter, as a fresh notebook has it: nothing was told to display figures inline."""
    formatter = pytest.importorskip("IPython.core.formatters").DisplayFormatter()
    data, metadata = formatter.format((IN_AXES | IN_FIGURES)[name]())
    assert data["image/png"].startswith(b"\x89PNG")
    assert 200 < metadata["image/png"]["width"] < 1000  # pixels


def test_no_window_is_needed(monkeypatch):
    code = (
        "import sys; sys.path.insert(0, 'tests/plot'); import mvla_sim as mv; from plot_data import *;"
        "mv.plot_image(make_image(make_grid()))._repr_png_(); assert 'matplotlib.pyplot' not in sys.modules"
    )
    monkeypatch.delenv("DISPLAY", raising=False)
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_users_style_is_untouched():
    before = dict(mpl.rcParams)
    IN_AXES["curves"]()._repr_png_()
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize("method", [*METHODS.names(), "lost.py:method"])
def test_scores_are_named_after_their_method(method):
    """In its own words, or by its title; a method that is nowhere to be found by its name."""
    figure = plot_image(make_image(GRID, method=method))
    labels = [axes.get_xlabel() for panel in figure.axes for axes in panel.child_axes]
    own = "" if method == "lost.py:method" else vars(METHODS.find(method)).get("score_label", "")
    assert (own or f"score of {title_of(method)}") in labels


@pytest.mark.parametrize(
    ("protocol", "words"),
    [("optimal", "best thresholds, found with the truth"), ("given", "given thresholds"),
     ("auto", "automatic thresholds"), ("otsu", "thresholds by otsu"), ("", "")],
)  # fmt: skip
def test_a_caption_says_whose_thresholds(protocol, words):
    assert score_caption(-12.34, protocol) == "CD = −12.3 dB(m²)" + ("\n" + words if words else "")
    assert score_caption(np.nan).startswith("CD undefined")
