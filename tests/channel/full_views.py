"""Views with everything that a channel file can carry of them."""

from __future__ import annotations

import numpy as np
from channel_scenes import ring_views

from mvla_sim.scene.views import Views


def views_of(count, receivers=True, boresights=True, seed=0):
    """Views on a ring about a centre that is not 0, with receivers and boresights where asked for."""
    rng = np.random.default_rng(seed)
    ring = ring_views(count)
    directions = rng.standard_normal((count, 3))
    return Views(
        ring.positions_m,
        ring.angles_deg,
        (0.25, -1.5),
        ring.positions_m + rng.standard_normal((count, 3)) if receivers else None,
        directions / np.linalg.norm(directions, axis=1, keepdims=True) if boresights else None,
    )
