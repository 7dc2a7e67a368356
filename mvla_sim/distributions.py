"""Settings that may be one value, or a distribution that a value is drawn from: an interval, or a list of choices."""

from __future__ import annotations

import json
import math
import operator
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    GetCoreSchemaHandler,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from mvla_sim.settings import Settings

__all__ = [
    "DECIMALS", "AnyChoice", "Choice", "Drawn", "Listed", "Real", "Spread", "TextChoice", "Uniform", "Weight", "Whole",
    "WholeChoice", "WholeUniform", "bounded", "draw", "value_at", "values_of", "weighted",
]  # fmt: skip

DECIMALS: Final = 6
"""Of the numbers that are drawn; of a :class:`Spread`, whose values may be tiny, significant digits."""
MOST_STEPS: Final = 1_000_000

Weight = Annotated[float, Field(gt=0, le=1e12)]
Weights = Annotated[tuple[Weight, ...] | None, Field(description="by default all choices are equally likely")]


class Uniform(Settings):
    """Any value from ``min`` to ``max``, all equally likely."""

    min: float
    max: float

    @model_validator(mode="after")
    def _check(self) -> Self:
        low, high = self.min, self.max
        if not low < high:
            raise ValueError(f"min = {low:g} must be below max = {high:g}; for one value write the number alone")
        if not math.isfinite(high - low):
            raise ValueError(f"min = {low:g} and max = {high:g} are too far apart")
        return self


class WholeUniform(Uniform):
    """Any whole number from ``min`` to ``max``, both included."""

    min: int
    max: int


class Choice(Settings):
    """One of the numbers listed."""

    choices: Annotated[tuple[float, ...], Field(min_length=1)]
    weights: Weights = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.weights is not None and len(self.weights) != len(self.choices):
            raise ValueError(f"weights has {len(self.weights)} entries for {len(self.choices)} choices")
        return self


class WholeChoice(Choice):
    """One of the whole numbers listed."""

    choices: Annotated[tuple[int, ...], Field(min_length=1)]


class TextChoice(Choice):
    """One of the texts listed."""

    choices: Annotated[tuple[str, ...], Field(min_length=1)]  # type: ignore[assignment]


class Spread(Uniform):
    """Any value from ``min`` to ``max``, evenly in the value or in its logarithm; with a step only whole steps.

    With a step all of ``min``, ``min + step`` … up to ``max`` are equally likely; whole numbers where all three are.
    """

    min: int | float
    max: int | float
    scale: Literal["linear", "log"] = "linear"
    step: Annotated[int | float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _check_scale(self) -> Self:
        if self.scale == "log" and self.step is not None:
            raise ValueError("scale = 'log' and step exclude each other")
        if self.scale == "log" and self.min <= 0:
            raise ValueError(f"min = {self.min:g} with scale = 'log': must be above 0")
        if self.step is not None and not 1 <= (self.max - self.min) / self.step <= MOST_STEPS:
            raise ValueError(f"step = {self.step:g} does not fit between min = {self.min:g} and max = {self.max:g}")
        return self

    def at(self, share: float) -> int | float:
        """The value below which a share of all lies."""
        if self.step is not None:
            count = math.floor((self.max - self.min) / self.step + 1e-9) + 1
            value = self.min + self.step * min(int(share * count), count - 1)
            return value if isinstance(value, int) else float(f"{value:.12g}")  # 0.3, not 0.30000000000000004
        if self.scale == "log":
            value = self.min * (self.max / self.min) ** share
        else:
            value = self.min + (self.max - self.min) * share
        return min(max(float(f"{value:.{DECIMALS}g}"), float(self.min)), float(self.max))


class AnyChoice(Choice):
    """One of the values listed: numbers, texts, true or false."""

    choices: Annotated[tuple[bool | int | float | str | None, ...], Field(min_length=1)]  # type: ignore[assignment]


class Drawn:
    """Annotation of a setting that is one value, or a table of a distribution: ``{min, max}`` or ``{choices}``."""

    def __init__(self, choice: type[Choice], uniform: type[Uniform] | None = None) -> None:
        self.choice = choice
        self.uniform = uniform

    def model_of(self, value: Any) -> type[Settings] | None:
        """The distribution that plain data are settings of; None for one value."""
        if not isinstance(value, dict):
            return None
        return self.choice if "choices" in value or self.uniform is None else self.uniform

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate a table as its distribution, and anything else as the type that is annotated."""

        def validated(value: Any, plain: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
            if isinstance(value, Uniform | Choice):
                return value
            model = self.model_of(value)
            if model is None:
                return plain(value)
            if info.mode == "json":
                return model.model_validate_json(json.dumps(value), strict=True)
            return model.model_validate(value)

        return core_schema.with_info_wrap_validator_function(
            validated, handler(source), serialization=core_schema.simple_ser_schema("any")
        )


Real = Annotated[float, Drawn(Choice, Uniform)]
"""A number, ``{min, max}`` or ``{choices}``."""

Listed = Annotated[float, Drawn(Choice)]
"""A number or ``{choices}``, where not every number of an interval is allowed."""

Whole = Annotated[int, Drawn(WholeChoice, WholeUniform)]
"""A whole number, or whole numbers to draw from."""


def values_of(distribution: Any) -> tuple[Any, ...]:
    """Every value of a fixed or listed distribution, and the two ends of a uniform one."""
    if isinstance(distribution, Choice):
        return distribution.choices
    if isinstance(distribution, Uniform):
        return distribution.min, distribution.max
    return (distribution,)


def draw(distribution: Any, random: np.random.Generator) -> Any:
    """A value of a distribution; one number is taken whatever its kind."""
    return value_at(distribution, random.random())


def value_at(distribution: Any, share: float) -> Any:
    """The value of a distribution at a share from 0 to 1 of its probability, lengths and angles to six decimals.

    It is the inverse of the cumulative distribution; choices have their weights' shares in the order of the list.
    Rounding makes the value the same on machines whose arithmetic differs in the last bit.
    """
    if isinstance(distribution, Spread):
        return distribution.at(share)
    if isinstance(distribution, WholeUniform):
        return min(distribution.min + int(share * (distribution.max - distribution.min + 1)), distribution.max)
    if isinstance(distribution, Uniform):
        value = round(distribution.min + (distribution.max - distribution.min) * share, DECIMALS)
        return min(max(value, distribution.min), distribution.max)
    if isinstance(distribution, Choice):
        choices = distribution.choices
        return choices[weighted(distribution.weights or (1.0,) * len(choices), share)]
    return distribution


def weighted(weights: Sequence[float], share: float) -> int:
    """Index at which the running share of the weights passes ``share``."""
    ends = np.cumsum(weights)
    return min(int(np.searchsorted(ends, share * ends[-1], side="right")), len(weights) - 1)


def bounded(
    *, above: float | None = None, least: float | None = None, below: float | None = None, most: float | None = None
) -> AfterValidator:
    """Validator of a distribution all of whose values must lie within bounds."""
    tests: tuple[tuple[float | None, str, Callable[[float, float], bool]], ...] = (
        (above, "above", operator.gt),
        (least, "at least", operator.ge),
        (below, "below", operator.lt),
        (most, "at most", operator.le),
    )
    given = [(bound, word, test) for bound, word, test in tests if bound is not None]
    allowed = " and ".join(f"{word} {bound:g}" for bound, word, _ in given)

    def check(distribution: Any) -> Any:
        for value in values_of(distribution):
            if not all(test(value, bound) for bound, _, test in given):
                raise ValueError(f"{value:g} is outside what is allowed: {allowed}")
        return distribution

    return AfterValidator(check)
