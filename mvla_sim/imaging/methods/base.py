"""What a method is."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.projection import RangeProfiles

__all__ = ["Method", "SumOverViews"]


class Method:
    """A way from an observation to an image.

    A method of this package is a module of :mod:`mvla_sim.imaging.methods` with an instance named ``METHOD``, and its
    name in :data:`mvla_sim.imaging.imaging_settings.METHOD_NAMES`. Other people's are functions; see
    :mod:`mvla_sim.imaging.methods.registry`.
    """

    title: ClassVar[str] = ""
    """Name in figures and tables."""
    uses_peaks: ClassVar[bool] = True
    """Whether it looks at peaks; if it looks at nothing else, it needs one at least."""
    uses_pdp: ClassVar[bool] = False
    """Whether it looks at profiles, which ready-made components do not have."""
    uses_amplitude: ClassVar[bool] = False
    """Whether it looks at complex amplitudes, which profiles lose with noise that is added to their power."""
    digest: str = ""
    """SHA-256 of the code of a method from elsewhere."""

    def profiles(self, seen: Observation) -> RangeProfiles | None:
        """Range profiles that images of any of these views can share; None where there are none to share."""
        del seen
        return None

    def image(self, seen: Observation) -> Estimate:
        """Make the image.

        Raises
        ------
        ConfigError, DataError
            A setting does not fit the observation; one line.
        """
        raise NotImplementedError


class SumOverViews(Method):
    """Methods that are one projection: ``image_n = Σ_m q_m(|p_n − T_m|)``."""

    per_view: ClassVar[bool] = True
    """Whether the sum is divided by the number of views."""
    with_support: ClassVar[bool] = True
    """Whether the angular support of the profiles' peaks is offered to the threshold."""

    def own_profiles(self, seen: Observation) -> RangeProfiles:
        """q_m of every view."""
        raise NotImplementedError

    def profiles(self, seen: Observation) -> RangeProfiles | None:
        """q_m of every view, where they depend on nothing but that view's peaks."""
        return None if self.uses_pdp else self.own_profiles(seen)

    def image(self, seen: Observation) -> Estimate:
        """Project."""
        result = seen.project(self.own_profiles(seen) if seen.made is None else seen.made)
        score = result.total / np.float32(seen.n_view) if self.per_view else result.total
        return Estimate(score, result.support_deg if self.with_support else None)
