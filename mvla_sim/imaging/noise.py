"""Noise at a given SNR, in the PDP domain as in the paper or on the complex CIR: what all kinds of it have."""

from __future__ import annotations

from collections.abc import Sequence
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
    """

    kinds: ClassVar[Kinds[Noise]] = NOISES
    uses_amplitude: ClassVar[bool] = False
    """Whether it is added to complex amplitudes."""

    snr_db: Annotated[float, Field(ge=-100, le=200)] | None = Field(20.0, description="SNR in dB; 'none': no noise")
    reference: Literal["view", "all"] = Field("view", description="whose mean square is the signal: a view's or all's")
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
        return self.drawn(pdp, 10 ** (self.snr_db / 10), generators)

    def drawn(self, pdp: Pdp, ratio: float, generators: Sequence[np.random.Generator]) -> Pdp:
        """Add noise at a ratio ρ = 10^(SNR/10) of signal to noise, from one generator a view."""
        raise NotImplementedError

    def mean_over_gate(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """⟨·⟩ of ``[n_view, n_range]``: the mean over the gate per view, or of all views for each, ``[n_view]``."""
        per_view = values.mean(axis=1)
        return per_view if self.reference == "view" else np.full_like(per_view, per_view.mean())
