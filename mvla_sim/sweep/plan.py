"""From an experiment's axes to its list of cases. Nothing is computed here; everything is checked."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from mvla_sim.errors import ConfigError
from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.view_selection import ViewSettings, select_views
from mvla_sim.scene.world import Scene, SceneSettings, load_scene
from mvla_sim.settings import assign, parse
from mvla_sim.sweep.calibration import Calibration
from mvla_sim.sweep.case import Case, case_key, setting_columns
from mvla_sim.sweep.experiment import ALL, OFFSET, AxisValue, ExperimentSettings, dotted_key
from mvla_sim.sweep.sources import Source, file_source, traced_source

__all__ = ["CASE_LIMIT", "Plan", "expand"]

CASE_LIMIT: Final = 20_000
"""Cases above which a run must be asked for on purpose."""

Values = Mapping[str, AxisValue]


@dataclass(frozen=True)
class Plan:
    """The cases of an experiment."""

    experiment: ExperimentSettings
    cases: tuple[Case, ...]  # by number
    sources: Mapping[str, Source]  # where each channel that the cases use comes from, by its key
    files: Mapping[str, SceneSettings]  # settings of each scene file, by the scene's name, before any axis

    @property
    def names(self) -> tuple[str, ...]:
        """Names of scenes and channel files, in the order of the plan."""
        return tuple(dict.fromkeys(str(case.values["scene"]) for case in self.cases))


def expand(experiment: ExperimentSettings, folder: Path | None = None, limit: int | None = CASE_LIMIT) -> Plan:
    """Return the product of scenes and axes, in the order of the file, every case validated.

    Experiments that calibrate with another one's table look beside ``folder``, where the results go.

    Raises
    ------
    ConfigError
        An axis names no setting, a value of it is not allowed, an offset or interval does not fit the scene's views,
        two scenes have one name, or there are more cases than ``limit``; nothing has run by then.
    DataError
        A scene file, or the table to calibrate with, cannot be used.
    """
    if experiment.variants:
        return _expand_variants(experiment, folder, limit)
    least = (len(experiment.scenes) + len(experiment.channels)) * math.prod(map(len, experiment.axes.values()))
    _check_limit(experiment, least, "at least ", limit)
    builder = _Builder(experiment)
    points = list(itertools.islice(builder.points(), limit))
    if len(points) == limit:
        _check_limit(experiment, sum(1 for _ in builder.points()), "", limit)
    calibration = None
    if experiment.calibration is not None:
        calibration = Calibration.load(experiment.calibration, folder or Path(experiment.name))
    cases = tuple(
        builder.case(number, name, channel, values, calibration)
        for number, (name, channel, values) in enumerate(points)
    )
    return Plan(experiment, cases, builder.sources, builder.files)


def _expand_variants(experiment: ExperimentSettings, folder: Path | None, limit: int | None) -> Plan:
    """Expand each variant as an experiment of its own, its settings as axes of one value, and join the plans."""
    cases: list[Case] = []
    sources: dict[str, Source] = {}
    files: Mapping[str, SceneSettings] = {}
    for variant in experiment.variants:
        axes = {**{key: (value,) for key, value in variant.set.items()}, **experiment.axes}
        plan = expand(experiment.model_copy(update={"axes": axes, "variants": ()}), folder, limit)
        for case in plan.cases:
            values = {"scene": case.values["scene"], "variant": variant.label}
            values |= {axis: value for axis, value in case.values.items() if axis not in variant.set}
            cases.append(replace(case, number=len(cases), values=values))
        sources |= plan.sources
        files = plan.files
        _check_limit(experiment, len(cases), "at least ", limit)
    return Plan(experiment, tuple(cases), sources, files)


def _check_limit(experiment: ExperimentSettings, count: int, more: str, limit: int | None) -> None:
    if limit is not None and count > limit:
        raise ConfigError(
            f"experiment {experiment.name}: {more}{count:,} cases; above {limit:,} shorten the axes, or lift the limit",
            setting="limit",
        )


class _Builder:
    """Builds each distinct scene and each distinct block of settings once."""

    def __init__(self, experiment: ExperimentSettings) -> None:
        self.experiment = experiment
        self.source = f"experiment {experiment.name}: axes"
        self.keys = {axis: key for axis in experiment.axes if (key := dotted_key(axis)) is not None}
        self.offset = next((axis for axis, key in self.keys.items() if key == OFFSET), None)
        self.all_offsets = self.offset is not None and experiment.axes[self.offset] == (ALL,)
        self.files: dict[str, SceneSettings] = {}
        self.sources: dict[str, Source] = {}
        self._of_files: dict[str, Source] = {}
        for file in experiment.scenes:
            scene = load_scene(file)
            if scene.name in self.files:
                raise ConfigError(f"{file}: name = '{scene.name}' is also the name of another scene of this experiment")
            self.files[scene.name] = scene
        truth = None if experiment.truth is None else Scene.load(experiment.truth).outline
        for file in experiment.channels:
            source = file_source(file, truth)
            if source.name in (*self.files, *self._of_files):
                raise ConfigError(f"{file}: '{source.name}' is also the name of another channel of this experiment")
            self._of_files[source.name] = source
            self.sources[source.key] = source
        self._blocks = {
            "imaging": experiment.imaging.model_dump_json(exclude_unset=True),
            "evaluation": experiment.evaluation.model_dump_json(exclude_unset=True),
        }
        self._channels: dict[tuple[Any, ...], str] = {}
        self._parsed: dict[tuple[Any, ...], Any] = {}
        self._strides: dict[tuple[str, ViewSettings], int] = {}

    def points(self) -> Iterator[tuple[str, str, Values]]:
        """Scene name, channel and axis values of each case; offsets run fastest where they are 'all'."""
        axes = self.experiment.axes
        for name in (*self.files, *self._of_files):
            for combination in itertools.product(*axes.values()):
                values = dict(zip(axes, combination, strict=True))
                channel = self.channel(name, values)
                stride = self._stride(channel, self._imaging(values).views)
                if not self.all_offsets:
                    yield name, channel, values
                    continue
                for offset in range(stride):
                    yield name, channel, values | {str(self.offset): offset}

    def channel(self, name: str, values: Values) -> str:
        """Build the scene at these axis values, if it is new, and return the name of its channel."""
        chosen = self._of("scene", values)
        if name in self._of_files:
            if chosen:
                raise ConfigError(
                    f"{self.source}.{next(iter(chosen))}: the channel {name} is that of a file, not traced"
                )
            return self._of_files[name].key
        place = (name, *chosen.items())
        if place not in self._channels:
            settings = self.files[name]
            if chosen:
                data = settings.model_dump(mode="json")
                for axis, value in chosen.items():
                    assign({"scene": data}, self.keys[axis], _plain(value), f"{self.source}.{axis}")
                settings = parse(SceneSettings, data, self.source)
            source = traced_source(Scene(settings, source=name))
            self._channels[place] = source.key
            self.sources.setdefault(source.key, source)
            self._parsed[place] = settings
        return self._channels[place]

    def case(self, number: int, name: str, channel: str, values: Values, calibration: Calibration | None) -> Case:
        """Put a case together."""
        imaging = self._imaging(values)
        if self.all_offsets:
            views = imaging.views.model_copy(update={"offset": values[str(self.offset)]})
            imaging = imaging.model_copy(update={"views": views})
        evaluation: EvaluationSettings = self._block("evaluation", EvaluationSettings, values)
        scene = self._parsed.get((name, *self._of("scene", values).items()))
        case = Case(number, scene, imaging, evaluation, channel, "", {"scene": name, **values})
        if calibration is not None:
            thresholds = calibration.thresholds(setting_columns(case))
            evaluation = evaluation.model_copy(update={"threshold": thresholds})
        return replace(case, evaluation=evaluation, key=case_key(channel, imaging, evaluation))

    def _imaging(self, values: Values) -> ImagingSettings:
        """Imaging settings at these axis values, at offset 0 where offsets are 'all'."""
        if self.all_offsets:
            values = {axis: value for axis, value in values.items() if axis != self.offset}
        settings: ImagingSettings = self._block("imaging", ImagingSettings, values)
        return settings

    def _of(self, block: str, values: Values) -> dict[str, AxisValue]:
        """The axis values that belong to a block of settings."""
        return {axis: value for axis, value in values.items() if self.keys[axis].startswith(f"{block}.")}

    def _block(self, block: str, model: type[Any], values: Values) -> Any:
        """One block of settings at these axis values, validated once."""
        chosen = self._of(block, values)
        place = (block, *((axis, type(value), value) for axis, value in chosen.items()))
        if place not in self._parsed:
            data = {block: json.loads(self._blocks[block])}  # quicker than a deep copy
            for axis, value in chosen.items():
                assign(data, self.keys[axis], _plain(value), f"{self.source}.{axis}")
            self._parsed[place] = parse(model, data[block], self.source)
        return self._parsed[place]

    def _stride(self, channel: str, views: ViewSettings) -> int:
        """Number of offsets of an interval; refuses interval and offset that the scene's views do not have."""
        place = (channel, views)
        if place not in self._strides:
            source = self.sources[channel]
            try:
                chosen = select_views(source.views, views)
            except ConfigError as error:
                raise ConfigError(f"experiment {self.experiment.name}: scene {source.name}: {error}") from error
            self._strides[place] = len(source.views) // len(chosen)
        return self._strides[place]


def _plain(value: AxisValue) -> AxisValue:
    """The value as a TOML file would have it."""
    return "none" if value is None else value
