"""Views, peaks and channels for the tests of the imaging stage."""

from __future__ import annotations

import numpy as np

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import range_to_delay
from mvla_sim.imaging.noise import NOISES
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.scene.views import Views

RESOLUTION = 0.05
PAPER_METHODS = ("mvla-gr", "mvla-hard", "bp")
BANDWIDTH = 299_792_458 / (2 * RESOLUTION)  # Hz: ΔR is 5 cm to the digit


def views_at(angles_deg, radius_m=10.0, height_m=0.0):
    """Views on a circle at any angles, in the given order."""
    turn = np.deg2rad(np.asarray(angles_deg, np.float64))
    positions = np.stack([radius_m * np.cos(turn), radius_m * np.sin(turn), np.full_like(turn, height_m)], axis=1)
    return Views(positions, np.mod(angles_deg, 360.0), (0.0, 0.0))


def ring(count, radius_m=10.0, height_m=0.0, start_deg=0.0):
    return views_at(start_deg + 360 / count * np.arange(count), radius_m, height_m)


def make_peaks(per_view):
    """Peaks from one list of (range, power) a view."""
    rows = [sorted(view) for view in per_view]
    flat = np.array([pair for view in rows for pair in view], np.float64).reshape(-1, 2)
    return Peaks(flat[:, 0], flat[:, 1], np.array([len(view) for view in rows], np.int64))


def random_peaks(rng, counts, low_m, high_m):
    """As many peaks a view as ``counts`` says, anywhere between two ranges."""
    return make_peaks(
        [list(zip(rng.uniform(low_m, high_m, k), rng.exponential(size=k) + 1e-3, strict=True)) for k in counts]
    )


def per_view(peaks):
    """(ranges, weights) of each view."""
    return [(peaks.range_m[peaks.view == m], peaks.weight[peaks.view == m]) for m in range(peaks.n_view)]


def channel(paths, views, bandwidth_hz=BANDWIDTH, **fields):
    """A CIR from one list of (range, complex gain) a view."""
    flat = np.array([pair for view in paths for pair in view], np.complex128).reshape(-1, 2)
    count = len(flat)
    return Cir(
        flat[:, 1].astype(np.complex64), range_to_delay(flat[:, 0].real), np.zeros(count, np.uint8),
        np.full((count, 3), np.nan, np.float32), np.array([len(view) for view in paths], np.int64),
        views=views, carrier_hz=36e9, bandwidth_hz=bandwidth_hz, **({"extent_m": 4.0} | fields),
    )  # fmt: skip


def random_channel(seed, views, paths=40, low_m=7.0, high_m=13.0):
    rng = np.random.default_rng(seed)
    gain = rng.standard_normal((len(views), paths)) + 1j * rng.standard_normal((len(views), paths))
    distance = rng.uniform(low_m, high_m, (len(views), paths))
    return channel([list(zip(r, g, strict=True)) for r, g in zip(distance, gain, strict=True)], views)


def scatterers(points_m, views, gain=1.0, **fields):
    """A CIR of isotropic points: gain over the product of both ways, at half their sum, with the carrier's phase."""
    wavelength = 299_792_458 / 36e9
    receivers = views.positions_m if views.receivers_m is None else views.receivers_m
    rows = []
    for transmitter, receiver in zip(views.positions_m, receivers, strict=True):
        there, back = (np.linalg.norm(np.asarray(points_m) - end, axis=1) for end in (transmitter, receiver))
        phase = np.exp(-2j * np.pi * (there + back) / wavelength)
        rows.append(list(zip((there + back) / 2, gain / (there * back) * phase, strict=True)))
    return channel(rows, views, **fields)


def response(paths, views, start_hz=36e9 - BANDWIDTH / 2, count=1001, bandwidth_hz=BANDWIDTH, **fields):
    """The frequency responses of one list of (range, complex gain) a view, gains as in a CIR: carrier phase included.

    H(f_k) = Σ g exp(−j2π(f_k − f_c)τ), f_c the middle of the band of ``count`` frequencies.
    """
    step = bandwidth_hz / count
    offset = step * (np.arange(count) - (count - 1) / 2)
    rows = []
    for view in paths:
        pairs = np.array(view, np.complex128).reshape(-1, 2)
        delay = range_to_delay(pairs[:, 0].real)
        rows.append((pairs[:, 1] * np.exp(-2j * np.pi * offset[:, None] * delay)).sum(axis=1))
    return FrequencyResponse(np.array(rows), start_hz, step, views=views, **({"extent_m": 4.0} | fields))


def noise_of(kind="gaussian", **settings):
    return NOISES.find(kind)(**settings)
