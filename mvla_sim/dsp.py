"""Signal processing that all stages share: windows, spectra of paths, profiles of spectra, the level of noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Window", "noise_level", "path_spectrum", "range_profiles"]

_COSINES = {"rectangular": (1.0,), "hann": (0.5, 0.5), "hamming": (0.54, 0.46), "blackman": (0.42, 0.5, 0.08)}
_NODES = 4096  # of the integral over a Kaiser window
_MAD_TO_SIGMA = 1.4826  # median absolute deviation of a normal distribution is σ/1.4826


@dataclass(frozen=True)
class Window:
    """A window by name; ``kaiser_beta`` is β of the Kaiser window I₀(β√(1 − x²))/I₀(β), −1 ≤ x ≤ 1, and of no other."""

    name: str = "rectangular"
    kaiser_beta: float = 6.0

    def weights(self, count: int) -> NDArray[np.float64]:
        """Weights at ``count`` frequencies centred in equal shares of the band, ``[count]``."""
        position = (np.arange(count) + 0.5) / count - 0.5
        if self.name == "kaiser":
            return np.asarray(np.i0(self.kaiser_beta * np.sqrt(1 - 4 * position**2)) / np.i0(self.kaiser_beta))
        terms = _COSINES[self.name]
        return np.asarray(sum(a * np.cos(2 * np.pi * k * position) for k, a in enumerate(terms)), np.float64)

    @property
    def broadening(self) -> float:
        """Equivalent noise bandwidth in units of 1/B: 1 for rectangular, 1.5 for Hann."""
        if self.name == "kaiser":
            weights = self.weights(_NODES)
            return float(_NODES * (weights**2).sum() / weights.sum() ** 2)
        terms = np.array(_COSINES[self.name])
        return float((terms[0] ** 2 + 0.5 * (terms[1:] ** 2).sum()) / terms[0] ** 2)


def path_spectrum(
    gain: NDArray[np.complexfloating], delay_s: NDArray[np.float64], lowest_hz: float, step_hz: float, count: int
) -> NDArray[np.complex128]:
    """Frequency response of paths, H_k = Σ_i g_i exp(−j2π(f_0 + kΔf)τ_i); an exact non-uniform DFT.

    Parameters
    ----------
    gain, delay_s
        Complex gain and delay of each path, ``[n_path]``, seconds.
    lowest_hz, step_hz
        First frequency f_0 and spacing Δf, hertz, counted from where gains have their phase (the carrier).
    count
        Number of frequencies K.

    Returns
    -------
    spectrum
        ``[count]`` complex128.

    Notes
    -----
    With z_i = exp(−j2πΔf·τ_i) and k = b·k₁ + k₂ it is one matrix product, H[k₁, k₂] = Σ_i (g_i z_i^{b·k₁}) z_i^{k₂},
    so only K/b + b powers a path are formed.
    """
    turned = gain * np.exp(-2j * np.pi * lowest_hz * delay_s)
    base = np.exp(-2j * np.pi * step_hz * delay_s)
    block = max(1, int(np.sqrt(count)))
    inner = _powers(base, block)
    outer = turned * _powers(inner[-1] * base, -(-count // block))
    return np.asarray((outer @ inner.T).reshape(-1)[:count], np.complex128)


def range_profiles(
    spectra: NDArray[np.complex128],
    weights: NDArray[np.float64],
    length: int,
    places: NDArray[np.intp],
    lowest: float | None = None,
) -> NDArray[np.complex128]:
    """Windowed, zero-padded inverse DFT of spectra: h_l = Σ_k w_k H_k exp(j2π(n_0 + k)l/L) / Σ_k w_k.

    An isolated echo g·exp(−j2πfτ) peaks at its delay with h = g, whatever window, number of frequencies and padding.

    Parameters
    ----------
    spectra
        H_k at K uniform frequencies, ``[..., n_frequency]``.
    weights
        The window's, ``[n_frequency]``.
    length
        L, at least K: samples of the axis of delays, which are 1/(L·Δf) apart.
    places
        Samples l that are wanted, ``[n_place]``; delays beyond L fold.
    lowest
        n_0 = f_0/Δf, the first frequency in steps; by default −(K−1)/2, which is to count from the middle of the band.

    Returns
    -------
    profiles
        ``[..., n_place]`` complex128.
    """
    count = spectra.shape[-1]
    first = -(count - 1) / 2 if lowest is None else lowest
    turn = np.exp(2j * np.pi * first * places / length) * (length / weights.sum())
    rows = spectra.reshape(-1, count)
    profiles = np.empty((len(rows), places.size), np.complex128)
    for row, spectrum in enumerate(rows):
        profiles[row] = np.fft.ifft(weights * spectrum, length)[places % length] * turn
    return profiles.reshape(*spectra.shape[:-1], places.size)


def noise_level(power: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Level and standard deviation of each profile's noise, ``[n_view]`` each, from the profiles ``[n_view, n_range]``.

    The median, and 1.4826 times the median absolute deviation: both insensitive to the few samples that hold echoes.
    """
    level = np.median(power, axis=1)
    return level, _MAD_TO_SIGMA * np.median(np.abs(power - level[:, None]), axis=1)


def _powers(base: NDArray[np.complex128], count: int) -> NDArray[np.complex128]:
    """base^k for k = 0 … count−1, ``[count, n]``."""
    powers = np.empty((count, base.size), np.complex128)
    powers[0] = 1
    for k in range(1, count):
        np.multiply(powers[k - 1], base, out=powers[k])
    return powers
