"""Running methods over a dataset under the protocol, and keeping what came of it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from mvla_sim.cluster.in_process import InProcess
from mvla_sim.cluster.interface import Cluster
from mvla_sim.dataset.access import BenchmarkDataset, open_dataset
from mvla_sim.dataset.protocol import (
    PROTOCOL,
    Attempt,
    best_thresholds,
    failed_metrics,
    protocol_settings,
    score_sample,
)
from mvla_sim.engine.machine import program_version
from mvla_sim.engine.provenance import code_digest, provenance
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.files import as_path, atomic_output, check_writable
from mvla_sim.imaging.imaging_settings import ImagingSettings
from mvla_sim.imaging.method import METHODS, phase_free_methods
from mvla_sim.imaging.methods.functions import names_a_file
from mvla_sim.imaging.threshold_rules.given import GivenThresholds
from mvla_sim.interrupt import interruptible
from mvla_sim.progress import progress

__all__ = ["SCORES", "Entry", "Result", "load_results", "plan_entries", "score_dataset"]

SCORES: Final = "scores"
"""Folder of the results inside a dataset's directory."""
SCHEMA: Final = "mvla-sim score"
MOST_BYTES: Final = 1 << 28
NUMERIC: Final = ("constants", "streams", "dsp", "grid", "imaging", "evaluation")
"""Parts of the package that decide a score, beside the method's own file."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A competitor: a method with its settings, and the name it has in the table."""

    label: str
    settings: ImagingSettings
    digest: str


@dataclass(frozen=True)
class Result:
    """What came of an entry.

    Attributes
    ----------
    label
        Its name in the table.
    identity
        SHA-256 over protocol, dataset, method, its code and its settings; equal ones are not computed again.
    top_percent, min_support_deg
        Thresholds from the validation split, per cent of all voxels and degrees.
    validation_db
        Mean CD over the validation split at these thresholds, dB(m²).
    rows
        One a test sample: ``sample``, ``cd_db``, ``f1_5cm``, ``f1_10cm``, ``empty``, ``seconds``, ``error``.
    settings
        The method's settings.
    """

    label: str
    identity: str
    top_percent: float
    min_support_deg: float
    validation_db: float
    rows: tuple[Mapping[str, Any], ...]
    settings: Mapping[str, Any]

    def __hash__(self) -> int:
        return hash((self.label, self.identity))


def score_dataset(
    folder: str | os.PathLike[str],
    methods: Sequence[str] | None = None,
    overrides: Sequence[str] = (),
    *,
    label: str | None = None,
    output: str | os.PathLike[str] | None = None,
    cluster: Cluster | None = None,
    fresh: bool = False,
) -> list[Result]:
    """Score methods on a dataset's test split, thresholds chosen on its validation split.

    Parameters
    ----------
    folder
        The dataset's directory.
    methods
        Names, as in ``method`` of the settings; by default every one of the package that needs no phase.
    overrides
        ``dotted.key=value`` texts for the methods' own settings.
    label
        Name in the table, where there is one method; by default the method's.
    output
        Folder of the results; by default ``scores`` in the dataset's directory.
    cluster
        Runs the samples; by default this process.
    fresh
        Compute again what is there.

    Returns
    -------
    list of Result
        All results of the folder that are of this dataset and protocol, those of earlier calls as well.

    Raises
    ------
    ConfigError, DataError, OutputError
        No such method or setting, no dataset, a split without samples, a folder that cannot be written, a method
        without an image of any validation sample; one line, where possible before work starts.
    """
    place = as_path(folder) / SCORES if output is None else as_path(output)
    with (
        contextlib.closing(open_dataset(folder, "validation")) as validation,
        contextlib.closing(open_dataset(folder, "test")) as test,
    ):
        for split in (validation, test):
            if not len(split):
                raise DataError(f"{folder}: the {split.split} split has no samples, so nothing can be scored")
        _check_whole(test)
        entries = plan_entries(validation, methods or phase_free_methods(), overrides, label)
        stored = {} if fresh else {result.label: result.identity for result in load_results(test, place)}
        missing = [entry for entry in entries if stored.get(entry.label) != _identity(entry, test)]
        if missing:
            place.mkdir(parents=True, exist_ok=True)
            for entry in missing:
                check_writable(_file(place, entry.label))
            for result in _run(missing, validation, test, cluster or InProcess()):
                _save(place, result, _dataset_digest(test))
        return load_results(test, place)


def _check_whole(dataset: BenchmarkDataset) -> None:
    """Refuse a dataset whose shards are missing or have another size than the index says."""
    for number, entry in sorted(dataset.index.shards.items()):
        file = dataset.index.file(number)
        size = file.stat().st_size if file.is_file() else 0
        if size != entry.bytes:
            raise DataError(f"{file}: has {size} bytes, the index says {entry.bytes}; build or download it again")


def plan_entries(
    dataset: BenchmarkDataset, methods: Sequence[str], overrides: Sequence[str] = (), label: str | None = None
) -> list[Entry]:
    """Check methods and settings before anything runs; parameters and errors as :func:`score_dataset`."""
    if label is not None and len(methods) != 1:
        raise ConfigError(f"label = {label}: names one method, {len(methods)} are given", setting="label")
    if label is not None and not re.fullmatch(r"[\w .:+=-]{1,60}", label):
        raise ConfigError(f"label = {label!r}: allowed: up to 60 letters, digits, blanks and . : + = - _")
    entries = []
    for name in dict.fromkeys(methods):
        settings = protocol_settings(dataset.campaign, name, overrides)
        entries.append(Entry(label or _label(name), settings, METHODS.find(name).digest()))
    labels = [entry.label for entry in entries]
    if double := next((one for one in labels if labels.count(one) > 1), None):
        raise ConfigError(f"methods: two are called {double}; score them one by one, with a label", setting="label")
    return entries


def load_results(dataset: BenchmarkDataset, place: Path) -> list[Result]:
    """Results of a folder, by label; those of another dataset or protocol are passed over.

    Raises
    ------
    DataError
        A result file cannot be read.
    """
    found = []
    for file in sorted(place.glob("*.json")):
        if file.stat().st_size > MOST_BYTES:
            raise DataError(f"{file}: {file.stat().st_size} bytes are no result file")
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            if data["schema"] != SCHEMA:
                continue
            result = Result(**{**data["result"], "rows": tuple(data["result"]["rows"])})
            same = data["protocol"] == PROTOCOL and data["dataset"] == _dataset_digest(dataset)
            complete = [int(row["sample"]) for row in result.rows] == list(dataset.numbers)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"{file}: not a readable result file ({error}); delete it and score again") from error
        if same and complete:
            found.append(result)
    return found


def _run(
    entries: Sequence[Entry], validation: BenchmarkDataset, test: BenchmarkDataset, cluster: Cluster
) -> Iterator[Result]:
    """Choose thresholds on one split, score on the other, yield a result an entry."""
    settings = [entry.settings for entry in entries]
    grid = test.grid
    tried = _over(validation, settings, [None] * len(settings), cluster)
    chosen = [best_thresholds(attempts, grid) for attempts in tried]
    scored = _over(test, settings, [pair for pair, _ in chosen], cluster)
    for entry, (pair, mean), attempts in zip(entries, chosen, scored, strict=True):
        rows = [
            {
                "sample": attempt.sample,
                **(attempt.metrics or failed_metrics(grid)),
                "seconds": round(attempt.seconds, 4),
                "error": attempt.error,
            }
            for attempt in attempts
        ]
        identity = _identity(entry, test)
        yield Result(
            entry.label, identity, pair.top_percent, pair.min_support_deg, mean, tuple(rows), _plain_settings(entry)
        )


def _over(
    dataset: BenchmarkDataset,
    settings: Sequence[ImagingSettings],
    thresholds: Sequence[GivenThresholds | None],
    cluster: Cluster,
) -> list[list[Attempt]]:
    """Apply methods to every sample of a split; attempts of each method, by sample."""
    found: dict[int, list[Attempt]] = {}
    with interruptible(), progress(f"scoring {dataset.split}", len(dataset), "samples") as advance:
        tasks = ((dataset[k], tuple(settings), tuple(thresholds)) for k in range(len(dataset)))
        for k, finished in cluster.run(score_sample, tasks, label="score"):
            if finished.error is not None:
                raise DataError(f"sample {dataset.numbers[k]}: {finished.reason}") from finished.error
            found[k] = finished.value
            advance(1)
    return [[found[k][number] for k in range(len(dataset))] for number in range(len(settings))]


def _label(name: str) -> str:
    """A method's name; of a function of a file without its folder."""
    if not names_a_file(name):
        return name
    method = METHODS.find(name).name.rpartition("/")[2]
    return method.removesuffix(":image").removesuffix(".py").replace(".py:", ":")


def _file(place: Path, label: str) -> Path:
    """File of an entry's result; the name is plain, whatever the label."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", label).strip("-") or "method"
    if plain != label:
        plain += f"-{hashlib.sha256(label.encode()).hexdigest()[:6]}"
    return place / f"{plain}.json"


def _dataset_digest(dataset: BenchmarkDataset) -> str:
    """SHA-256 over the data of all shards and the campaign."""
    data = {
        "campaign": dataset.campaign.identity(),
        "shards": [dataset.index.shards[number].data_sha256 for number in sorted(dataset.index.shards)],
    }
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _identity(entry: Entry, dataset: BenchmarkDataset) -> str:
    data = {
        "protocol": PROTOCOL,
        "dataset": _dataset_digest(dataset),
        "settings": _plain_settings(entry),
        "code": [code_digest(*NUMERIC), entry.digest],
        "version": program_version(),
    }
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _plain_settings(entry: Entry) -> dict[str, Any]:
    """Settings as plain data; a method's file by its name alone."""
    return {**entry.settings.model_dump(mode="json"), "method": _label(entry.settings.method)}


def _save(place: Path, result: Result, dataset: str) -> None:
    data = {
        "schema": SCHEMA,
        "protocol": PROTOCOL,
        "dataset": dataset,
        "result": asdict(result),
        "provenance": provenance(),
    }
    with atomic_output(_file(place, result.label)) as temporary:
        temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
