"""Local maxima above a noise floor that is estimated from the PDP itself."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat

from mvla_sim.dsp import noise_level
from mvla_sim.errors import ConfigError
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.peaks import PeakDetector, Peaks

__all__ = ["LocalMaxima"]


class LocalMaxima(PeakDetector):
    """A sample is a component if it is a local maximum above the threshold and no stronger one is too close to it.

    The threshold is level + ``threshold_sigma``·σ, and no less than ``dynamic_range_db`` below the view's maximum. The
    paper has "a noise-relative magnitude threshold" (before ``eq:Rmi``) and leaves open what the noise is taken to be:
    ``relative_to`` says it.

    * ``estimated-floor``, the default, and all that measured data allow: of the profile itself, never of the true
      noise. The median is the level, 1.4826 times the median absolute deviation σ, both insensitive to the few samples
      that hold echoes, but not to many.
    * ``true-noise``: mean and σ of the noise that was added, which a simulation knows: the floor does not rise with
      sidelobes and echoes.
    * ``maximum``: ``dynamic_range_db`` alone decides, as on a display of so many decibels; σ is not used.
    """

    kind: Literal["local-maxima"] = "local-maxima"
    dynamic_range_db: PositiveFloat = Field(
        25.0, description="weaker peaks, relative to the strongest, are dropped: two Hann sidelobes reach -25.5 dB"
    )
    min_separation: NonNegativeFloat = Field(1.0, description="in resolution cells: 1/B times the window's broadening")
    relative_to: Literal["estimated-floor", "true-noise", "maximum"] = Field(
        "estimated-floor", description="what the threshold rises from; 'maximum': dynamic_range_db alone decides"
    )
    max_peaks: Annotated[int, Field(ge=1)] | None = Field(None, description="keep the strongest; by default all")
    refine: bool = Field(True, description="move each peak to the vertex of the parabola through three samples")

    def peaks_of(self, pdp: Pdp) -> Peaks:
        """Find the components of every view.

        Raises
        ------
        ConfigError
            The threshold is relative to the true noise, and that is not known.
        """
        from scipy.signal import find_peaks  # noqa: PLC0415 - a quarter of what each worker and command would import

        distance = max(1.0, self.min_separation * pdp.broadening * pdp.resolution_m / pdp.step_m)
        ranges, powers, sizes = [], [], []
        for power, level in zip(pdp.power, self._noise_threshold(pdp), strict=True):
            floor = max(level, power.max() * 10 ** (-self.dynamic_range_db / 10))
            found, _ = find_peaks(power, height=max(floor, np.finfo(np.float64).tiny), distance=distance)
            shift, height = _vertex(power, found) if self.refine else (np.zeros(found.size), power[found])
            if self.max_peaks is not None and found.size > self.max_peaks:
                strongest = np.sort(np.argsort(-height, kind="stable")[: self.max_peaks])
                found, shift, height = found[strongest], shift[strongest], height[strongest]
            ranges.append(pdp.start_m + pdp.step_m * (found + shift))
            powers.append(height)
            sizes.append(found.size)
        return Peaks(np.concatenate(ranges), np.concatenate(powers), np.array(sizes, np.int64))

    def _noise_threshold(self, pdp: Pdp) -> NDArray[np.float64]:
        """What a component of each view has to exceed the noise by, ``[n_view]``; −∞ where noise does not count."""
        if self.relative_to == "maximum":
            return np.full(len(pdp.power), -np.inf)
        level, sigma = pdp.noise_mean, pdp.noise_sigma
        if self.relative_to == "estimated-floor":
            level, sigma = noise_level(pdp.power)
        if level is None or sigma is None:
            raise ConfigError(
                "peaks.relative_to = 'true-noise': the noise of these profiles is not known (measured data, "
                "noise.snr_db = 'none', or a kind of noise that does not tell); allowed: estimated-floor, maximum"
            )
        return np.asarray(level + self.threshold_sigma * sigma, np.float64)


def _vertex(power: NDArray[np.float64], found: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Vertex of the parabola through each peak and its neighbours: shift in samples (within ±1/2) and height."""
    left, middle, right = power[found - 1], power[found], power[found + 1]
    curvature = left - 2 * middle + right
    safe = np.where(curvature < 0, curvature, -1.0)  # a flat top has no curvature and stays where it is
    shift = np.where(curvature < 0, 0.5 * (left - right) / safe, 0.0)
    return shift, middle - 0.25 * (left - right) * shift
