"""Grids, views and scenes that are measured."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from mvla_sim.grid import VoxelGrid
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import SceneSettings
from mvla_sim.settings import parse

__all__ = ["DEFAULT_RAYS", "EXTENT_M", "GRID_M", "RESOLUTION_M", "grid_of", "ring", "scene_settings"]

GRID_M: Final = 10.0
"""Side of the imaged square, metres; more voxels are finer ones."""
EXTENT_M: Final = 8.0
RESOLUTION_M: Final = 0.05
DEFAULT_RAYS: Final = (6000, 20_000)
"""The program's defaults: rays of the diffuse pass, and of that of specular reflection and diffraction."""


def grid_of(voxels: float) -> VoxelGrid:
    """Square grid of about so many voxels over the imaged area."""
    side = max(1, round(math.sqrt(voxels)))
    return VoxelGrid((0.0, 0.0, 0.0), (side, side, 1), GRID_M / side)


def ring(views: float) -> Views:
    """Evenly spaced views on a circle of 10 m."""
    angles = np.asarray(360 / views * np.arange(round(views)), np.float64)
    turn = np.deg2rad(angles)
    return Views(10 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1), angles, (0.0, 0.0))


def scene_settings(shape: str, views: float, rays: float, turn_deg: float = 0.0, **more: Any) -> SceneSettings:
    """A ``star`` or ``circle`` of 4 m radius inside a circle of views, turned so that the scene is a new one.

    ``rays`` are those a view of both passes together, in the default proportion; ``more`` sets the object.
    """
    share = rays / sum(DEFAULT_RAYS)
    data = {
        "name": "bench",
        "objects": [{"shape": shape, "rotation_deg": turn_deg, **more}],
        "trajectory": {"kind": "circle", "interval_deg": 360 / views, "start_deg": 1.0},
        "ray_tracing": {
            "diffuse_rays": max(1, round(DEFAULT_RAYS[0] * share)),
            "specular_rays": max(1, round(DEFAULT_RAYS[1] * share)),
        },
    }
    return parse(SceneSettings, data, "bench")
