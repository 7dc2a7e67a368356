"""Run an experiment and put its table and pictures into a folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from mvla_sim.channel.cir import Cir
from mvla_sim.cli.pictures import draw_waterfall, truth_of
from mvla_sim.config.experiment import ExperimentSettings
from mvla_sim.errors import OutputError
from mvla_sim.files import atomic_output
from mvla_sim.report.figures import plot_comparison, plot_curves, plot_image, plot_scene
from mvla_sim.report.style import save_figure
from mvla_sim.runtime.provenance import provenance
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.plan import Case
from mvla_sim.sweep.run import CaseResult, run_cases, table_of

__all__ = ["execute"]


def execute(settings: ExperimentSettings, cases: Sequence[Case], folder: Path, out: Console) -> None:
    """Run all cases; the table holds every finished case even if the run is stopped.

    Raises
    ------
    OutputError
        The folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made ({error.strerror})") from error
    shown: list[CaseResult] = []
    rows = []
    pictures: list[Path] = []

    def on_channel(scene: Scene, cir: Cir) -> None:
        for suffix in (".png", ".pdf"):
            pictures.append(folder / f"{scene.name}-scene{suffix}")
            save_figure(plot_scene(scene, *truth_of(scene, settings.imaging.grid)), pictures[-1])
        pictures.append(folder / f"{scene.name}-waterfall.png")
        draw_waterfall(cir, pictures[-1], [f"noise.snr_db={settings.imaging.noise.snr_db or 'none'}"])

    try:
        for result in run_cases(cases, on_channel):
            rows.append(result.row())
            if any(_matches(result.case, wanted) for wanted in settings.show):
                shown.append(result)
    finally:
        if rows:
            _write_table(rows, settings, folder)
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
    table = table_of(rows)
    if {"interval_deg", "method"} <= set(table) and table["interval_deg"].nunique() > 1:
        pictures.append(folder / "cd-against-interval.png")
        save_figure(
            plot_curves(
                table,
                "interval_deg",
                "cd_db",
                "method",
                x_label="angular interval (°)",
                y_label="Chamfer distance (dB(m²))",
            ),
            pictures[-1],
        )
    _print(rows, settings, out)
    out.print(f"table:    {folder / 'table.csv'}", markup=False)
    for picture in pictures:
        out.print(f"picture:  {picture}", markup=False)


def _write_table(rows: list[dict[str, object]], settings: ExperimentSettings, folder: Path) -> None:
    with atomic_output(folder / "table.csv") as temporary:
        table_of(rows).to_csv(temporary, index=False, float_format="%.9g")
    with atomic_output(folder / "experiment.json") as temporary:
        record = {"settings": settings.model_dump(mode="json"), "provenance": provenance()}
        record["settings"]["scenes"] = [Path(name).name for name in settings.scenes]
        temporary.write_text(json.dumps(record, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _matches(case: Case, wanted: Mapping[str, object]) -> bool:
    return all(case.values.get(key) == value for key, value in wanted.items())


def _label(case: Case) -> str:
    """Name of a case's picture: its values, a short name where the value alone says nothing."""
    parts = [str(v) if isinstance(v, str) else f"{k.rpartition('.')[2]}-{v:g}" for k, v in case.values.items()]
    return "-".join(parts)


def _rows_of(shown: Sequence[CaseResult]) -> list[list[CaseResult]]:
    """Group shown cases that differ in the method alone, in the order of the plan."""
    groups: dict[str, list[CaseResult]] = {}
    for result in shown:
        key = str({k: v for k, v in result.case.values.items() if k != "method"})
        groups.setdefault(key, []).append(result)
    return [group for group in groups.values() if len(group) > 1]


def _print(rows: Sequence[dict[str, object]], settings: ExperimentSettings, out: Console) -> None:
    """Print the main columns; the CSV has them all."""
    heads = {"cd_db": "CD dB(m²)", "top_percent": "p %", "min_support_deg": "T_θ °", "f1_10cm": "F1 10 cm"}
    columns = ["scene", *settings.axes, *(key for key in heads if key in rows[0])]
    table = Table(*(heads.get(key, key) for key in columns), title=settings.name)
    for row in rows:
        table.add_row(*(f"{v:.4g}" if isinstance(v := row.get(key, ""), float) else str(v) for key in columns))
    out.print(table)
