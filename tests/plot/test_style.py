"""Files are right, repeatable, and never half-written; nobody else's matplotlib changes."""

from __future__ import annotations

import itertools
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from mvla_sim.errors import ConfigError, OutputError
from mvla_sim.plot.drawing import FALSE, HIT, MISS
from mvla_sim.plot.style import FIGURE_SUFFIXES, PNG_DPI, figure_style, new_figure, save_figure

HEADERS = {".png": b"\x89PNG\r\n\x1a\n", ".pdf": b"%PDF-", ".svg": b"<?xml"}


def simple_figure():
    with figure_style():
        figure = new_figure(2.0, 1.5)
        axes = figure.add_subplot()
        axes.plot([0, 1, 2], [1, 0, 2], label="Θ")
        axes.pcolormesh(np.arange(12.0).reshape(3, 4), rasterized=True)
        figure.legend(loc="outside upper center")
    return figure


@pytest.mark.parametrize("suffix", FIGURE_SUFFIXES)
def test_each_suffix_gives_its_format_and_the_same_bytes_every_time(tmp_path, suffix):
    one, other = tmp_path / f"one{suffix}", tmp_path / f"other{suffix}"
    save_figure(simple_figure(), one)
    with mpl.rc_context({"font.size": 20, "savefig.bbox": "tight", "axes.facecolor": "red"}):  # a user's own taste
        save_figure(simple_figure(), other)
    assert one.read_bytes().startswith(HEADERS[suffix])
    assert one.read_bytes() == other.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [one.name, other.name]


def test_png_has_the_declared_size_and_is_not_blank(tmp_path):
    save_figure(simple_figure(), tmp_path / "figure.PNG")
    pixels = imread(tmp_path / "figure.PNG", format="png")
    assert pixels.shape[:2] == (1.5 * PNG_DPI, 2.0 * PNG_DPI)
    assert np.ptp(pixels[..., :3]) > 0.5  # dark lines on white


@pytest.mark.parametrize("name", ["figure.jpg", "figure", "figure.png.txt", ".png"])
def test_other_suffixes_are_refused_before_anything_is_written(tmp_path, name):
    with pytest.raises(ConfigError, match=r"allowed: \.pdf, \.png, \.svg"):
        save_figure(simple_figure(), tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", FIGURE_SUFFIXES)
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, suffix):
    class Broken(mpl.lines.Line2D):
        def draw(self, *_):
            raise RuntimeError("cannot draw")

    target = tmp_path / f"figure{suffix}"
    target.write_bytes(b"old")
    figure = simple_figure()
    figure.add_artist(Broken([0, 1], [0, 1]))
    with pytest.raises(RuntimeError, match="cannot draw"):
        save_figure(figure, target)
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        save_figure(simple_figure(), tmp_path / "nowhere" / "figure.png")


def fail_inside_the_style():
    with figure_style():
        assert mpl.rcParams["pdf.fonttype"] == 42  # publishers refuse Type 3 fonts
        raise ZeroDivisionError


def test_the_style_is_gone_after_the_block():
    before = dict(mpl.rcParams)
    with pytest.raises(ZeroDivisionError):
        fail_inside_the_style()
    assert dict(mpl.rcParams) == before


def test_import_touches_no_global_state():
    code = (
        "import matplotlib as m; before = dict(m.rcParams); import sys, mvla_sim.plot.image_figures;"
        "assert 'matplotlib.pyplot' not in sys.modules; assert dict(m.rcParams) == before"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# Machado, Oliveira and Fernandes 2009, severity 1: what a viewer without one kind of cone sees, on linear RGB.
SIGHT = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
}


@pytest.mark.parametrize("sight", SIGHT)
def test_the_classes_of_a_binary_image_can_be_told_apart(sight):
    colors = np.array([to_rgb(color) for color in (HIT, FALSE, MISS, "white")])
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.transpose(SIGHT[sight]), 0, 1)
    seen = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    for one, other in itertools.combinations(seen, 2):
        assert np.abs(one - other).max() > 0.2  # 51 of 255 in some channel: several times what is just noticeable
