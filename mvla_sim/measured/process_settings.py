"""Settings of ``mvla process``: one TOML file from measured data, or from a scene, to an image and its judgement."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from mvla_sim.channel.readers.import_settings import ImportSettings, resolve_files
from mvla_sim.channel.synthesis_settings import SynthesisSettings
from mvla_sim.imaging.imaging_settings import EvaluationSettings, ImagingSettings
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside

__all__ = ["SWEEPS", "MeasurementSettings", "ProcessSettings", "load_process"]

SWEEPS = "sweeps"
"""Folder of a synthetic measurement's files, inside that of the results."""


class MeasurementSettings(SynthesisSettings):
    """A synthetic measurement: a scene is traced and written as a laboratory's files, from which all else is made."""

    scene: str


class ProcessSettings(Settings):
    """Where data come from, how they are imaged, and what they are compared with.

    Give one source: ``import`` (files of a laboratory or another program; with ``measurement`` they are made first) or
    ``scene`` (traced and imaged directly).
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]*$")]
    description: str = ""
    measurement: MeasurementSettings | None = None
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
        return self


def load_process(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> ProcessSettings:
    """Read the TOML file; names inside are relative to it, those of ``import`` after a ``measurement`` to its sweeps.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    data: dict[str, Any] = apply_overrides(read_toml(path, "process file"), overrides)
    folder = Path(path).parent
    for key in ("scene", "truth"):
        if isinstance(data.get(key), str):
            data[key] = resolve_beside(data[key], folder)
    made, source = data.get("measurement"), data.get("import")
    if isinstance(made, dict) and isinstance(made.get("scene"), str):
        made["scene"] = resolve_beside(made["scene"], folder)
    if isinstance(source, dict):
        if made is None:
            resolve_files(source, folder)
        else:
            source.setdefault("source", SWEEPS)
    return parse(ProcessSettings, data, str(path))
