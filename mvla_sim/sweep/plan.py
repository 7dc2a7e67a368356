"""From an experiment's axes to its list of cases. Nothing is computed here; everything is checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mvla_sim.errors import ConfigError
from mvla_sim.scene.world import SceneSettings
from mvla_sim.sweep.axes import AxisValue
from mvla_sim.sweep.case import Case
from mvla_sim.sweep.case_builder import CaseBuilder, Product
from mvla_sim.sweep.experiment import ExperimentSettings
from mvla_sim.sweep.sources import Source

__all__ = ["CASE_LIMIT", "Plan", "check_limit", "expand", "products_of"]

CASE_LIMIT: Final = 20_000
"""Cases above which a run must be asked for on purpose."""


@dataclass(frozen=True)
class Plan:
    """The cases of an experiment."""

    experiment: ExperimentSettings
    cases: tuple[Case, ...]  # by number
    sources: Mapping[str, Source]  # where each channel that the cases use comes from, by its key
    files: Mapping[str, SceneSettings]  # settings of each scene file, by the scene's name, before any axis

    @property
    def swept(self) -> tuple[str, ...]:
        """Names of all axes, of any part."""
        return tuple(dict.fromkeys(axis for _, axes in self.experiment.products() for axis in axes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of scenes and channel files, in the order of the plan."""
        return tuple(dict.fromkeys(str(case.values["scene"]) for case in self.cases))


def expand(experiment: ExperimentSettings, folder: Path | None = None, limit: int | None = CASE_LIMIT) -> Plan:
    """Return the product of scenes and axes, in the order of the file, every case validated.

    With parts there is a product each, with variants all of it for each of them. Experiments that calibrate with
    another one's table look beside ``folder``, where the results go.

    Raises
    ------
    ConfigError
        An axis names no setting, a value of it is not allowed, an offset or interval does not fit the scene's views,
        two scenes have one name, or there are more cases than ``limit``; nothing has run by then. Or the experiment has
        a design; see :func:`~mvla_sim.sweep.design_plan.plan_design`.
    DataError
        A scene file, or the table to calibrate with, cannot be used.
    """
    name = f"experiment {experiment.name}"
    if experiment.design is not None:
        raise ConfigError(f"{name}: has a design, whose cases are planned round by round; see plan_design")
    builder = CaseBuilder(experiment, folder)
    products: list[Product] = []
    for variant in experiment.variants:
        labels, source = {"variant": variant.label}, f"{name}: variant '{variant.label}'"
        products += products_of(experiment, source, variant.set, labels)
    products = products or list(products_of(experiment, f"{name}: axes"))
    check_limit(name, sum(map(builder.least, products)), "at least ", limit)
    cases: list[Case] = []
    for product in products:
        for case in builder.cases(product, len(cases)):
            cases.append(case)
            check_limit(name, len(cases), "at least ", limit)
    return Plan(experiment, tuple(cases), builder.sources, builder.files)


def products_of(
    experiment: ExperimentSettings,
    source: str,
    fixed: Mapping[str, AxisValue] | None = None,
    labels: Mapping[str, AxisValue] | None = None,
) -> Iterator[Product]:
    """One product for each part of an experiment, or the one of its axes; a part's name is one of the labels."""
    for number, (part, axes) in enumerate(experiment.products(), 1):
        own = {} if part is None else {"part": part.name or str(number)}
        yield Product(source, axes, part.scenes if part else None, fixed or {}, {**(labels or {}), **own})


def check_limit(name: str, count: int, more: str, limit: int | None) -> None:
    """Refuse more cases than a limit; ``more`` stands before their number."""
    if limit is not None and count > limit:
        raise ConfigError(
            f"{name}: {more}{count:,} cases; above {limit:,} shorten the axes, or lift the limit", setting="limit"
        )
