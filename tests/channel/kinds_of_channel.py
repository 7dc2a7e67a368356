"""A random channel of each kind, with everything that it and its file can hold."""

from __future__ import annotations

import dataclasses

import numpy as np
from channel_scenes import random_cir, ring_views

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.response import FrequencyResponse
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


def random_response(seed=0, count=5, points=33, **changes):
    rng = np.random.default_rng(seed)
    fields = {
        "response": rng.standard_normal((count, points)) + 1j * rng.standard_normal((count, points)),
        "start_hz": 34.5e9,
        "step_hz": 7.5e6,
        "views": ring_views(count),
        "extent_m": 4.0,
    }
    return FrequencyResponse(**(fields | changes))


def random_components(seed=0, count=5, **changes):
    """Components of random views, one view without any."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(1, 9, count)
    rows[count // 2] = 0
    fields = {
        "range_m": np.concatenate([np.sort(rng.uniform(3, 9, n)) for n in rows]),
        "power": 10 ** rng.uniform(-12, 0, int(rows.sum())),
        "row_size": rows.astype(np.int64),
        "views": ring_views(count),
        "carrier_hz": 36e9,
        "bandwidth_hz": 3e9,
        "extent_m": 4.0,
    }
    return Components(**(fields | changes))


MAKERS = {Cir: random_cir, FrequencyResponse: random_response, Components: random_components}
EVERY_KIND = tuple(MAKERS)


def name_of(kind):
    return kind.__name__


def same(one, other):
    """Whether two channels hold the same bits, NaN equal to NaN."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        first, second = getattr(one, field.name), getattr(other, field.name)
        if isinstance(first, np.ndarray):
            assert first.dtype == second.dtype, field.name
        if field.name not in ("views", "outline"):
            np.testing.assert_equal(second, first)
    for name in ("positions_m", "angles_deg", "center_m", "receivers_m"):
        np.testing.assert_equal(getattr(other.views, name), getattr(one.views, name))
    assert (one.views.boresights is None) == (other.views.boresights is None)
    if one.views.boresights is not None:  # divided by their length again, which is 1 to rounding
        np.testing.assert_allclose(other.views.boresights, one.views.boresights, rtol=0, atol=1e-15)
