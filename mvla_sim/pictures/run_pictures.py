"""Pictures of a run: the cases that an experiment shows, and the curve of its table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from mvla_sim.channel.simulate import simulate
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.method import title_of
from mvla_sim.pictures.file_pictures import draw_waterfall, truth_of
from mvla_sim.plot.curves import plot_curves
from mvla_sim.plot.drawing import view_count
from mvla_sim.plot.image_figures import plot_comparison, plot_image, score_caption
from mvla_sim.plot.scene_figures import plot_scene
from mvla_sim.plot.style import save_figure
from mvla_sim.sweep.batch import Outcome
from mvla_sim.sweep.case import Case
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.run import images_of
from mvla_sim.sweep.table import AVERAGED, averaged

__all__ = ["draw_run"]


def draw_run(plan: Plan, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw what an experiment shows and, where CD against the interval is all there is, that; return the files.

    The folder must exist; raises OutputError where a file cannot be written.
    """
    return [*_draw_shown(plan, folder), *_draw_curve(plan, table, folder)]


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
        figure = plot_comparison(
            [r.image for r in group],
            [r.evaluation.truth for r in group],
            [r.evaluation.occupied for r in group],
            [f"{title_of(r.image.method)}, {view_count(r.image.n_view)}" for r in group],
            captions=[score_caption(r.evaluation.cd_db, r.evaluation.protocol) for r in group],
        )
        for suffix in (".png", ".pdf"):
            pictures.append(folder / f"comparison-{number + 1}{suffix}")
            save_figure(figure, pictures[-1])
    return pictures


def _draw_channel(plan: Plan, channel: str, folder: Path) -> list[Path]:
    """Draw a scene and the waterfall of its profiles."""
    scene, imaging = plan.sources[channel].scene, plan.experiment.imaging
    if scene is None:
        return []
    pictures = [folder / f"{scene.name}-scene{suffix}" for suffix in (".png", ".pdf")]
    for picture in pictures:
        save_figure(plot_scene(scene, *truth_of(scene, imaging.grid)), picture)
    pictures.append(folder / f"{scene.name}-waterfall.png")
    draw_waterfall(simulate(scene), pictures[-1], imaging_settings(snr_db=imaging.noise.snr_db))
    return pictures


def _draw_curve(plan: Plan, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Draw CD against the interval where that is all that varies, beside method, offset and seed."""
    axes = ["interval_deg", "method"]
    others = [a for a in plan.swept if a not in (*axes, *AVERAGED)]
    several = others or plan.experiment.parts or len(plan.names) > 1
    if several or not {*axes, "cd_db"} <= set(table) or table["interval_deg"].nunique() < 2:
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
