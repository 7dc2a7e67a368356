"""Paths that a user traced with Sionna RT itself: the same channel as our own tracer's of the same scene."""

from __future__ import annotations

import numpy as np
import pytest
from channel_scenes import build, ring

from mvla_sim.channel.cir import INTERACTIONS, Cir
from mvla_sim.channel.raytrace import ViewTracer
from mvla_sim.errors import DataError

RADIO = {"carrier_hz": 36e9, "bandwidth_hz": 3e9}


@pytest.fixture(scope="module")
def traced():
    """A square's specular and diffracted paths: our own, and its scene as Sionna has it, with the views' positions."""
    scene = build([{"shape": "square", "side_m": 1.0}], ring(90.0), diffuse=False, specular_rays=20_000)
    tracer = ViewTracer(scene)
    return tracer, scene.views.positions_m, [tracer.trace(p, "view") for p in scene.views.positions_m]


def solve(tracer, **more):
    return tracer._solver(
        tracer._scene, max_depth=tracer._settings.max_depth, samples_per_src=20_000, los=True, refraction=False,
        specular_reflection=True, diffuse_reflection=False, diffraction=True, **more,
    )  # fmt: skip


def each(tracer, positions):
    """One Paths a view: the pair is moved from view to view."""
    found = []
    for place in positions:
        for end in ("tx", "rx"):
            tracer._scene.get(end).position = [float(c) for c in place]
        found.append(solve(tracer))
    return found


@pytest.fixture(scope="module")
def moved(traced):
    tracer, positions, _ = traced
    return each(tracer, positions)


def same_paths(cir, ours):
    """Delays to a tenth of a millimetre, gains to their float32 phases; a path of a corner may come twice or not."""
    for view, own in enumerate(ours):
        rows = cir.rows(view)
        order = np.argsort(own.delay_s, kind="stable")
        strong = [np.abs(gain) > 1e-7 for gain in (cir.gain[rows], own.gain[order])]
        np.testing.assert_allclose(
            cir.range_m[rows][strong[0]], own.delay_s[order][strong[1]] * 299_792_458 / 2, rtol=0, atol=1e-4
        )
        np.testing.assert_allclose(abs(cir.gain[rows][strong[0]]), abs(own.gain[order][strong[1]]), rtol=1e-3)
        sums = [np.sum(gain) for gain in (cir.gain[rows], own.gain)]
        assert abs(sums[0] - sums[1]) < 0.02 * np.abs(own.gain).sum()  # phases: 36 GHz × 0.1 ps is 1.3°


def test_one_paths_a_view_is_the_channel_of_our_own_tracer(traced, moved):
    _, positions, ours = traced
    cir = Cir.from_sionna(moved, positions, **RADIO, extent_m=1.4, config={"name": "mine"})
    assert cir.n_view == 4
    np.testing.assert_allclose(cir.views.angles_deg, [0, 90, 180, 270], atol=1e-9)
    assert cir.views.receivers_m is None
    assert (cir.extent_m, cir.config["name"]) == (1.4, "mine")
    assert all((np.diff(cir.delay_s[cir.rows(view)]) >= 0).all() for view in range(4))
    assert (cir.interaction & (INTERACTIONS["specular"] | INTERACTIONS["diffraction"])).all()
    assert cir.delay_s.min() > 1e-8  # the direct path of length 0 is left out
    np.testing.assert_allclose(abs(cir.first_point_m[:, :2]).max(axis=1), 0.5, atol=1e-3)  # on the square
    same_paths(cir, ours)


def test_positions_are_those_of_the_paths_or_refused(traced, moved):
    _, positions, _ = traced
    np.testing.assert_allclose(Cir.from_sionna(moved, **RADIO).views.positions_m, positions, atol=1e-6)
    with pytest.raises(DataError, match=r"positions_m: view 0 is 12 m from where its paths begin"):
        Cir.from_sionna(moved, -positions, **RADIO)
    with pytest.raises(DataError, match=r"positions_m has shape \(3, 3\); the paths are of 4 views"):
        Cir.from_sionna(moved, positions[:3], **RADIO)
    with pytest.raises(DataError, match="there is none"):
        Cir.from_sionna([], **RADIO)


def test_of_many_transmitters_and_receivers_the_pairs_are_taken(traced, moved):
    """All at once: every transmitter reaches every receiver, and only those in one place are a view."""
    from sionna import rt  # noqa: PLC0415 - after the tracer has chosen the backend

    tracer, positions, _ = traced
    world = tracer._scene
    for number, place in enumerate(positions[1:], 1):
        world.add(rt.Transmitter(f"tx{number}", position=[float(c) for c in place]))
        world.add(rt.Receiver(f"rx{number}", position=[float(c) for c in place]))
    try:
        for end in ("tx", "rx"):
            world.get(end).position = [float(c) for c in positions[0]]
        for synthetic in (True, False):
            cir = Cir.from_sionna(solve(tracer, synthetic_array=synthetic), positions, **RADIO)
            alone = Cir.from_sionna(moved, positions, **RADIO)
            assert cir.row_size.tolist() == alone.row_size.tolist()
            np.testing.assert_allclose(cir.range_m, alone.range_m, rtol=0, atol=1e-4)
        world.remove("rx3")
        with pytest.raises(DataError, match="4 transmitters and 3 receivers"):
            Cir.from_sionna(solve(tracer), positions, **RADIO)
    finally:
        for number in (1, 2, 3):
            world.remove(f"tx{number}")
            if number < 3:
                world.remove(f"rx{number}")
