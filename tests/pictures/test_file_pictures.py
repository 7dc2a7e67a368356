"""Pictures of files say what they show, and whose thresholds that is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from matplotlib.text import Text

import mvla_sim as mv
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.evaluation.evaluate import evaluate
from mvla_sim.evaluation.metrics import score
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.pictures import file_pictures
from mvla_sim.pictures.file_pictures import draw
from mvla_sim.plot.image_figures import score_caption

GRID = VoxelGrid((0.0, 0.0, 0.0), (40, 40, 1), 0.1)


def make_image(occupied=None, threshold=None, outline=True):
    """A bright ring about a square, so that the best thresholds are somewhere between; and other people's."""
    x, y, _ = GRID.centers().T
    ring = np.exp(-((np.maximum(abs(x), abs(y)) - 1) ** 2) / 0.02) + 0.3 * np.random.default_rng(1).random(x.size)
    config = {} if threshold is None else {"imaging": {"threshold": threshold}}
    square = shapely.box(-1, -1, 1, 1) if outline else None
    return Image(ring.reshape(GRID.shape).astype(np.float32), None, GRID, "bp", 12, occupied, square, config=config)


def few():
    """Forty voxels, much fewer than are best."""
    mask = np.zeros(GRID.shape, bool)
    mask.ravel()[np.argsort(-make_image().score.ravel())[:40]] = True
    return mask


@pytest.fixture
def texts(monkeypatch, tmp_path):
    """Draw images, and return all texts of the figure and the masks that it shows."""

    def shown(*images):
        figures = []
        monkeypatch.setattr(file_pictures, "save_figure", lambda figure, _: figures.append(figure))
        files = [tmp_path / f"{number}.nc" for number in range(len(images))]
        for image, file in zip(images, files, strict=True):
            image.save(file)
        draw(files, tmp_path / "figure.png", [])
        (figure,) = figures
        return " / ".join(text.get_text().replace("\n", ", ") for text in figure.findobj(Text))

    return shown


@pytest.mark.parametrize(
    ("threshold", "words"),
    [({"top_percent": 2.5}, "given thresholds"), ("auto", "automatic thresholds"),
     ({"rule": "auto"}, "automatic thresholds"), (None, "given thresholds")],
)  # fmt: skip
@pytest.mark.parametrize("count", [1, 2])
def test_the_distance_is_that_of_the_binary_image_that_is_drawn(texts, threshold, words, count):
    image = make_image(few(), threshold)
    best = evaluate(image)
    drawn = score(best.truth, few(), GRID).cd_db
    assert drawn > best.cd_db + 1  # dB: the two are told apart by the digit that is printed
    found = texts(*[image] * count)
    assert score_caption(drawn) in found
    assert score_caption(best.cd_db) not in found
    assert words in found
    assert "found with the truth" not in found


@pytest.mark.parametrize("count", [1, 2])
def test_without_a_binary_image_the_best_is_drawn_and_said_to_need_the_truth(texts, count):
    found = texts(*[make_image()] * count)
    assert score_caption(evaluate(make_image()).cd_db) in found
    assert "best thresholds, found with the truth" in found


def test_without_a_truth_there_is_no_distance(texts):
    found = texts(make_image(few(), outline=False))
    assert "CD" not in found
    with pytest.raises(DataError, match="one at a time"):
        texts(make_image(outline=False), make_image())


def test_a_target_that_reaches_out_of_the_grid_can_be_looked_at(texts):
    beyond = replace(make_image(few()), outline=shapely.box(-3, -1, 1, 1))
    assert "CD" not in texts(beyond)


def test_images_take_no_settings(tmp_path):
    make_image().save(tmp_path / "i.nc")
    with pytest.raises(ConfigError, match="as it is"):
        draw([tmp_path / "i.nc"], tmp_path / "f.png", ["grid.spacing_m=1"])


def test_public_plot_functions_are_there():
    for name in ("plot_scene", "plot_waterfall", "plot_image", "plot_comparison", "plot_curves", "save_figure"):
        assert getattr(mv, name).__doc__
