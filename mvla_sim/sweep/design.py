"""Settings of a design: many settings varied at once, each combination of them run over an experiment's axes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, NonNegativeInt, PositiveInt, field_validator, model_validator

from mvla_sim.distributions import AnyChoice, Drawn, Spread
from mvla_sim.settings import Settings
from mvla_sim.sweep.axes import Axes, AxisValue, PartSettings, check_keys, shared

__all__ = ["SAMPLE", "DesignSettings", "RoundSettings"]

SAMPLE = "sample"
"""Key of a listed sample's name, and the column of it."""

MOST_SAMPLES = 1_000_000
SPREAD, CHOICE = set(Spread.model_fields), set(AnyChoice.model_fields)


def _is_distribution(value: Any) -> Any:
    """Tell how distributions are written; what is wrong inside of one is told by itself."""
    if not isinstance(value, dict) or (
        {"min", "max"} <= value.keys() <= SPREAD or {"choices"} <= value.keys() <= CHOICE
    ):
        return value
    keys = ", ".join(value) or "nothing"
    raise ValueError(
        f"a table of {keys} is no distribution; write one value, {{ min, max }} with scale = 'log' or a step, or "
        f"{{ choices }} with or without weights"
    )


Distribution = Annotated[AxisValue, Drawn(AnyChoice, Spread), BeforeValidator(_is_distribution)]
"""One value, ``{min, max}`` with ``scale = "log"`` or a ``step``, or ``{choices}`` with or without ``weights``."""


class RoundSettings(Settings):
    """One round of a design: what every sample that is still in it runs, and how many of them go on to the next."""

    keep: Annotated[float, Field(gt=0, le=1)] | None = Field(
        None, description="share of this round's samples that goes on to the next, those of the lowest score"
    )
    keep_count: PositiveInt | None = Field(None, description="their number instead")
    axes: Axes | None = Field(None, description="instead of the experiment's axes and parts")
    parts: tuple[PartSettings, ...] | None = Field(None, description="instead of the experiment's axes and parts")
    overrides: dict[str, AxisValue] = Field(
        default_factory=dict, description="dotted key or short name: value, for this round alone"
    )

    @field_validator("overrides")
    @classmethod
    def _check_overrides(cls, overrides: dict[str, AxisValue]) -> dict[str, AxisValue]:
        check_keys(overrides)
        return overrides

    @model_validator(mode="after")
    def _check(self) -> RoundSettings:
        if self.keep is not None and self.keep_count is not None:
            raise ValueError("keep and keep_count both say how many go on; keep one")
        return self


class DesignSettings(Settings):
    """N samples of settings, drawn at once or listed; each is run over the experiment's axes and parts.

    A distribution is ``{ min = 0.1, max = 2.0 }``, with ``scale = "log"`` even in the logarithm and with ``step`` in
    whole steps from ``min``; or ``{ choices = ["hann", "rect"], weights = [2, 1] }``, as in campaigns. One value is
    the same for all samples. With ``draw = "sobol"`` the samples are scrambled Sobol points, which fill the space of
    all settings more evenly than random ones do; the first of more samples are those of fewer. With ``draw = "list"``
    they are the tables ``[[design.list]]``, ``key = value``, all of the same keys; a key ``sample`` names them.

    Rounds are successive halving: all samples run the first round, those of the lowest score go on to the next, and so
    on, so that rounds may cost more and more. Cases that two rounds share are run once.

    The score of a sample is the mean of a metric over its finished cases, or what a function makes of them; see
    :mod:`mvla_sim.sweep.scores`.
    """

    samples: Annotated[int, Field(ge=1, le=MOST_SAMPLES)] | None = Field(
        None, description="number of samples; needed unless they are listed"
    )
    draw: Literal["sobol", "random", "list"] = Field("sobol", description="where the samples come from")
    seed: NonNegativeInt = Field(0, description="of the draw")
    score: Annotated[str, Field(min_length=1)] = Field(
        "cd_db", description="a metric, a score of an installed package, or file.py:function; lowest is best"
    )
    invalid: Literal["refuse", "skip"] = Field(
        "refuse", description="what to do with samples whose settings exclude each other"
    )
    settings: dict[str, Distribution] = Field(
        default_factory=dict, description="distributions by dotted key or short name"
    )
    listed: tuple[dict[str, AxisValue], ...] = Field((), alias="list", description="the samples, with draw = 'list'")
    rounds: tuple[RoundSettings, ...] = Field((), description="by default one, of the experiment's axes and parts")

    @field_validator("settings")
    @classmethod
    def _check_settings(cls, settings: dict[str, Any]) -> dict[str, Any]:
        check_keys(settings)
        return settings

    @field_validator("listed")
    @classmethod
    def _check_listed(cls, listed: tuple[dict[str, AxisValue], ...]) -> tuple[dict[str, AxisValue], ...]:
        for number, values in enumerate(listed):
            check_keys(key for key in values if key != SAMPLE)
            if different := sorted(set(values) ^ set(listed[0])):
                raise ValueError(
                    f"sample {number} and sample 0 differ in having '{different[0]}'; all need the same keys"
                )
        names = [str(values[SAMPLE]) for values in listed if SAMPLE in values]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two samples are named '{name}'")
        return listed

    @model_validator(mode="after")
    def _check(self) -> DesignSettings:
        if self.draw == "list":
            if not self.listed or not self.keys:
                raise ValueError("draw = 'list' needs at least one sample with a setting in list")
            if self.settings or self.samples not in (None, len(self.listed)):
                raise ValueError("draw = 'list' has its samples in list; leave samples and settings out")
        elif self.listed:
            raise ValueError(f"list is of draw = 'list', and draw = '{self.draw}'; keep one")
        elif self.samples is None:
            raise ValueError("samples: missing key; give the number of samples")
        elif not any(isinstance(value, Spread | AnyChoice) for value in self.settings.values()):
            raise ValueError("settings has no distribution; give at least one")
        for number, one in enumerate(self.rounds):
            if taken := shared(one.overrides, self.keys):
                raise ValueError(f"rounds[{number}].overrides: '{taken}' is a setting of the design")
            last, keeps = number == len(self.rounds) - 1, one.keep is not None or one.keep_count is not None
            if last and keeps:
                raise ValueError(f"rounds[{number}] is the last, so nothing is kept for a next one; leave keep out")
            if not last and not keeps:
                raise ValueError(f"rounds[{number}] needs keep or keep_count, for another round follows")
        if self.invalid == "refuse":
            tuple(self.counts(len(self.listed) or self.samples or 0))
        return self

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the settings that samples have values of."""
        return tuple(self.settings or (key for key in (self.listed[0] if self.listed else ()) if key != SAMPLE))

    def counts(self, samples: int) -> Iterator[int]:
        """Number of samples of each round, where so many begin.

        Raises
        ------
        ValueError
            A round keeps none.
        """
        yield samples
        for number, one in enumerate(self.rounds[:-1]):
            kept = int(samples * one.keep + 1e-9) if one.keep is not None else min(one.keep_count or 0, samples)
            if kept == 0:
                raise ValueError(f"rounds[{number}].keep = {one.keep:g} of {samples} samples keeps none")
            samples = kept
            yield samples
