"""Settings of an experiment file: scenes, stage settings, and the axes that are swept."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.method import METHODS
from mvla_sim.imaging.methods.functions import names_a_file
from mvla_sim.imaging.reading import on_reading
from mvla_sim.settings import Settings, apply_overrides, parse, read_toml, resolve_beside
from mvla_sim.shipped import find
from mvla_sim.sweep.axes import Axes, AxisValue, Name, PartSettings, dotted_key, shared
from mvla_sim.sweep.design import DesignSettings

__all__ = ["CalibrationSettings", "ExperimentSettings", "VariantSettings", "load_experiment"]


class CalibrationSettings(Settings):
    """Thresholds taken from another experiment instead of this experiment's own ground truth.

    For each combination of the other experiment's axes that are not in ``over``, the rule ``averages`` takes the means
    of its optimal p and T_θ, as the paper does; the rule ``least-mean`` takes the one pair at which the mean of its CD
    in dB is least. Means are first over all its cases of one value of ``over``'s first name, then over these values, so
    that each interval weighs the same however many offsets it has. With ``scene`` in ``over`` they are means over
    scenes too, and ``scenes`` says of which: held-out calibration, where it is of others than this experiment's.

    The paper takes "the average of their optimal values over different angular intervals", and does not say which these
    are. ``where`` says which values of an axis that is averaged over count, as ``where.interval_deg = [1, 5, 10, 30]``.
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
    where: dict[str, tuple[AxisValue, ...]] = Field(
        default_factory=dict, description="axis of over: the values whose cases count; by default all"
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
        averaged = {dotted_key(name) for name in self.over if name != "scene"}
        for axis, values in self.where.items():
            if dotted_key(axis) not in averaged:
                told = "; write scenes = [...]" if axis == "scene" else ""
                raise ValueError(f"where: '{axis}' is no axis of over, which is {', '.join(self.over)}{told}")
            if not values:
                raise ValueError(f"where: '{axis}' is empty; give at least one value")
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
    ``offset = "all"`` stands for every offset of a case's interval. With parts, the cases are the products of each
    part's scenes and axes. With variants, all that is run for each of them; with a design, for each of its samples.
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
    axes: Axes = Field(
        default_factory=dict, description="lists of values by dotted key or short name; cases are their product"
    )
    parts: tuple[PartSettings, ...] = Field((), description="parts with axes, and scenes, of their own")
    design: DesignSettings | None = Field(None, description="many settings varied at once, instead of variants")
    variants: tuple[VariantSettings, ...] = Field((), description="or the name of a TOML file that lists them")
    show: tuple[dict[str, AxisValue], ...] = Field((), description="cases of which pictures are drawn, by axis value")

    @model_validator(mode="after")
    def _check(self) -> ExperimentSettings:
        if not (self.scenes or self.channels) and not (self.parts and all(part.scenes for part in self.parts)):
            raise ValueError("scenes: give a scene file at least, or channel files in channels")
        self._check_parts(self.axes, self.parts, "parts")
        swept = [axis for _, axes in self.products() for axis in axes]
        for wanted in self.show:
            for key in wanted:
                if key not in ("scene", *swept):
                    allowed = ", ".join(dict.fromkeys(["scene", *swept]))
                    raise ValueError(f"show: '{key}' is no axis of this experiment; allowed: {allowed}")
        labels = [variant.label for variant in self.variants]
        for variant in self.variants:
            if labels.count(variant.label) > 1:
                raise ValueError(f"variants: the label '{variant.label}' is used twice")
            if taken := shared(variant.set, swept):
                raise ValueError(f"variants: '{variant.label}' sets {dotted_key(taken)}, which is an axis")
        if self.design is not None:
            self._check_design(self.design)
            swept += self.design.keys
        thresholds = [axis for axis in swept if axis.startswith("evaluation.threshold")]
        if self.calibration and (thresholds or self.evaluation.threshold is not None):
            given = f"axes.{thresholds[0]}" if thresholds else "evaluation.threshold"
            raise ValueError(f"calibration and {given} both give thresholds; keep one")
        return self

    def _check_parts(self, axes: Axes, parts: Sequence[PartSettings], where: str) -> None:
        names = [part.name or str(number) for number, part in enumerate(parts, 1)]
        for number, part in enumerate(parts):
            if names.count(names[number]) > 1:
                raise ValueError(f"{where}: the name '{names[number]}' is used twice")
            if not (part.scenes or self.scenes or self.channels):
                raise ValueError(f"{where}[{number}].scenes: give a scene file at least, for the experiment has none")
            if taken := shared(part.axes, axes):
                raise ValueError(f"{where}[{number}].axes: '{taken}' is an axis of all parts already")

    def _check_design(self, design: DesignSettings) -> None:
        if self.variants or self.show:
            which = "variants" if self.variants else "show"
            raise ValueError(f"{which} and design: an experiment with a design has no {which}; keep one")
        for number, one in enumerate(design.rounds):
            self._check_parts(one.axes or {}, one.parts or (), f"design.rounds[{number}].parts")
        for number in range(max(1, len(design.rounds))):
            whole = self.of_round(number)
            if not (whole.scenes or whole.channels) and not (whole.parts and all(part.scenes for part in whole.parts)):
                raise ValueError(f"design.rounds[{number}]: has no scenes; give its parts some")
            swept = [axis for _, axes in whole.products() for axis in axes]
            if taken := shared(design.keys, swept):
                raise ValueError(f"design: '{taken}' is a setting of the design, and an axis")
            if design.rounds and (taken := shared(design.rounds[number].overrides, swept)):
                raise ValueError(f"design.rounds[{number}].overrides: '{taken}' is an axis of that round")

    def products(self) -> Iterator[tuple[PartSettings | None, dict[str, tuple[AxisValue, ...]]]]:
        """Each part with all its axes, the shared ones first; without parts the axes alone."""
        if not self.parts:
            yield None, self.axes
        for part in self.parts:
            yield part, {**self.axes, **part.axes}

    def of_round(self, number: int) -> ExperimentSettings:
        """The experiment with the axes and parts of a round of its design, by number from 0, and no design."""
        rounds = self.design.rounds if self.design is not None else ()
        update: dict[str, Any] = {"design": None}
        if number < len(rounds) and (rounds[number].axes, rounds[number].parts) != (None, None):
            update |= {"axes": rounds[number].axes or {}, "parts": rounds[number].parts or ()}
        return self.model_copy(update=update)


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
    tables = [data, *_tables(data.get("parts")), *_tables(data.get("design"))]
    for one in _tables(data.get("design")):
        tables += [inner for each in _tables(one.get("rounds")) for inner in (each, *_tables(each.get("parts")))]
    for table in tables:
        if isinstance(table.get("scenes"), list):
            table["scenes"] = [
                str(find("scenes", s, file.parent)) if isinstance(s, str) else s for s in table["scenes"]
            ]
        _find_methods(table)
    if isinstance(data.get("channels"), list):
        data["channels"] = [resolve_beside(c, file.parent) if isinstance(c, str) else c for c in data["channels"]]
    if isinstance(data.get("truth"), str):
        data["truth"] = str(find("scenes", data["truth"], file.parent))
    if isinstance(data.get("variants"), str):
        variants = resolve_beside(data["variants"], file.parent)
        data["variants"] = read_toml(variants, "file of variants").get("variants", [])
    if isinstance(data.get("reading"), str):
        if data["reading"].endswith(".toml"):
            data["reading"] = resolve_beside(data["reading"], file.parent)
        data = on_reading(data["reading"], data)
    return parse(ExperimentSettings, data, str(file))


def _tables(data: Any) -> list[dict[str, Any]]:
    """The tables in a list, or the one table; nothing of anything else, which is refused later."""
    return [item for item in (data if isinstance(data, list) else [data]) if isinstance(item, dict)]


def _find_methods(table: dict[str, Any]) -> None:
    """Find methods of files that are swept, so that [imaging] may have their settings beside those of others."""
    for one in (*_tables(table.get("axes")), *_tables(table.get("settings")), *_tables(table.get("list"))):
        named = one.get("method")
        named = named.get("choices") if isinstance(named, dict) else named
        for name in named if isinstance(named, list) else [named]:
            if isinstance(name, str) and names_a_file(name):
                METHODS.find(name)
