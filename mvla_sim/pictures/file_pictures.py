"""Pictures from files, for ``mvla plot`` and ``mvla scene show``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.loading import CHANNEL_SCHEMAS, Channel, load_channel
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.evaluation.evaluate import EvaluationSettings, evaluate, ground_truth
from mvla_sim.evaluation.ground_truth import rasterize
from mvla_sim.evaluation.metrics import score
from mvla_sim.files import existing_file
from mvla_sim.grid import GridSettings, VoxelGrid
from mvla_sim.imaging.image import SCHEMA as IMAGE_SCHEMA
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.method import title_of
from mvla_sim.imaging.pipeline import observe
from mvla_sim.netcdf import schema_of
from mvla_sim.plot.drawing import view_count
from mvla_sim.plot.image_figures import plot_comparison, plot_image, score_caption
from mvla_sim.plot.scene_figures import plot_scene
from mvla_sim.plot.style import save_figure
from mvla_sim.plot.waterfall import plot_waterfall
from mvla_sim.scene.world import Scene

__all__ = ["draw", "draw_scene", "draw_waterfall", "truth_of"]


def draw(files: Sequence[Path], output: Path, overrides: Sequence[str]) -> None:
    """Draw one channel file, or image files side by side; DataError for other files, and for kinds that are mixed."""
    kinds = [schema_of(existing_file(file, "channel or image file")) for file in files]
    for file, kind in zip(files, kinds, strict=True):
        if kind not in (*CHANNEL_SCHEMAS, IMAGE_SCHEMA):
            allowed = ", ".join(map(repr, (*CHANNEL_SCHEMAS, IMAGE_SCHEMA)))
            raise DataError(f"{file}: schema is {kind!r}; allowed: {allowed}")
    channels = [file for file, kind in zip(files, kinds, strict=True) if kind in CHANNEL_SCHEMAS]
    if channels and len(files) == 1:
        draw_waterfall(load_channel(files[0]), output, imaging_settings(overrides))
    elif channels:
        raise DataError(f"{channels[0]}: give one CIR or other channel file alone, or image files only")
    elif overrides:
        raise ConfigError(f"{overrides[0]}: an image is drawn as it is; settings are those that it is made with")
    else:
        draw_images(files, output)


def draw_images(files: Sequence[Path], output: Path) -> None:
    """Draw images with the binary image inside them, or else with the best one, and say whose thresholds those are."""
    images = [Image.load(file) for file in files]
    try:
        shown = [_binary(image) for image in images if image.outline is not None]
    except DataError:  # the outline reaches out of the grid: a part of the target can be looked at, not scored
        if len(images) > 1:
            raise
        shown = []
    if len(shown) < len(images):
        if len(images) > 1:
            raise DataError(f"{files[0]}: images without an outline are drawn one at a time")
        save_figure(plot_image(images[0]), output)
        return
    truths, masks, captions = zip(*shown, strict=True)
    names = [f"{title_of(image.method)}, {view_count(image.n_view)}" for image in images]
    if len(images) == 1:
        title = "\n".join([names[0], captions[0].replace("\n", ", ")])
        save_figure(plot_image(images[0], truths[0], masks[0], title), output)
    else:
        save_figure(plot_comparison(images, truths, masks, names, captions=captions), output)


def _binary(image: Image) -> tuple[NDArray[np.bool_], NDArray[np.bool_], str]:
    """Truth, binary image, and the distance between those two with whose thresholds made it."""
    if image.occupied is None:
        found = evaluate(image)
        return found.truth, found.occupied, score_caption(found.cd_db, found.protocol)
    truth = ground_truth(image, EvaluationSettings())
    imaging = image.config.get("imaging")
    rule = imaging.get("threshold") if isinstance(imaging, dict) else None
    name = rule.get("rule", "given") if isinstance(rule, dict) else rule or "given"
    return truth, image.occupied, score_caption(score(truth, image.occupied, image.grid).cd_db, str(name))


def draw_waterfall(channel: Channel, output: Path, settings: ImagingSettings) -> None:
    """Draw PDPs against the view angle, with their peaks; DataError for components, which are no profiles."""
    seen = observe(channel, settings)
    if seen.front.pdp is None:
        raise DataError("this file holds ready-made components and no profiles; make an image of it and draw that")
    save_figure(plot_waterfall(seen.pdp, seen.views, seen.peaks), output)


def draw_scene(scene_file: str | Path, output: Path, overrides: Sequence[str]) -> None:
    """Draw a scene with the ground truth on the default grid, centred on the target."""
    scene = Scene.load(scene_file, overrides)
    save_figure(plot_scene(scene, *truth_of(scene, GridSettings())), output)


def truth_of(scene: Scene, settings: GridSettings) -> tuple[NDArray[np.bool_], VoxelGrid]:
    """Ground truth of a scene and its grid."""
    grid = VoxelGrid.from_settings(settings, scene.settings.plane_height_m)
    return rasterize(scene.outline, grid, "contour"), grid
