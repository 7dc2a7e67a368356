"""Settings that may be one value, or a distribution that a value is drawn from: uniform, or a list of choices."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from mvla_sim.config.base import Settings
from mvla_sim.config.scene import ItuMaterial

__all__ = [
    "Choice", "Listed", "Material", "MaterialChoice", "Real", "Uniform", "Weight", "Whole", "WholeChoice",
    "WholeUniform", "bounded", "values_of",
]  # fmt: skip

Weight = Annotated[float, Field(gt=0, le=1e12)]
Weights = Annotated[tuple[Weight, ...] | None, Field(description="by default all choices are equally likely")]


class _UniformBase(Settings):
    @model_validator(mode="after")
    def _check(self) -> Any:
        low, high = self.min, self.max  # type: ignore[attr-defined]
        if not low < high:
            raise ValueError(f"min = {low:g} must be below max = {high:g}; for one value write the number alone")
        if not math.isfinite(high - low):
            raise ValueError(f"min = {low:g} and max = {high:g} are too far apart")
        return self


class _ChoiceBase(Settings):
    @model_validator(mode="after")
    def _check(self) -> Any:
        choices, weights = self.choices, self.weights  # type: ignore[attr-defined]
        if weights is not None and len(weights) != len(choices):
            raise ValueError(f"weights has {len(weights)} entries for {len(choices)} choices")
        return self


class Uniform(_UniformBase):
    """Any value from ``min`` to ``max``, all equally likely."""

    min: float
    max: float


class Choice(_ChoiceBase):
    """One of the numbers listed."""

    choices: Annotated[tuple[float, ...], Field(min_length=1)]
    weights: Weights = None


class WholeUniform(_UniformBase):
    """Any whole number from ``min`` to ``max``, both included."""

    min: int
    max: int


class WholeChoice(_ChoiceBase):
    """One of the whole numbers listed."""

    choices: Annotated[tuple[int, ...], Field(min_length=1)]
    weights: Weights = None


class MaterialChoice(_ChoiceBase):
    """One of the materials listed."""

    choices: Annotated[tuple[ItuMaterial, ...], Field(min_length=1)]
    weights: Weights = None


def _form(value: Any) -> str:
    """Which form of a distribution plain data has, so that messages speak of that form alone."""
    if isinstance(value, _ChoiceBase) or (isinstance(value, dict) and "choices" in value):
        return "choice"
    return "uniform" if isinstance(value, dict | _UniformBase) else "value"


def _choice_or_value(value: Any) -> str:
    return "choice" if isinstance(value, dict | _ChoiceBase) else "value"


# The tags' names are part of an error's location, of which base.describe drops a model's name and "literal[".
_FORM = {"value": "literal[value]"}


def _tagged(forms: dict[str, str], form: Callable[[Any], str]) -> Callable[[Any], str]:
    return lambda value: (_FORM | forms)[form(value)]


Real = Annotated[
    Annotated[float, Tag("literal[value]")] | Annotated[Uniform, Tag("Uniform")] | Annotated[Choice, Tag("Choice")],
    Discriminator(_tagged({"uniform": "Uniform", "choice": "Choice"}, _form)),
]
"""A number, ``{min, max}`` or ``{choices}``."""

Listed = Annotated[
    Annotated[float, Tag("literal[value]")] | Annotated[Choice, Tag("Choice")],
    Discriminator(_tagged({"choice": "Choice"}, _choice_or_value)),
]
"""A number or ``{choices}``, where not every number of an interval is allowed."""

Whole = Annotated[
    Annotated[int, Tag("literal[value]")]
    | Annotated[WholeUniform, Tag("WholeUniform")]
    | Annotated[WholeChoice, Tag("WholeChoice")],
    Discriminator(_tagged({"uniform": "WholeUniform", "choice": "WholeChoice"}, _form)),
]
"""A whole number, or whole numbers to draw from."""

Material = Annotated[
    Annotated[ItuMaterial, Tag("literal[value]")] | Annotated[MaterialChoice, Tag("MaterialChoice")],
    Discriminator(_tagged({"choice": "MaterialChoice"}, _choice_or_value)),
]
"""An ITU-R P.2040 name or ``{choices}`` of them."""


def values_of(distribution: Any) -> tuple[Any, ...]:
    """Every value of a fixed or listed distribution, and the two ends of a uniform one."""
    if isinstance(distribution, _ChoiceBase):
        return tuple(distribution.choices)  # type: ignore[attr-defined]
    if isinstance(distribution, _UniformBase):
        return distribution.min, distribution.max  # type: ignore[attr-defined]
    return (distribution,)


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
