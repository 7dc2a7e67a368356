"""``mvla``: its commands, and its errors in one line."""

from __future__ import annotations

import warnings
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from mvla_sim import __version__
from mvla_sim.cli.dataset_commands import dataset_app
from mvla_sim.cli.image_commands import image_app
from mvla_sim.cli.machine_commands import machine_app
from mvla_sim.cli.measured_commands import measured_app
from mvla_sim.cli.options import note, option_for, out
from mvla_sim.cli.scene_commands import channel_app, scene_app
from mvla_sim.cli.sweep_commands import sweep_app
from mvla_sim.cluster.dask_settings import readable_configuration
from mvla_sim.errors import MvlaError, MvlaWarning
from mvla_sim.interrupt import INTERRUPTED

__all__ = ["app", "run"]

app = typer.Typer(
    name="mvla",
    help="Phase-free geometry reconstruction from radio channels: trace, image, score, sweep.",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for part in (machine_app, channel_app, image_app, sweep_app, measured_app):
    app.add_typer(part)
app.add_typer(scene_app, name="scene")
app.add_typer(dataset_app, name="dataset")


def run(arguments: list[str]) -> int:
    """Run the command line and return its exit code; errors of the package are one line and code 2."""
    if arguments in ([], ["scene"], ["dataset"]):
        arguments = [*arguments, "--help"]
    shown = warnings.showwarning
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if issubclass(category, MvlaWarning):
            if str(message) not in told:  # a scene may be built more than once
                told.add(str(message))
                note(f"note: {message}")
        else:
            shown(message, category, *place)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", MvlaWarning)
            warnings.showwarning = show  # type: ignore[assignment]
            with readable_configuration():
                code = app(arguments, prog_name="mvla", standalone_mode=False)
    except TyperException as error:
        note(f"error: {error.format_message()}")
        return 2
    except MvlaError as error:
        note(f"error: {error}{option_for(error)}")
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except MemoryError as error:
        note(f"error: out of memory ({error}); use a coarser grid or fewer rays")
        return 2
    if code == INTERRUPTED:  # Typer turns Ctrl-C into this code and says nothing
        note("stopped; finished files are whole, nothing half-written is left")
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
