"""Run an experiment and put its table and pictures into a folder."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table

from mvla_sim.channel.simulate import simulate
from mvla_sim.cluster.interface import Cluster
from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.paper.ablation import BESIDE, LADDER, ablation_table, markdown, plot_ablation
from mvla_sim.paper.robustness import plot_robustness
from mvla_sim.plot.figures import plot_comparison, plot_curves, plot_image, plot_scene
from mvla_sim.plot.pictures import draw_waterfall, truth_of
from mvla_sim.plot.style import save_figure
from mvla_sim.sweep.batch import Outcome
from mvla_sim.sweep.case import Case
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.run import RunResult, images_of, run_plan
from mvla_sim.sweep.survey import survey
from mvla_sim.sweep.table import averaged

__all__ = ["execute", "show_plan"]

MOST_ROWS = 40
"""Longer tables are not printed."""
FIRST_ERRORS = 3
AVERAGED = ("offset", "seed")
"""Axes that results are averaged over where they are shown."""


def show_plan(plan: Plan, folder: Path, workers: int, out: Console) -> None:
    """Print what a run would do: cases by axis, what is stored and cached, and about how long it takes."""
    found = survey(plan, folder, workers)
    table = Table("axis", "values", "", title=plan.experiment.name)
    table.add_row("scene", str(len(plan.files)), ", ".join(plan.files))
    for axis, values in plan.experiment.axes.items():
        count = "" if values == ("all",) else str(len(values))
        table.add_row(axis, count, ", ".join("none" if value is None else str(value) for value in values))
    out.print(table)
    again = f", of which {found.failed} failed before" if found.failed else ""
    out.print(f"cases:    {found.cases}; {found.done} stored, {found.cases - found.done} to run{again}", markup=False)
    cached = sum(channel.cached for channel in found.channels)
    out.print(f"CIRs:     {len(found.channels)} needed, {cached} cached", markup=False)
    for channel in found.channels:
        if not channel.cached:
            out.print(f"          {channel.scene}: {channel.views} views to trace", markup=False)
    basis = "from the time of stored cases" if found.measured else "a guess: nothing was measured yet"
    out.print(f"time:     about {_duration(found.seconds)} with {workers} workers ({basis})", markup=False)


def execute(plan: Plan, folder: Path, out: Console, errors: Console, *, cluster: Cluster, fresh: bool = False) -> int:
    """Run what is missing, draw the pictures the experiment asks for, print the main columns.

    Returns
    -------
    int
        Exit code: 1 where a case failed or is missing, else 0.
    """
    result = run_plan(plan, folder, cluster=cluster, fresh=fresh)
    for note in result.notes:
        errors.print(f"mvla: note: {note}", markup=False)
    pictures = [
        *_draw_shown(plan, folder),
        *_draw_curve(plan, result.table, folder),
        *_draw_robustness(plan, result.table, folder),
        *_draw_ablation(plan, result.table, folder),
    ]
    _print(result.table, plan, out)
    for file in result.files:
        out.print(f"table:    {file}", markup=False)
    for picture in pictures:
        out.print(f"picture:  {picture}", markup=False)
    return _verdict(result, errors)


def _verdict(result: RunResult, errors: Console) -> int:
    """Say what failed, and return the exit code."""
    failed = result.table[result.table["status"] == "failed"]
    for row in failed.head(FIRST_ERRORS).to_dict("records"):
        errors.print(f"mvla: case {row['case']} failed: {row['error']}", markup=False)
    missing = result.count("missing")
    if len(failed) or missing:
        parts = [f"{n} {word}" for n, word in ((len(failed), "failed"), (missing, "missing")) if n]
        errors.print(f"mvla: error: of {len(result.table)} cases {' and '.join(parts)}; see the table", markup=False)
        return 1
    return 0


def _draw_shown(plan: Plan, folder: Path) -> list[Path]:
    """Draw the scenes, and the images of the cases that the experiment shows; nothing where it shows none."""
    cases = [case for case in plan.cases if any(_matches(case, wanted) for wanted in plan.experiment.show)]
    pictures: list[Path] = []
    for channel in dict.fromkeys(case.channel for case in cases):
        pictures += _draw_channel(plan, channel, folder)
    shown = list(images_of(plan, cases))
    for result in shown:
        pictures.append(folder / f"{_label(result.case)}.png")
        save_figure(plot_image(result.image, result.evaluation.truth, result.evaluation.occupied), pictures[-1])
    for number, group in enumerate(_rows_of(shown)):
        labels = [f"{r.image.method}, {r.image.n_view} views: CD {r.evaluation.cd_db:.1f} dB(m²)" for r in group]
        figure = plot_comparison(
            [r.image for r in group],
            [r.evaluation.truth for r in group],
            [r.evaluation.occupied for r in group],
            labels,
        )
        for suffix in (".png", ".pdf"):
            pictures.append(folder / f"comparison-{number + 1}{suffix}")
            save_figure(figure, pictures[-1])
    return pictures


def _draw_channel(plan: Plan, channel: str, folder: Path) -> list[Path]:
    """Draw a scene and the waterfall of its profiles."""
    scene, imaging = plan.scenes[channel], plan.experiment.imaging
    pictures = [folder / f"{scene.name}-scene{suffix}" for suffix in (".png", ".pdf")]
    for picture in pictures:
        save_figure(plot_scene(scene, *truth_of(scene, imaging.grid)), picture)
    pictures.append(folder / f"{scene.name}-waterfall.png")
    draw_waterfall(simulate(scene), pictures[-1], imaging_settings(snr_db=imaging.noise.snr_db))
    return pictures


def _draw_ablation(plan: Plan, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw the ladder and write its table, where an experiment is of its rungs and of nothing that is not drawn."""
    methods = set(plan.experiment.axes.get("method", ()))
    if not set(LADDER) <= methods <= {*LADDER, *BESIDE} or "interval_deg" not in plan.experiment.axes:
        return []
    with contextlib.suppress(DataError):  # no case is finished
        files = [folder / "ablation.md", folder / "ablation.png", folder / "ablation.pdf"]
        with atomic_output(files[0]) as temporary:
            temporary.write_text(markdown(ablation_table(table)), encoding="utf-8")
        for file in files[1:]:
            save_figure(plot_ablation(table), file)
        return files
    return []


def _draw_robustness(plan: Plan, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw CD and F1 against each impairment, a figure a scene, where impairments are swept."""
    swept = [*plan.experiment.axes, *(key for variant in plan.experiment.variants for key in variant.set)]
    if not any(key.startswith("imaging.impairments.") for key in swept):
        return []
    centimetres = f"{100 * max(plan.experiment.evaluation.distances_m):g}"
    pictures: list[Path] = []
    for scene in plan.files:
        with contextlib.suppress(DataError):  # no case of it is finished
            figure = plot_robustness(
                table, scene=scene, f1=f"f1_{centimetres}cm", f1_label=f"F1 at {centimetres} cm", title=scene
            )
            for suffix in (".png", ".pdf"):
                pictures.append(folder / f"{scene}-robustness{suffix}")
                save_figure(figure, pictures[-1])
    return pictures


def _draw_curve(plan: Plan, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw CD against the interval where that is all that varies, beside method, offset and seed."""
    axes = ["interval_deg", "method"]
    others = [a for a in plan.experiment.axes if a not in (*axes, *AVERAGED)]
    if others or len(plan.files) > 1 or not {*axes, "cd_db"} <= set(table) or table["interval_deg"].nunique() < 2:
        return []
    figure = plot_curves(
        averaged(table, axes),
        "interval_deg",
        "cd_db",
        "method",
        low="cd_db_min",
        high="cd_db_max",
        x_label="angular interval (°)",
        y_label="Chamfer distance (dB(m²))",
    )
    picture = folder / "cd-against-interval.png"
    save_figure(figure, picture)
    return [picture]


def _matches(case: Case, wanted: Mapping[str, object]) -> bool:
    return all(case.values.get(key) == value for key, value in wanted.items())


def _label(case: Case) -> str:
    """Name of a case's picture: its values, a short name where the value alone says nothing."""
    parts = [
        value
        if isinstance(value, str)
        else f"{key.rpartition('.')[2]}-{'none' if value is None else format(value, 'g')}"
        for key, value in case.values.items()
    ]
    return "-".join(parts)


def _rows_of(shown: Sequence[Outcome]) -> list[list[Outcome]]:
    """Group shown cases that differ in the method alone, in the order of the plan."""
    groups: dict[str, list[Outcome]] = {}
    for result in shown:
        key = str({k: v for k, v in result.case.values.items() if k != "method"})
        groups.setdefault(key, []).append(result)
    return [group for group in groups.values() if len(group) > 1]


def _print(table: pd.DataFrame, plan: Plan, out: Console) -> None:
    """Print the main columns, averaged over offsets and seeds, if that makes a short table; the CSV has them all."""
    heads = {"cd_db": "CD dB(m²)", "top_percent": "p %", "min_support_deg": "T_θ °", "f1_10cm": "F1 10 cm"}
    variant = ["variant"] if "variant" in table else []
    axes = ["scene", *variant, *(axis for axis in plan.experiment.axes if axis not in AVERAGED)]
    shown = averaged(table, axes)
    if len(shown) > MOST_ROWS or "cd_db" not in shown:
        out.print(f"{plan.experiment.name}: {len(table)} cases", markup=False)
        return
    columns = [*axes, "cases", *(key for key in heads if key in shown)]
    title = f"{plan.experiment.name}: means over {' and '.join(a for a in AVERAGED if a in table)}"
    grid = Table(
        *(heads.get(key, key) for key in columns), title=title if len(table) > len(shown) else plan.experiment.name
    )
    for row in shown.to_dict("records"):
        grid.add_row(*(_text(row[key]) for key in columns))
    out.print(grid)


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
