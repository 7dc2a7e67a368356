"""All settings from a channel to an image, and the names they go by."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Final

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from mvla_sim.channel.impairments import ImpairmentSettings
from mvla_sim.errors import ConfigError
from mvla_sim.grid import GridSettings
from mvla_sim.imaging.beam import BeamSettings
from mvla_sim.imaging.detectors.local_maxima import LocalMaxima
from mvla_sim.imaging.likelihood import MvlaSettings
from mvla_sim.imaging.method import METHODS, Method
from mvla_sim.imaging.methods import functions
from mvla_sim.imaging.noise import NOISES, Noise
from mvla_sim.imaging.noises.gaussian import GaussianNoise
from mvla_sim.imaging.paths import PathSettings
from mvla_sim.imaging.pdp import PdpSettings
from mvla_sim.imaging.peaks import DETECTORS, PeakDetector
from mvla_sim.imaging.reading import on_reading
from mvla_sim.imaging.thresholds import THRESHOLD_RULES, ThresholdRule
from mvla_sim.imaging.view_selection import ViewSettings
from mvla_sim.settings import Settings, apply_overrides, assign, parse

__all__ = ["SHORT_NAMES", "ImagingSettings", "imaging_key", "imaging_settings"]

SHORT_NAMES: Final[Mapping[str, str]] = {
    "method": "method",
    "snr_db": "noise.snr_db",
    "seed": "noise.seed",
    "interval_deg": "views.interval_deg",
    "offset": "views.offset",
    "kappa": "mvla.kappa",
    "eta": "mvla.eta",
    "extent_m": "mvla.extent_m",
    "spacing_m": "grid.spacing_m",
    "threshold_sigma": "peaks.threshold_sigma",
}
"""Names that need no path: in ``imaging_settings``, with ``--set`` and as axes of an experiment."""


def _method_name(value: Any) -> Any:
    """A function by its name; a name if there is such a method."""
    if callable(value) and not isinstance(value, str):
        return functions.named(value)
    if isinstance(value, str):
        try:
            METHODS.find(value)
        except ConfigError as error:  # the key and the name are told anyway
            raise ValueError(str(error).removeprefix(f"method = '{value}': ")) from error
    return value


class ImagingSettings(Settings):
    """All settings of ``mvla image``.

    Beside the fields, each method of this package that has settings, and the chosen method, has a table of its own,
    as ``[imaging.carving]``; :attr:`chosen` is the method with its settings.
    """

    model_config = ConfigDict(extra="allow")

    method: Annotated[str, BeforeValidator(_method_name)] = Field(
        "mvla-gr", description="name of a method, or file.py:function"
    )
    grid: GridSettings = GridSettings()
    paths: PathSettings = PathSettings()
    pdp: PdpSettings = PdpSettings()
    noise: Annotated[Noise, NOISES] = GaussianNoise()
    peaks: Annotated[PeakDetector, DETECTORS] = LocalMaxima()
    mvla: MvlaSettings = MvlaSettings()
    views: ViewSettings = ViewSettings()
    beam: BeamSettings = BeamSettings()
    impairments: ImpairmentSettings = ImpairmentSettings()
    threshold: Annotated[ThresholdRule, THRESHOLD_RULES] | None = Field(
        None, description="also write the binary image at these: top_percent and min_support_deg, or 'auto'"
    )

    @model_validator(mode="after")
    def _check_blocks(self, info: ValidationInfo) -> ImagingSettings:
        """Validate the tables of methods, and add those that were not given at their defaults."""
        given = self.__pydantic_extra__ or {}
        blocks: dict[str, Any] = {}
        for key, value in given.items():
            model = METHODS.block(key, self.method)
            if model is None:
                _refuse(key, "extra_forbidden", "unknown key", value)
            elif isinstance(value, Method):
                blocks[key] = value
            elif not isinstance(value, dict):
                _refuse(key, "model_type", f"must be a table of settings of {model.name}", value)
            else:
                blocks[key] = _block(key, model, value, info)
        chosen = METHODS.find(self.method)
        for key, model in (*METHODS.tables().items(), (chosen.block_name(), chosen)):
            if key not in blocks and model.model_fields:
                blocks[key] = _block(key, model, {}, info)
        object.__setattr__(self, "__pydantic_extra__", dict(sorted(blocks.items())))
        return self

    @classmethod
    def model_of_extra(cls, key: str, data: Any) -> type[BaseModel] | None:
        """The method whose settings a table of another name than the fields' is, for messages."""
        try:
            return METHODS.block(key, str(data.get("method", "mvla-gr")))
        except ConfigError:
            return None

    @classmethod
    def extra_models(cls) -> dict[str, type[Method]]:
        """The methods that have settings, but for those of files, by the names of their tables."""
        return {method.block_name(): method for method in METHODS.installed() if method.model_fields}

    @property
    def chosen(self) -> Method:
        """The method with its settings."""
        cls = METHODS.find(self.method)
        own = (self.__pydantic_extra__ or {}).get(cls.block_name())
        if isinstance(own, cls):
            return own
        return cls() if own is None else cls(**own.model_dump())  # of a file that has changed since, or of no settings


def _block(key: str, model: type[Method], value: dict[str, Any], info: ValidationInfo) -> Method:
    """Validate a method's table; errors have its key in front."""
    try:
        if info.mode == "json":
            return model.model_validate_json(json.dumps(value), strict=True)
        return model.model_validate(value)
    except ValidationError as error:
        raise ValidationError.from_exception_data(
            key,
            [
                InitErrorDetails(
                    type=PydanticCustomError(item["type"], "{text}", {"text": item["msg"]}),
                    loc=(key, *item["loc"]),
                    input=item["input"],
                )
                for item in error.errors(include_url=False)
            ],
        ) from error


def _refuse(key: str, kind: str, text: str, value: Any) -> None:
    error = PydanticCustomError(kind, "{text}", {"text": text})
    raise ValidationError.from_exception_data(key, [InitErrorDetails(type=error, loc=(key,), input=value)])


def imaging_key(name: str) -> str:
    """Dotted key in :class:`ImagingSettings` of any name that a setting goes by.

    ``snr_db``, ``noise.snr_db`` and ``imaging.noise.snr_db`` are one.
    """
    own = name.removeprefix("imaging.")
    return SHORT_NAMES.get(own, own)


def imaging_settings(
    overrides: Sequence[str] = (),
    *,
    method: str | Callable[..., Any] | None = None,
    reading: str | None = None,
    **values: Any,
) -> ImagingSettings:
    """Build imaging settings from short names and dotted keys; everything else keeps its default.

    Parameters
    ----------
    overrides
        ``dotted.key=value`` texts, as with ``--set``.
    method
        Name of a method, ``file.py:function``, or a function.
    reading
        Name of a reading of the paper, whose settings take the place of the defaults: ``paper`` or ``physical``, or a
        file. What is set beside it wins, and a :class:`~mvla_sim.imaging.reading.ReadingWarning` says so.
    **values
        By short name, for example ``imaging_settings(method="bp", snr_db=20, interval_deg=5)``, or by the name of a
        whole block, ``imaging_settings(pdp={"window": "hamming"})`` or ``imaging_settings(noise=ExponentialNoise())``.

    Raises
    ------
    ConfigError
        An unknown name or a value that is not allowed.
    DataError
        There is no such reading.
    """
    data: dict[str, Any] = {}
    if method is not None:
        data["method"] = functions.named(method) if callable(method) else method
    for name, value in values.items():
        assign(data, imaging_key(name), "none" if value is None else value)
    data = apply_overrides(data, overrides, imaging_key)
    if reading is not None:
        data = on_reading(reading, {"imaging": data})["imaging"]
    return parse(ImagingSettings, data, "imaging settings")
