"""``mvla dataset``: build, check, export and score benchmark datasets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table

from mvla_sim.cli.options import CacheUrl, Overrides, Scheduler, Workers, duration, note, say, show, wrote
from mvla_sim.errors import ConfigError

if TYPE_CHECKING:
    import pandas as pd

    from mvla_sim.dataset.dry_run import BuildForecast

__all__ = ["dataset_app"]

FIRST_ERRORS: Final = 3

dataset_app = typer.Typer(help="Build, check, export and score benchmark datasets.")

DatasetFolder = Annotated[Path, typer.Argument(metavar="DIR", help="A dataset's directory.")]


@dataset_app.command(name="build")
def dataset_build(
    campaign: Annotated[
        str, typer.Argument(help="A campaign file (TOML), or the name of one that comes along: benchmark-small.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Directory of the dataset.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say how many samples, bytes and hours; stop.")] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    cache_url: CacheUrl = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Try failed samples again.")] = False,
    overrides: Overrides = None,
) -> None:
    """Build a dataset from a campaign file, or what is missing of it, and write its card.

    Every finished shard is whole on the disk, so a build can be stopped at any time and goes on when started again.
    """
    from mvla_sim.cluster.opening import open_cluster
    from mvla_sim.dataset.access import BenchmarkDataset
    from mvla_sim.dataset.build import build_dataset
    from mvla_sim.dataset.campaign import load_campaign
    from mvla_sim.dataset.dry_run import estimate
    from mvla_sim.engine.cache import shared_cache
    from mvla_sim.engine.machine import core_count
    from mvla_sim.pictures.dataset_pictures import write_card

    settings = load_campaign(campaign, overrides or [])
    if dry_run:
        count = core_count() if workers is None else workers
        _show_forecast(estimate(settings, output, count), len(settings.families), count)
        return
    with shared_cache(cache_url), open_cluster(workers, scheduler, note) as cluster:
        if cluster.remote:
            cluster.start()  # before the directory is made
        result = build_dataset(settings, output, cluster=cluster, retry_failed=retry_failed)
    for text in result.notes:
        note(f"note: {text}")
    index = result.index
    dataset = BenchmarkDataset(index)
    size = sum(entry.bytes for entry in index.shards.values())
    say(
        f"{output}: {len(dataset)} of {settings.samples} samples in {len(index.shards)} shards, "
        f"{size / 2**20:.1f} MiB; {result.made} shards made, the others kept"
    )
    if len(dataset):
        wrote(*write_card(dataset))
    for failure in index.failed[:FIRST_ERRORS]:
        note(f"sample {failure.sample} failed: {failure.error}")
    missing = settings.samples - len(dataset)
    if missing:
        note(f"error: {missing} of {settings.samples} samples are missing")
    raise typer.Exit(int(missing > 0))


@dataset_app.command(name="verify")
def dataset_verify(
    folder: DatasetFolder,
    recompute: Annotated[int, typer.Option(min=0, help="How many samples are made again and compared.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Decides which.")] = 0,
) -> None:
    """Check a dataset: schema, checksums, counts, splits, truth, and a random few samples made again."""
    from mvla_sim.dataset.verify import LEVEL, PLACE_M, verify

    report = verify(folder, recompute, seed)
    failed = f", {report.failed} failed in the build" if report.failed else ""
    say(f"{folder}: {report.shards} shards, {report.samples} samples{failed}")
    if report.recomputed:
        say(
            f"made again: samples {', '.join(map(str, report.recomputed))}; {100 * report.stray:.2g} % of the paths "
            f"differ by more than {1e3 * PLACE_M:g} mm or {100 * LEVEL:g} % of |gain|"
        )
    for problem in report.problems:
        note(f"error: {problem}")
    if report.ok:
        say("all is well")
    raise typer.Exit(int(not report.ok))


@dataset_app.command(name="export")
def dataset_export(
    folder: DatasetFolder,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the scenarios (npz), or file (mat).")],
    form: Annotated[str, typer.Option("--format", help="npz (DeepMIMO v4) or mat (MATLAB).")] = "npz",
    split: Annotated[str | None, typer.Option(help="train, validation or test; by default all.")] = None,
) -> None:
    """Export a dataset for DeepMIMO or MATLAB."""
    from mvla_sim.dataset.access import open_dataset
    from mvla_sim.dataset.exports import export_mat, export_npz

    if form not in ("npz", "mat"):
        raise ConfigError(f"--format {form}: allowed: npz, mat")
    dataset = open_dataset(folder, split)
    if form == "mat":
        say(f"{export_mat(dataset, output)}: {len(dataset)} samples")
    else:
        say(f"{output}: {len(export_npz(dataset, output))} DeepMIMO scenarios, a folder each")


@dataset_app.command(name="score")
def dataset_score(
    folder: DatasetFolder,
    method: Annotated[
        list[str] | None,
        typer.Option(help="A method's name, or file.py:function. May be repeated; default every method there is."),
    ] = None,
    label: Annotated[str | None, typer.Option(help="Name in the table, of one method.")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the results; default DIR/scores.")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Compute again what is there.")] = False,
    overrides: Overrides = None,
) -> None:
    """Score methods on the test split, with thresholds from the validation split, and show the leaderboard."""
    from mvla_sim.cluster.opening import open_cluster
    from mvla_sim.dataset.access import open_dataset
    from mvla_sim.dataset.leaderboard import build_leaderboard, write_leaderboard
    from mvla_sim.dataset.score import SCORES, score_dataset

    with open_cluster(workers, scheduler, note) as cluster:
        results = score_dataset(
            folder, method, overrides or [], label=label, output=output, cluster=cluster, fresh=fresh
        )
    test = open_dataset(folder, "test")
    table = build_leaderboard(results)
    show(_leaderboard(table, f"{test.campaign.name}: {len(test)} test scene{'s' * (len(test) > 1)}"))
    wrote(*write_leaderboard(table, test, output or folder / SCORES))
    failed = 0
    for result in results:
        bad = [row for row in result.rows if row["error"]]
        failed += len(bad)
        if bad:
            note(
                f"{result.label} failed on {len(bad)} of {len(result.rows)} test samples, which count as worst; "
                f"the first, sample {bad[0]['sample']}: {bad[0]['error']}"
            )
    raise typer.Exit(int(failed > 0))


def _show_forecast(found: BuildForecast, families: int, workers: int) -> None:
    """Print what a build would take."""
    say(f"samples:  {found.samples} of {families} families")
    each = f"about {_size(found.bytes / found.shards)} each; "
    say(f"shards:   {found.shards}; {each}{found.stored} stored, {found.shards - found.stored} to make")
    say(f"size:     about {_size(found.bytes)} ({found.basis})")
    where = f"with {workers} worker{'s' * (workers > 1)}" if workers else "in this process"
    say(f"time:     about {duration(found.seconds)} {where}")


def _size(count: float) -> str:
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.1f} MiB"


def _leaderboard(table: pd.DataFrame, title: str) -> Table:
    """What fits a terminal; the files have the rest."""
    shown = Table(title=title)
    shown.add_column("method")
    for name in ("CD dB(m²)", "behind, dB", "F1 at 10 cm", "empty"):
        shown.add_column(name, justify="right")
    for place, row in enumerate(table.to_dict("records")):
        behind = "" if place == 0 else _range(row, "behind_db", 1)
        missing = str(row["empty"] + row["failed"])
        shown.add_row(row["method"], _range(row, "cd_db", 1), behind, f"{row['f1_10cm']:.2f}", missing)
    return shown


def _range(row: Mapping[Any, Any], name: str, digits: int) -> str:
    if math.isnan(row[f"{name}_lo"]):
        return f"{row[name]:.{digits}f}"
    return f"{row[name]:.{digits}f} [{row[f'{name}_lo']:.{digits}f}, {row[f'{name}_hi']:.{digits}f}]"
