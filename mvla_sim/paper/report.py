"""Build figures, tables and the report page from a folder of stored results; nothing is computed but averages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd

from mvla_sim.errors import DataError
from mvla_sim.files import atomic_output
from mvla_sim.measured.process_files import RESULT
from mvla_sim.paper.averages import finite, mean_advantage
from mvla_sim.paper.beyond import sections_beyond
from mvla_sim.paper.claims import Claim, ResultTables, claims_table, judge, thresholds_table
from mvla_sim.paper.page import Section, table_html, write_page
from mvla_sim.paper.panels import parameter_maps, plot_cd_panels, plot_examples, plot_parameter_maps, plot_verdicts
from mvla_sim.plot.style import png_bytes, save_figure
from mvla_sim.sweep.plan import Plan
from mvla_sim.sweep.run import images_of
from mvla_sim.sweep.table import FILE, PARQUET, RECORD, load_table

__all__ = ["draw_examples", "write_report"]

EXAMPLE_CASES = [(20.0, i) for i in (1.0, 5.0, 10.0, 30.0)] + [(snr, 5.0) for snr in (15.0, 10.0, 5.0, 0.0)]
"""(SNR in dB, interval in degrees) of the paper's eight example panels."""
_MAP_COLUMNS = {"scene", "kappa", "eta", "cd_db"}
_STAR_COLUMNS = {"snr_db", "interval_deg", "method", "cd_db", "top_percent", "min_support_deg", "area_m2"}
_HEADS = {
    "snr_db": "SNR (dB)",
    "mvla_top_percent": "MVLA-GR p (%)",
    "paper_mvla_top_percent": "paper",
    "mvla_min_support_deg": "MVLA-GR T_θ (°)",
    "paper_mvla_min_support_deg": "paper ",
    "bp_top_percent": "BP p (%)",
    "paper_bp_top_percent": "paper  ",
    "mvla_area_m2": "MVLA-GR area (m²)",
    "mvla_optimal_area_m2": "at its optima (m²)",
    "bp_area_m2": "BP area (m²)",
}
"""Heads of the table of thresholds; columns of one head differ by blanks."""
VEHICLE = "vehicle"
VOLUME = "vehicle-3d"
TITLE = "MVLA-GR: the paper's experiments, reproduced, and beyond"
LEAD = "Built by mvla-sim from stored results. Thresholds called optimal are found with the ground truth."


def write_report(folder: Path) -> Path:
    """Write figures, ``claims.csv``, ``thresholds.csv`` and ``report.html`` into a folder of results.

    Experiments beyond the paper have their sections where they are stored; see :mod:`mvla_sim.paper.beyond`.

    Raises
    ------
    DataError
        The folder holds no experiment.
    OutputError
        The folder cannot be written.
    """
    found = {name: _table(folder / name) for name in
             ("kappa-eta", "star-optimal", "star-calibrated", "sensitivity-star", "sensitivity-map")}  # fmt: skip
    beyond = sections_beyond(folder)
    if all(table is None for table in found.values()) and not beyond:
        raise DataError(f"{folder}: holds no table of an experiment; reproduce the paper first")
    checks = _json(folder / "checks.json")
    vehicle = _json(folder / VEHICLE / RESULT)
    if vehicle:
        checks["c14"] = vehicle
    optimal, calibrated = found["star-optimal"], found["star-calibrated"]
    claims = judge(ResultTables(found["kappa-eta"], optimal, calibrated, checks))
    _csv(claims_table(claims), folder / "claims.csv")
    sections = [
        _keys(claims, optimal, _json(folder / "run.json"), _unfinished(found)),
        _claims(claims),
        _maps(folder, found["kappa-eta"]),
        *(_curves(folder, name, found[name]) for name in ("star-optimal", "star-calibrated")),
        _thresholds(folder, optimal, calibrated),
        _examples(folder),
        _vehicle(folder, vehicle),
        _sensitivity(folder, found["sensitivity-star"], found["sensitivity-map"]),
        *beyond,
        _record(folder),
    ]
    return write_page(folder / "report.html", TITLE, LEAD, sections)


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
        drawn.append(folder / f"examples-{method}.png")
        truths, masks = ([getattr(o.evaluation, name) for o in shown] for name in ("truth", "occupied"))
        figure = plot_examples([o.image for o in shown], truths, masks, labels)
        save_figure(figure, drawn[-1])
    return drawn


def _keys(claims: list[Claim], optimal: pd.DataFrame | None, run: dict[str, Any], unfinished: str) -> Section:
    """The figures that say most, and what is not finished."""
    by_number = {claim.number: claim for claim in claims if claim.verdict != "not tested"}
    held = sum(claim.verdict == "holds" for claim in by_number.values())
    keys = [(f"{held} of {len(by_number)}", "claims of the paper that could be tested here hold")]
    if "C1" in by_number:
        keys.append((f"{by_number['C1'].measured:.1f} dB", "from the paper's (κ, η) down to the smallest averaged CD"))
    if "C3" in by_number:
        keys.append((f"{100 * by_number['C3'].measured:.0f} %", "of (SNR, Δθ) conditions in which MVLA-GR beats BP"))
    if optimal is not None:
        means = finite(optimal)
        snr = means["snr_db"].max()
        means = means[means["snr_db"] == snr].groupby(["interval_deg", "method"])["cd_db"].mean().unstack("method")
        for interval in sorted({1.0, 5.0, 30.0} & set(means.dropna().index)):
            pair = f"{means.loc[interval, 'mvla-gr']:.1f} / {means.loc[interval, 'bp']:.1f} dB".replace("-", "−")
            keys.append((pair, f"mean CD of MVLA-GR / BP at {interval:g}° and {snr:g} dB, optimal thresholds"))
    if isinstance(run.get("total_s"), int | float):
        keys.append((f"{run['total_s'] / 60:.1f} min", "to run all of it" + (" (quick)" if run.get("quick") else "")))
    return Section("Key figures", keys=keys, warning=unfinished)


def _unfinished(found: dict[str, pd.DataFrame | None]) -> str:
    """Say which experiments have cases that failed or are missing, and the first error of each."""
    parts = []
    for name, table in found.items():
        if table is None or (table["status"] == "done").all():
            continue
        rest = table[table["status"] != "done"]
        errors = [text for text in rest.get("error", pd.Series(dtype=str)).fillna("") if text]
        why = f" ({errors[0]})" if errors else ""
        parts.append(f"{name}: {len(rest)} of {len(table)} cases failed or are missing{why}")
    return f"Not finished: {'; '.join(parts)}. Figures and verdicts rest on the other cases." if parts else ""


def _claims(claims: list[Claim]) -> Section:
    table = claims_table(claims)[["number", "verdict", "text", "figure", "rule", "detail"]]
    count = {word: sum(c.verdict == word for c in claims) for word in ("holds", "does not hold", "not tested")}
    text = f"{count['holds']} hold, {count['does not hold']} do not hold, {count['not tested']} not tested here."
    table.columns = pd.Index(["claim", "verdict", "the paper says", "measured here", "rule", "note"])
    return Section("What the paper claims", text, tables=[table_html(table, stack=True)])


def _maps(folder: Path, table: pd.DataFrame | None) -> Section:
    title = "Choosing κ and η (Section IV-A)"
    if table is None:
        return Section(title, "Not run.")
    picture = folder / "kappa-eta.png"
    save_figure(plot_parameter_maps(table), picture)
    names = list(parameter_maps(table))
    pictures = [(png_bytes(plot_parameter_maps(table, name)), f"CD over κ and η, {name}") for name in names]
    caption = (
        "Smallest CD over every p and T_θ for each (κ, η), at 72 views and 20 dB, in dB(m²); first the average of the "
        "targets. Circle: smallest; cross: the paper's point. One colour scale for all."
    )
    return Section(title, figures=[(pictures, caption)])


def _curves(folder: Path, name: str, table: pd.DataFrame | None) -> Section:
    kind = name.removeprefix("star-")
    title = f"The star under {kind} thresholds (Section IV-B)"
    if table is None:
        return Section(title, "Not run.")
    picture = folder / f"{name}.png"
    save_figure(plot_cd_panels(table), picture)
    pictures = [
        (png_bytes(plot_cd_panels(table, only=snr)), f"CD against Δθ at {snr:g} dB, {kind} thresholds")
        for snr in sorted(finite(table)["snr_db"].unique())
    ]
    caption = f"CD against Δθ under {kind} thresholds; lines: means over offsets and seeds, bands: 10 to 90 %"
    return Section(title, figures=[(pictures, caption)])


def _thresholds(folder: Path, table: pd.DataFrame | None, calibrated: pd.DataFrame | None) -> Section:
    title = "Calibrated thresholds"
    if table is None:
        return Section(title, "Not run.")
    thresholds = thresholds_table(table, calibrated)
    _csv(thresholds, folder / "thresholds.csv")
    text = (
        "p is per cent of all voxels and depends on the grid, the retained area does not. The paper's grid is unknown. "
        "MVLA-GR's p is before the test Θ ≥ T_θ, its area after it."
    )
    shown = thresholds.rename(columns=_HEADS)[list(_HEADS.values())]
    return Section(title, text, tables=[table_html(shown)])


def _examples(folder: Path) -> Section:
    pictures = [(file, f"Binary reconstructions over the ground truth, {file.stem.removeprefix('examples-')}")
                for file in sorted((folder / "examples").glob("examples-*.png"), reverse=True)]  # fmt: skip
    return Section("Examples", "" if pictures else "Not run.", figures=pictures)


def _vehicle(folder: Path, result: dict[str, Any]) -> Section:
    title = "A vehicle from a laboratory's files (Section IV-C)"
    if not result:
        return Section(title, "Not run.")
    pictures = [(file, caption) for file, caption in (
        (folder / VEHICLE / "image.png", "Support map and binary result; the car's plan view is drawn over"),
        (folder / VOLUME / "volume.png", "In three dimensions, from sensors at three heights"),
    ) if file.exists()]  # fmt: skip
    rows = [
        {"": label, "result": result.get(f"result_{key}"), "car": result.get(f"target_{key}")}
        for label, key in (("length (m)", "length_m"), ("width (m)", "width_m"), ("aspect ratio", "aspect"),
                           ("orientation (°)", "orientation_deg"))
    ]  # fmt: skip
    scores = ", ".join(
        f"{label} {factor * result[key]:.1f} {unit}"
        for label, key, factor, unit in (
            ("CD", "cd_db", 1, "dB(m²)"),
            ("result to outline", "accuracy_m", 100, "cm"),
            ("outline to result", "completeness_m", 100, "cm"),
        )
        if isinstance(result.get(key), float)
    )
    text = (
        "The paper's data are not public. A traced car is written as the Touchstone files of a network analyser, with "
        "noise, a phase of its own in every sweep, leakage and static echoes, and all that follows uses those files "
        f"alone: background subtraction, calibration by a sphere, gating, imaging within the beams. {scores}."
    )
    return Section(title, text, pictures, [table_html(pd.DataFrame(rows), digits=3)])


def _sensitivity(folder: Path, star: pd.DataFrame | None, maps: pd.DataFrame | None) -> Section:
    title = "What decides the claims"
    if star is None:
        return Section(title, "Not run.")
    rows: dict[str, dict[str, str]] = {}
    gaps = []
    for variant, table in star.groupby("variant", sort=False):
        part = None if maps is None else maps[maps["variant"] == variant]
        claims = judge(ResultTables(kappa_eta=part, star_optimal=table))
        rows[str(variant)] = {claim.number: claim.verdict for claim in claims}
        measured = {claim.number: claim.measured for claim in claims}
        gaps.append(
            {
                "variant": variant,
                "(0.5, 0.04) above the minimum (dB)": measured["C1"],
                "mean advantage of MVLA-GR (dB)": mean_advantage(table),
                "advantage at the densest (dB)": measured["C5"],
            }
        )
    verdicts = pd.DataFrame(rows).T
    verdicts = verdicts.loc[:, (verdicts != "not tested").any()]
    picture = folder / "sensitivity.png"
    save_figure(plot_verdicts(verdicts), picture)
    _csv(verdicts.rename_axis("variant").reset_index(), folder / "sensitivity.csv")
    text = "Each row departs from the default settings in one point, on a smaller sweep of one seed and one offset."
    figures = [(picture, "Verdicts by departure from the default settings")]
    return Section(title, text, figures, [table_html(pd.DataFrame(gaps), digits=3)])


def _record(folder: Path) -> Section:
    run = _json(folder / "run.json")
    texts = {
        f"Settings and provenance of {file.parent.name}": json.dumps(
            _json(file), indent=1, sort_keys=True, ensure_ascii=False
        )
        for file in sorted(folder.glob(f"*/{RECORD}"))
    }
    spent = run.get("seconds")
    seconds = pd.DataFrame(list(spent.items()) if isinstance(spent, dict) else [], columns=["experiment", "seconds"])
    total = f", {run['total_s']:.0f} s in all" if isinstance(run.get("total_s"), int | float) else ""
    tables = [table_html(seconds, f"Run times{total}")] if len(seconds) else []
    return Section("How it was made", "" if texts else "No record.", tables=tables, folded=texts)


def _table(folder: Path) -> pd.DataFrame | None:
    """Cases of an experiment, failed ones too; None where there is no table, or too little of it for any figure."""
    if not ((folder / FILE).exists() or (folder / PARQUET).exists()):
        return None
    table = load_table(folder)
    done = table[table["status"] == "done"]
    needed = _MAP_COLUMNS if {"kappa", "eta"} <= set(table.columns) else _STAR_COLUMNS
    if done.empty or not needed <= set(table.columns):
        return None
    return table if needed is _MAP_COLUMNS or set(done["method"]) >= {"mvla-gr", "bp"} else None


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
