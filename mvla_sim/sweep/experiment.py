"""Settings of an experiment file: scenes, stage settings, and the axes that are swept."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import Field, field_validator, model_validator

from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import SHORT_NAMES, ImagingSettings
from mvla_sim.imaging.method import METHODS
from mvla_sim.imaging.methods.functions import names_a_file
from mvla_sim.imaging.reading import on_reading
from mvla_sim.scene.world import SceneSettings
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside
from mvla_sim.shipped import find

__all__ = [
    "ALL", "OFFSET", "AxisValue", "CalibrationSettings", "ExperimentSettings", "VariantSettings", "dotted_key",
    "load_experiment",
]  # fmt: skip

AxisValue = bool | int | float | str | None
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]*$")]

ALL = "all"
"""The value of the axis ``offset`` that stands for every offset of a case's interval."""

BLOCKS: Final[Mapping[str, type[Settings]]] = {
    "imaging": ImagingSettings,
    "evaluation": EvaluationSettings,
    "scene": SceneSettings,
}
"""Whose settings may be swept, by the first part of a dotted key."""

OFFSET = f"imaging.{SHORT_NAMES['offset']}"
"""The full dotted key of ``offset``."""


def dotted_key(axis: str) -> str | None:
    """Full dotted key of the setting that an axis names; None where it has the form of none.

    ``kappa``, ``mvla.kappa`` and ``imaging.mvla.kappa`` are one.
    """
    if axis in SHORT_NAMES:
        return f"imaging.{SHORT_NAMES[axis]}"
    block, _, rest = axis.partition(".")
    if block in BLOCKS:
        return axis if rest else None
    if axis in ("plane_height_m", "outline"):
        return f"scene.{axis}"
    return next((f"{owner}.{axis}" for owner, model in BLOCKS.items() if rest and block in model.model_fields), None)


class CalibrationSettings(Settings):
    """Thresholds taken from another experiment instead of this experiment's own ground truth.

    For each combination of the other experiment's axes that are not in ``over``, the rule ``averages`` takes the means
    of its optimal p and T_θ, as the paper does; the rule ``least-mean`` takes the one pair at which the mean of its CD
    in dB is least. Means are first over all its cases of one value of ``over``'s first name, then over these values, so
    that each interval weighs the same however many offsets it has. With ``scene`` in ``over`` they are means over
    scenes too, and ``scenes`` says of which: held-out calibration, where it is of others than this experiment's.
    """

    source: Name = Field(alias="from", description="name of the other experiment's folder, beside this one's")
    over: Annotated[tuple[str, ...], Field(min_length=1, description="axes that thresholds are averaged over")] = (
        "interval_deg",
        "offset",
        "seed",
    )
    rule: Literal["averages", "least-mean"] = Field(
        "averages", description="'least-mean' needs evaluation.threshold_map = true in the other experiment"
    )
    scenes: Annotated[tuple[str, ...], Field(min_length=1)] | None = Field(
        None, description="scenes of the other experiment whose thresholds count; by default all"
    )

    @field_validator("over")
    @classmethod
    def _check_over(cls, over: tuple[str, ...]) -> tuple[str, ...]:
        for name in over:
            if name != "scene" and dotted_key(name) is None:
                raise ValueError(f"'{name}' names no setting, so it is no axis")
        return over

    @model_validator(mode="after")
    def _check(self) -> CalibrationSettings:
        if self.scenes is not None and "scene" not in self.over:
            raise ValueError("scenes: needs 'scene' in over, for thresholds of other scenes are no scene's own")
        return self


class VariantSettings(Settings):
    """One departure from an experiment's settings, for sensitivity studies: a label and the settings that change."""

    label: Annotated[str, Field(min_length=1, description="name of the variant in the table")]
    set: dict[str, AxisValue] = Field(default_factory=dict, description="dotted key or short name: value")

    @field_validator("set")
    @classmethod
    def _check_set(cls, chosen: dict[str, AxisValue]) -> dict[str, AxisValue]:
        for key in chosen:
            if dotted_key(key) is None:
                raise ValueError(f"'{key}' names no setting; write imaging., evaluation. or scene. in front of it")
        return chosen


class ExperimentSettings(Settings):
    """One experiment file.

    An axis is a short name (``snr_db``, ``interval_deg``, ``offset``, ``seed``, ``method``, ``kappa``, ``eta``, …) or a
    dotted key that begins with ``imaging.``, ``evaluation.`` or ``scene.``; cases are the product of all axes.
    ``offset = "all"`` stands for every offset of a case's interval. With variants, the whole product is run for each.
    """

    name: Name = Field(description="of the results' folder")
    description: str = Field("", description="for readers of the file")
    scenes: tuple[str, ...] = Field((), description="scene files, which are traced")
    channels: tuple[str, ...] = Field((), description="channel files, as of mvla import")
    reading: str | None = Field(
        None, description="preset of what the paper leaves open: 'paper', 'physical', or a file"
    )
    truth: str | None = Field(None, description="scene file whose outline is the truth of channels that carry none")
    imaging: ImagingSettings = ImagingSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    calibration: CalibrationSettings | None = Field(None, description="thresholds from another experiment's table")
    axes: dict[str, tuple[AxisValue, ...]] = Field(
        default_factory=dict, description="lists of values by dotted key or short name; cases are their product"
    )
    variants: tuple[VariantSettings, ...] = Field((), description="or the name of a TOML file that lists them")
    show: tuple[dict[str, AxisValue], ...] = Field((), description="cases of which pictures are drawn, by axis value")

    @field_validator("axes")
    @classmethod
    def _check_axes(cls, axes: dict[str, tuple[AxisValue, ...]]) -> dict[str, tuple[AxisValue, ...]]:
        keys: dict[str, str] = {}
        for axis, values in axes.items():
            key = dotted_key(axis)
            if key is None:
                raise ValueError(
                    f"'{axis}' names no setting; allowed: {', '.join(sorted(SHORT_NAMES))}, or a dotted key that "
                    f"begins with imaging., evaluation. or scene."
                )
            if key in keys:
                raise ValueError(f"'{axis}' and '{keys[key]}' name the same setting")
            keys[key] = axis
            if not values:
                raise ValueError(f"'{axis}' is empty; give at least one value")
            seen: set[tuple[bool, AxisValue]] = set()
            for value in values:
                if (isinstance(value, bool), value) in seen:  # 1 and 1.0 are one value, 1 and true are not
                    raise ValueError(f"'{axis}' has {value!r} twice")
                seen.add((isinstance(value, bool), value))
            if key == OFFSET and ALL in values and len(values) > 1:
                raise ValueError(f"'{axis}' has '{ALL}' and other values; give one or the other")
        return axes

    @model_validator(mode="after")
    def _check(self) -> ExperimentSettings:
        if not (self.scenes or self.channels):
            raise ValueError("scenes: give a scene file at least, or channel files in channels")
        for wanted in self.show:
            for key in wanted:
                if key != "scene" and key not in self.axes:
                    allowed = ", ".join(["scene", *self.axes])
                    raise ValueError(f"show: '{key}' is no axis of this experiment; allowed: {allowed}")
        labels = [variant.label for variant in self.variants]
        for variant in self.variants:
            if labels.count(variant.label) > 1:
                raise ValueError(f"variants: the label '{variant.label}' is used twice")
            swept = {dotted_key(key) for key in variant.set} & {dotted_key(axis) for axis in self.axes}
            if swept:
                names = ", ".join(sorted(map(str, swept)))
                raise ValueError(f"variants: '{variant.label}' sets {names}, which is an axis")
        thresholds = [axis for axis in self.axes if axis.startswith("evaluation.threshold")]
        if self.calibration and (thresholds or self.evaluation.threshold is not None):
            given = f"axes.{thresholds[0]}" if thresholds else "evaluation.threshold"
            raise ValueError(f"calibration and {given} both give thresholds; keep one")
        return self


def _full_key(key: str) -> str:
    """Key in an experiment file of any name that a setting goes by."""
    return key if key.split(".", maxsplit=1)[0] in ExperimentSettings.model_fields else dotted_key(key) or key


def load_experiment(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> ExperimentSettings:
    """Read an experiment file, or one that comes with the package; scenes are files relative to it, or shipped ones.

    Raises
    ------
    DataError, ConfigError
        One line that names the file, the key, its value and what is allowed.
    """
    file = find("experiments", path)
    data: dict[str, Any] = apply_overrides(read_toml(file, "experiment file"), overrides, _full_key)
    if isinstance(data.get("scenes"), list):
        data["scenes"] = [str(find("scenes", s, file.parent)) if isinstance(s, str) else s for s in data["scenes"]]
    if isinstance(data.get("channels"), list):
        data["channels"] = [resolve_beside(c, file.parent) if isinstance(c, str) else c for c in data["channels"]]
    if isinstance(data.get("truth"), str):
        data["truth"] = str(find("scenes", data["truth"], file.parent))
    if isinstance(data.get("variants"), str):
        variants = resolve_beside(data["variants"], file.parent)
        data["variants"] = read_toml(variants, "file of variants").get("variants", [])
    if isinstance(data.get("axes"), dict):
        for name in data["axes"].get("method", ()):
            if isinstance(name, str) and names_a_file(name):
                METHODS.find(name)  # so that [imaging] may have its settings beside those of others
        data["axes"] = {
            key: [ALL] if value == ALL and dotted_key(key) == OFFSET else value for key, value in data["axes"].items()
        }
    if isinstance(data.get("reading"), str):
        if data["reading"].endswith(".toml"):
            data["reading"] = resolve_beside(data["reading"], file.parent)
        data = on_reading(data["reading"], data)
    return parse(ExperimentSettings, data, str(file))
