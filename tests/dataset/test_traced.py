"""The whole way with the tracer: two tiny scenes, built, checked, opened, drawn, described; and the command line."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import numpy as np
import psutil
import pytest
from campaigns import write

from mvla_sim.channel.simulate import simulate
from mvla_sim.cli.app import run
from mvla_sim.dataset import build as module
from mvla_sim.dataset.access import open_dataset
from mvla_sim.dataset.build import build_dataset
from mvla_sim.dataset.campaign import load_campaign
from mvla_sim.dataset.card import shown_samples
from mvla_sim.dataset.sample import draw_sample
from mvla_sim.dataset.verify import unmatched_share, verify
from mvla_sim.errors import DataError
from mvla_sim.plot.scene_figures import plot_samples
from mvla_sim.scene.world import Scene

SMALL = ("samples=2", "samples_per_shard=1", "split.train=0.5", "split.validation=0.0", "split.test=0.5",
         "trajectory.interval_deg=60", "families.0.objects=1", "families.1.weight=1e-9")  # fmt: skip
EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def command(folder, *arguments):
    """Exit code of ``mvla dataset …`` in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        return run(["dataset", *map(str, arguments)])
    finally:
        os.chdir(before)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the campaign's file and the dataset, made by a worker that dies once.

    kill -9 as soon as the first shard is written; its successor is made by the next worker.
    """
    folder = tmp_path_factory.mktemp("traced")
    write(folder)
    original, killed = module._write, []

    def write_and_kill(place, campaign, shard):
        entry = original(place, campaign, shard)
        if not killed:
            killed.extend(p for p in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(p.cmdline()))
            for process in killed:
                process.kill()
        return entry

    settings = [part for override in SMALL for part in ("--set", override)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_write", write_and_kill)
        assert command(folder, "build", "tiny.toml", "-o", "out", "--workers", 1, *settings) == 0
    assert killed
    return folder


@pytest.fixture
def copy(built, tmp_path):
    shutil.copytree(built / "out", tmp_path / "out")
    return tmp_path


def test_a_traced_dataset_passes_and_is_that_of_the_scenes(built):
    report = verify(built / "out", recompute=2)
    assert report.ok, report.problems
    assert report.recomputed == (0, 1)
    dataset = open_dataset(built / "out")
    for k, sample in enumerate(dataset):
        traced = simulate(Scene(draw_sample(dataset.campaign, k)))
        assert unmatched_share(sample.cir, traced) == 0
        assert (sample.cir.row_size > 0).all()


def test_workers_and_their_deaths_change_no_number(built):
    """Traced in this process, all data are those that the worker made, and the one after it."""
    here = build_dataset(load_campaign(built / "tiny.toml", SMALL), built / "here", workers=0).index
    there = open_dataset(built / "out").index
    assert [shard.data_sha256 for shard in here.shards.values()] == [
        shard.data_sha256 for shard in there.shards.values()
    ]


def test_the_card_says_what_is_inside(built):
    text = (built / "out" / "README.md").read_text()
    dataset = open_dataset(built / "out")
    assert text.startswith("# tiny\n")
    assert "2 samples in 2 shards" in text
    assert "Licence: CC-BY-4.0" in text
    assert "| all | 1 | 0 | 1 | 2 |" in text
    assert "![Some of the scenes from above: targets and sensor positions](scenes.png)" in text
    counts = [sample.cir.gain.size for sample in dataset]
    assert f"| paths of a sample | {min(counts)} | {np.median(counts):.6g} | {max(counts)} |" in text
    assert (built / "out" / "scenes.png").stat().st_size > 5000
    assert str(built) not in text
    for line in re.search(r"```python\n(.*?)```", text, re.DOTALL)[1].splitlines():  # what it shows can be run
        compile(line, "card", "exec")


def test_pictures_show_every_family(built):
    dataset = open_dataset(built / "out")
    assert shown_samples(dataset) == [0, 1]
    figure = plot_samples(list(dataset))
    drawn = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_title() for axes in drawn] == ["0: boxes", "1: boxes"]
    with pytest.raises(DataError, match="no sample to draw"):
        plot_samples([])


def test_commands(copy, built, capsys):
    assert command(copy, "verify", "out", "--recompute", 1) == 0
    text = capsys.readouterr().out
    assert "2 shards, 2 samples" in text
    assert "all is well" in text
    assert command(copy, "export", "out", "--format", "mat", "-o", "out.mat") == 0
    assert command(copy, "export", "out", "--format", "npz", "-o", "npz", "--split", "test") == 0
    assert len(list((copy / "npz").iterdir())) == 1
    capsys.readouterr()
    settings = [part for override in SMALL for part in ("--set", override)]
    write(copy)
    assert command(copy, "build", "tiny.toml", "-o", "out", "--dry-run", *settings) == 0
    text = capsys.readouterr().out
    assert "MiB each; 2 stored, 0 to make" in text
    assert "from 2 stored shards" in text
    (copy / "out" / "shard-00001.nc").unlink()
    assert command(copy, "verify", "out", "--recompute", 0) == 1
    assert "shard-00001.nc: no such shard" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("build", "none.toml", "-o", "new"), "none.toml: no such file"),
        (("build", "tiny.toml", "-o", "new", "--set", "sample=1"), "unknown key"),
        (("build", "tiny.toml", "-o", "new", "--workers", "2", "--scheduler", "tcp://x:1"), "give one of them"),
        (("build", "tiny.toml", "-o", "out"), "holds a dataset of other settings: samples = 2 there, 10 here"),
        (("verify", "none"), "no such dataset"),
        (("export", "out", "--format", "csv", "-o", "x"), "--format csv: allowed: npz, mat"),
        (("export", "out", "--format", "mat", "-o", "x.txt"), "must end in .mat"),
        (("export", "out", "--split", "tset", "-o", "x"), "split = 'tset'"),
    ],
)
def test_bad_commands_are_one_line(copy, capsys, arguments, message):
    write(copy)
    assert command(copy, *arguments) == 2
    told = capsys.readouterr()
    assert message in told.err
    assert len(told.err.strip().splitlines()) == 1
    assert told.out == ""


def test_a_probe_tells_size_and_time(tmp_path, capsys):
    write(tmp_path)
    settings = [part for override in SMALL for part in ("--set", override)]
    assert command(tmp_path, "build", "tiny.toml", "-o", "out", "--dry-run", *settings) == 0
    text = capsys.readouterr().out
    assert "samples:  2 of 2 families" in text
    assert "from a probe: 8 views each of 2 samples" in text
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("name", "samples"), [("benchmark-small", 100), ("benchmark-large", 10_000)])
def test_the_ready_campaigns_are_valid(name, samples):
    campaign = load_campaign(EXPERIMENTS / f"{name}.toml")
    assert (campaign.name, campaign.samples) == (name, samples)
    shapes = {family.shape for family in campaign.families}
    assert shapes == {"circle", "square", "rectangle", "triangle", "star", "polygon", "smooth"}
    for k in range(0, samples, samples // 50):
        Scene(draw_sample(campaign, k))
