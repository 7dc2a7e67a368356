"""``mvla import``, ``synthesize`` and ``process``: measured data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table

from mvla_sim.cli.options import Output, Overrides, check_output, say, show, wrote

if TYPE_CHECKING:
    from mvla_sim.measured.process import Processed

__all__ = ["measured_app", "show_processed"]

measured_app = typer.Typer()

SHOWN: Final = {
    "length (m)": "length_m",
    "width (m)": "width_m",
    "aspect ratio": "aspect",
    "orientation (°)": "orientation_deg",
}


@measured_app.command(name="import")
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
    from mvla_sim.channel.importing import import_channel, import_settings
    from mvla_sim.channel.overview import overview

    check_output(output, ".nc")
    if source.suffix.lower() == ".toml" and settings is None:
        chosen = import_settings(None, source, overrides or [])
    else:
        chosen = import_settings(source, settings, overrides or [])
    channel = import_channel(chosen)
    channel.save(output)
    say(f"{output}: {channel.summary}")
    for line in overview(channel):
        say(line)
    for key in ("source.background", "source.calibration"):
        if key in channel.provenance:
            say(f"{key.removeprefix('source.')}: {channel.provenance[key]}")


@measured_app.command()
def synthesize(
    cir_file: Annotated[Path, typer.Argument(metavar="CIR.nc", help="A CIR file of mvla simulate.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the Touchstone files.")],
    overrides: Overrides = None,
) -> None:
    """Write a CIR as a laboratory's sweeps: noise, drifting phase, leakage, static echoes; one .s2p file a view."""
    from mvla_sim.channel.cir import Cir
    from mvla_sim.channel.synthesis import SynthesisSettings, write_sweeps
    from mvla_sim.channel.synthesis import synthesize as measure
    from mvla_sim.files import make_folder
    from mvla_sim.settings import apply_overrides, parse

    settings = parse(SynthesisSettings, apply_overrides({}, overrides or []), "synthesis settings")
    cir = Cir.load(cir_file)
    name = str(cir.config.get("name", cir_file.stem))
    files = write_sweeps(measure(cir, settings), make_folder(output), name, cir.views.angles_deg)
    say(f"{output}: {len(files)} Touchstone files; angles are those of the sensor")


@measured_app.command()
def process(
    file: Annotated[
        str, typer.Argument(help="A TOML file with [import] or scene, or the name of one that comes along: vehicle.")
    ],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder; default results/NAME.")] = None,
    overrides: Overrides = None,
) -> None:
    """Measured data in one go: import, image, threshold, pictures, bounding box and, with a truth, scores."""
    from mvla_sim.files import make_folder
    from mvla_sim.measured.process import load_process
    from mvla_sim.measured.process import process as run_stages
    from mvla_sim.measured.process_files import write_processed

    settings = load_process(file, overrides or [])
    folder = make_folder(output or Path("results") / settings.name)
    done = run_stages(settings, folder)
    show_processed(settings.name, done, write_processed(done, settings, folder))


def show_processed(name: str, done: Processed, files: Sequence[Path]) -> None:
    """Print boxes and scores beside those of the target, and the files that were written."""
    boxes = {"result": done.box, "target": done.truth_box if done.box is not None else None}
    known = {head: box for head, box in boxes.items() if box is not None}
    if known:
        table = Table("", *known, title=name)
        for label, key in SHOWN.items():
            table.add_row(label, *(f"{getattr(box, key):.3g}" for box in known.values()))
        show(table)
    if done.evaluation is not None:
        scores = done.evaluation.scores
        say(
            f"CD {scores.cd_db:.1f} dB(m²), result to outline {100 * scores.accuracy_m:.1f} cm, outline to result "
            f"{100 * scores.completeness_m:.1f} cm ({done.evaluation.protocol} thresholds)"
        )
    say("seconds:  " + ", ".join(f"{stage} {value:.2f}" for stage, value in done.seconds.items()))
    wrote(*files)
