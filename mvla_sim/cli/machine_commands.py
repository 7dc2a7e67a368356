"""``mvla doctor``, ``settings`` and ``bench``: this machine, what can be set, and what it costs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from mvla_sim.cli.options import Reading, note, say, show, wrote

__all__ = ["machine_app"]

machine_app = typer.Typer()


@machine_app.command()
def doctor() -> None:
    """Check this machine: backend, libLLVM, packages, memory, and a one-ray smoke trace; 2 where it is unfit."""
    from mvla_sim.engine.doctor import collect

    facts = collect()
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column()
    for name, value in facts.rows:
        table.add_row(name, value)
    show(table)
    for problem in facts.problems:
        say(f"unfit: {problem}")
    if not facts.problems:
        say("This machine is fit.")
    raise typer.Exit(2 if facts.problems else 0)


@machine_app.command()
def settings(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[WORD]...", help="Only these: scene, imaging, …, a part of keys, or a method file.py:function."
        ),
    ] = None,
    reading: Reading = None,
) -> None:
    """List every setting with its default and meaning: all, a group, or those whose key has a word in it.

    With a reading, those that it may set, with the values it gives them.
    """
    from mvla_sim.listing import list_settings

    group = ""
    for entry in list_settings(*(words or ()), reading=reading):
        if entry.group != group:
            group = entry.group
            say(f"\n# {group}")
        value = f"{entry.key} = {entry.default}" if entry.default else f"{entry.key}  (required)"
        say(f"{value:<44}  # {entry.meaning}".rstrip(" #"))


@machine_app.command()
def bench(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for bench.json, bench.csv and bench.md.")
    ] = Path("results/bench"),
    quick: Annotated[bool, typer.Option("--quick", help="Few and small points; a minute and a half.")] = False,
    stage: Annotated[
        list[str] | None,
        typer.Option(
            help="tracing, projection, search or sweep; default all: the estimate needs them. May be repeated."
        ),
    ] = None,
    ratios: Annotated[
        bool,
        typer.Option("--ratios", help="Compare with plain NumPy, a plain PathSolver loop and BP instead: ratios.csv."),
    ] = False,
    scenes: Annotated[int, typer.Option(help="Of the estimate: scenes, each imaged once.")] = 1_000_000,
    views: Annotated[int, typer.Option(help="Of the estimate: views of a scene.")] = 360,
    nodes: Annotated[int, typer.Option(help="Of the estimate: nodes.")] = 64,
    cores: Annotated[int, typer.Option(help="Of the estimate: cores a node.")] = 32,
) -> None:
    """Measure how cost grows with rays, views, facets, voxels, thresholds and workers; estimate a large campaign."""
    from mvla_sim.bench.cost_tables import FILES, axis_tables, cost_lines, disturbed_note, estimate_lines, write_bench
    from mvla_sim.bench.estimate import CostScenario, costs_from, estimate
    from mvla_sim.bench.stages import STAGES, measure_stages, series_of
    from mvla_sim.engine.machine import core_count, cpu_name
    from mvla_sim.files import check_writable, make_folder
    from mvla_sim.interrupt import interruptible

    if ratios:
        _ratios(output, stage or ())
        return
    campaign = CostScenario(scenes=scenes, views=views, nodes=nodes, cores=cores)
    for name in stage or ():
        series_of(name)
    chosen = [name for name in STAGES if not stage or name in stage]
    with interruptible():
        make_folder(output)
        for name in FILES:
            check_writable(output / name)
        say(f"{cpu_name()}, {core_count()} cores; every point in a process of its own")
        rows = measure_stages(chosen, quick=quick)
        costs = costs_from(rows) if chosen == list(STAGES) else None
        found = None if costs is None else estimate(costs, campaign)
        files = write_bench(output, rows, costs, found, quick=quick)
    for one in axis_tables(rows):
        table = Table(*one.header, title=one.title, title_justify="left", caption=one.law or None)
        for column in table.columns:
            column.justify = "right"
        for cells in one.lines:
            table.add_row(*cells)
        show(table)
    for line in [] if costs is None else cost_lines(costs):
        say(line)
    if found is not None:
        first, *others = estimate_lines(found)
        say("\n  ".join([f"\n{first}", *others]))
        say("\n  ".join(["assumed:", *found.assumptions]))
    wrote(*files)
    disturbed = sum(row.disturbed for row in rows)
    if disturbed:
        note(f"note: {disturbed_note(disturbed, len(rows))}")


def _ratios(output: Path, stages: Sequence[str]) -> None:
    from mvla_sim.bench.cost_tables import ratio_line, write_ratios
    from mvla_sim.bench.ratios import check_stages, measure_ratios
    from mvla_sim.engine.machine import core_count, cpu_name
    from mvla_sim.files import check_writable, make_folder
    from mvla_sim.interrupt import interruptible

    check_stages(stages)
    with interruptible():
        make_folder(output)
        check_writable(output / "ratios.csv")
        say(f"{cpu_name()}, {core_count()} cores; medians of calls in turn")
        found = []
        for one in measure_ratios(stages):
            say(ratio_line(one))
            found.append(one)
        file = write_ratios(output, found)
    wrote(file)
