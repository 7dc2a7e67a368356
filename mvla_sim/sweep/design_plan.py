"""From a design to the cases of its rounds. Nothing is computed here; every sample is checked in every round."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mvla_sim.errors import ConfigError
from mvla_sim.sweep.case import Case
from mvla_sim.sweep.case_builder import CaseBuilder, Product
from mvla_sim.sweep.design import SAMPLE, DesignSettings
from mvla_sim.sweep.experiment import ExperimentSettings
from mvla_sim.sweep.plan import CASE_LIMIT, Plan, check_limit, products_of
from mvla_sim.sweep.sampling import DesignSample, draw_samples
from mvla_sim.sweep.scores import Score, find_score, metric_names

__all__ = ["DesignPlan", "plan_design"]


@dataclass(frozen=True, eq=False)
class DesignPlan:
    """The samples of a design, and the cases of its first round; those of others depend on what is kept."""

    experiment: ExperimentSettings
    design: DesignSettings
    every: tuple[DesignSample, ...]  # all that were drawn
    samples: tuple[DesignSample, ...]  # those that can be run
    invalid: Mapping[DesignSample, str]  # why the others cannot
    counts: tuple[int, ...]  # samples of each round
    score: Score
    cases: tuple[Case, ...]  # of the first round
    limit: int | None  # of the cases of a round
    builder: CaseBuilder = field(repr=False)

    @property
    def rounds(self) -> int:
        """Number of rounds."""
        return len(self.counts)

    @property
    def whole(self) -> Plan:
        """The plan as its store knows it: of all rounds' scenes."""
        return Plan(self.experiment, self.cases, self.builder.sources, self.builder.files)

    def plan_of(self, number: int, samples: Sequence[DesignSample], first: int = 0) -> Plan:
        """Cases of some samples in a round, by number from 0; they are numbered from ``first`` on.

        Raises
        ------
        ConfigError
            There are more than the limit, or settings exclude each other in a way that a check of single values does
            not show.
        """
        cases: list[Case] = list(self.cases) if number == 0 and len(samples) == len(self.samples) else []
        name = f"experiment {self.experiment.name}, round {number + 1}"
        for sample in samples if not cases else ():
            for product in _products(self.experiment, self.design, number, sample):
                cases += self.builder.cases(product, first + len(cases))
                check_limit(name, len(cases), "at least ", self.limit)
        return Plan(self.experiment, tuple(cases), self.builder.sources, self.builder.files)


def plan_design(
    experiment: ExperimentSettings, folder: Path | None = None, limit: int | None = CASE_LIMIT
) -> DesignPlan:
    """Draw the samples of an experiment's design and check all of them.

    Parameters are those of :func:`~mvla_sim.sweep.plan.expand`.

    Raises
    ------
    ConfigError
        As :func:`~mvla_sim.sweep.plan.expand`, of any sample in any round; there is no such score; a round keeps no
        sample, or may have more cases than ``limit``. Nothing has run by then.
    DataError
        A scene file, or the table to calibrate with, cannot be used.
    """
    design, name = experiment.design, f"experiment {experiment.name}"
    if design is None:
        raise ConfigError(f"{name}: has no design; see expand")
    samples = draw_samples(design)
    builder = CaseBuilder(experiment, folder)
    _check_counts(experiment, design, builder, samples, limit)
    cases: list[Case] = []
    valid: list[DesignSample] = []
    invalid: dict[DesignSample, str] = {}
    score: Score | None = None
    for sample in samples:
        try:
            own = _checked(experiment, design, builder, sample, len(cases))
        except ConfigError as error:
            invalid[sample] = _why(error, experiment, sample)
            continue
        valid.append(sample)
        cases += own
        check_limit(f"{name}, round 1", len(cases), "at least ", limit)
        score = score or find_score(design.score, metric_names(own[0].evaluation))
    if score is None or (invalid and design.invalid == "refuse"):
        sample, why = next(iter(invalid.items()))
        values = ", ".join(f"{key} = {'none' if value is None else value}" for key, value in sample.values.items())
        others = f" [the first of {len(invalid)} of {len(samples)} samples]" if len(invalid) > 1 else ""
        raise ConfigError(f"{name}: sample {sample.label} ({values}): {why}{others}")
    counts = _counts(experiment, design, len(valid))
    return DesignPlan(experiment, design, samples, tuple(valid), invalid, counts, score, tuple(cases), limit, builder)


def _checked(
    experiment: ExperimentSettings, design: DesignSettings, builder: CaseBuilder, sample: DesignSample, first: int
) -> list[Case]:
    """Check a sample in every round, and return its cases of the first."""
    cases: list[Case] = []
    for product in _products(experiment, design, 0, sample):
        cases += builder.cases(product, first + len(cases))
    for number in range(1, len(design.rounds)):
        for product in _products(experiment, design, number, sample):
            builder.check(product)
    return cases


def _counts(experiment: ExperimentSettings, design: DesignSettings, samples: int) -> tuple[int, ...]:
    try:
        return tuple(design.counts(samples))
    except ValueError as error:
        raise ConfigError(f"experiment {experiment.name}: design.{error}") from error


def _products(
    experiment: ExperimentSettings, design: DesignSettings, number: int, sample: DesignSample
) -> Iterator[Product]:
    """What a sample runs in a round."""
    overrides = design.rounds[number].overrides if design.rounds else {}
    labels = {"round": number + 1, SAMPLE: sample.label, **overrides, **sample.values}
    fixed = {**overrides, **sample.values}
    return products_of(experiment.of_round(number), _source(experiment, sample), fixed, labels)


def _check_counts(
    experiment: ExperimentSettings,
    design: DesignSettings,
    builder: CaseBuilder,
    samples: Sequence[DesignSample],
    limit: int | None,
) -> None:
    """Refuse rounds that are far too large, before any case is built."""
    for number, count in enumerate(_counts(experiment, design, len(samples))):
        least = sum(map(builder.least, _products(experiment, design, number, samples[0])))
        check_limit(f"experiment {experiment.name}, round {number + 1}", count * least, "at least ", limit)


def _source(experiment: ExperimentSettings, sample: DesignSample) -> str:
    return f"experiment {experiment.name}: sample {sample.label}"


def _why(error: ConfigError, experiment: ExperimentSettings, sample: DesignSample) -> str:
    """An error's message without what it says of the sample already."""
    text = str(error).removeprefix(_source(experiment, sample)).removeprefix(f"experiment {experiment.name}")
    return text.lstrip(".: ")
