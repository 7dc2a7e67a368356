"""White noise on the complex CIR, before the squared magnitude."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError
from mvla_sim.imaging.noise import Noise
from mvla_sim.imaging.pdp import Pdp, frequency_count

__all__ = ["ComplexNoise"]


class ComplexNoise(Noise):
    """Circular and of the signal's own band and window: |h + n|², n circular Gaussian of power ⟨|h|²⟩/ρ, or max|h|²/ρ.

    The latter with ``signal = "peak-power"``; the other two conventions are the same here. It does not depend on
    ``pdp.oversampling``. Where there is no signal the noise's power is exponential: its mean is its standard deviation.
    """

    uses_amplitude: ClassVar[bool] = True

    kind: Literal["complex"] = "complex"

    def drawn(self, pdp: Pdp, ratio: float, generators: Sequence[np.random.Generator]) -> Pdp:
        """|h + n|².

        Raises
        ------
        ConfigError
            These profiles hold power only.
        """
        if pdp.amplitude is None:
            raise ConfigError("noise.kind = 'complex' needs complex amplitudes; these profiles hold power only")
        over_gate = self.peak_over_gate if self.signal == "peak-power" else self.mean_over_gate
        power = over_gate(pdp.power) / ratio
        amplitude = pdp.amplitude + np.sqrt(power)[:, None] * np.array([_band_noise(one, pdp) for one in generators])
        return replace(pdp, power=np.abs(amplitude) ** 2, amplitude=amplitude, noise_mean=power, noise_sigma=power)


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
