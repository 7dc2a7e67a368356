"""``mvla simulate`` and ``mvla scene``: from a scene to its channel, picture or export."""

from __future__ import annotations

from typing import Annotated

import typer

from mvla_sim.cli.options import Output, Overrides, check_output, note, say

__all__ = ["channel_app", "scene_app"]

channel_app = typer.Typer()
scene_app = typer.Typer(help="Look at scenes and export them.")

SceneFile = Annotated[str, typer.Argument(help="A scene file (TOML), or the name of one that comes along: star.")]


@channel_app.command()
def simulate(
    scene: SceneFile,
    output: Output,
    overrides: Overrides = None,
    cache: Annotated[bool, typer.Option("--cache/--no-cache", help="Reuse a result traced before.")] = True,
) -> None:
    """Trace a scene from every view and write its channel impulse responses (NetCDF-4)."""
    from mvla_sim.scene.world import Scene

    check_output(output, ".nc")
    loaded = Scene.load(scene, overrides or [])
    from mvla_sim.channel.simulate import simulate as trace

    cir = trace(loaded, cache=cache)
    cir.save(output)
    empty = int((cir.row_size == 0).sum())
    if empty:
        note(f"note: {empty} of {cir.n_view} views have no path; they are kept as empty rows")
    near, far = cir.range_m.min(), cir.range_m.max()
    say(f"{output}: {cir.n_view} views, {cir.gain.size} paths, ranges {near:.2f} to {far:.2f} m")


@scene_app.command(name="show")
def scene_show(scene: SceneFile, output: Output, overrides: Overrides = None) -> None:
    """Draw a scene's outline, trajectory and ground truth (PNG, PDF, SVG)."""
    check_output(output, ".png", ".pdf", ".svg")
    from mvla_sim.pictures.file_pictures import draw_scene

    draw_scene(scene, output, overrides or [])
    say(str(output))


@scene_app.command(name="export")
def scene_export(scene: SceneFile, output: Output, overrides: Overrides = None) -> None:
    """Write a scene as Mitsuba XML with PLY meshes, for ``sionna.rt.load_scene``."""
    check_output(output, ".xml")
    from mvla_sim.scene.mitsuba_xml import export_mitsuba
    from mvla_sim.scene.world import Scene

    say(str(export_mitsuba(Scene.load(scene, overrides or []), output)))
