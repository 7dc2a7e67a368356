"""Build figures, tables and the report page from a folder of stored results; nothing is computed but averages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd

from mvla_sim.errors import DataError
from mvla_sim.evaluation.claims import Claim, Tables, claims_table, judge, thresholds_table
from mvla_sim.files import atomic_output
from mvla_sim.report.page import Section, pretty, table_html, write_page
from mvla_sim.report.panels import plot_cd_panels, plot_examples, plot_parameter_maps, plot_verdicts
from mvla_sim.report.style import save_figure
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.run import images_of
from mvla_sim.sweep.table import FILE, PARQUET, RECORD, load_table

__all__ = ["draw_examples", "write_report"]

EXAMPLE_CASES = [(20.0, i) for i in (1.0, 5.0, 10.0, 30.0)] + [(snr, 5.0) for snr in (15.0, 10.0, 5.0, 0.0)]
"""(SNR in dB, interval in degrees) of the paper's eight example panels."""
_MAP_COLUMNS = {"scene", "kappa", "eta", "cd_db"}
_STAR_COLUMNS = {"snr_db", "interval_deg", "method", "cd_db", "top_percent", "min_support_deg", "area_m2"}
LEAD = "Built by mvla-sim from stored results. Thresholds called optimal are found with the ground truth."


def write_report(folder: Path) -> Path:
    """Write figures, ``claims.csv``, ``thresholds.csv`` and ``report.html`` into a folder of results.

    Raises
    ------
    DataError
        The folder holds no experiment.
    OutputError
        The folder cannot be written.
    """
    found = {name: _table(folder / name) for name in
             ("kappa-eta", "star-optimal", "star-calibrated", "sensitivity-star", "sensitivity-map")}  # fmt: skip
    if all(table is None for table in found.values()):
        raise DataError(f"{folder}: holds no table of an experiment; run mvla reproduce first")
    checks = _json(folder / "checks.json")
    claims = judge(Tables(found["kappa-eta"], found["star-optimal"], found["star-calibrated"], checks))
    _csv(claims_table(claims), folder / "claims.csv")
    sections = [
        _claims(claims),
        _maps(folder, found["kappa-eta"]),
        *(_curves(folder, name, found[name]) for name in ("star-optimal", "star-calibrated")),
        _thresholds(folder, found["star-optimal"]),
        _examples(folder),
        _sensitivity(folder, found["sensitivity-star"], found["sensitivity-map"]),
        _record(folder),
    ]
    return write_page(folder / "report.html", "MVLA-GR: the paper's experiments, reproduced", LEAD, sections)


def draw_examples(plan: Plan, folder: Path) -> list[Path]:
    """Draw the paper's eight example panels, a figure a method."""
    drawn = []
    for method in ("mvla-gr", "bp"):
        by_place = {
            (c.values["snr_db"], c.values["interval_deg"]): c for c in plan.cases if c.values["method"] == method
        }
        cases = [by_place[place] for place in EXAMPLE_CASES if place in by_place]
        shown = list(images_of(plan, cases))
        if not shown:
            continue
        labels = [
            f"{o.case.values['interval_deg']:g}°, {o.case.values['snr_db']:g} dB: CD {o.evaluation.cd_db:.1f} dB(m²)"
            for o in shown
        ]
        figure = plot_examples(
            [o.image for o in shown],
            [o.evaluation.truth for o in shown],
            [o.evaluation.occupied for o in shown],
            labels,
        )
        drawn.append(folder / f"examples-{method}.png")
        save_figure(figure, drawn[-1])
    return drawn


def _claims(claims: list[Claim]) -> Section:
    table = claims_table(claims)[["number", "verdict", "text", "figure", "rule", "detail"]]
    count = {word: sum(c.verdict == word for c in claims) for word in ("holds", "does not hold", "not tested")}
    text = f"{count['holds']} claims hold, {count['does not hold']} do not, {count['not tested']} were not tested here."
    return Section("What the paper claims", text, tables=[table_html(table)])


def _maps(folder: Path, table: pd.DataFrame | None) -> Section:
    title = "Choosing κ and η (Section IV-A)"
    if table is None:
        return Section(title, "Not run.")
    picture = folder / "kappa-eta.png"
    save_figure(plot_parameter_maps(table), picture)
    return Section(
        title, figures=[(picture, "Smallest CD over every p and T_θ for each (κ, η), at 72 views and 20 dB")]
    )


def _curves(folder: Path, name: str, table: pd.DataFrame | None) -> Section:
    kind = name.removeprefix("star-")
    title = f"The star under {kind} thresholds (Section IV-B)"
    if table is None:
        return Section(title, "Not run.")
    picture = folder / f"{name}.png"
    save_figure(plot_cd_panels(table), picture)
    caption = f"CD against Δθ under {kind} thresholds; lines: means over offsets and seeds, bands: 10 to 90 %"
    return Section(title, figures=[(picture, caption)])


def _thresholds(folder: Path, table: pd.DataFrame | None) -> Section:
    title = "Calibrated thresholds"
    if table is None:
        return Section(title, "Not run.")
    thresholds = thresholds_table(table)
    _csv(thresholds, folder / "thresholds.csv")
    text = (
        "p is per cent of all voxels and depends on the grid, the retained area does not. The paper's grid is unknown."
    )
    return Section(title, text, tables=[table_html(thresholds)])


def _examples(folder: Path) -> Section:
    pictures = [(file, f"Binary reconstructions over the ground truth, {file.stem.removeprefix('examples-')}")
                for file in sorted((folder / "examples").glob("examples-*.png"), reverse=True)]  # fmt: skip
    return Section("Examples", "" if pictures else "Not run.", figures=pictures)


def _sensitivity(folder: Path, star: pd.DataFrame | None, maps: pd.DataFrame | None) -> Section:
    title = "What decides the claims"
    if star is None:
        return Section(title, "Not run.")
    rows: dict[str, dict[str, str]] = {}
    gaps = []
    for variant in star["variant"].unique():
        part = None if maps is None else maps[maps["variant"] == variant]
        claims = judge(Tables(kappa_eta=part, star_optimal=star[star["variant"] == variant]))
        rows[variant] = {claim.number: claim.verdict for claim in claims}
        figures = {claim.number: claim.figure for claim in claims}
        gaps.append(
            {"variant": variant, "κ and η": figures["C1"], "advantage": figures["C4"], "densest": figures["C5"]}
        )
    verdicts = pd.DataFrame(rows).T
    verdicts = verdicts.loc[:, (verdicts != "not tested").any()]
    picture = folder / "sensitivity.png"
    save_figure(plot_verdicts(verdicts), picture)
    _csv(verdicts.rename_axis("variant").reset_index(), folder / "sensitivity.csv")
    text = "Each row departs from the default settings in one point, on a smaller sweep of one seed and one offset."
    return Section(
        title, text, [(picture, "Verdicts by departure from the default settings")], [table_html(pd.DataFrame(gaps))]
    )


def _record(folder: Path) -> Section:
    run = _json(folder / "run.json")
    texts = {}
    for file in sorted(folder.glob(f"*/{RECORD}")):
        texts[f"Settings and provenance of {file.parent.name}"] = pretty(_json(file))
    seconds = pd.DataFrame(list(run.get("seconds", {}).items()), columns=["experiment", "seconds"])
    tables = [table_html(seconds, f"Run times, {run.get('total_s', 0):.0f} s in all")] if len(seconds) else []
    return Section("How it was made", "" if texts else "No record.", tables=tables, folded=texts)


def _table(folder: Path) -> pd.DataFrame | None:
    """Finished cases of an experiment; None where there is no table, or too little of it for any figure."""
    if not ((folder / FILE).exists() or (folder / PARQUET).exists()):
        return None
    table = load_table(folder)
    done = table[table["status"] == "done"]
    needed = _MAP_COLUMNS if {"kappa", "eta"} <= set(table.columns) else _STAR_COLUMNS
    if done.empty or not needed <= set(table.columns):
        return None
    return done if needed is _MAP_COLUMNS or set(done["method"]) >= {"mvla-gr", "bp"} else None


def _json(file: Path) -> dict[str, Any]:
    if not file.exists():
        return {}
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DataError(f"{file}: is not JSON ({error})") from error
    return data if isinstance(data, dict) else {}


def _csv(table: pd.DataFrame, file: Path) -> None:
    with atomic_output(file) as temporary:
        table.to_csv(temporary, index=False, float_format="%.6g")
