"""``mvla reproduce`` and ``mvla report`` on experiments small enough to run in seconds."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import mvla

from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.measured.process import load_process
from mvla_sim.paper import reproduce as reproduce_module
from mvla_sim.paper.reproduce import EXPERIMENTS, MEASURED, QUICK_OVERRIDES
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.experiment import load_experiment

EXPERIMENT_FILES = Path(__file__).parents[2] / "experiments"
SCENE = """
name = "{name}"
[[objects]]
shape = "{name}"
[trajectory]
interval_deg = 30.0
[ray_tracing]
diffuse_rays = 300
specular = false
diffraction = false
"""
GRID = "[imaging.grid]\nspacing_m = 0.25\n"
STAR = 'snr_db = [0.0, 20.0]\nseed = [0, 1]\ninterval_deg = [30.0, 60.0]\nmethod = ["mvla-gr", "bp"]\n'
MEASUREMENT = """
name = "{name}"
scene = "../scenes/star.toml"
truth = "../scenes/star.toml"
[imaging.grid]
size_m = [10, 10, {height}]
spacing_m = 0.25
[imaging.threshold]
top_percent = 2.0
"""
MAP = 'scenes = ["../scenes/circle.toml"]\n'


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with scenes and one tiny experiment of each name."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "scenes").mkdir()
    (folder / "experiments").mkdir()
    for name in ("star", "circle"):
        (folder / "scenes" / f"{name}.toml").write_text(SCENE.format(name=name))
    for name in EXPERIMENTS:
        scenes = MAP if name == "kappa-eta" else 'scenes = ["../scenes/star.toml"]\n'
        axes = "kappa = [0.5, 1.0]\neta = [0.0, 0.04]\nseed = [0]\n" if scenes == MAP else STAR
        more = '[calibration]\nfrom = "star-optimal"\n' if name == "star-calibrated" else ""
        text = f'name = "{name}"\n{scenes}{GRID}[axes]\n{axes}{more}'
        (folder / "experiments" / f"{name}.toml").write_text(text)
    for name, height in zip(MEASURED, (0, 1), strict=True):
        (folder / "experiments" / f"{name}.toml").write_text(MEASUREMENT.format(name=name, height=height))
    return folder


@pytest.mark.slow
@pytest.mark.timeout(900)  # every experiment, and two reports
def test_everything_runs_and_the_report_can_be_rebuilt_from_what_is_stored(work):
    scene = work / "scenes" / "star.toml"
    scene.write_text(scene.read_text().replace("interval_deg = 30.0", "interval_deg = 5.0"))  # the phase check wants 5°
    text = mvla("reproduce", "--experiments", "experiments", "--workers", 0, folder=work, notes=True)
    results = work / "results"
    assert "report.html" in text
    assert {p.name for p in results.iterdir() if p.is_dir()} == {"paper", "physical", *MEASURED}
    for reading in ("paper", "physical"):
        assert {p.name for p in (results / reading).iterdir() if p.is_dir()} == set(EXPERIMENTS)
    checks = json.loads((results / "checks.json").read_text())
    assert set(checks) == {"c15", "c16"}
    assert max(checks["c16"]["largest_score_change"].values()) < 1e-5
    assert set(json.loads((results / "run.json").read_text())["seconds"]) == {
        *(f"{reading}/{name}" for reading in ("paper", "physical") for name in EXPERIMENTS),
        *MEASURED,
        "checks",
    }
    page = (results / "report.html").read_bytes()
    assert b"Not run." not in page
    (results / "report.html").unlink()
    mvla("report", folder=work)
    assert (results / "report.html").read_bytes() == page


def test_missing_experiment_is_refused_before_anything_runs(tmp_path):
    text = mvla("reproduce", "--experiments", "mine", folder=tmp_path, code=2)
    assert "mine/main.toml: no such experiment file" in text
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_is_enough(tmp_path, monkeypatch):
    """The experiments that come with the package are run where none are given, and where nothing else is."""
    monkeypatch.chdir(tmp_path)
    started = []

    def run_plan(plan, folder, **_):
        started.append((plan.experiment.name, len(plan.cases), folder))
        raise KeyboardInterrupt

    monkeypatch.setattr(reproduce_module, "run_plan", run_plan)
    with pytest.raises(KeyboardInterrupt):
        next(reproduce_module.reproduce(None, Path("results"), cluster=None))
    assert started == [("main", 144, Path("results/paper/main"))]


def test_readings_are_judged_on_fresh_seeds_too(tmp_path, monkeypatch):
    """Another tracing seed, noise seeds that no reading was chosen with; of the experiments that claims rest on."""
    plans = {}

    def expand(settings, folder, _):
        plans[folder.relative_to(tmp_path).as_posix()] = settings
        return settings

    monkeypatch.setattr(reproduce_module, "expand", expand)
    monkeypatch.setattr(reproduce_module, "run_plan", lambda *_, **__: SimpleNamespace(table=None))
    monkeypatch.setattr(reproduce_module, "draw_run", lambda *_: [])
    monkeypatch.setattr(reproduce_module, "draw_examples", lambda *_: [])
    steps = reproduce_module.reproduce(None, tmp_path, cluster=None, readings=["paper"], fresh_seeds=True)
    for _ in range(8):
        next(steps)
    judged = ["kappa-eta", "star-optimal", "star-calibrated"]
    assert list(plans) == [f"paper/{name}" for name in EXPERIMENTS] + [f"paper-fresh/{name}" for name in judged]
    for name in judged:
        usual, fresh = plans[f"paper/{name}"], plans[f"paper-fresh/{name}"]
        assert fresh.axes["scene.ray_tracing.seed"] == (2,)
        assert fresh.axes["seed"] == (2, 3, 4, 5, 6)[: len(usual.axes["seed"])]
        assert {k: v for k, v in fresh.axes.items() if "seed" not in k} == {
            k: v for k, v in usual.axes.items() if k != "seed"
        }
        assert fresh.imaging == usual.imaging == imaging_settings(
            reading="paper", snr_db=usual.imaging.noise.snr_db
        )  # fmt: skip


def test_report_of_nothing_is_refused(tmp_path):
    assert "holds no table" in mvla("report", "-o", tmp_path, folder=tmp_path, code=2)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_repositorys_experiments_are_valid_also_when_quick(name):
    settings = load_experiment(EXPERIMENT_FILES / f"{name}.toml", QUICK_OVERRIDES.get(name, ()))
    assert settings.name == name
    assert name not in QUICK_OVERRIDES or settings.axes["seed"] == (0,)


@pytest.mark.parametrize("name", MEASURED)
def test_the_repositorys_measurements_are_valid(name):
    settings = load_process(EXPERIMENT_FILES / f"{name}.toml")
    assert settings.name == name
    scene = Scene.load(settings.truth)
    assert len(scene.views) in (36, 108)
    assert settings.imaging.grid.spacing_m == {"vehicle": 0.005, "vehicle-3d": 0.05}[name]
