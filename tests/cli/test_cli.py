"""The command line as a user meets it, in an empty folder; in a child process where that is what is tested."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest
import trimesh
import typer
from command_line import mvla

from mvla_sim.cli.app import app, run
from mvla_sim.errors import MvlaError
from mvla_sim.imaging.method import METHODS

SCENE = """
name = "small"
[[objects]]
shape = "square"
side_m = 2.0
[trajectory]
kind = "circle"
radius_m = 5.0
interval_deg = 30.0
[ray_tracing]
diffuse_rays = 500
specular_rays = 2000
"""
GRID = ["--set", "grid.size_m=[4, 4, 0]", "--set", "grid.spacing_m=0.1"]


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with a scene, its CIR file, and an image of each kind of method."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "small.toml").write_text(SCENE)
    mvla("simulate", "small.toml", "-o", "cir.nc", folder=folder)
    mvla("image", "cir.nc", "--snr", "20", *GRID, "-o", "mvla.nc", folder=folder)
    mvla(
        "image",
        "cir.nc",
        "--method",
        "bp",
        "--interval-deg",
        "60",
        "--offset",
        "1",
        *GRID,
        "-o",
        "bp.nc",
        folder=folder,
    )
    return folder


def commands(group, *path):
    """Every command and group of commands that the program has."""
    yield path
    for name, command in getattr(group, "commands", {}).items():
        yield from commands(command, *path, name)


COMMANDS = [*commands(typer.main.get_command(app))]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_help(capsys, command):
    """In words, and an option or argument each explained."""
    assert run([*command, "--help"]) == 0
    text = capsys.readouterr().out
    assert " ".join(["Usage: mvla", *command]) in text


def test_there_are_as_many_commands_as_ever():
    assert len(COMMANDS) >= 23  # 20 commands, the program, and two groups


def test_version_and_help_leave_nothing_behind(tmp_path):
    assert re.fullmatch(r"mvla-sim \d+\.\d+\.\d+\n", mvla("--version", folder=tmp_path))
    mvla("--help", folder=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_help_names_every_method(capsys):
    run(["image", "--help"])
    text = re.sub(r"\W+", "", capsys.readouterr().out)
    assert [name for name in METHODS.names() if name.replace("-", "") not in text] == []


def test_help_imports_nothing_heavy(tmp_path):
    """Only what traces may import Sionna; help needs none of the numerical packages."""
    code = (
        "import sys; from mvla_sim.cli.app import run; run(['--help']);"
        "heavy = ('sionna', 'mitsuba', 'drjit', 'numpy', 'xarray', 'matplotlib', 'trimesh');"
        "print([m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip().splitlines()[-1] == "[]"


def test_imaging_and_scoring_do_not_import_sionna(work):
    code = (
        "import sys; import mvla_sim as mv;"
        "s = mv.imaging_settings(grid={'size_m': [4, 4, 0], 'spacing_m': 0.1});"
        "mv.evaluate(mv.reconstruct(mv.Cir.load('cir.nc'), s));"
        "print('sionna' in sys.modules, 'mitsuba' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=work, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False False"


def test_scores(work):
    row = json.loads(mvla("evaluate", "mvla.nc", "--json", folder=work))
    assert row["protocol"] == "optimal"
    assert row["cd_db"] == row["optimal_cd_db"]
    assert row["cd_db"] < -10  # 10 dB is 0.3 m in both directions: far worse than any image of a 2 m square
    given = json.loads(
        mvla("evaluate", "mvla.nc", "--top-percent", "50", "--min-support-deg", "0", "--json", folder=work)
    )
    assert given["protocol"] == "given"
    assert given["cd_db"] >= row["cd_db"]
    assert "cd_db" in mvla("evaluate", "bp.nc", folder=work)


def test_automatic_thresholds_need_no_truth(work):
    """The binary image that is stored is that of the thresholds that ``evaluate`` finds again, and no oracle's."""
    mvla("image", "cir.nc", "--snr-db", "20", *GRID, "--threshold", "auto", "-o", "auto.nc", folder=work)
    row = json.loads(mvla("evaluate", "auto.nc", "--threshold", "auto", "--json", folder=work))
    assert row["protocol"] == "auto"
    with h5py.File(work / "auto.nc") as file:
        assert file["occupied"][:].sum() == row["n_reconstruction"]
    assert row["n_reconstruction"] > 0
    assert row["cd_db"] >= row["optimal_cd_db"]
    both = mvla("evaluate", "auto.nc", "--threshold", "auto", "--top-percent", "5", folder=work, code=2)
    assert "give one of them" in both
    assert "'otto' is no threshold rule; allowed: auto, given" in mvla(
        "evaluate", "auto.nc", "--threshold", "otto", folder=work, code=2
    )
    assert "otto" in mvla("image", "cir.nc", "--threshold", "otto", "-o", "otto.nc", folder=work, code=2)
    assert not (work / "otto.nc").exists()


def test_results_carry_their_settings(work):
    with h5py.File(work / "bp.nc") as file:
        config = json.loads(file.attrs["config"])
    assert config["imaging"]["method"] == "bp"
    assert config["imaging"]["views"] == {"interval_deg": 60.0, "offset": 1}
    assert config["simulation"]["objects"][0]["side_m"] == 2.0


def test_binary_image_is_written_with_thresholds(work):
    mvla("image", "cir.nc", "--set", "threshold.top_percent=2", *GRID, "-o", "binary.nc", folder=work)
    with h5py.File(work / "binary.nc") as file:
        assert file["occupied"][:].sum() == round(0.02 * 40 * 40)


def test_pictures(work):
    mvla("scene", "show", "small.toml", "-o", "scene.png", folder=work)
    mvla("plot", "cir.nc", "-o", "waterfall.svg", *GRID, folder=work)
    mvla("plot", "mvla.nc", "-o", "image.pdf", folder=work)
    mvla("plot", "mvla.nc", "bp.nc", "-o", "both.png", folder=work)
    assert (work / "scene.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (work / "waterfall.svg").read_bytes()[:600]
    assert (work / "image.pdf").read_bytes().startswith(b"%PDF")
    assert (work / "both.png").stat().st_size > 10_000


def test_scene_export(work):
    mvla("scene", "export", "small.toml", "-o", "small.xml", folder=work)
    assert (work / "small.xml").read_text().lstrip().startswith("<")


def test_experiment(work):
    (work / "tiny.toml").write_text(
        'name = "tiny"\nscenes = ["small.toml"]\n[imaging.grid]\nsize_m = [4, 4, 0]\nspacing_m = 0.1\n'
        '[axes]\ninterval_deg = [30, 60]\nmethod = ["mvla-gr", "bp"]\n'
    )
    assert re.search(r"cases: +4;", mvla("run", "tiny.toml", "--dry-run", folder=work))
    assert not (work / "results").exists()
    mvla("run", "tiny.toml", "--workers", "0", folder=work)
    lines = (work / "results" / "tiny" / "table.csv").read_text().splitlines()
    assert len(lines) == 5


def test_turntable_is_the_same_views(work):
    mvla("simulate", "small.toml", "--set", "trajectory={kind='turntable', sensor_m=[5, 0, 0], interval_deg=30}",
         "-o", "table.nc", folder=work)  # fmt: skip
    with h5py.File(work / "table.nc") as one, h5py.File(work / "cir.nc") as other:
        # the sensor turns clockwise in the target's frame: the same positions in another order
        a = np.round(one["position"][:], 6) + 0.0
        b = np.round(other["position"][:], 6) + 0.0
        assert {tuple(p) for p in a} == {tuple(p) for p in b}


BAD_SCENES = {
    "misspelt key": ("objects.0.sid_m=3", "sid_m.*did you mean 'side_m'"),
    "unknown table": ("radios.carrier_hz=1", "radios: unknown key.*allowed: .*radio"),
    "wrong type": ("objects.0.side_m=wide", "side_m = 'wide'.*number"),
    "negative size": ("objects.0.side_m=-1", "side_m = -1.*greater than 0"),
    "zero bandwidth": ("radio.bandwidth_hz=0", "bandwidth_hz = 0.*greater than 0"),
    "not a number": ("radio.carrier_hz=nan", "carrier_hz.*finite"),
    "interval": ("trajectory.interval_deg=7", "interval_deg = 7 does not divide 360.*allowed"),
    "sensor inside": ("trajectory.radius_m=0.5", "inside"),
    "plane above": ("plane_height_m=3", "-1.*1.*3"),
    "unknown material": ("objects.0.material=unobtainium", "unobtainium.*metal"),
    "no mechanism": (
        "ray_tracing={specular=false, diffuse=false, diffraction=false}", "at least one must be true",
    ),
    "no form": ("objects", "dotted.key=value"),
}  # fmt: skip


@pytest.mark.parametrize(("override", "message"), BAD_SCENES.values(), ids=BAD_SCENES)
def test_bad_scene_is_one_line(work, override, message):
    text = mvla("simulate", "small.toml", "--set", override, "-o", "bad.nc", folder=work, code=2)
    assert re.search(message, text), text
    assert not (work / "bad.nc").exists()


BAD_IMAGES = {
    "uneven interval": (["--interval", "45"], "45 does not divide.*allowed: 30"),
    "offset": (["--interval", "60", "--offset", "2"], "offset = 2.*0 to 1"),
    "method": (["--method", "magic"], "magic.*mvla-gr"),
    "snr": (["--snr", "loud"], "--snr loud: must be a number or 'none'"),
    "gate": (["--set", "pdp.gate_m=[20, 30]"], r"no path lies inside the range gate of 20.00 to 30.00 m.*m outside"),
    "grid too large": (["--set", "grid.spacing_m=1e-6"], "GiB are free; a spacing of"),
    "no peak": (["--set", "peaks.threshold_sigma=1e9"], "no peak in any of the 12 chosen views.*threshold_sigma"),
    "threshold": (["--set", "threshold.top_percent=0"], "top_percent = 0.*greater than 0"),
    "output kind": (["-o", "image.txt"], "must end in .nc"),
    "output folder": (["-o", "nowhere/image.nc"], "the folder nowhere does not exist"),
    "noise of bp": (["--method", "bp", "--set", "threshold={top_percent=1, min_support_deg=5}"], "no angular support"),
}


@pytest.mark.parametrize(("arguments", "message"), BAD_IMAGES.values(), ids=BAD_IMAGES)
def test_bad_imaging_is_one_line(work, arguments, message):
    before = set(work.iterdir())
    text = mvla("image", "cir.nc", "-o", "bad.nc", *arguments, folder=work, code=2)
    assert re.search(message, text), text
    assert set(work.iterdir()) == before  # nothing half-written, no temporary file


def test_bad_files_are_one_line(work, tmp_path):
    whole = (work / "cir.nc").read_bytes()
    for name, content, message in (
        ("missing.nc", None, "no such"),
        ("empty.nc", b"", "is empty"),
        ("text.nc", b"view,delay\n0,1\n", "not a readable NetCDF-4 file"),
        ("cut.nc", whole[: len(whole) // 2], "not a readable NetCDF-4 file"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        assert re.search(message, mvla("image", name, "-o", "out.nc", folder=tmp_path, code=2))
    shutil.copy(work / "cir.nc", tmp_path / "future.nc")
    with h5py.File(tmp_path / "future.nc", "a") as file:
        file.attrs["schema_version"] = 99
    assert "version 99; this program reads version 2" in mvla(
        "image", "future.nc", "-o", "o.nc", folder=tmp_path, code=2
    )
    assert "schema is" in mvla("evaluate", work / "cir.nc", folder=tmp_path, code=2)
    assert not (tmp_path / "out.nc").exists()


def test_bad_meshes_are_one_line(tmp_path):
    box = trimesh.creation.box((2, 2, 2))
    lid_and_wall_off = trimesh.Trimesh(
        box.vertices, box.faces[np.abs(box.face_normals[:, 0] - 1) > 1e-6], process=False
    )
    lid_and_wall_off.export(tmp_path / "open.ply")
    trimesh.creation.box((2000, 2000, 2000)).export(tmp_path / "millimetres.ply")
    (tmp_path / "empty.ply").write_bytes(b"")
    for file, message in (
        ("open.ply", "not watertight"),
        ("millimetres.ply", "scale = 0.001"),
        ("empty.ply", "is empty"),
        ("none.ply", "no such|does not exist"),
    ):
        (tmp_path / "scene.toml").write_text(f'name = "m"\n[[objects]]\nshape = "mesh"\nfile = "{file}"\n')
        text = mvla("simulate", "scene.toml", "-o", "m.nc", folder=tmp_path, code=2)
        assert re.search(message, text), text
        assert file in text


def test_target_outside_the_grid_says_how_far(work):
    mvla(
        "image", "cir.nc", "--set", "grid.size_m=[1, 4, 0]", "--set", "grid.spacing_m=0.1", "-o", "thin.nc", folder=work
    )
    text = mvla("evaluate", "thin.nc", folder=work, code=2)
    assert re.search(r"0\.50? m", text), text


TELLING = """
from mvla_sim.channel import raytrace
from mvla_sim.cli import main
trace = raytrace.ViewTracer.trace
def telling(*arguments, **named):
    found = trace(*arguments, **named)
    print("traced", flush=True)
    return found
raytrace.ViewTracer.trace = telling
main()
"""
"""The program, which says when a view is traced."""


def test_interrupt_keeps_finished_views(tmp_path):
    """Ctrl-C while tracing: exit code 130, no output under the final name, and the next run goes on."""
    (tmp_path / "long.toml").write_text(SCENE.replace("interval_deg = 30.0", "interval_deg = 0.25"))
    environment = os.environ | {"MVLA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", TELLING, "simulate", "long.toml", "-o", "long.nc"]
    child = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "traced\n"
    child.send_signal(signal.SIGINT)
    _, text = child.communicate(timeout=60)
    assert child.returncode == 130, text
    assert "run the same command to go on" in text
    assert not (tmp_path / "long.nc").exists()
    assert list((tmp_path / "cache" / "cir").glob("*.partial.nc"))


@pytest.mark.parametrize("delay_s", [0.05, 0.3, 0.6, 1.0])
def test_interrupt_at_any_moment_is_one_line(tmp_path, delay_s):
    """Ctrl-C while packages are still being loaded must not surface as their error, nor be swallowed."""
    (tmp_path / "long.toml").write_text(SCENE.replace("interval_deg = 30.0", "interval_deg = 0.25"))
    code = "import sys; from mvla_sim.cli import main; sys.stdout.write('up'); sys.stdout.flush(); main()"
    command = [sys.executable, "-c", code]
    child = subprocess.Popen(
        [*command, "simulate", "long.toml", "-o", "long.nc", "--no-cache"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert child.stdout.read(2) == "up"
    time.sleep(delay_s + 0.05)  # the handler is installed first of all
    child.send_signal(signal.SIGINT)
    _, text = child.communicate(timeout=60)
    assert child.returncode == 130, text
    assert "Traceback" not in text
    assert re.search("^mvla: (error: )?stopped", text, re.MULTILINE), text
    assert [file.name for file in tmp_path.iterdir()] == ["long.toml"]


def test_full_disk_is_one_line_and_leaves_nothing(work):
    """A file size limit stands for a full disk: HDF5 must not be what meets it."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({20_000}, {20_000}));"
    ignore = "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
    code = f"{limit}{ignore}import mvla_sim as mv; i = mv.Image.load('mvla.nc'); i.save('more.nc')"
    done = subprocess.run([sys.executable, "-c", code], cwd=work, capture_output=True,
                          text=True, check=False)  # fmt: skip
    assert "more.nc" in done.stderr.strip().splitlines()[-1]
    assert "OutputError" in done.stderr
    assert not (work / "more.nc").exists()
    assert not list(work.glob(".more*"))


def test_names_and_sizes_beyond_all_bounds_are_one_line(work):
    assert "too long" in mvla("image", "cir.nc", "-o", "n" * 300 + ".nc", folder=work, code=2)
    for setting, message in (("pdp.gate_m=[3, 1e9]", "gate_m.*GiB"), ("mvla.kappa=1e-9", "kappa.*times")):
        text = mvla("image", "cir.nc", "--set", setting, "-o", "g.nc", folder=work, code=2)
        assert re.search(message, text), text


def test_a_part_of_the_target_can_be_looked_at(work):
    zoom = ["--set", "grid.size_m=[1, 1, 0]", "--set", "grid.spacing_m=0.05"]
    mvla("image", "cir.nc", *zoom, "-o", "zoom.nc", folder=work)
    mvla("plot", "zoom.nc", "-o", "zoom.png", folder=work)
    assert (work / "zoom.png").stat().st_size > 1000


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "star-optimal"),
        ("reproduce",),
        ("dataset", "build", "benchmark-small", "-o", "out"),
        ("dataset", "score", "out"),
    ],
)
def test_whatever_takes_workers_takes_one_a_core_by_default(arguments, tmp_path, monkeypatch, capsys):
    def start(workers, out):
        raise MvlaError(f"{workers} worker processes are asked for")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mvla_sim.cluster.opening.core_count", lambda: 7)
    monkeypatch.setattr("mvla_sim.cluster.local_processes.LocalProcesses", start)
    assert run(list(arguments)) == 2
    assert capsys.readouterr().err.strip().endswith("7 worker processes are asked for")
    assert run([*arguments, "--workers", "3"]) == 2
    assert capsys.readouterr().err.strip().endswith("3 worker processes are asked for")
    assert list(tmp_path.iterdir()) == []
