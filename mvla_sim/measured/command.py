"""Measured data on the command line: ``mvla import``, ``synthesize``, ``process``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.readers.import_settings import import_settings
from mvla_sim.channel.readers.importing import import_channel
from mvla_sim.channel.synthesis import synthesize, write_campaign
from mvla_sim.channel.synthesis_settings import SynthesisSettings
from mvla_sim.errors import OutputError
from mvla_sim.files import atomic_output
from mvla_sim.imaging.volumes import export_image
from mvla_sim.measured.process import Processed, process
from mvla_sim.measured.process_settings import ProcessSettings, load_process
from mvla_sim.plot.figures import plot_image
from mvla_sim.plot.measured_figures import plot_measured, plot_volume
from mvla_sim.plot.pictures import draw_waterfall
from mvla_sim.plot.style import save_figure
from mvla_sim.settings import apply_overrides, parse

__all__ = ["RESULT", "import_file", "run_process", "write_sweeps"]

RESULT = "result.json"
_SHOWN = (
    ("length (m)", "length_m"),
    ("width (m)", "width_m"),
    ("aspect ratio", "aspect"),
    ("orientation (°)", "orientation_deg"),
)


def import_file(source: Path, output: Path, settings: Path | None, overrides: Sequence[str], out: Console) -> None:
    """Read foreign data and write a channel file; a source that ends in .toml is a file of settings."""
    if source.suffix.lower() == ".toml" and settings is None:
        chosen = import_settings(None, source, overrides)
    else:
        chosen = import_settings(source, settings, overrides)
    channel = import_channel(chosen)
    channel.save(output)
    if isinstance(channel, Cir):
        what = f"{channel.gain.size} paths"
    elif isinstance(channel, Components):
        what = f"{channel.range_m.size} components"
    else:
        what = (
            f"{channel.response.shape[1]} frequencies from {channel.start_hz / 1e9:.6g} GHz in steps of "
            f"{channel.step_hz / 1e6:.6g} MHz, unambiguous to {channel.unambiguous_range_m:.2f} m"
        )
    out.print(f"{output}: {channel.n_view} views, {what}", markup=False)
    for key in ("source.background", "source.calibration"):
        if key in channel.provenance:
            out.print(f"{key.removeprefix('source.')}: {channel.provenance[key]}", markup=False)


def write_sweeps(cir_file: Path, folder: Path, overrides: Sequence[str], out: Console) -> None:
    """Write a CIR file as the sweeps of a network analyser, one Touchstone file a view."""
    settings = parse(SynthesisSettings, apply_overrides({}, overrides), "synthesis settings")
    cir = Cir.load(cir_file)
    _make(folder)
    name = str(cir.config.get("name", cir_file.stem))
    files = write_campaign(synthesize(cir, settings), folder, name, cir.views.angles_deg)
    out.print(f"{folder}: {len(files)} Touchstone files; angles are those of the sensor", markup=False)


def run_process(file: Path, folder: Path | None, overrides: Sequence[str], out: Console) -> Path:
    """Process a measurement; write its files, figures and figures of merit, and return their folder."""
    settings = load_process(file, overrides)
    folder = folder or Path("results") / settings.name
    _make(folder)
    done = process(settings, folder)
    done.channel.save(folder / "channel.nc")
    done.image.save(folder / "image.nc")
    written = [folder / "channel.nc", folder / "image.nc", *_draw(done, settings, folder)]
    written += [export_image(done.image, folder / f"image.{suffix}") for suffix in settings.export]
    with atomic_output(folder / RESULT) as temporary:
        temporary.write_text(json.dumps(done.merit(), indent=1) + "\n", encoding="utf-8")
    written.append(folder / RESULT)
    _print(done, settings, out)
    for path in written:
        out.print(f"wrote:    {path}", markup=False)
    return folder


def _draw(done: Processed, settings: ProcessSettings, folder: Path) -> list[Path]:
    outline = None if done.truth is None else done.truth.outline
    pictures = []
    flat = done.image.grid.counts[2] == 1
    pictures.append(folder / ("image.png" if flat else "volume.png"))
    if done.occupied is None:
        figure = plot_image(done.image)
    elif flat:
        figure = plot_measured(done.image, done.occupied, outline, done.box, settings.description)
    else:
        meshes = () if done.truth is None else [item.mesh for item in done.truth.objects]
        figure = plot_volume(done.image, done.occupied, meshes, settings.description)
    save_figure(figure, pictures[-1])
    if not isinstance(done.channel, Components):
        pictures.append(folder / "waterfall.png")
        draw_waterfall(done.channel, pictures[-1], settings.imaging)
    return pictures


def _print(done: Processed, settings: ProcessSettings, out: Console) -> None:
    """Print boxes and scores beside those of the target."""
    if done.box is not None:
        boxes = [box for box in (done.box, done.truth_box) if box is not None]
        table = Table("", "result", *(["target"] if len(boxes) == 2 else []), title=settings.name)
        for label, name in _SHOWN:
            table.add_row(label, *(f"{getattr(box, name):.3g}" for box in boxes))
        out.print(table)
    if done.evaluation is not None:
        scores = done.evaluation.scores
        out.print(
            f"CD {scores.cd_db:.1f} dB(m²), result to outline {100 * scores.accuracy_m:.1f} cm, outline to result "
            f"{100 * scores.completeness_m:.1f} cm ({done.evaluation.protocol} thresholds)",
            markup=False,
        )
    out.print("seconds:  " + ", ".join(f"{stage} {value:.2f}" for stage, value in done.seconds.items()), markup=False)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made ({error.strerror or error})") from error
