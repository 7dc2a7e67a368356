"""Small scenes for the tests of the channel stage."""

from __future__ import annotations

import numpy as np

from mvla_sim.channel.cir import Cir
from mvla_sim.constants import range_to_delay
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import Scene, SceneSettings
from mvla_sim.settings import parse


def build(objects, trajectory, radio=None, **ray_tracing):
    """Scene of objects, a trajectory and a radio, all as in a scene file."""
    data = {"name": "test", "objects": objects, "trajectory": trajectory, "ray_tracing": ray_tracing}
    data["radio"] = radio or {}
    return Scene(parse(SceneSettings, data, "test"))


def at(*positions_m):
    """Trajectory of listed positions."""
    return {"kind": "positions", "positions_m": [[float(c) for c in p] for p in positions_m]}


def ring(interval_deg, radius_m=6.0, start_deg=0.0):
    return {"kind": "circle", "interval_deg": interval_deg, "radius_m": radius_m, "start_deg": start_deg}


def ring_views(count, radius_m=6.0):
    angles = 360 / count * np.arange(count)
    turn = np.deg2rad(angles)
    return Views(radius_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1), angles, (0.0, 0.0))


def random_cir(seed=0, count=5, **changes):
    """A CIR of random paths, one view without any, with everything a file can carry."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(1, 9, count)
    rows[count // 2] = 0
    paths = int(rows.sum())
    gain = (rng.standard_normal(paths) + 1j * rng.standard_normal(paths)).astype(np.complex64)
    fields = {
        "gain": gain,
        "delay_s": range_to_delay(rng.uniform(3, 9, paths)),
        "interaction": rng.integers(0, 16, paths).astype(np.uint8),
        "first_point_m": rng.standard_normal((paths, 3)).astype(np.float32),
        "row_size": rows.astype(np.int64),
        "views": ring_views(count),
        "carrier_hz": 36e9,
        "bandwidth_hz": 3e9,
        "extent_m": 4.0,
    }
    return Cir(**(fields | changes))
