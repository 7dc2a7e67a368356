"""Measured data from the command line: import, synthesize, process, export, and what is refused in one line."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest
import scipy.io
import trimesh

import mvla_sim as mv
from mvla_sim.channel.readers.touchstone_files import write_touchstone
from mvla_sim.cli.app import run
from mvla_sim.constants import SPEED_OF_LIGHT, range_to_delay
from mvla_sim.imaging.pipeline import observe

CAR_SCENE = """
name = "box"
[[objects]]
shape = "rectangle"
length_m = 3.0
width_m = 1.5
[trajectory]
kind = "turntable"
sensor_m = [8.0, 0.0, 0.0]
interval_deg = 30.0
pair_separation_m = 0.2
[radio.antenna]
kind = "horn"
azimuth_beamwidth_deg = 30.0
[ray_tracing]
diffuse_rays = 500
specular_rays = 3000
"""
PROCESS = """
name = "bench"
truth = "box.toml"
export = ["vtk"]
[measurement]
scene = "box.toml"
points = 401
snr_db = 40.0
cable_delay_s = 5e-9
system_gain_db = 7.0
reference_range_m = 8.0
reference_radius_m = 0.3
echoes = [{ range_m = 7.0, gain_db = -70.0 }]
[import.sweeps]
angle_pattern = "box_{angle}deg"
background = { file = "background.s2p", align_m = [0.7, 1.6] }
reference = { file = "reference.s2p", kind = "sphere", range_m = 8.0, radius_m = 0.3 }
[import.geometry]
radius_m = 8.0
pair_separation_m = 0.2
[import.antenna]
kind = "horn"
azimuth_beamwidth_deg = 30.0
[imaging]
mvla = { extent_m = 3.4 }
[imaging.grid]
size_m = [5, 5, 0]
spacing_m = 0.05
[imaging.threshold]
top_percent = 2.0
"""
ANGLES = np.arange(0.0, 360.0, 30.0)
FREQUENCY = np.linspace(34.5e9, 37.5e9, 201)
PLACE = ["--set", "geometry.radius_m=5", "--set", "extent_m=1.0"]
GRID = ["--set", "grid.size_m=[3, 3, 0]", "--set", "grid.spacing_m=0.05"]


def mvla(capsys, *arguments, code=0):
    """Run ``mvla`` in this process; on an error, check that it is one line. Return what it printed."""
    assert run([str(a) for a in arguments]) == code, capsys.readouterr()
    printed = capsys.readouterr()
    if code:
        lines = printed.err.strip().splitlines()
        assert len(lines) == 1, printed.err
        assert lines[0].startswith("mvla: error: ")
        return lines[0]
    return printed.out + printed.err


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A processed measurement: a plate-sided box made into a laboratory's files and imaged from those alone."""
    place = tmp_path_factory.mktemp("bench")
    (place / "box.toml").write_text(CAR_SCENE)
    (place / "bench.toml").write_text(PROCESS)
    assert run(["process", str(place / "bench.toml"), "-o", str(place / "out")]) == 0
    return place


def write_sweeps(place, ranges_m=lambda _: 5.0, frequency=FREQUENCY, angles=ANGLES, name="car_{:03.0f}"):
    """One echo of gain 1 a view, as .s2p files."""
    place.mkdir(exist_ok=True)
    for angle in angles:
        s = np.zeros((frequency.size, 2, 2), complex)
        s[:, 1, 0] = np.exp(-2j * np.pi * frequency * range_to_delay(ranges_m(angle)))
        write_touchstone(place / (name.format(angle) + ".s2p"), frequency, s)
    return place


def test_a_laboratorys_files_become_an_image_of_the_target(bench):
    """Through drift, leakage and a static echo of the target's own range the box is where it stands."""
    result = json.loads((bench / "out" / "result.json").read_text())
    assert result["views"] == 12
    assert result["accuracy_m"] < 0.15  # three range cells: the arcs of 12 views reach beyond the corners
    assert result["orientation_error_deg"] < 10
    assert result["target_length_m"] == pytest.approx(3.0)
    assert abs(result["result_length_m"] - 3.0) < 0.6  # two arcs' ends
    channel = mv.load_channel(bench / "out" / "channel.nc")
    assert channel.provenance["importer"] == "touchstone"
    cable_ns = float(channel.provenance["source.calibration"].split()[0])
    assert cable_ns == pytest.approx(5.0, abs=0.05)  # 7 mm: noise, and the sphere is seen by a pair 0.2 m apart
    assert str(bench) not in json.dumps(dict(channel.config)), "no folder of the machine is kept"
    for name in ("image.png", "waterfall.png", "image.vtk", "image.nc"):
        assert (bench / "out" / name).stat().st_size > 1000


def test_calibrated_levels_are_path_gains(bench):
    """The flash of a side at right angles: the plate's λ/(8πR), R = 8 − 0.75 m; the calibration takes the horns out."""
    channel = mv.load_channel(bench / "out" / "channel.nc")
    settings = mv.imaging_settings(grid={"size_m": [5, 5, 0]})
    front = observe(channel, settings).front
    side = int(np.argmin(abs(channel.views.angles_deg - 90)))
    peak = front.pdp.power[side].argmax()
    assert front.pdp.range_m[peak] == pytest.approx(7.25, abs=0.03)
    expected = 20 * np.log10(SPEED_OF_LIGHT / 36e9 / (8 * np.pi * 7.25))
    # Edges of the 3 m side and of its 2 m height diffract into the same cell, and the wall is no infinite plate.
    assert 10 * np.log10(front.pdp.power[side, peak]) == pytest.approx(expected, abs=2.0)


def test_import_image_export(folder, capsys):
    write_sweeps(folder / "sweeps", lambda a: 5 - np.cos(np.deg2rad(a)))  # a point at (1, 0) on a turntable
    text = mvla(capsys, "import", "sweeps", "-o", "c.nc", *PLACE, "--set", "sweeps.angle_pattern=car_{angle}")
    assert "12 views, 201 frequencies" in text
    mvla(capsys, "image", "c.nc", "-o", "i.nc", *GRID, "--set", "threshold.top_percent=0.1")
    image = mv.Image.load("i.nc")
    iy, ix = np.unravel_index(image.score[0].argmax(), image.score[0].shape)
    x, y, _ = image.grid.axes()
    # The echo's range is that of a point 1 m off the axis to first order; 1/2R of curvature is 0.1 m.
    assert np.hypot(x[ix] - 1.0, y[iy]) < 0.15
    mvla(capsys, "export", "i.nc", "-o", "i.ply")
    assert trimesh.load("i.ply").is_watertight
    mvla(capsys, "export", "i.nc", "-o", "i.vtk")
    mvla(capsys, "plot", "c.nc", "-o", "w.png", *GRID)
    assert "must end in" in mvla(capsys, "export", "i.nc", "-o", "i.obj", code=2)


def test_import_from_a_toml_and_from_python_give_the_same(folder, capsys):
    write_sweeps(folder / "sweeps")
    (folder / "i.toml").write_text(
        'source = "sweeps"\n[sweeps]\nangle_pattern = "car_{angle}"\n[geometry]\nradius_m = 5.0\nangles = "sensor"\n'
    )
    mvla(capsys, "import", "i.toml", "-o", "a.nc")
    mvla(capsys, "import", "sweeps", "--settings", "i.toml", "-o", "b.nc")
    a, b, c = mv.load_channel("a.nc"), mv.load_channel("b.nc"), mv.import_channel(mv.import_settings(file="i.toml"))
    np.testing.assert_array_equal(a.response, b.response)
    np.testing.assert_array_equal(a.response, c.response)
    np.testing.assert_allclose(a.views.angles_deg, ANGLES)


def test_frequency_and_delay_axes_of_one_channel_agree(folder, capsys):
    """The same echoes as responses over frequency and as taps over delay give one profile."""
    ranges = 5 + 0.3 * np.sin(np.deg2rad(ANGLES))
    response = np.exp(-2j * np.pi * FREQUENCY * range_to_delay(ranges)[:, None])
    np.savez("f.npz", response=response.T, frequency=FREQUENCY / 1e9, angle=ANGLES)
    step = FREQUENCY[1] - FREQUENCY[0]
    tau = np.arange(201) / (201 * step)
    taps = np.array([((np.exp(2j * np.pi * (FREQUENCY - 36e9) * t) * response).mean(axis=1)) for t in tau]).T
    scipy.io.savemat("t.mat", {"h": taps, "tau": tau * 1e9, "angle": ANGLES})
    arrays = ["--set", "arrays.angles=angle", *PLACE]
    mvla(capsys, "import", "f.npz", "-o", "f.nc", *arrays, "--set", "arrays.axis_unit=1e9")
    mvla(
        capsys, "import", "t.mat", "-o", "t.nc", *arrays, "--set", "arrays.data=h", "--set", "arrays.axis=tau",
        "--set", "arrays.axis_kind=delay", "--set", "arrays.axis_unit=1e-9", "--set", "carrier_hz=36e9",
    )  # fmt: skip
    f, t = mv.load_channel("f.nc"), mv.load_channel("t.nc")
    assert t.step_hz == pytest.approx(f.step_hz, rel=1e-6)
    np.testing.assert_allclose(abs(f.response), 1, atol=1e-6)
    turn = (t.response * f.response.conj()).mean(axis=1, keepdims=True)
    np.testing.assert_allclose(t.response, f.response * turn / abs(turn), atol=1e-6)  # but for a phase a view


def test_components_enter_after_the_peaks(folder, capsys):
    rows = ["view,angle_deg,range_m,power_db"] + [f"{k},{a},5.0,-60" for k, a in enumerate(ANGLES)]
    (folder / "c.csv").write_text("\n".join(rows) + "\n")
    radio = ["--set", "carrier_hz=36e9", "--set", "bandwidth_hz=3e9"]
    mvla(capsys, "import", "c.csv", "-o", "c.nc", *PLACE, *radio)
    mvla(capsys, "image", "c.nc", "-o", "i.nc", *GRID)
    image = mv.Image.load("i.nc")
    assert np.unravel_index(image.score.argmax(), image.score.shape)[1:] in [(29, 29), (29, 30), (30, 29), (30, 30)]
    assert "bp needs profiles" in mvla(capsys, "image", "c.nc", "--method", "bp", "-o", "b.nc", *GRID, code=2)
    assert "no profiles" in mvla(capsys, "plot", "c.nc", "-o", "w.png", code=2)
    assert "bandwidth_hz: missing key" in mvla(capsys, "import", "c.csv", "-o", "d.nc", *PLACE, *radio[:2], code=2)


def test_synthesize_writes_what_import_reads(folder, capsys):
    (folder / "box.toml").write_text(CAR_SCENE)
    mvla(capsys, "simulate", "box.toml", "-o", "cir.nc")
    mvla(capsys, "synthesize", "cir.nc", "-o", "s", "--set", "points=401", "--set", "random_phase=false")
    geometry = ["--set", "geometry.radius_m=8", "--set", "geometry.angles=sensor", "--set", "extent_m=3.4"]
    mvla(
        capsys, "import", "s", "-o", "c.nc", *geometry, "--set", "sweeps.angle_pattern=box_{angle}deg",
        "--set", "sweeps.background.file=s/background.s2p",
    )  # fmt: skip
    assert mv.load_channel("c.nc").n_view == 12
    assert "unknown key" in mvla(capsys, "synthesize", "cir.nc", "-o", "s", "--set", "pionts=3", code=2)


def _comment_only(file):
    file.write_text("! nothing but this\n")


def _truncated(file):
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:60], lines[60][:30]]) + "\n")


def _not_a_number(file):
    text = file.read_text().splitlines()
    words = text[-5].split()
    file.write_text("\n".join([*text[:-5], " ".join([words[0], *["nan"] * 8]), *text[-4:]]) + "\n")


def _other_axis(file):
    write_sweeps(file.parent, frequency=FREQUENCY + 1e8, angles=[90.0])


def _fewer_points(file):
    write_sweeps(file.parent, frequency=FREQUENCY[::2], angles=[90.0])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_comment_only, "car_090.s2p"),
        (_truncated, "car_090.s2p"),
        (_not_a_number, "car_090.s2p.*not finite"),
        (_other_axis, "car_090.s2p"),
        (_fewer_points, "car_090.s2p"),
        (lambda f: shutil.copy(f, f.with_name("car_north.s2p")), "car_north.s2p"),
        (lambda f: shutil.copy(f, f.with_name("car_450.s2p")), "450"),
        (lambda f: shutil.copy(f, f.with_name("car_90.0.s2p")), "90"),
    ],
)
def test_spoilt_folders_are_refused(folder, capsys, spoil, message):
    write_sweeps(folder / "sweeps")
    spoil(folder / "sweeps" / "car_090.s2p")
    arguments = ["import", "sweeps", "-o", "c.nc", *PLACE, "--set", "sweeps.angle_pattern=car_{angle}"]
    assert re.search(message, mvla(capsys, *arguments, code=2))
    assert not (folder / "c.nc").exists()


def test_wrong_settings_and_files_are_refused(folder, capsys):
    write_sweeps(folder / "sweeps")
    write_sweeps(folder / "other", frequency=FREQUENCY[:-1], angles=[0.0], name="empty")
    base = ["import", "sweeps", "-o", "c.nc", "--set", "sweeps.angle_pattern=car_{angle}"]
    assert "geometry.radius_m: missing key" in mvla(capsys, *base, code=2)
    base += PLACE
    assert "empty.s2p" in mvla(capsys, *base, "--set", "sweeps.background.file=other/empty.s2p", code=2)
    far = ["--set", "sweeps.background.file=sweeps/car_000.s2p", "--set", "sweeps.background.align_m=[3, 40]"]
    assert "unambiguous range" in mvla(capsys, *base, *far, code=2)
    assert "S31" in mvla(capsys, *base, "--set", "sweeps.parameter=S31", code=2)
    assert "no such" in mvla(capsys, "import", "nowhere", "-o", "c.nc", *PLACE, code=2)
    assert "unknown kind" in mvla(capsys, "import", shutil.copy("sweeps/car_000.s2p", "a.xyz"), "-o", "c.nc", code=2)
    (folder / "one").mkdir()
    write_touchstone(folder / "one" / "car_000.s1p", FREQUENCY, np.ones((201, 1, 1), complex))
    one = ["import", "one", *base[2:]]
    assert "has no S21; a file of 1 port has S11 only" in mvla(capsys, *one, code=2)
    scipy.io.savemat("m.mat", {"H": np.ones((12, 201)), "f": FREQUENCY})
    line = mvla(capsys, "import", "m.mat", "-o", "c.nc", *PLACE, code=2)
    assert "no variable 'frequency'" in line
    assert "H (12, 201)" in line, "the names that the file has are listed"


def test_gates_beams_and_axes_that_do_not_fit_are_refused(folder, capsys):
    write_sweeps(folder / "sweeps")
    base = ["import", "sweeps", "-o", "c.nc", "--set", "sweeps.angle_pattern=car_{angle}", *PLACE]
    mvla(capsys, *base)
    gate = ["--set", "pdp.gate_m=[1, 20]"]
    assert "unambiguous range of 9.99 m" in mvla(capsys, "image", "c.nc", "-o", "i.nc", *GRID, *gate, code=2)
    large = ["--set", "grid.size_m=[14, 14, 0]"]
    assert "points over the same band" in mvla(capsys, "image", "c.nc", "-o", "i.nc", *large, code=2)
    horn = ["--set", 'antenna={kind="horn"}', "--set", "geometry.pointing.azimuth_deg=90"]
    mvla(capsys, *base, *horn)
    assert "no view's beam meets the grid" in mvla(capsys, "image", "c.nc", "-o", "i.nc", *GRID, code=2)
    assert not (folder / "i.nc").exists()


SCENE_PROCESS = """
name = "seen"
scene = "box.toml"
export = ["ply"]
[imaging]
grid = { size_m = [5, 5, 0], spacing_m = 0.1 }
"""


def test_a_truth_is_enough_for_a_surface(folder, capsys):
    """Without thresholds the binary result is the best one: it is drawn, boxed, and so exported as well."""
    (folder / "box.toml").write_text(CAR_SCENE)
    (folder / "p.toml").write_text('truth = "box.toml"\n' + SCENE_PROCESS)
    text = mvla(capsys, "process", "p.toml", "-o", "out")
    result = json.loads((folder / "out" / "result.json").read_text())
    assert result["protocol"] == "optimal"
    assert "wrote:    out/image.ply" in text
    surface = trimesh.load(folder / "out" / "image.ply")
    assert surface.volume == pytest.approx(result["n_reconstruction"] * 0.1**3, rel=1e-4)


@pytest.mark.parametrize("more", ["", 'truth = "box.toml"\nimaging.grid.size_m = [5, 5, 1]\n'])
def test_a_surface_of_nothing_is_refused_before_any_work(folder, capsys, more):
    """No thresholds, and no truth that could give them: none at all, or in three dimensions."""
    (folder / "box.toml").write_text(CAR_SCENE)
    overrides = [word for line in more.splitlines() for word in ("--set", line.replace(" = ", "="))]
    (folder / "p.toml").write_text(SCENE_PROCESS)
    text = mvla(capsys, "process", "p.toml", "-o", "out", *overrides, code=2)
    assert "export: 'ply' is the surface of the binary result; give imaging.threshold" in text
    assert not (folder / "out").exists()


def test_process_files_that_make_no_sense_are_refused(folder, capsys):
    (folder / "p.toml").write_text('name = "x"\n')
    assert "give either import or scene" in mvla(capsys, "process", "p.toml", code=2)
    (folder / "p.toml").write_text('name = "x"\n[import]\nsource = "a"\nsorce = "b"\n')
    assert "did you mean 'source'" in mvla(capsys, "process", "p.toml", code=2)
    assert not (folder / "results").exists()
