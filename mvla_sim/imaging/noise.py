"""Noise at a given SNR, in the PDP domain as in the paper or on the complex CIR: what all kinds of it have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt

from mvla_sim.imaging.pdp import Pdp
from mvla_sim.kinds import Kind, Kinds
from mvla_sim.streams import Stream, stream

__all__ = ["NOISES", "Noise"]

NOISES: Final[Kinds[Noise]] = Kinds(
    "noise kind", "mvla_sim.noises", "mvla_sim.imaging.noises", key="kind", default="gaussian"
)
"""All kinds of noise by name."""


class Noise(Kind):
    """Noise at a given SNR; the realisation depends on the seed and a view's place in the file alone.

    A kind of noise has the field ``kind``, a ``Literal`` of its name, and :meth:`drawn`.

    The paper gives SNRs and adds noise "in the PDP domain" (section "Simulation and Measurement Results"), but does not
    say what of the signal an SNR compares with what of the noise. ``signal`` says it, ρ = 10^(SNR/10), ⟨·⟩ being the
    mean over the gate:

    * ``mean-square``, the default: ρ is a ratio of mean squares of what the noise is added to, ⟨P²⟩ to ⟨n²⟩, or of the
      complex amplitude, ⟨|h|²⟩ to ⟨|n|²⟩. The usual AWGN tools with 'measured' power do this.
    * ``mean-power``: the mean of the PDP over ρ is the noise's standard deviation, or its mean where it has one: a
      ratio of powers, as links are planned. For complex noise it is the same as ``mean-square``.
    * ``peak-power``: the same with the largest value of the PDP in place of its mean, as a network analyser's display
      is read: peak over floor.

    ``clip`` sets what noise of zero mean has made negative to 0, for no receiver shows a power below it.
    """

    kinds: ClassVar[Kinds[Noise]] = NOISES
    uses_amplitude: ClassVar[bool] = False
    """Whether it is added to complex amplitudes."""

    snr_db: Annotated[float, Field(ge=-100, le=200)] | None = Field(20.0, description="SNR in dB; 'none': no noise")
    signal: Literal["mean-square", "mean-power", "peak-power"] = Field(
        "mean-square", description="what of the PDP the SNR compares with the noise"
    )
    reference: Literal["view", "all"] = Field("view", description="whose signal that is: a view's own, or all views'")
    clip: bool = Field(False, description="set powers below 0 to 0 after the noise")
    seed: NonNegativeInt = Field(0, description="of the realisation")

    def add(self, pdp: Pdp, numbers: NDArray[np.intp] | None = None) -> Pdp:
        """Return the profiles with noise; without ``snr_db`` they are returned as they are.

        Parameters
        ----------
        pdp
            Profiles without noise.
        numbers
            Number of each of their views in its file, ``[n_view]``, which names the view's stream of random numbers; by
            default 0, 1, 2 …

        Raises
        ------
        ConfigError
            This kind needs complex amplitudes, and these profiles hold power only.
        """
        if self.snr_db is None:
            return pdp
        places = range(len(pdp.power)) if numbers is None else numbers
        generators = [stream(self.seed, Stream.NOISE, int(view)) for view in places]
        noisy = self.drawn(pdp, 10 ** (self.snr_db / 10), generators)
        return replace(noisy, power=np.maximum(noisy.power, 0)) if self.clip else noisy

    def drawn(self, pdp: Pdp, ratio: float, generators: Sequence[np.random.Generator]) -> Pdp:
        """Add noise at a ratio ρ = 10^(SNR/10) of signal to noise, from one generator a view.

        The profiles should say what was added, ``noise_mean`` and ``noise_sigma``, for detectors that ask for it.
        """
        raise NotImplementedError

    def level(self, power: NDArray[np.float64], ratio: float, second_moment: float = 1.0) -> NDArray[np.float64]:
        """Level of noise on the PDP per view, ``[n_view]``, for an SNR of ``ratio`` in the convention of ``signal``.

        √(⟨P²⟩/(cρ)), ⟨P⟩/ρ or max P/ρ, of ``power`` P, ``[n_view, n_range]``, with c the ``second_moment`` of the noise
        at level 1.
        """
        if self.signal == "mean-square":
            return np.asarray(np.sqrt(self.mean_over_gate(power**2) / ratio / second_moment), np.float64)
        return (self.mean_over_gate(power) if self.signal == "mean-power" else self.peak_over_gate(power)) / ratio

    def peak_over_gate(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Largest of ``[n_view, n_range]`` over the gate per view, or over all views for each, ``[n_view]``."""
        per_view = values.max(axis=1)
        return per_view if self.reference == "view" else np.full_like(per_view, per_view.max())

    def mean_over_gate(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """⟨·⟩ of ``[n_view, n_range]``: the mean over the gate per view, or of all views for each, ``[n_view]``."""
        per_view = values.mean(axis=1)
        return per_view if self.reference == "view" else np.full_like(per_view, per_view.mean())
