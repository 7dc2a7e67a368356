"""``mvla run``, ``reproduce`` and ``report``: experiments, and the paper's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table

from mvla_sim.cli.options import CacheUrl, Overrides, Scheduler, Workers, duration, note, say, show, wrote

if TYPE_CHECKING:
    from mvla_sim.sweep.design_plan import DesignPlan
    from mvla_sim.sweep.design_run import DesignResult, RoundState
    from mvla_sim.sweep.experiment import ExperimentSettings
    from mvla_sim.sweep.plan import Plan
    from mvla_sim.sweep.session import RunResult
    from mvla_sim.sweep.survey import Survey

__all__ = ["sweep_app"]

sweep_app = typer.Typer()

MOST_ROWS: Final = 40
"""Longer tables are not printed."""
FIRST_ERRORS: Final = 3
BEST: Final = 10
"""Samples of a design that are printed."""
HEADS: Final = {"cd_db": "CD dB(m²)", "top_percent": "p %", "min_support_deg": "T_θ °", "f1_10cm": "F1 10 cm"}

ResultsFolder = Annotated[Path, typer.Option("--output", "-o", help="Folder of the results.")]


@sweep_app.command()
def run(
    experiment: Annotated[
        str, typer.Argument(help="An experiment file (TOML), or the name of one that comes along: star-optimal.")
    ],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder; default results/NAME.")] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would run, and about how long, and stop.")
    ] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    cache_url: CacheUrl = None,
    yes: Annotated[bool, typer.Option("--yes", help="Run even very many cases.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard the cases stored in the folder.")] = False,
    overrides: Overrides = None,
) -> None:
    """Run the cases of an experiment that are not stored yet; write its table and pictures.

    An experiment with a design is run round by round, and the best of its samples are printed.

    Every finished case is stored at once, so a run can be stopped at any time and goes on when it is started again.
    Tables are written as CSV and as Parquet.
    """
    from mvla_sim.cluster.opening import open_cluster
    from mvla_sim.engine.cache import shared_cache
    from mvla_sim.engine.machine import core_count
    from mvla_sim.paper.ablation import draw_ablation
    from mvla_sim.paper.robustness import draw_robustness
    from mvla_sim.pictures.run_pictures import draw_run
    from mvla_sim.sweep.experiment import load_experiment
    from mvla_sim.sweep.plan import CASE_LIMIT, expand
    from mvla_sim.sweep.run import run_plan
    from mvla_sim.sweep.survey import survey

    settings = load_experiment(experiment, overrides or [])
    folder = output or Path("results") / settings.name
    limit = None if yes else CASE_LIMIT
    if settings.design is not None:
        with shared_cache(cache_url):
            raise typer.Exit(_run_design(settings, folder, limit, (workers, scheduler), dry_run=dry_run, fresh=fresh))
    plan = expand(settings, folder, limit)
    if dry_run:
        count = core_count() if workers is None else max(1, workers)
        _show_survey(plan, survey(plan, folder, count), count)
        return
    with shared_cache(cache_url), open_cluster(workers, scheduler, note) as cluster:
        result = run_plan(plan, folder, cluster=cluster, fresh=fresh)
        drawn = (draw(plan, result.table, folder) for draw in (draw_run, draw_robustness, draw_ablation))
        pictures = [file for files in drawn for file in files]
    raise typer.Exit(_show_run(plan, result, pictures))


@sweep_app.command()
def reproduce(
    output: ResultsFolder = Path("results"),
    experiments: Annotated[
        Path | None, typer.Option(help="Folder with the experiment files; by default those that come along.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One noise seed.")] = False,
    reading: Annotated[
        list[str] | None, typer.Option(help="Reading of the paper; default paper and physical. May be repeated.")
    ] = None,
    fresh_seeds: Annotated[
        bool, typer.Option("--fresh-seeds", help="Judge readings on seeds they were not chosen with as well.")
    ] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    cache_url: CacheUrl = None,
) -> None:
    """Run the paper's experiments under each reading, unless they are stored; judge its claims, write the report."""
    from mvla_sim.cli.measured_commands import show_processed
    from mvla_sim.cluster.opening import open_cluster
    from mvla_sim.engine.cache import shared_cache
    from mvla_sim.paper.reading_sections import READINGS
    from mvla_sim.paper.reproduce import MeasurementStep, RunStep
    from mvla_sim.paper.reproduce import reproduce as steps

    code = 0
    with shared_cache(cache_url), open_cluster(workers, scheduler, note) as cluster:
        for step in steps(
            experiments, output, cluster=cluster, quick=quick, readings=reading or READINGS, fresh_seeds=fresh_seeds
        ):
            if isinstance(step, RunStep):
                code = max(code, _show_run(step.plan, step.result, step.pictures))
            elif isinstance(step, MeasurementStep):
                show_processed(step.name, step.done, step.files)
            else:
                wrote(step, what="report")
    raise typer.Exit(code)


@sweep_app.command()
def report(output: ResultsFolder = Path("results")) -> None:
    """Build figures, claims and the report page from stored results."""
    from mvla_sim.paper.report import write_report

    say(str(write_report(output)))


def _run_design(
    settings: ExperimentSettings,
    folder: Path,
    limit: int | None,
    workers: tuple[int | None, str | None],
    *,
    dry_run: bool,
    fresh: bool,
) -> int:
    """Run a design, or say what would run, and return the exit code."""
    from mvla_sim.cluster.opening import open_cluster
    from mvla_sim.engine.machine import core_count
    from mvla_sim.sweep.design_plan import plan_design
    from mvla_sim.sweep.design_run import run_design, survey_design

    plan = plan_design(settings, folder, limit)
    drawn = f"{len(plan.every):,} samples of {len(plan.design.keys)} settings"
    say(f"{settings.name}: {drawn}" + (f", of which {len(plan.invalid):,} cannot be run" if plan.invalid else ""))
    if dry_run:
        count = core_count() if workers[0] is None else max(1, workers[0])
        _show_rounds(plan, survey_design(plan, folder, count), count)
        return 0
    with open_cluster(*workers, note) as cluster:
        result = run_design(plan, folder, cluster=cluster, fresh=fresh, tell=say)
    for text in result.notes:
        note(f"note: {text}")
    _show_best(plan, result)
    return _show_end(result, ())


def _show_rounds(plan: DesignPlan, rounds: Sequence[RoundState], workers: int) -> None:
    """Print what each round of a design would run, and about how long it takes."""
    columns = ("round", "samples", "cases", "stored", f"time with {workers} workers")
    table = Table(*columns, title=plan.experiment.name)
    for number, one in enumerate(rounds, 1):
        found, most = one.survey, "" if one.known else "at most "
        stored = f"{found.done:,}" if one.known else ""
        table.add_row(
            str(number), f"{one.samples:,}", f"{most}{found.cases:,}", stored, f"about {duration(found.seconds)}"
        )
    show(table)
    missing = {channel.scene: channel.views for one in rounds for channel in one.survey.channels if not channel.cached}
    for scene, views in missing.items():
        say(f"CIRs:     {scene}: {views} views to trace")
    measured = all(one.survey.measured for one in rounds if one.known)
    basis = "from the time of stored cases" if measured else "a guess: nothing was measured yet"
    say(f"time:     about {duration(sum(one.survey.seconds for one in rounds))} ({basis})")


def _show_best(plan: DesignPlan, result: DesignResult) -> None:
    """Print the best samples."""
    from mvla_sim.sweep.design_run import best_samples

    grid = Table("sample", "round", plan.design.score, "failed", "settings", title=f"{plan.experiment.name}: the best")
    for row in best_samples(result.design, BEST).to_dict("records"):
        values = ", ".join(f"{key} = {_text(row[key])}" for key in plan.design.keys)
        failed = f"{row['failed']} of {row['cases']}" if row["failed"] else ""
        grid.add_row(row["sample"], str(row["round"]), _text(row["score"]), failed, values)
    show(grid)


def _show_survey(plan: Plan, found: Survey, workers: int) -> None:
    """Print what a run would do: cases by axis, what is stored and cached, and about how long it takes."""
    table = Table("axis", "values", "", title=plan.experiment.name)
    table.add_row("scene", str(len(plan.names)), ", ".join(plan.names))
    for number, (part, axes) in enumerate(plan.experiment.products(), 1):
        if part is not None:
            table.add_row(f"part {part.name or number}", "", "")
        for axis, values in axes.items():
            count = "" if values == ("all",) else str(len(values))
            table.add_row(axis, count, ", ".join("none" if value is None else str(value) for value in values))
    show(table)
    again = f", of which {found.failed} failed before" if found.failed else ""
    say(f"cases:    {found.cases}; {found.done} stored, {found.cases - found.done} to run{again}")
    say(f"CIRs:     {len(found.channels)} needed, {sum(channel.cached for channel in found.channels)} cached")
    for channel in found.channels:
        if not channel.cached:
            say(f"          {channel.scene}: {channel.views} views to trace")
    basis = "from the time of stored cases" if found.measured else "a guess: nothing was measured yet"
    say(f"time:     about {duration(found.seconds)} with {workers} workers ({basis})")


def _show_run(plan: Plan, result: RunResult, pictures: Sequence[Path]) -> int:
    """Print notes, the main columns and the files of a run; return its exit code, 1 where a case has no result."""
    for text in result.notes:
        note(f"note: {text}")
    _show_table(plan, result)
    return _show_end(result, pictures)


def _show_end(result: RunResult, pictures: Sequence[Path]) -> int:
    """Print the files of a run and what failed, and return its exit code."""
    wrote(*result.files, what="table")
    wrote(*pictures, what="picture")
    failed = result.table[result.table["status"] == "failed"]
    for row in failed.head(FIRST_ERRORS).to_dict("records"):
        note(f"case {row['case']} failed: {row['error']}")
    counts = [f"{n} {word}" for word in ("failed", "missing") if (n := result.count(word))]
    if counts:
        note(f"error: of {len(result.table)} cases {' and '.join(counts)}; see the table")
    return int(bool(counts))


def _show_table(plan: Plan, result: RunResult) -> None:
    """Print the main columns, averaged over offsets and seeds, if that makes a short table; the CSV has them all."""
    from mvla_sim.sweep.table import AVERAGED, averaged

    table, name = result.table, plan.experiment.name
    labels = [name for name in ("variant", "part") if name in table]
    axes = ["scene", *labels, *(axis for axis in plan.swept if axis not in AVERAGED)]
    shown = averaged(table, axes)
    if len(shown) > MOST_ROWS or "cd_db" not in shown:
        say(f"{name}: {len(table)} cases")
        return
    columns = [*axes, "cases", *(key for key in HEADS if key in shown)]
    means = f": means over {' and '.join(a for a in AVERAGED if a in table)}" if len(table) > len(shown) else ""
    grid = Table(*(HEADS.get(key, key) for key in columns), title=name + means)
    for row in shown.to_dict("records"):
        grid.add_row(*(_text(row[key]) for key in columns))
    show(grid)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
