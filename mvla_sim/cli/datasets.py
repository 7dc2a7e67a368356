"""Commands of ``mvla dataset``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mvla_sim.cli.options import CacheUrl, Overrides, Scheduler, errors, note, out

__all__ = ["dataset_app"]

dataset_app = typer.Typer(help="Build, check, export and score benchmark datasets.")

FewWorkers = Annotated[int, typer.Option(min=0, help="Worker processes; by default everything runs in this one.")]
DatasetFolder = Annotated[Path, typer.Argument(metavar="DIR", help="A dataset's directory.")]


@dataset_app.command(name="build")
def dataset_build(
    campaign: Annotated[Path, typer.Argument(help="A campaign file (TOML), as experiments/benchmark-small.toml.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Directory of the dataset.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say how many samples, bytes and hours; stop.")] = False,
    workers: FewWorkers = 0,
    scheduler: Scheduler = None,
    cache_url: CacheUrl = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Try failed samples again.")] = False,
    overrides: Overrides = None,
) -> None:
    """Build a dataset from a campaign file, or what is missing of it, and write its card.

    Every finished shard is whole on the disk, so a build can be stopped at any time and goes on when started again.
    """
    from mvla_sim.cli.dataset import build

    places: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "cache_url": cache_url}
    code = build(campaign, output, overrides or [], out, errors, dry_run=dry_run, retry_failed=retry_failed, **places)
    raise typer.Exit(code)


@dataset_app.command(name="verify")
def dataset_verify(
    folder: DatasetFolder,
    recompute: Annotated[int, typer.Option(min=0, help="How many samples are made again and compared.")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="Decides which.")] = 0,
) -> None:
    """Check a dataset: schema, checksums, counts, splits, truth, and a random few samples made again."""
    from mvla_sim.cli.dataset import check

    raise typer.Exit(check(folder, recompute, seed, out, errors))


@dataset_app.command(name="export")
def dataset_export(
    folder: DatasetFolder,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the scenarios (npz), or file (mat).")],
    form: Annotated[str, typer.Option("--format", help="npz (DeepMIMO v4) or mat (MATLAB).")] = "npz",
    split: Annotated[str | None, typer.Option(help="train, validation or test; by default all.")] = None,
) -> None:
    """Export a dataset for DeepMIMO or MATLAB."""
    from mvla_sim.cli.dataset import export_dataset

    export_dataset(folder, form, output, split, out)


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
    workers: FewWorkers = 0,
    scheduler: Scheduler = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Compute again what is there.")] = False,
    overrides: Overrides = None,
) -> None:
    """Score methods on the test split, with thresholds from the validation split, and show the leaderboard."""
    from mvla_sim.cli.score import score
    from mvla_sim.cluster.opening import open_cluster

    with open_cluster(_workers(workers, scheduler), scheduler, note) as cluster:
        code = score(
            folder, method, overrides or [], out, errors,
            label=label, output=output, cluster=cluster, fresh=fresh,
        )  # fmt: skip
    raise typer.Exit(code)


def _workers(workers: int, scheduler: str | None) -> int | None:
    """By default no other process; none are asked for where there is a scheduler."""
    return None if scheduler is not None and workers == 0 else workers
