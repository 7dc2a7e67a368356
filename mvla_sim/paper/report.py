"""Build figures, tables and the report page from a folder of stored results; nothing is computed but averages."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from mvla_sim.errors import DataError
from mvla_sim.measured.process_files import RESULT
from mvla_sim.paper.averages import finite
from mvla_sim.paper.beyond import sections_beyond
from mvla_sim.paper.claims import claims_table
from mvla_sim.paper.page import Section, table_html, write_page
from mvla_sim.paper.reading_sections import FRESH, ReadingResults, sections_of_readings, stored_readings
from mvla_sim.paper.search_sections import search_sections
from mvla_sim.sweep.table import RECORD, write_csv

__all__ = ["write_report"]

VEHICLE = "vehicle"
VOLUME = "vehicle-3d"
TITLE = "MVLA-GR: the paper's experiments, reproduced, and beyond"
LEAD = "Built by mvla-sim from stored results. Thresholds called optimal are found with the ground truth."


def write_report(folder: Path) -> Path:
    """Write figures, ``claims.csv``, each reading's ``thresholds.csv``, and ``report.html`` into a folder of results.

    The paper's experiments are in a folder a reading, which are shown side by side. Experiments beyond the paper have
    their sections where they are stored; see :mod:`mvla_sim.paper.beyond`.

    Raises
    ------
    DataError
        The folder holds no experiment.
    OutputError
        The folder cannot be written.
    """
    checks = _json(folder / "checks.json")
    vehicle = _json(folder / VEHICLE / RESULT)
    if vehicle:
        checks["c14"] = vehicle
    readings = stored_readings(folder, checks)
    beyond = sections_beyond(folder)
    if not readings and not beyond:
        raise DataError(f"{folder}: holds no table of an experiment; reproduce the paper first")
    sections = [
        _keys(readings, _json(folder / "run.json")),
        _claims(readings, folder),
        *sections_of_readings(readings),
        _vehicle(folder, vehicle),
        *search_sections(folder),
        *beyond,
        _record(folder),
    ]
    return write_page(folder / "report.html", TITLE, LEAD, sections)


def _keys(readings: Sequence[ReadingResults], run: dict[str, Any]) -> Section:
    """The figures that say most, and what is not finished."""
    keys: list[tuple[str, str]] = []
    for reading in readings:
        by_number = {claim.number: claim for claim in reading.claims if claim.verdict != "not tested"}
        held = sum(claim.verdict == "holds" for claim in by_number.values())
        under = f"under the reading '{reading.name}'"
        keys.append((f"{held} of {len(by_number)}", f"claims of the paper that could be tested hold {under}"))
        if reading.name.endswith(FRESH):
            continue
        if "C1" in by_number:
            text = f"from the paper's (κ, η) down to the smallest averaged CD, {under}"
            keys.append((f"{by_number['C1'].measured:.1f} dB", text))
        if (optimal := reading.tables["star-optimal"]) is not None:
            keys += _mean_pairs(optimal, reading.name)
    if isinstance(run.get("total_s"), int | float):
        keys.append((f"{run['total_s'] / 60:.1f} min", "to run all of it" + (" (quick)" if run.get("quick") else "")))
    unfinished = "; ".join(filter(None, (reading.unfinished for reading in readings)))
    warning = f"Not finished: {unfinished}. Figures and verdicts rest on the other cases." if unfinished else ""
    return Section("Key figures", keys=keys, warning=warning)


def _mean_pairs(optimal: pd.DataFrame, name: str) -> list[tuple[str, str]]:
    means = finite(optimal)
    snr = means["snr_db"].max()
    means = means[means["snr_db"] == snr].groupby(["interval_deg", "method"])["cd_db"].mean().unstack("method")
    pairs = []
    for interval in sorted({1.0, 5.0, 30.0} & set(means.dropna().index)):
        pair = f"{means.loc[interval, 'mvla-gr']:.1f} / {means.loc[interval, 'bp']:.1f} dB".replace("-", "−")
        pairs.append((pair, f"mean CD of MVLA-GR / BP at {interval:g}° and {snr:g} dB, '{name}', optimal thresholds"))
    return pairs


def _claims(readings: Sequence[ReadingResults], folder: Path) -> Section:
    """Every claim with its verdict under each reading, side by side; writes ``claims.csv``."""
    if not readings:
        return Section("What the paper claims", "Not run.")
    tables = {reading.name: claims_table(reading.claims) for reading in readings}
    every = pd.concat([table.assign(reading=name) for name, table in tables.items()], ignore_index=True)
    write_csv(every[["reading", *(name for name in every if name != "reading")]], folder / "claims.csv")
    first = next(iter(tables.values()))
    shown = pd.DataFrame({"claim": first["number"], "the paper says": first["text"] + "; rule: " + first["rule"]})
    counts = []
    for name, table in tables.items():
        shown[f"'{name}'"] = table["verdict"]
        if not name.endswith(FRESH):
            shown[f"measured under '{name}'"] = table["figure"].str.cat(table["detail"], sep="; ").str.strip("; ")
        count = table["verdict"].value_counts()
        words = ", ".join(f"{count[word]} {word}" for word in ("holds", "does not hold", "not tested") if word in count)
        counts.append(f"'{name}': {words}")
    text = (
        "A reading is a choice of what the paper leaves open. 'paper' is the one found to come nearest to what it "
        "publishes, 'physical' this package's own defaults; '-fresh' is the same on seeds that it was not chosen with, "
        f"and its figures are in claims.csv. {'. '.join(counts)}."
    )
    return Section("What the paper claims", text, tables=[table_html(shown, stack=True)])


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


def _record(folder: Path) -> Section:
    run = _json(folder / "run.json")
    texts = {
        f"Settings and provenance of {file.parent.relative_to(folder)}": json.dumps(
            _json(file), indent=1, sort_keys=True, ensure_ascii=False
        )
        for file in sorted([*folder.glob(f"*/{RECORD}"), *folder.glob(f"*/*/{RECORD}")])
    }
    spent = run.get("seconds")
    seconds = pd.DataFrame(list(spent.items()) if isinstance(spent, dict) else [], columns=["experiment", "seconds"])
    total = f", {run['total_s']:.0f} s in all" if isinstance(run.get("total_s"), int | float) else ""
    tables = [table_html(seconds, f"Run times{total}")] if len(seconds) else []
    return Section("How it was made", "" if texts else "No record.", tables=tables, folded=texts)


def _json(file: Path) -> dict[str, Any]:
    if not file.exists():
        return {}
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DataError(f"{file}: is not JSON ({error})") from error
    return data if isinstance(data, dict) else {}
