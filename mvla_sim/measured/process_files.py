"""Files of a processed measurement: channel, image, pictures, exports and figures of merit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from mvla_sim.channel.components import Components
from mvla_sim.files import atomic_output
from mvla_sim.imaging.volumes import export_image
from mvla_sim.measured.process import Processed, ProcessSettings
from mvla_sim.pictures.file_pictures import draw_waterfall
from mvla_sim.plot.image_figures import plot_image, plot_measured
from mvla_sim.plot.style import save_figure
from mvla_sim.plot.volume_figure import plot_volume

__all__ = ["RESULT", "write_processed"]

RESULT = "result.json"


def write_processed(done: Processed, settings: ProcessSettings, folder: Path) -> list[Path]:
    """Write ``channel.nc``, ``image.nc``, pictures, the exports asked for and ``result.json``; return these files.

    ``settings`` are those it was made with. The folder must exist; raises OutputError where a file cannot be written.
    """
    done.channel.save(folder / "channel.nc")
    done.image.save(folder / "image.nc")
    written = [folder / "channel.nc", folder / "image.nc", *_draw(done, settings, folder)]
    shown = replace(done.image, occupied=done.occupied)  # also where only the truth could say which voxels those are
    written += [export_image(shown, folder / f"image.{suffix}") for suffix in settings.export]
    with atomic_output(folder / RESULT) as temporary:
        temporary.write_text(json.dumps(done.merit(), indent=1) + "\n", encoding="utf-8")
    return [*written, folder / RESULT]


def _draw(done: Processed, settings: ProcessSettings, folder: Path) -> list[Path]:
    outline = None if done.truth is None else done.truth.outline
    flat = done.image.grid.counts[2] == 1
    pictures = [folder / ("image.png" if flat else "volume.png")]
    if done.occupied is None:
        figure = plot_image(done.image)
    elif flat:
        figure = plot_measured(done.image, done.occupied, outline, done.box, settings.description)
    else:
        meshes = () if done.truth is None else [item.mesh for item in done.truth.objects]
        figure = plot_volume(done.image, done.occupied, meshes, settings.description)
    save_figure(figure, pictures[-1])
    if not isinstance(done.channel, Components):
        pictures.append(folder / "waterfall.png")
        draw_waterfall(done.channel, pictures[-1], settings.imaging)
    return pictures
