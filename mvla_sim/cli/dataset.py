"""Datasets on the command line: ``mvla dataset build``, ``verify``, ``export``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from mvla_sim.cluster.opening import open_cluster
from mvla_sim.dataset.access import BenchmarkDataset, open_dataset
from mvla_sim.dataset.build import build_dataset
from mvla_sim.dataset.campaign import CampaignSettings, load_campaign
from mvla_sim.dataset.card import CARD, PICTURE, card_text, shown_samples
from mvla_sim.dataset.dry_run import estimate
from mvla_sim.dataset.exports import export_mat, export_npz
from mvla_sim.dataset.verify import LEVEL, PLACE_M, verify
from mvla_sim.engine.cache import shared_cache
from mvla_sim.errors import ConfigError
from mvla_sim.files import atomic_output
from mvla_sim.plot.samples import plot_samples
from mvla_sim.plot.style import save_figure

__all__ = ["build", "check", "export_dataset", "write_card"]

FIRST_ERRORS = 3


def build(
    file: Path,
    folder: Path,
    overrides: Sequence[str],
    out: Console,
    errors: Console,
    *,
    dry_run: bool = False,
    workers: int | None = 0,
    scheduler: str | None = None,
    cache_url: str | None = None,
    retry_failed: bool = False,
) -> int:
    """Build a dataset and its card, or say what that would take; returns the exit code, 1 where samples are missing.

    Without workers and scheduler everything runs in this process.
    """
    campaign = load_campaign(file, overrides)
    if dry_run:
        _show(campaign, folder, workers or 0, out)
        return 0
    with (
        shared_cache(cache_url),
        open_cluster(
            workers or (0 if scheduler is None else None),
            scheduler,
            lambda text: errors.print(f"mvla: {text}", markup=False),
        ) as cluster,
    ):
        if cluster.remote:
            cluster.start()  # before the directory is made
        result = build_dataset(campaign, folder, cluster=cluster, retry_failed=retry_failed)
    for note in result.notes:
        errors.print(f"mvla: note: {note}", markup=False)
    index = result.index
    dataset = BenchmarkDataset(index)
    size = sum(entry.bytes for entry in index.shards.values())
    out.print(
        f"{folder}: {len(dataset)} of {campaign.samples} samples in {len(index.shards)} shards, "
        f"{size / 2**20:.1f} MiB; {result.made} shards made, the others kept",
        markup=False,
    )
    if len(dataset):
        for written in write_card(dataset):
            out.print(f"wrote:    {written}", markup=False)
    for failure in index.failed[:FIRST_ERRORS]:
        errors.print(f"mvla: sample {failure.sample} failed: {failure.error}", markup=False)
    missing = campaign.samples - len(dataset)
    if missing:
        errors.print(f"mvla: error: {missing} of {campaign.samples} samples are missing", markup=False)
    return int(missing > 0)


def write_card(dataset: BenchmarkDataset) -> list[Path]:
    """Write README.md and the picture of some scenes into a dataset's directory."""
    folder = dataset.index.folder
    save_figure(plot_samples([dataset[k] for k in shown_samples(dataset)]), folder / PICTURE)
    with atomic_output(folder / CARD) as temporary:
        temporary.write_text(card_text(dataset), encoding="utf-8")
    return [folder / CARD, folder / PICTURE]


def check(folder: Path, recompute: int, seed: int, out: Console, errors: Console) -> int:
    """Verify a dataset; returns the exit code, 1 where something is wrong."""
    report = verify(folder, recompute, seed)
    failed = f", {report.failed} failed in the build" if report.failed else ""
    out.print(f"{folder}: {report.shards} shards, {report.samples} samples{failed}", markup=False)
    if report.recomputed:
        out.print(
            f"made again: samples {', '.join(map(str, report.recomputed))}; {100 * report.stray:.2g} % of the paths "
            f"differ by more than {1e3 * PLACE_M:g} mm or {100 * LEVEL:g} % of |gain|",
            markup=False,
        )
    for problem in report.problems:
        errors.print(f"mvla: error: {problem}", markup=False)
    if report.ok:
        out.print("all is well", markup=False)
    return int(not report.ok)


def export_dataset(folder: Path, form: str, output: Path, split: str | None, out: Console) -> None:
    """Export a dataset, or one split of it, as DeepMIMO scenarios (npz) or as one MATLAB file (mat)."""
    if form not in ("npz", "mat"):
        raise ConfigError(f"--format {form}: allowed: npz, mat")
    dataset = open_dataset(folder, split)
    if form == "mat":
        out.print(f"{export_mat(dataset, output)}: {len(dataset)} samples", markup=False)
    else:
        out.print(f"{output}: {len(export_npz(dataset, output))} DeepMIMO scenarios, a folder each", markup=False)


def _show(campaign: CampaignSettings, folder: Path, workers: int, out: Console) -> None:
    found = estimate(campaign, folder, workers)
    out.print(f"samples:  {found.samples} of {len(campaign.families)} families", markup=False)
    each = f"about {_size(found.bytes / found.shards)} each; "
    out.print(
        f"shards:   {found.shards}; {each}{found.stored} stored, {found.shards - found.stored} to make", markup=False
    )
    out.print(f"size:     about {_size(found.bytes)} ({found.basis})", markup=False)
    where = f"with {workers} worker{'s' * (workers > 1)}" if workers else "in this process"
    out.print(f"time:     about {_time(found.seconds)} {where}", markup=False)


def _size(count: float) -> str:
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.1f} MiB"


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
