"""Every setting with its default and meaning, read from the models themselves."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from mvla_sim.channel.readers.import_settings import ImportSettings
from mvla_sim.channel.synthesis_settings import SynthesisSettings
from mvla_sim.imaging.imaging_settings import EvaluationSettings, ImagingSettings
from mvla_sim.scene.antenna_settings import Horn
from mvla_sim.scene.scene_settings import RadioSettings, RayTracingSettings

__all__ = ["Setting", "settings_of"]

Setting = tuple[str, str, str]
"""Dotted key, default and meaning, as text."""


def settings_of() -> dict[str, list[Setting]]:
    """Settings by what they are for: ``scene`` for ``simulate``, ``imaging`` for ``image``, and so on."""
    return {
        "scene": [
            *_walk(RadioSettings, "radio"),
            *list(_walk(Horn, "radio.antenna"))[1:],
            *_walk(RayTracingSettings, "ray_tracing"),
        ],
        "imaging": list(_walk(ImagingSettings, "")),
        "evaluation": list(_walk(EvaluationSettings, "")),
        "import": list(_walk(ImportSettings, "")),
        "synthesis": list(_walk(SynthesisSettings, "")),
    }


def _walk(model: type[BaseModel], path: str) -> Iterator[Setting]:
    for name, field in model.model_fields.items():
        key = f"{path}.{name}" if path else name
        inner = _model(field.annotation)
        if inner is not None and field.default is not None:
            yield from _walk(inner, key)
            continue
        if inner is not None:
            yield key, "none", field.description or ""
            yield from _walk(inner, key)
            continue
        yield key, _text(field.default), _meaning(field.annotation, field.description)


def _model(annotation: Any) -> type[BaseModel] | None:
    """The settings class of a field, also where the field may be absent."""
    candidates = [annotation, *typing.get_args(annotation)]
    return next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)


def _text(default: Any) -> str:
    if default is PydanticUndefined:
        return "required"
    if default is None:
        return "none"
    if isinstance(default, bool):
        return str(default).lower()
    return str(list(default)) if isinstance(default, tuple) else str(default)


def _meaning(annotation: Any, description: str | None) -> str:
    choices = [str(c) for c in typing.get_args(annotation)] if typing.get_origin(annotation) is typing.Literal else []
    return "; ".join(part for part in (description, " | ".join(choices)) if part)
