"""Noise at a given SNR, in the PDP domain as in the paper or on the complex CIR."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError
from mvla_sim.imaging.imaging_settings import NoiseSettings
from mvla_sim.imaging.pdp import Pdp, frequency_count
from mvla_sim.streams import Stream, stream

__all__ = ["add_noise"]


def add_noise(pdp: Pdp, settings: NoiseSettings) -> Pdp:
    """Return the profiles with noise; without ``snr_db`` they are returned as they are.

    Each view draws from a stream of its own, named by its index in ``pdp``, so add noise to all views of a file first
    and select views after.

    Notes
    -----
    With ⟨·⟩ the mean over the gate (of one view, or of all with ``reference = "all"``) and ρ = 10^(SNR/10):

    * ``gaussian``: P + n, n ~ N(0, σ²), σ² = ⟨P²⟩/ρ. The signal whose power is measured is the PDP itself, as the usual
      AWGN tools with 'measured' power do. The noise has zero mean, so the result may be negative.
    * ``exponential``: P + n, n exponential of mean √(⟨P²⟩/(2ρ)), so that ⟨n²⟩ = ⟨P²⟩/ρ: noise power behind a square-law
      detector that does not beat with the signal.
    * ``complex``: |h + n|², n circular Gaussian of power ⟨|h|²⟩/ρ, of the signal's own band and window.

    The first two are white on the profile's axis, as the paper adds them to its PDPs, so the noise in a resolution cell
    falls as ``pdp.oversampling`` rises; ``complex`` does not depend on it.

    Raises
    ------
    ConfigError
        ``complex`` noise on profiles whose complex amplitude is not known.
    """
    if settings.snr_db is None:
        return pdp
    ratio = 10 ** (settings.snr_db / 10)
    generators = [stream(settings.seed, Stream.NOISE, view) for view in range(pdp.power.shape[0])]
    count = pdp.power.shape[1]
    if settings.kind == "complex":
        if pdp.amplitude is None:
            raise ConfigError("noise.kind = 'complex' needs complex amplitudes; these profiles hold power only")
        scale = np.sqrt(_mean(pdp.power, settings) / ratio)
        amplitude = pdp.amplitude + scale[:, None] * np.array([_band_noise(g, pdp) for g in generators])
        return replace(pdp, power=np.abs(amplitude) ** 2, amplitude=amplitude)
    second_moment = _mean(pdp.power**2, settings) / ratio
    if settings.kind == "exponential":
        draw = np.array([g.standard_exponential(count) for g in generators])
        return replace(pdp, power=pdp.power + np.sqrt(second_moment / 2)[:, None] * draw, amplitude=None)
    draw = np.array([g.standard_normal(count) for g in generators])
    return replace(pdp, power=pdp.power + np.sqrt(second_moment)[:, None] * draw, amplitude=None)


def _band_noise(random: np.random.Generator, pdp: Pdp) -> NDArray[np.complex128]:
    """Circular Gaussian noise of mean power 1 that is white over the band before the window, ``[n_range]``."""
    samples = pdp.power.shape[1]
    count = frequency_count(samples, pdp.oversampling)
    weights = pdp.window.weights(count)
    draw = random.standard_normal(2 * count)
    length = count * pdp.oversampling
    noise = np.fft.ifft(weights * (draw[:count] + 1j * draw[count:]), length)[:samples]
    center = np.exp(-1j * np.pi * (count - 1) / length * np.arange(samples))  # the band is centred on the carrier
    return np.asarray(noise * center * (length / np.sqrt(2 * (weights**2).sum())), np.complex128)


def _mean(values: NDArray[np.float64], settings: NoiseSettings) -> NDArray[np.float64]:
    """Mean over the gate per view, or of all views for each, ``[n_view]``."""
    per_view = values.mean(axis=1)
    return per_view if settings.reference == "view" else np.full_like(per_view, per_view.mean())
