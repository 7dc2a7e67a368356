"""Commands of ``mvla``. Heavy modules are imported inside the commands that need them, so that help is quick."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from mvla_sim import __version__
from mvla_sim.cli.datasets import dataset_app
from mvla_sim.cli.options import CacheUrl, Output, Overrides, Scheduler, Workers, errors, note, out
from mvla_sim.errors import ConfigError, MvlaError
from mvla_sim.interrupt import INTERRUPTED

__all__ = ["app", "run"]

app = typer.Typer(
    name="mvla",
    help="Phase-free geometry reconstruction from radio channels: trace, image, score, sweep.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
scene_app = typer.Typer(help="Look at scenes and export them.")
app.add_typer(scene_app, name="scene")
app.add_typer(dataset_app, name="dataset")

SceneFile = Annotated[Path, typer.Argument(help="A scene file (TOML), as in scenes/.")]


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code; errors of the package are one line and code 2."""
    if arguments in ([], ["scene"], ["dataset"]):
        arguments = [*arguments, "--help"]
    try:
        code = app(arguments, standalone_mode=False)
    except TyperException as error:
        errors.print(f"mvla: error: {error.format_message()}", markup=False)
        return 2
    except MvlaError as error:
        errors.print(f"mvla: error: {error}", markup=False)
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except MemoryError as error:
        errors.print(f"mvla: error: out of memory ({error}); use a coarser grid or fewer rays", markup=False)
        return 2
    if code == INTERRUPTED:  # Typer turns Ctrl-C into this code and says nothing
        errors.print("mvla: stopped; finished files are whole, nothing half-written is left", markup=False)
    return code if isinstance(code, int) else 0


def _version(value: bool) -> None:
    if value:
        out.print(f"mvla-sim {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    del version


@app.command()
def doctor() -> None:
    """Check this machine: backend, libLLVM, packages, memory, and a one-ray smoke trace."""
    from mvla_sim.engine.doctor import report

    raise typer.Exit(report(out))


@app.command()
def settings() -> None:
    """List every setting with its default and meaning."""
    from rich.table import Table

    from mvla_sim.cli.listing import settings_of

    for block, entries in settings_of().items():
        table = Table("key", "default", "meaning", title=f"{block} settings", title_justify="left")
        for entry in entries:
            table.add_row(*entry)
        out.print(table)


@app.command()
def simulate(
    scene: SceneFile,
    output: Output,
    overrides: Overrides = None,
    cache: Annotated[bool, typer.Option("--cache/--no-cache", help="Reuse a result traced before.")] = True,
) -> None:
    """Trace a scene from every view and write its channel impulse responses (NetCDF-4)."""
    from mvla_sim.scene.world import Scene

    _check_output(output, (".nc",))
    loaded = Scene.load(scene, overrides or [])
    from mvla_sim.channel.simulate import simulate as trace

    cir = trace(loaded, cache=cache)
    cir.save(output)
    empty = int((cir.row_size == 0).sum())
    if empty:
        errors.print(
            f"mvla: note: {empty} of {cir.n_view} views have no path; they are kept as empty rows", markup=False
        )
    near, far = cir.range_m.min(), cir.range_m.max()
    out.print(f"{output}: {cir.n_view} views, {cir.gain.size} paths, ranges {near:.2f} to {far:.2f} m", markup=False)


@app.command()
def image(
    cir_file: Annotated[Path, typer.Argument(metavar="CHANNEL.nc", help="A CIR file, or another of mvla import.")],
    output: Output,
    method: Annotated[str | None, typer.Option(help="mvla-gr, mvla-hard, bp, or file.py:function.")] = None,
    snr: Annotated[str | None, typer.Option(help="SNR in dB, or 'none' for no noise.")] = None,
    interval: Annotated[float | None, typer.Option(help="Use a view every so many degrees.")] = None,
    offset: Annotated[int | None, typer.Option(help="First view used.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the noise.")] = None,
    threshold: Annotated[str | None, typer.Option(help="auto: also a binary image, without the truth.")] = None,
    overrides: Overrides = None,
) -> None:
    """Reconstruct an image from a CIR file, or from imported data."""
    from mvla_sim.imaging.imaging_settings import imaging_settings

    _check_output(output, (".nc",))
    given = {
        "method": method,
        "snr_db": _number(snr, "--snr"),
        "interval_deg": interval,
        "offset": offset,
        "seed": seed,
        "threshold": threshold,
    }
    settings = imaging_settings(overrides or [], **{k: v for k, v in given.items() if v is not None})
    from mvla_sim.channel.loading import load_channel
    from mvla_sim.imaging.pipeline import reconstruct

    result = reconstruct(load_channel(cir_file), settings)
    result.save(output)
    nx, ny, nz = result.grid.counts
    out.print(f"{output}: {settings.method}, {result.n_view} views, {nx} × {ny} × {nz} voxels")


@app.command()
def evaluate(
    image_file: Annotated[Path, typer.Argument(metavar="IMAGE.nc", help="An image file.")],
    truth: Annotated[str | None, typer.Option(help="contour or filled.")] = None,
    top_percent: Annotated[float | None, typer.Option(help="p in per cent; by default the optimum.")] = None,
    min_support: Annotated[float | None, typer.Option(help="T_θ in degrees, with --top-percent.")] = None,
    threshold: Annotated[str | None, typer.Option(help="auto: thresholds from the image, without the truth.")] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    overrides: Overrides = None,
) -> None:
    """Score an image against its target: Chamfer distance, F1 and more, at given or at optimal thresholds."""
    from mvla_sim.imaging.imaging_settings import EvaluationSettings
    from mvla_sim.settings import apply_overrides, parse

    if min_support is not None and top_percent is None:
        raise ConfigError(f"--min-support {min_support:g}: give --top-percent with it")
    if threshold is not None and top_percent is not None:
        raise ConfigError(f"--threshold {threshold} and --top-percent {top_percent:g}: give one of them")
    data: dict[str, Any] = {} if truth is None else {"truth": truth}
    if threshold is not None:
        data["threshold"] = threshold
    if top_percent is not None:
        data["threshold"] = {"top_percent": top_percent, "min_support_deg": min_support or 0.0}
    settings = parse(EvaluationSettings, apply_overrides(data, overrides or []), "evaluation settings")
    from mvla_sim.evaluation.evaluate import evaluate as score_image
    from mvla_sim.imaging.image import Image

    row = score_image(Image.load(image_file), settings).as_dict()
    if json_output:
        import json
        import math

        finite = {k: str(v) if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
        out.print(json.dumps(finite, indent=2), markup=False)
        return
    from rich.table import Table

    table = Table("metric", "value", title=str(image_file))
    for key, value in row.items():
        table.add_row(key, f"{value:.4g}" if isinstance(value, float) else str(value))
    out.print(table)


@app.command()
def plot(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="One CIR file, or one or more image files.")],
    output: Output,
    overrides: Overrides = None,
) -> None:
    """Draw a CIR file's PDP waterfall with its peaks, or images with their optimal reconstruction (PNG, PDF, SVG)."""
    from mvla_sim.plot.pictures import draw

    _check_output(output, (".png", ".pdf", ".svg"))
    draw(files, output, overrides or [])
    out.print(str(output), markup=False)


@app.command(name="run")
def run_experiment(
    experiment: Annotated[Path, typer.Argument(help="An experiment file (TOML), as in experiments/.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder; default results/NAME.")] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show what would run, and about how long, and stop.")
    ] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    cache_url: CacheUrl = None,
    yes: Annotated[bool, typer.Option("--yes", help="Run even very many cases.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard the cases stored in the folder.")] = False,
    overrides: Overrides = None,
) -> None:
    """Run the cases of an experiment that are not stored yet; write its table and pictures.

    Every finished case is stored at once, so a run can be stopped at any time and goes on when it is started again.
    Tables are written as CSV and as Parquet.
    """
    from mvla_sim.cluster.opening import open_cluster
    from mvla_sim.engine.cache import shared_cache
    from mvla_sim.engine.machine import core_count
    from mvla_sim.paper.experiments import execute, show_plan
    from mvla_sim.sweep.experiment import load_experiment
    from mvla_sim.sweep.plan import CASE_LIMIT, expand

    settings = load_experiment(experiment, overrides or [])
    folder = output or Path("results") / settings.name
    plan = expand(settings, folder, None if yes else CASE_LIMIT)
    with shared_cache(cache_url), open_cluster(workers, scheduler, note) as cluster:
        if dry_run:  # no worker starts before it is needed
            show_plan(plan, folder, core_count() if workers is None else max(1, workers), out)
            return
        code = execute(plan, folder, out, errors, cluster=cluster, fresh=fresh)
    raise typer.Exit(code)


@app.command(name="import")
def import_data(
    source: Annotated[
        Path,
        typer.Argument(help="Folder of .s1p/.s2p files, .mat, .npz, .h5, .nc, .csv, .p2m, DeepMIMO folder, or a TOML."),
    ],
    output: Output,
    settings: Annotated[Path | None, typer.Option("--settings", help="TOML file of import settings.")] = None,
    overrides: Overrides = None,
) -> None:
    """Read measured data, or another program's paths, into a channel file (NetCDF-4) that mvla image takes."""
    from mvla_sim.measured.command import import_file

    _check_output(output, (".nc",))
    import_file(source, output, settings, overrides or [], out)


@app.command()
def synthesize(
    cir_file: Annotated[Path, typer.Argument(metavar="CIR.nc", help="A CIR file of mvla simulate.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the Touchstone files.")],
    overrides: Overrides = None,
) -> None:
    """Write a CIR as a laboratory's sweeps: noise, drifting phase, leakage, static echoes; one .s2p file a view."""
    from mvla_sim.measured.command import write_sweeps

    write_sweeps(cir_file, output, overrides or [], out)


@app.command()
def process(
    file: Annotated[Path, typer.Argument(help="A TOML file with [import] or scene, as experiments/vehicle.toml.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder; default results/NAME.")] = None,
    overrides: Overrides = None,
) -> None:
    """Measured data in one go: import, image, threshold, pictures, bounding box and, with a truth, scores."""
    from mvla_sim.measured.command import run_process

    run_process(file, output, overrides or [], out)


@app.command()
def export(
    image_file: Annotated[Path, typer.Argument(metavar="IMAGE.nc", help="An image file.")],
    output: Output,
) -> None:
    """Export an image: .vtk (ParaView: scores, Θ, binary result) or .ply (surface of the binary result)."""
    from mvla_sim.imaging.image import Image
    from mvla_sim.imaging.volumes import export_image

    _check_output(output, (".vtk", ".ply"))
    out.print(str(export_image(Image.load(image_file), output)), markup=False)


ResultsFolder = Annotated[Path, typer.Option("--output", "-o", help="Folder of the results.")]


@app.command()
def reproduce(
    output: ResultsFolder = Path("results"),
    experiments: Annotated[Path, typer.Option(help="Folder with the experiment files.")] = Path("experiments"),
    quick: Annotated[bool, typer.Option("--quick", help="One noise seed, no sensitivity study.")] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    cache_url: CacheUrl = None,
) -> None:
    """Run every experiment of the paper that is not stored yet, judge its claims, and write the report."""
    from mvla_sim.cluster.opening import open_cluster
    from mvla_sim.engine.cache import shared_cache
    from mvla_sim.paper.reproduce import reproduce as run_all

    with shared_cache(cache_url), open_cluster(workers, scheduler, note) as cluster:
        code = run_all(experiments, output, out, errors, quick=quick, cluster=cluster)
    raise typer.Exit(code)


@app.command()
def report(output: ResultsFolder = Path("results")) -> None:
    """Build figures, claims and the report page from stored results."""
    from mvla_sim.paper.report import write_report

    out.print(str(write_report(output)), markup=False)


@app.command()
def bench(
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for bench.json, bench.csv and bench.md.")
    ] = Path("results/bench"),
    quick: Annotated[bool, typer.Option("--quick", help="Few and small points; a minute and a half.")] = False,
    stage: Annotated[
        list[str] | None,
        typer.Option(
            help="tracing, projection, search or sweep; default all: the estimate needs them. May be repeated."
        ),
    ] = None,
    scenes: Annotated[int, typer.Option(help="Of the estimate: scenes, each imaged once.")] = 1_000_000,
    views: Annotated[int, typer.Option(help="Of the estimate: views of a scene.")] = 360,
    nodes: Annotated[int, typer.Option(help="Of the estimate: nodes.")] = 64,
    cores: Annotated[int, typer.Option(help="Of the estimate: cores a node.")] = 32,
) -> None:
    """Measure how cost grows with rays, views, facets, voxels, thresholds and workers; estimate a large campaign."""
    from mvla_sim.bench.estimate import Campaign
    from mvla_sim.cli.bench import bench as measure

    campaign = Campaign(scenes=scenes, views=views, nodes=nodes, cores=cores)
    measure(output, out, errors, quick=quick, stages=stage or (), campaign=campaign)


@scene_app.command(name="show")
def scene_show(scene: SceneFile, output: Output, overrides: Overrides = None) -> None:
    """Draw a scene's outline, trajectory and ground truth (PNG, PDF, SVG)."""
    _check_output(output, (".png", ".pdf", ".svg"))
    from mvla_sim.plot.pictures import draw_scene

    draw_scene(scene, output, overrides or [])
    out.print(str(output), markup=False)


@scene_app.command(name="export")
def scene_export(scene: SceneFile, output: Output, overrides: Overrides = None) -> None:
    """Write a scene as Mitsuba XML with PLY meshes, for ``sionna.rt.load_scene``."""
    _check_output(output, (".xml",))
    from mvla_sim.scene.mitsuba_xml import export_mitsuba
    from mvla_sim.scene.world import Scene

    out.print(str(export_mitsuba(Scene.load(scene, overrides or []), output)), markup=False)


def _check_output(path: Path, suffixes: tuple[str, ...]) -> None:
    """Refuse an output that cannot be written, before anything is computed."""
    from mvla_sim.files import check_writable

    if path.suffix.lower() not in suffixes:
        raise ConfigError(f"-o {path}: the name must end in {' or '.join(suffixes)}")
    check_writable(path)


def _number(text: str | None, option: str) -> float | str | None:
    """Return a number, 'none', or nothing."""
    if text is None or text.lower() == "none":
        return None if text is None else "none"
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{option} {text}: must be a number or 'none'") from None
