"""From lists of values to cases: every distinct scene and block of settings is read, built and validated once."""

from __future__ import annotations

import functools
import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from mvla_sim.errors import ConfigError
from mvla_sim.evaluation.evaluate import EvaluationSettings
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.method import METHODS
from mvla_sim.imaging.view_selection import ViewSettings, select_views
from mvla_sim.scene.world import Scene, SceneSettings, load_scene
from mvla_sim.settings import assign, parse, with_nulls
from mvla_sim.sweep.axes import ALL, OFFSET, AxisValue, dotted_key
from mvla_sim.sweep.calibration import Calibration
from mvla_sim.sweep.case import Case, Once, case_key, setting_columns
from mvla_sim.sweep.experiment import ExperimentSettings
from mvla_sim.sweep.sources import Source, file_source, traced_source

__all__ = ["CaseBuilder", "Product"]

Values = Mapping[str, AxisValue]
Block = TypeVar("Block", bound=BaseModel)


@dataclass(frozen=True)
class Product:
    """Scenes and lists of values, of which every combination is a case."""

    source: str  # where it comes from, for messages
    axes: Mapping[str, tuple[AxisValue, ...]]
    scenes: tuple[str, ...] | None = None  # files; None for the experiment's scenes and channels
    fixed: Values = field(default_factory=dict)  # settings that all its cases have
    labels: Values = field(default_factory=dict)  # columns beside scene and axes, as of a variant

    @property
    def offset(self) -> str | None:
        """Name of the axis of offsets where it stands for all of them."""
        return next(
            (axis for axis, values in self.axes.items() if values == (ALL,) and dotted_key(axis) == OFFSET), None
        )


class CaseBuilder:
    """Builds the cases of products of one experiment's scenes and settings.

    Raises
    ------
    ConfigError, DataError
        A file cannot be used, or two have one name. :meth:`cases` raises them too.
    """

    def __init__(self, experiment: ExperimentSettings, folder: Path | None = None) -> None:
        self.experiment = experiment
        self.files: dict[str, SceneSettings] = {}
        """Settings of each scene file, by the scene's name, before any axis."""
        self.sources: dict[str, Source] = {}
        """Where each channel comes from, by its key."""
        self.once = Once()
        self._folder = folder or Path(experiment.name)
        self._names: dict[str, str] = {}  # of scenes, by their file
        self._of_files: dict[str, Source] = {}
        self._texts = {
            "imaging": experiment.imaging.model_dump_json(exclude_unset=True),
            "evaluation": experiment.evaluation.model_dump_json(exclude_unset=True),
        }
        self._made: dict[tuple[Any, ...], Any] = {}
        self._strides: dict[tuple[str, ViewSettings], int] = {}
        self._calibration: Calibration | None = None
        for file in experiment.scenes:
            self._name(file)
        truth = None if experiment.truth is None else Scene.load(experiment.truth)
        for file in experiment.channels:
            source = file_source(file, truth)
            if source.name in (*self.files, *self._of_files):
                raise ConfigError(f"{file}: '{source.name}' is also the name of another channel of this experiment")
            self._of_files[source.name] = source
            self.sources[source.key] = source

    def least(self, product: Product) -> int:
        """Number of cases of a product, at least: of each interval there may be several offsets."""
        scenes = self.experiment.scenes + self.experiment.channels if product.scenes is None else product.scenes
        return len(scenes) * math.prod(map(len, product.axes.values()))

    def cases(self, product: Product, number: int = 0) -> Iterator[Case]:
        """Every case of a product, numbered from ``number`` on; offsets run fastest where they are 'all'."""
        blocks = _Blocks(self, product)
        for name in self._scene_names(product):
            for combination in itertools.product(*product.axes.values()):
                values = dict(zip(product.axes, combination, strict=True))
                for one in self._offsets(blocks, name, values):
                    yield self._case(blocks, number, name, one)
                    number += 1

    def check(self, product: Product) -> None:
        """Validate a product without all its cases: each axis at each of its values, the others at their first."""
        blocks = _Blocks(self, product)
        first = {axis: values[0] for axis, values in product.axes.items()}
        points = [first, *(first | {axis: value} for axis, values in product.axes.items() for value in values[1:])]
        for name, values in itertools.product(self._scene_names(product), points):
            one = next(self._offsets(blocks, name, values))
            self._settings(blocks, one)

    def _scene_names(self, product: Product) -> list[str]:
        if product.scenes is not None:
            return [self._name(file) for file in product.scenes]
        return [*(self._name(file) for file in self.experiment.scenes), *self._of_files]

    def _name(self, file: str) -> str:
        """Read a scene file, unless that was done, and return the scene's name."""
        if file not in self._names:
            scene = load_scene(file)
            if scene.name in (*self.files, *self._of_files):
                raise ConfigError(f"{file}: name = '{scene.name}' is also the name of another scene of this experiment")
            self.files[scene.name] = scene
            self._names[file] = scene.name
        return self._names[file]

    def _offsets(self, blocks: _Blocks, name: str, values: Values) -> Iterator[Values]:
        """Values with each offset of their interval, where offsets are all; else these alone, if they fit the scene."""
        offset = blocks.product.offset
        first = values if offset is None else {**values, offset: 0}
        views = blocks.settings("imaging", ImagingSettings, first).views
        stride = self._stride(self._channel(blocks, name, first), views)
        if offset is None:
            yield values
        else:
            yield from ({**values, offset: number} for number in range(stride))

    def _settings(self, blocks: _Blocks, values: Values) -> tuple[ImagingSettings, EvaluationSettings]:
        """Settings of an image and its evaluation; refuses a scan whose bounds hold no voxel of the grid."""
        imaging = blocks.settings("imaging", ImagingSettings, values)
        evaluation = blocks.settings("evaluation", EvaluationSettings, values)
        if evaluation.scan.bounds_area:
            evaluation.scan.largest_count(VoxelGrid.from_settings(imaging.grid))
        return imaging, evaluation

    def _case(self, blocks: _Blocks, number: int, name: str, values: Values) -> Case:
        imaging, evaluation = self._settings(blocks, values)
        channel = self._channel(blocks, name, values)
        scene = None if name in self._of_files else blocks.scene(name, values)
        columns = {"scene": name, **blocks.product.labels, **values}
        if self.experiment.calibration is not None:
            if self._calibration is None:
                self._calibration = Calibration.load(self.experiment.calibration, self._folder)
            case = Case(number, scene, imaging, evaluation, channel, "", columns)
            thresholds = self._calibration.thresholds(setting_columns(case, self.once))
            evaluation = evaluation.model_copy(update={"threshold": thresholds})
        key = case_key(channel, imaging, evaluation, self.once)
        return Case(number, scene, imaging, evaluation, channel, key, columns)

    def _channel(self, blocks: _Blocks, name: str, values: Values) -> str:
        """Build the scene at these axis values, if it is new, and return the name of its channel."""
        if name in self._of_files:
            if chosen := blocks.chosen("scene", values):
                raise ConfigError(
                    f"{blocks.product.source}.{next(iter(chosen))}: the channel {name} is that of a file, not traced"
                )
            return self._of_files[name].key
        source = self.once(_traced, blocks.scene(name, values), name)
        self.sources.setdefault(source.key, source)
        return source.key

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

    def start(self, block: str, name: str) -> str:
        """Settings of a block before any axis, as JSON; of a scene those of its file."""
        return self.files[name].model_dump_json() if block == "scene" else self._texts[block]

    def built(self, block: str, model: type[Block], texts: Mapping[str, str], source: str) -> Block:
        """Settings of plain data, a JSON text each; validated where the same were not before."""
        place = (block, *texts.items())
        if place not in self._made:
            made = self._composed(texts) if model is ImagingSettings else None
            self._made[place] = made or parse(model, {key: json.loads(text) for key, text in texts.items()}, source)
        settings: Block = self._made[place]
        return settings

    def _composed(self, texts: Mapping[str, str]) -> ImagingSettings | None:
        """Imaging settings of parts that are validated already; None where something is wrong, which is then told."""
        try:
            parts = {key: self._part(key, text, texts.get("method")) for key, text in texts.items()}
            return ImagingSettings.model_validate(parts)
        except (ValidationError, ConfigError):
            return None

    def _part(self, key: str, text: str, method: str | None) -> Any:
        place = (key, text, method)
        if place not in self._made:
            self._made[place] = _validated_part(key, json.loads(text), method and json.loads(method))
        return self._made[place]


class _Blocks:
    """Blocks of settings at the axis values of one product."""

    def __init__(self, builder: CaseBuilder, product: Product) -> None:
        self.product = product
        self._builder = builder
        self._keys = {name: key for name in (*product.fixed, *product.axes) if (key := dotted_key(name)) is not None}
        self._places = {name: (*key.split(".")[:2],) for name, key in self._keys.items()}  # block, and part of it
        self._starts: dict[tuple[str, str], dict[str, str]] = {}  # each part as JSON, with what is fixed
        self._parts: dict[tuple[Any, ...], str] = {}  # the same at axis values
        self._chosen: dict[tuple[Any, ...], Any] = {}

    def chosen(self, block: str, values: Values) -> dict[str, AxisValue]:
        """What is set in a block: the fixed settings, and the axis values that belong to it."""
        return {
            name: value
            for name, value in (*self.product.fixed.items(), *values.items())
            if self._places[name][0] == block
        }

    def scene(self, name: str, values: Values) -> SceneSettings:
        """A scene at these axis values; that of its file where nothing of it is set."""
        if not self.chosen("scene", values):
            return self._builder.files[name]
        return self.settings("scene", SceneSettings, values, name)

    def settings(self, block: str, model: type[Block], values: Values, name: str = "") -> Block:
        """One block of settings at these axis values."""
        own = [(axis, value) for axis, value in values.items() if self._places[axis][0] == block]
        place = (block, name, *((axis, type(value), value) for axis, value in own))
        if place not in self._chosen:
            texts = dict(self._start(block, name))
            for part in dict.fromkeys(self._places[axis][1] for axis, _ in own):
                of_part = [(axis, value) for axis, value in own if self._places[axis][1] == part]
                texts[part] = self._part(block, name, part, of_part)
            self._chosen[place] = self._builder.built(block, model, texts, self.product.source)
        settings: Block = self._chosen[place]
        return settings

    def _part(self, block: str, name: str, part: str, values: list[tuple[str, AxisValue]]) -> str:
        """A part of a block with axis values in it, as JSON."""
        place = (block, name, part, *((axis, type(value), value) for axis, value in values))
        if place not in self._parts:
            start = self._start(block, name)
            data = {part: json.loads(start[part])} if part in start else {}
            for axis, value in values:
                self._assign(data, block, axis, value)
            self._parts[place] = json.dumps(data[part])
        return self._parts[place]

    def _start(self, block: str, name: str) -> dict[str, str]:
        if (block, name) not in self._starts:
            data = json.loads(self._builder.start(block, name))
            for key, value in self.product.fixed.items():
                if self._places[key][0] == block:
                    self._assign(data, block, key, value)
            self._starts[block, name] = {key: json.dumps(value) for key, value in data.items()}
        return self._starts[block, name]

    def _assign(self, data: dict[str, Any], block: str, name: str, value: AxisValue) -> None:
        """Set a value, as a TOML file would have it."""
        plain = "none" if value is None else value
        assign({block: data}, self._keys[name], plain, f"{self.product.source}.{name}")


def _traced(settings: SceneSettings, name: str) -> Source:
    return traced_source(Scene(settings, source=name))


def _validated_part(key: str, value: Any, method: Any) -> Any:
    """One table, or value, of imaging settings, validated as it is within them.

    Raises ValidationError or ConfigError: something is wrong with it.
    """
    if key == "method":
        return value
    if key in ImagingSettings.model_fields:
        adapter, annotated = _field(key)
        return adapter.validate_json(json.dumps(with_nulls(annotated, value)), strict=True)
    model = METHODS.block(key, str(method or ImagingSettings.model_fields["method"].default))
    if model is None:
        raise ConfigError(f"{key}: unknown key")
    return model.model_validate_json(json.dumps(with_nulls(model, value)), strict=True)


@functools.cache
def _field(key: str) -> tuple[TypeAdapter[Any], tuple[Any, Any]]:
    """What validates a field of imaging settings, and what is annotated about it."""
    field_info = ImagingSettings.model_fields[key]
    annotation: Any = field_info.annotation
    for item in field_info.metadata:
        annotation = Annotated[annotation, item]
    return TypeAdapter(annotation), (field_info.annotation, field_info.metadata)
