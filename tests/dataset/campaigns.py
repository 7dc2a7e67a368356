"""Small campaigns, and a tracer that is a formula: the same paths for the same scene, in a millisecond."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mvla_sim.channel.cir import Cir
from mvla_sim.constants import range_to_delay
from mvla_sim.dataset.build import build_dataset
from mvla_sim.dataset.campaign import CampaignSettings, load_campaign
from mvla_sim.errors import DataError
from mvla_sim.settings import parse

CAMPAIGN = """
name = "tiny"
seed = 7
samples = 10
samples_per_shard = 4
split = { train = 0.5, validation = 0.2, test = 0.3 }
[trajectory]
radius_m = { min = 5.0, max = 6.0 }
interval_deg = { choices = [30.0, 45.0] }
[ray_tracing]
diffuse_rays = 200
specular_rays = 1000
[grid]
size_m = [6.0, 4.0, 0.0]
spacing_m = 0.1
[[families]]
name = "boxes"
shape = "square"
objects = { min = 1, max = 2 }
size_m = { min = 0.5, max = 1.0 }
x_m = { min = -2.0, max = 2.0 }
y_m = { min = -1.0, max = 1.0 }
rotation_deg = { min = 0.0, max = 90.0 }
material = { choices = ["metal", "wood"] }
[[families]]
name = "blobs"
shape = "smooth"
size_m = { min = 1.0, max = 2.0 }
facets = 24
"""

EVERY_FAMILY = {
    "circle": {"facets": 24},
    "square": {},
    "rectangle": {"aspect": {"min": 0.2, "max": 0.9}},
    "triangle": {},
    "star": {"points": {"min": 3, "max": 9}, "inner_ratio": {"min": 0.2, "max": 0.8}},
    "polygon": {"corners": {"min": 3, "max": 12}, "roughness": {"min": 0.0, "max": 0.9}},
    "smooth": {"harmonics": {"min": 2, "max": 8}, "roughness": {"min": 0.0, "max": 0.9}, "facets": 60},
}


def write(folder: Path, text: str = CAMPAIGN) -> Path:
    """Write a campaign file and return its name."""
    file = folder / "tiny.toml"
    file.write_text(text)
    return file


def tiny(folder: Path, *overrides: str) -> CampaignSettings:
    """The settings of the tiny campaign."""
    return load_campaign(write(folder), overrides)


def built(folder: Path, *overrides: str) -> Path:
    """Build the tiny dataset from channels by formula and return its directory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mvla_sim.dataset.shard.simulate", fake_simulate)
        build_dataset(tiny(folder, *overrides), folder / "out", workers=0)
    return folder / "out"


def of_family(shape: str, **changes) -> CampaignSettings:
    """A campaign of one family of several objects."""
    family = {
        "name": shape, "shape": shape, "objects": {"min": 1, "max": 3}, "size_m": {"min": 0.5, "max": 2.5},
        "x_m": {"min": -3, "max": 3}, "y_m": {"min": -3, "max": 3}, "rotation_deg": {"min": 0, "max": 360},
        **EVERY_FAMILY[shape],
    }  # fmt: skip
    return parse(CampaignSettings, {"name": "c", "samples": 40, "seed": 3, "families": [family]} | changes, "test")


def fake_simulate(scene, *, cache=True):
    """A channel that follows from the scene alone: a path from each corner of the outline's hull."""
    corners = np.array(scene.outline.convex_hull.exterior.coords)
    points = np.concatenate([corners, np.zeros((len(corners), 1))], axis=1)
    ranges = np.linalg.norm(scene.views.positions_m[:, None] - points, axis=2)
    count, n_view = len(points), len(scene.views)
    receivers = scene.views.receivers_m
    if receivers is not None:
        ranges = (ranges + np.linalg.norm(receivers[:, None] - points, axis=2)) / 2
    return Cir(
        gain=(np.exp(1j * ranges) / ranges**2).ravel().astype(np.complex64),
        delay_s=range_to_delay(ranges).ravel(),
        interaction=np.resize(np.array([1, 2, 8], np.uint8), n_view * count),
        first_point_m=np.tile(points, (n_view, 1)).astype(np.float32),
        row_size=np.full(n_view, count, np.int64),
        views=scene.views,
        carrier_hz=scene.settings.radio.carrier_hz,
        bandwidth_hz=scene.settings.radio.bandwidth_hz,
        extent_m=scene.extent_m,
        outline=scene.outline,
        antenna=scene.settings.radio.antenna,
        config=scene.settings.model_dump(mode="json"),
        provenance={"program": "a formula"},
    )


def failing_simulate(*numbers: int):
    """A tracer that raises for the samples of these numbers."""

    def trace(scene, *, cache=True):
        if int(scene.name.rpartition("-")[2]) in numbers:
            raise DataError("no path was found\nat any view")
        return fake_simulate(scene)

    return trace


def count_paths(sample):
    """A transform that can be pickled."""
    return sample.cir.gain.size


def digests(index) -> list[str]:
    """Checksums over the data of each shard, in order."""
    return [index.shards[number].data_sha256 for number in sorted(index.shards)]


def equal(one: Cir, other: Cir) -> bool:
    """Whether two channels are the same, bit for bit, but for their provenance."""
    names = ("gain", "delay_s", "interaction", "first_point_m", "row_size")
    views = ("positions_m", "angles_deg", "center_m", "receivers_m", "boresights")
    return (
        all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
        and all(np.array_equal(getattr(one.views, name), getattr(other.views, name)) for name in views)
        and one.outline.equals_exact(other.outline, 1e-8)
        and (one.carrier_hz, one.bandwidth_hz, one.extent_m, one.antenna, dict(one.config))
        == (other.carrier_hz, other.bandwidth_hz, other.extent_m, other.antenna, dict(other.config))
    )
