"""Run a design round by round: score every sample, keep the best share, and write one row a sample and round."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pandas as pd

from mvla_sim.cluster.interface import Cluster
from mvla_sim.errors import DataError
from mvla_sim.files import as_path, atomic_output, existing_file
from mvla_sim.progress import progress
from mvla_sim.sweep.case import Case, Once, Row, setting_columns
from mvla_sim.sweep.design import SAMPLE
from mvla_sim.sweep.design_plan import DesignPlan
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.sampling import DesignSample
from mvla_sim.sweep.scores import SCORE
from mvla_sim.sweep.session import RunResult, open_session, write_record
from mvla_sim.sweep.store import Store, identity
from mvla_sim.sweep.survey import Survey, survey_rows
from mvla_sim.sweep.table import build_table, write_table

__all__ = ["DESIGN", "DesignResult", "RoundState", "best_samples", "load_design", "run_design", "survey_design"]

DESIGN: Final = "design.csv"
"""One row a sample and round, in the experiment's folder."""
HEAD: Final = (SAMPLE, "round", "cases", "failed", "invalid", SCORE)


@dataclass(frozen=True, eq=False)
class DesignResult(RunResult):
    """What a run of a design leaves."""

    design: pd.DataFrame  # one row a sample and round; see `load_design`

    def __repr__(self) -> str:
        """One line: how many cases and samples there are."""
        samples = self.design[SAMPLE].nunique()
        return f"DesignResult({self.count('done')} of {len(self.table)} cases done, {samples} samples)"


@dataclass(frozen=True)
class RoundState:
    """What a round of a design would run."""

    samples: int
    known: bool  # whether it is known which samples these are; else as many others stand for them
    survey: Survey


@dataclass
class _Round:
    """A round that has begun: its cases, and the figures of the samples that are scored."""

    number: int
    samples: Sequence[DesignSample]
    plan: Plan
    figures: Mapping[str, Mapping[str, float]]


def run_design(
    plan: DesignPlan,
    folder: Path,
    *,
    workers: int | None = None,
    cluster: Cluster | None = None,
    fresh: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> DesignResult:
    """Run what is missing of a design, and write its tables.

    Parameters
    ----------
    plan
        The design.
    folder
        Where its store and tables are kept.
    workers, cluster, fresh
        Number of processes; or what runs the cases instead; discard what is stored. They change no number.
    tell
        Takes a line as each round begins and ends.

    Notes
    -----
    ``table.csv`` and ``table.parquet`` have the cases of all rounds, ``design.csv`` the samples of each. Of the
    settings they have those that differ between cases: axes, the sample's own and the round's; all others are in
    ``experiment.json``.

    Raises
    ------
    ConfigError, DataError, OutputError, RunInterruptedError
        As for any experiment. DataError also where the score's function fails for every sample, or no sample of a round
        has a score, so that none can be kept.
    """
    rounds: list[_Round] = []
    notes: list[str] = []
    with Store.open(folder, identity(plan.whole), fresh=fresh) as store:

        def write() -> tuple[pd.DataFrame, pd.DataFrame, list[Path]]:
            return _write(plan, rounds, store.rows(), folder)

        with open_session(store, folder, workers, cluster, lambda: write()[0]) as session:
            samples: Sequence[DesignSample] = plan.samples
            for number in range(plan.rounds):
                current = plan.plan_of(number, samples, sum(len(one.plan.cases) for one in rounds))
                rounds.append(_Round(number, samples, current, {}))
                title = f"round {number + 1} of {plan.rounds}"
                tell(f"{title}: {len(samples):,} samples, {len(current.cases):,} cases")
                session.run(current, f"{plan.experiment.name}, {title}")
                rounds[-1].figures, wrong = _figures(plan, rounds[-1], store.rows())
                notes += wrong
                samples = _kept(plan, rounds[-1])
                tell(_summary(plan, rounds[-1], samples))
                notes += _failures(rounds[-1], store.rows())
        table, design, files = write()
    return DesignResult(table, tuple(files), (*store.notes, *session.notes, *notes), design)


def survey_design(plan: DesignPlan, folder: Path, workers: int) -> list[RoundState]:
    """Find out what a run would do in each round, without doing it; raises as :func:`~mvla_sim.sweep.survey.survey`.

    Of rounds that depend on what is not computed yet the cases are at most so many, and the time is that of the first
    so many samples.
    """
    rows = Store.peek(folder, identity(plan.whole))
    states: list[RoundState] = []
    samples: Sequence[DesignSample] = plan.samples
    known, first = True, 0
    for number, count in enumerate(plan.counts):
        samples = samples[:count]
        current = plan.plan_of(number, samples, first)
        first += len(current.cases)
        states.append(RoundState(len(samples), known, survey_rows(current, rows, workers)))
        known = known and states[-1].survey.done == states[-1].survey.cases
        if known and number < plan.rounds - 1:
            one = _Round(number, samples, current, {})
            one.figures, _ = _figures(plan, one, rows)
            samples = _kept(plan, one)
    return states


def load_design(folder: str | os.PathLike[str]) -> pd.DataFrame:
    """Read what came of a design from its folder: one row a sample and round, in the order in which they were drawn.

    Columns are ``sample``, ``round`` (from 1; 0 for samples that cannot be run), ``cases`` and ``failed`` (their number
    in that round), ``invalid`` (why it cannot be run), the settings by the design's names, and ``score`` with the
    score's other figures in that round.

    Raises DataError: there is none, or it is no such table.
    """
    file = existing_file(as_path(folder) / DESIGN, "table of a design; run the experiment first")
    try:
        table = pd.read_csv(file, dtype={SAMPLE: str, "invalid": str}, low_memory=False)
    except (ValueError, UnicodeDecodeError) as error:  # pandas' own errors are ValueErrors
        raise DataError(f"{file}: not a readable table ({error})") from error
    if missing := [name for name in HEAD if name not in table]:
        raise DataError(f"{file}: not a table of a design; it lacks the column {missing[0]}")
    return table.assign(invalid=table["invalid"].fillna(""))


def best_samples(design: pd.DataFrame, count: int) -> pd.DataFrame:
    """The rows of the best samples in their last rounds: those of later rounds before others, then by their score."""
    last = design.sort_values("round", kind="stable").drop_duplicates(SAMPLE, keep="last")
    return last.sort_values(["round", SCORE], ascending=[False, True], na_position="last", kind="stable").head(count)


def _figures(plan: DesignPlan, one: _Round, rows: Mapping[str, Row]) -> tuple[dict[str, dict[str, float]], list[str]]:
    """What the score makes of each sample, and what went wrong with some; raises DataError where it did with all.

    A sample without a finished case has no score, and neither has one whose cases the score's function cannot take.
    """
    by_label: dict[str, list[Case]] = {sample.label: [] for sample in one.samples}
    for case in one.plan.cases:
        by_label[str(case.values[SAMPLE])].append(case)
    columns = _own_columns if plan.score.of_metric else setting_columns
    once, none = Once(), {SCORE: math.nan}
    figures: dict[str, dict[str, float]] = {}
    errors: list[DataError] = []
    with progress(f"{plan.experiment.name}, scores", len(by_label), "samples") as advance:
        for label, cases in by_label.items():
            finished = any(_status(rows, case) == "done" for case in cases)
            try:
                table = build_table(cases, _of(cases, rows), columns, once)
                figures[label] = plan.score.figures(table, label) if finished else none
            except DataError as error:
                figures[label] = none
                errors.append(error)
            advance(1)
    if errors and all(figures[label] is none for label in figures):
        raise errors[0]
    where = f"round {one.number + 1}: no score for {len(errors)} samples"
    return figures, [f"{where}; the first: {errors[0]}"] if errors else []


def _kept(plan: DesignPlan, one: _Round) -> list[DesignSample]:
    """The samples that go on to the next round, in their own order; those without a score never do."""
    if one.number == plan.rounds - 1:
        return []
    scores = {sample: one.figures[sample.label][SCORE] for sample in one.samples}
    ranked = sorted((sample for sample in one.samples if not math.isnan(scores[sample])), key=lambda s: scores[s])
    if not ranked:
        where = f"round {one.number + 1} of {plan.experiment.name}"
        raise DataError(f"{where}: no sample has a score, so none can be kept; see the errors in the table")
    chosen = set(ranked[: plan.counts[one.number + 1]])
    return [sample for sample in one.samples if sample in chosen]


def _summary(plan: DesignPlan, one: _Round, kept: Sequence[DesignSample]) -> str:
    scores = [figures[SCORE] for figures in one.figures.values()]
    best = min((score for score in scores if not math.isnan(score)), default=math.nan)
    on = f"; {len(kept):,} of {len(scores):,} go on" if kept else ""
    return f"round {one.number + 1} of {plan.rounds}: best {plan.score.name} {best:.4g}{on}"


def _failures(one: _Round, rows: Mapping[str, Row]) -> list[str]:
    failed = {str(case.values[SAMPLE]) for case in one.plan.cases if _status(rows, case) == "failed"}
    return [f"round {one.number + 1}: {len(failed)} samples have failed cases; scored without them"] if failed else []


def _status(rows: Mapping[str, Row], case: Case) -> str:
    return rows[case.key].status if case.key in rows else "missing"


def _of(cases: Sequence[Case], rows: Mapping[str, Row]) -> dict[str, Row]:
    return {case.key: rows[case.key] for case in cases if case.key in rows}


def _own_columns(case: Case, once: Once) -> dict[str, object]:
    """Columns of a case that differ between cases."""
    del once
    return dict(case.values)


def _write(
    plan: DesignPlan, rounds: Sequence[_Round], rows: Mapping[str, Row], folder: Path
) -> tuple[pd.DataFrame, pd.DataFrame, list[Path]]:
    """Write the tables of cases and samples, and the record of what made them."""
    cases = [case for one in rounds for case in one.plan.cases]
    table = build_table(cases, _of(cases, rows), _own_columns)
    write_record(plan.experiment, table, folder)
    design = _design_table(plan, rounds, rows)
    with atomic_output(folder / DESIGN) as temporary:
        design.to_csv(temporary, index=False, float_format="%.9g")
    return table, design, [*write_table(table, folder), folder / DESIGN]


def _design_table(plan: DesignPlan, rounds: Sequence[_Round], rows: Mapping[str, Row]) -> pd.DataFrame:
    settings = {
        sample.label: {key: math.nan if value is None else value for key, value in sample.values.items()}
        for sample in plan.every
    }
    reasons = {sample.label: why for sample, why in plan.invalid.items()}
    records: list[dict[str, object]] = []
    for sample in plan.every if not rounds else plan.invalid:
        head = {SAMPLE: sample.label, "round": 0, "cases": 0, "failed": 0, "invalid": reasons.get(sample.label, "")}
        records.append(head | settings[sample.label] | {SCORE: math.nan})
    for one in rounds:
        statuses: dict[str, list[str]] = {sample.label: [] for sample in one.samples}
        for case in one.plan.cases:
            statuses[str(case.values[SAMPLE])].append(_status(rows, case))
        for label, found in statuses.items():
            counts = {"round": one.number + 1, "cases": len(found), "failed": found.count("failed"), "invalid": ""}
            figures = one.figures.get(label, {})
            if taken := sorted({*HEAD[:-1], *plan.design.keys} & {*figures}):
                raise DataError(f"design.score = '{plan.score.name}': a figure cannot be called '{taken[0]}'")
            records.append({SAMPLE: label, **counts, **settings[label], SCORE: math.nan, **figures})
    order = {sample.label: place for place, sample in enumerate(plan.every)}
    return pd.DataFrame(records).sort_values([SAMPLE, "round"], key=lambda c: c.map(order) if c.name == SAMPLE else c,
                                             kind="stable", ignore_index=True)  # fmt: skip
