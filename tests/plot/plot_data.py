"""Small data for figures, and what every figure must satisfy."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from matplotlib.axes import Axes
from matplotlib.text import Text
from mpl_toolkits.mplot3d import Axes3D

from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.plot.style import PNG_DPI
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import Scene

SCENES = Path(__file__).parents[2] / "scenes"
SQUARE = shapely.box(-1, -1, 1, 1)
PIXEL = 1.0  # display units: positions are rounded to whole pixels when drawn


def make_grid(nx=8, ny=8, nz=1):
    return VoxelGrid((0.0, 0.0, 0.0), (nx, ny, nz), 0.5)


def make_image(grid, support=True, method="mvla-gr", scale=1.0, outline=SQUARE):
    rng = np.random.default_rng(1)
    score = (scale * rng.random(grid.shape)).astype(np.float32)
    angle = (90 * rng.random(grid.shape)).astype(np.float32)
    return Image(score, angle if support else None, grid, method, 12, outline=outline)


def make_masks(grid):
    rng = np.random.default_rng(2)
    return rng.random(grid.shape) < 0.4, rng.random(grid.shape) < 0.4


def circle(angles_deg, radius=5.0):
    angles = np.deg2rad(angles_deg)
    positions = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return Views(positions, np.mod(angles_deg, 360.0), (0.0, 0.0))


def make_profiles(n_view, n_range=20):
    rng = np.random.default_rng(3)
    power = 1e-12 * rng.standard_normal((n_view, n_range))  # noise of zero mean goes below zero
    power[:, 7] = 1e-9 * (1 + np.arange(n_view))
    peaks = Peaks(np.full(n_view, 2.0 + 7 * 0.1), power[:, 7], np.ones(n_view, np.int64))
    return Pdp(power, None, 2.0, 0.1, 0.2, 1.5), peaks


def square_scene(*overrides):
    return Scene.load(SCENES / "square.toml", overrides)


def curve_table():
    return pd.DataFrame(
        [
            {"method": method, "snr": snr, "x": x, "y": -20.0 + x - snr / 10 - (method == "bp"), "lo": -25.0, "hi": 5.0}
            for method in ("mvla-gr", "bp")
            for snr in (20, 0, 10)
            for x in (30, 1, 5, 10)
        ]
    )


VIEWS = circle(np.arange(0, 360, 30))
PROFILES, PEAKS = make_profiles(12)


def drawn_texts(figure):
    """Every text that is drawn: tick labels outside their axis exist, but are not."""
    hidden = set()
    for axes in figure.findobj(Axes):
        for axis in axes._axis_map.values():
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if not (axes.axison and axes.get_visible() and low - slack <= tick.get_loc() <= high + slack):
                    hidden |= {tick.label1, tick.label2}
            if not axes.axison:
                hidden.add(axis.label)
    return [text for text in figure.findobj(Text) if text.get_visible() and text.get_text() and text not in hidden]


def check_texts(figure):
    """Every text is inside the figure, and clear of the others and of all flat panels."""
    figure.set_dpi(PNG_DPI)
    figure.canvas.draw()
    boxes = [(text.get_text(), text.get_window_extent()) for text in drawn_texts(figure)]
    assert len(boxes) > 4
    width, height = figure.get_size_inches() * PNG_DPI
    for text, box in boxes:
        assert box.x0 >= -PIXEL, text
        assert box.y0 >= -PIXEL, text
        assert box.x1 <= width + PIXEL, text
        assert box.y1 <= height + PIXEL, text
    flat = [axes for axes in figure.findobj(Axes) if axes.axison and not isinstance(axes, Axes3D)]
    panels = [(f"panel {n}", axes.get_window_extent()) for n, axes in enumerate(flat)]
    for (one, a), (other, b) in [*itertools.combinations(boxes, 2), *itertools.product(boxes, panels)]:
        across = min(a.x1, b.x1) - max(a.x0, b.x0)
        along = min(a.y1, b.y1) - max(a.y0, b.y0)
        # two lines of a title may share the empty space above and below their letters, about a fifth of their height
        assert across <= PIXEL or along <= 0.2 * min(a.height, b.height), f"'{one}' over '{other}'"
