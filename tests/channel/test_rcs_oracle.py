"""The chain against a point scatterer of prescribed radar cross-section, whose delay and gain are known."""

from __future__ import annotations

import numpy as np
import pytest
from channel_scenes import ring_views

from mvla_sim.channel.cir import Cir
from mvla_sim.constants import SPEED_OF_LIGHT, delay_to_range
from mvla_sim.engine.backend import activate_sionna
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.pipeline import observe, reconstruct

POINT = np.array([1.0, 0.5, 0.0])
CROSS_SECTION = 0.5
CARRIER = 36e9


@pytest.fixture(scope="module")
def cir():
    """CIR of the point, as the engine's radar cross-section solver computes it, from 24 views."""
    rt = activate_sionna()
    import mitsuba as mi  # noqa: PLC0415 - only after the backend is chosen
    from sionna.rt.rcs import ConstantRCSSensingTarget, RCSSolver  # noqa: PLC0415

    world = rt.Scene()
    world.frequency = CARRIER
    array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    world.tx_array = world.rx_array = array
    world.add(ConstantRCSSensingTarget("point", sigma=CROSS_SECTION, position=mi.Point3f(*map(float, POINT))))
    world.add(rt.Transmitter("tx", position=[6.0, 0.0, 0.0]))
    world.add(rt.Receiver("rx", position=[6.0, 0.0, 0.0]))
    solver = RCSSolver(deterministic=True)
    views = ring_views(24)
    found = []
    for position in views.positions_m:
        place = mi.Point3f(*map(float, position))
        world.get("tx").position = place
        world.get("rx").position = place
        found.append(solver(world, max_depth=1, samples_per_sp=100, buffer_size_per_sp=100, seed=1))
    return Cir.from_sionna(found, views.positions_m, carrier_hz=CARRIER, bandwidth_hz=3e9, extent_m=1.0)


def test_delay_and_gain_follow_the_radar_equation(cir):
    assert (cir.row_size == 1).all()
    distance = np.linalg.norm(cir.views.positions_m - POINT, axis=1)
    np.testing.assert_allclose(cir.range_m, distance, rtol=3e-7)  # float32
    wavelength = SPEED_OF_LIGHT / CARRIER
    expected = np.sqrt(wavelength**2 * CROSS_SECTION / ((4 * np.pi) ** 3 * distance**4))
    np.testing.assert_allclose(np.abs(cir.gain), expected, rtol=1e-5)  # a chain of float32 operations


def test_peaks_are_the_point(cir):
    settings = imaging_settings(snr_db=None)
    front = observe(cir, settings).front
    assert (front.peaks.row_size == 1).all()
    # The parabola's bias at four samples a resolution cell is below 1 % of a sample of 12.5 mm; its height's below 1 %.
    np.testing.assert_allclose(front.peaks.range_m, delay_to_range(cir.delay_s), rtol=0, atol=2e-4)
    np.testing.assert_allclose(front.peaks.power, np.abs(cir.gain) ** 2, rtol=0.01)


@pytest.mark.parametrize("method", ["bp", "mvla-gr", "mvla-hard"])
@pytest.mark.parametrize("snr_db", [None, 20.0])
def test_image_peaks_at_the_point(cir, method, snr_db):
    image = reconstruct(cir, imaging_settings(method=method, snr_db=snr_db, **{"grid.size_m": [4.0, 4.0, 0.0]}))
    best = np.flatnonzero(image.score == image.score.max())
    place = image.grid.centers(best).mean(axis=0)
    assert np.linalg.norm(place - POINT) < image.grid.spacing_m  # the point lies between four voxels
    if method != "bp":
        assert image.support_deg.ravel()[best].min() == pytest.approx(345, abs=1e-3)  # all 24 views; degrees, float32
