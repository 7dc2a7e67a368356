"""From measured data, or a scene, to an image, its binary result and figures of merit: settings and stages in order.

Settings come from one TOML file; :func:`mvla_sim.measured.process_files.write_processed` writes what came of it.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mvla_sim.channel.importing import ImportSettings, import_channel, resolve_files
from mvla_sim.channel.loading import Channel
from mvla_sim.channel.simulate import simulate
from mvla_sim.channel.synthesis import SynthesisSettings, synthesize, write_sweeps
from mvla_sim.errors import OutputError, check_argument
from mvla_sim.evaluation.boxes import Box, bounding_box, box_of_outline, largest_parts
from mvla_sim.evaluation.evaluate import Evaluation, EvaluationSettings, evaluate
from mvla_sim.files import as_path
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.scene.world import Scene
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml
from mvla_sim.shipped import find

__all__ = ["MeasurementSettings", "ProcessSettings", "Processed", "load_process", "process", "turn_between"]


SWEEPS = "sweeps"
"""Folder of a synthetic measurement's files, inside that of the results."""


class MeasurementSettings(SynthesisSettings):
    """A synthetic measurement: a scene is traced and written as a laboratory's files, from which all else is made."""

    scene: str = Field(description="a scene file, traced and written as a laboratory's files")


class ProcessSettings(Settings):
    """Where data come from, how they are imaged, and what they are compared with.

    Give one source: ``import`` (files of a laboratory or another program; with ``measurement`` they are made first) or
    ``scene`` (traced and imaged directly).
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]*$", description="of the results' folder")]
    description: str = Field("", description="title of the figures")
    measurement: MeasurementSettings | None = Field(
        None, description="synthetic measurement that makes the files first"
    )
    source: ImportSettings | None = Field(None, alias="import", description="as in mvla import")
    scene: str | None = Field(None, description="a scene file, traced and imaged without any file between")
    imaging: ImagingSettings = ImagingSettings()
    truth: str | None = Field(None, description="a scene file whose outline is drawn over and scored against")
    evaluation: EvaluationSettings = EvaluationSettings()
    smallest_part: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.02, description="connected parts below this share of the result are left out of its bounding box"
    )
    thinnest_m: Annotated[float, Field(ge=0)] = Field(
        0.25, description="parts of the true outline thinner than this, such as mirrors, are left out of its box"
    )
    export: tuple[Literal["vtk", "ply"], ...] = Field((), description="also write the image in these formats")

    @model_validator(mode="after")
    def _check(self) -> ProcessSettings:
        if (self.source is None) == (self.scene is None):
            raise ValueError("give either import or scene")
        if self.measurement is not None and self.source is None:
            raise ValueError("measurement needs import: it says how the files that are made are read")
        if "ply" in self.export and not self._finds_thresholds():
            raise ValueError("export: 'ply' is the surface of the binary result; give imaging.threshold")
        return self

    def _finds_thresholds(self) -> bool:
        """Whether there will be a binary result: at thresholds of the settings, or at the best against a truth."""
        compared = self.truth is not None and VoxelGrid.from_settings(self.imaging.grid).counts[2] == 1
        return compared or self.imaging.threshold is not None


def load_process(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> ProcessSettings:
    """Read the TOML file, or one that comes with the package.

    Names inside are relative to it, those of ``import`` after a ``measurement`` to its sweeps; scenes may be shipped
    ones.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    file = find("experiments", path)
    data: dict[str, Any] = apply_overrides(read_toml(file, "process file"), overrides)
    made, source = data.get("measurement"), data.get("import")
    for table, key in ((data, "scene"), (data, "truth"), (made, "scene")):
        if isinstance(table, dict) and isinstance(table.get(key), str):
            table[key] = str(find("scenes", table[key], file.parent))
    if isinstance(source, dict):
        if made is None:
            resolve_files(source, file.parent)
        else:
            source.setdefault("source", SWEEPS)
    return parse(ProcessSettings, data, str(file))


@dataclass(frozen=True, eq=False)
class Processed:
    """What came of a measurement.

    Attributes
    ----------
    channel
        The imported, or traced, data.
    image
        The image, with the binary result where thresholds were given or could be found.
    occupied
        That result, ``[nz, ny, nx]`` bool; None without thresholds and without a truth.
    evaluation
        Scores against the truth; None where there is none or the image has several layers.
    truth
        The scene of the true target; None where it is not known.
    box, truth_box
        Bounding boxes of the result without its small parts, and of the true outline.
    seconds
        Wall-clock time of each stage.
    """

    channel: Channel
    image: Image
    occupied: NDArray[np.bool_] | None
    evaluation: Evaluation | None
    truth: Scene | None
    box: Box | None
    truth_box: Box | None
    seconds: dict[str, float]

    def __repr__(self) -> str:
        """One line: the image, and how it compares with the truth."""
        score = "" if self.evaluation is None else f", CD {self.evaluation.cd_db:.1f} dB(m²)"
        return f"Processed({self.image.method}, {self.image.n_view} views, {self.image.grid.size} voxels{score})"

    def merit(self) -> dict[str, Any]:
        """Figures of merit as plain data: boxes, scores, thresholds and times."""
        figures: dict[str, Any] = {
            "views": self.image.n_view,
            "voxels": self.image.grid.size,
            "seconds": {name: round(value, 3) for name, value in self.seconds.items()},
        }
        for name, box in (("result", self.box), ("target", self.truth_box)):
            if box is not None:
                figures |= {f"{name}_{key}": value for key, value in _plain(box).items()}
        if self.box is not None and self.truth_box is not None:
            figures["orientation_error_deg"] = turn_between(self.box.orientation_deg, self.truth_box.orientation_deg)
        if self.evaluation is not None:
            figures |= self.evaluation.as_dict()
        return {key: _finite(value) for key, value in figures.items()}


def process(settings: ProcessSettings, folder: Path) -> Processed:
    """Run every stage.

    Parameters
    ----------
    settings
        Where data come from, how they are imaged, what they are compared with.
    folder
        Where a synthetic measurement puts its files; it must exist.

    Raises
    ------
    MvlaError
        As the stages do.
    """
    check_argument("settings", settings, ProcessSettings, "see load_process")
    folder = as_path(folder)
    seconds: dict[str, float] = {}
    if settings.scene is not None:
        with _timed(seconds, "tracing"):
            channel: Channel = simulate(Scene.load(settings.scene))
    else:
        assert settings.source is not None
        source = settings.source
        if settings.measurement is not None:
            with _timed(seconds, "measurement"):
                source = _measured(settings.measurement, source, folder)
        with _timed(seconds, "import"):
            channel = import_channel(source)
    truth = None if settings.truth is None else Scene.load(settings.truth)
    if truth is not None and channel.plane_height_m is None:
        channel = replace(channel, plane_height_m=truth.settings.plane_height_m)
    with _timed(seconds, "image"):
        image = reconstruct(channel, settings.imaging)
    evaluation = None
    occupied = image.occupied
    if truth is not None and image.grid.counts[2] == 1:
        with _timed(seconds, "evaluation"):
            image = replace(image, outline=truth.outline, plane_height_m=truth.settings.plane_height_m)
            chosen = settings.evaluation
            if chosen.threshold is None and settings.imaging.threshold is not None:
                chosen = chosen.model_copy(update={"threshold": settings.imaging.threshold})
            evaluation = evaluate(image, chosen)
        occupied = evaluation.occupied
    box = None
    if occupied is not None and occupied.any():
        box = bounding_box(largest_parts(occupied, settings.smallest_part), image.grid)
    truth_box = None if truth is None else box_of_outline(_without_thin_parts(truth.outline, settings.thinnest_m))
    return Processed(channel, image, occupied, evaluation, truth, box, truth_box, seconds)


def turn_between(one_deg: float, other_deg: float) -> float:
    """Angle between two undirected axes, 0 to 90 degrees."""
    return abs((one_deg - other_deg + 90) % 180 - 90)


def _without_thin_parts(outline: Any, thinnest_m: float) -> Any:
    """Outline, opened by a disc: what the disc does not fit into is gone; corners stay sharp."""
    opened = outline.buffer(-thinnest_m / 2, join_style="mitre").buffer(thinnest_m / 2, join_style="mitre")
    return outline if opened.is_empty else opened


def _measured(settings: MeasurementSettings, source: ImportSettings, folder: Path) -> ImportSettings:
    """Trace the scene, write a laboratory's files, and return import settings that point at them."""
    scene = Scene.load(settings.scene)
    campaign = synthesize(simulate(scene), settings)
    sweeps = folder / SWEEPS
    try:
        sweeps.mkdir(exist_ok=True)
        for old in sweeps.glob("*.s2p"):  # of an earlier run: views that no longer exist must not stay
            old.unlink()
    except OSError as error:
        raise OutputError(f"{sweeps}: cannot be made or emptied ({error.strerror or error})") from error
    angles = scene.settings.trajectory.angles_in_names(scene.views, f"{settings.scene}: trajectory")
    write_sweeps(campaign, sweeps, scene.name, angles)
    chosen = source.sweeps
    made = {name: part for name in ("background", "reference") if (part := getattr(chosen, name)) is not None}
    update = {name: part.model_copy(update={"file": str(sweeps / part.file)}) for name, part in made.items()}
    return source.model_copy(update={"source": str(sweeps), "sweeps": chosen.model_copy(update=update)})


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - began


def _plain(box: Box) -> dict[str, Any]:
    named = {name: getattr(box, name) for name in ("length_m", "width_m", "aspect", "orientation_deg")}
    return {**named, "center_m": list(box.center_m)}


def _finite(value: Any) -> Any:
    """JSON has no NaN and no infinity: they are told as text."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
