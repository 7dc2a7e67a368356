"""``mvla image``, ``evaluate``, ``plot`` and ``export``: from a channel to an image, its score and its pictures."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

import mvla_sim
from mvla_sim.cli.options import Output, Overrides, Reading, check_output, say, show
from mvla_sim.errors import ConfigError

__all__ = ["image_app"]

image_app = typer.Typer()


def _methods() -> str:
    """Names of this package's methods, from the text of their modules: importing them would make help slow."""
    files = sorted((Path(mvla_sim.__file__).parent / "imaging" / "methods").glob("*.py"))
    found = [re.search(r'^    name: ClassVar\[str\] = "(.+)"$', file.read_text("utf-8"), re.M) for file in files]
    return ", ".join(match[1] for match in found if match is not None)


@image_app.command()
def image(
    cir_file: Annotated[Path, typer.Argument(metavar="CHANNEL.nc", help="A CIR file, or another of mvla import.")],
    output: Output,
    method: Annotated[
        str | None, typer.Option(help=f"{_methods()}, one of an installed package, or file.py:function.")
    ] = None,
    snr_db: Annotated[str | None, typer.Option("--snr", "--snr-db", help="SNR in dB, or 'none' for no noise.")] = None,
    interval_deg: Annotated[
        float | None, typer.Option("--interval", "--interval-deg", help="Use a view every so many degrees.")
    ] = None,
    offset: Annotated[int | None, typer.Option(help="First view used.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the noise.")] = None,
    threshold: Annotated[str | None, typer.Option(help="auto: also a binary image, without the truth.")] = None,
    reading: Reading = None,
    overrides: Overrides = None,
) -> None:
    """Reconstruct an image from a CIR file, or from imported data."""
    from mvla_sim.imaging.imaging_settings import imaging_settings

    check_output(output, ".nc")
    given: dict[str, Any] = {
        "method": method,
        "snr_db": _number(snr_db, "--snr"),
        "interval_deg": interval_deg,
        "offset": offset,
        "seed": seed,
        "threshold": threshold,
        "reading": reading,
    }
    settings = imaging_settings(overrides or [], **{k: v for k, v in given.items() if v is not None})
    from mvla_sim.channel.loading import load_channel
    from mvla_sim.imaging.pipeline import reconstruct

    result = reconstruct(load_channel(cir_file), settings)
    result.save(output)
    nx, ny, nz = result.grid.counts
    say(f"{output}: {settings.method}, {result.n_view} views, {nx} × {ny} × {nz} voxels")


@image_app.command()
def evaluate(
    image_file: Annotated[Path, typer.Argument(metavar="IMAGE.nc", help="An image file.")],
    truth: Annotated[str | None, typer.Option(help="contour or filled.")] = None,
    top_percent: Annotated[float | None, typer.Option(help="p in per cent; by default the optimum.")] = None,
    min_support_deg: Annotated[
        float | None, typer.Option("--min-support", "--min-support-deg", help="T_θ in degrees, with --top-percent.")
    ] = None,
    threshold: Annotated[str | None, typer.Option(help="auto: thresholds from the image, without the truth.")] = None,
    reading: Reading = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    overrides: Overrides = None,
) -> None:
    """Score an image against its target: Chamfer distance, F1 and more, at given or at optimal thresholds."""
    from mvla_sim.evaluation.evaluate import EvaluationSettings
    from mvla_sim.imaging.reading import on_reading
    from mvla_sim.settings import apply_overrides, parse

    if min_support_deg is not None and top_percent is None:
        raise ConfigError(f"--min-support {min_support_deg:g}: give --top-percent with it")
    if threshold is not None and top_percent is not None:
        raise ConfigError(f"--threshold {threshold} and --top-percent {top_percent:g}: give one of them")
    data: dict[str, Any] = {} if truth is None else {"truth": truth}
    if threshold is not None:
        data["threshold"] = threshold
    if top_percent is not None:
        data["threshold"] = {"top_percent": top_percent, "min_support_deg": min_support_deg or 0.0}
    data = apply_overrides(data, overrides or [])
    if reading is not None:
        data = on_reading(reading, {"evaluation": data})["evaluation"]
    settings = parse(EvaluationSettings, data, "evaluation settings")
    from mvla_sim.evaluation.evaluate import evaluate as score_image
    from mvla_sim.imaging.image import Image

    row = score_image(Image.load(image_file), settings).as_dict()
    if json_output:
        finite = {k: str(v) if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
        say(json.dumps(finite, indent=2))
        return
    table = Table("metric", "value", title=str(image_file))
    for key, value in row.items():
        table.add_row(key, f"{value:.4g}" if isinstance(value, float) else str(value))
    show(table)


@image_app.command()
def plot(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="One CIR file, or one or more image files.")],
    output: Output,
    overrides: Overrides = None,
) -> None:
    """Draw a CIR file's PDP waterfall with its peaks, or images with their binary image (PNG, PDF, SVG).

    The binary image is the one in the file or, where there is none, the best one, which the truth is needed for.
    """
    from mvla_sim.pictures.file_pictures import draw

    check_output(output, ".png", ".pdf", ".svg")
    draw(files, output, overrides or [])
    say(str(output))


@image_app.command()
def export(
    image_file: Annotated[Path, typer.Argument(metavar="IMAGE.nc", help="An image file.")],
    output: Output,
) -> None:
    """Export an image: .vtk (ParaView: scores, Θ, binary result) or .ply (surface of the binary result)."""
    from mvla_sim.imaging.image import Image
    from mvla_sim.imaging.volumes import export_image

    check_output(output, ".vtk", ".ply")
    say(str(export_image(Image.load(image_file), output)))


def _number(text: str | None, option: str) -> float | str | None:
    """Return a number, 'none', or nothing."""
    if text is None or text.lower() == "none":
        return None if text is None else "none"
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{option} {text}: must be a number or 'none'") from None
