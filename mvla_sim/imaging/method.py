"""What a method is, and how it is found by its name."""

from __future__ import annotations

from typing import Any, ClassVar, Final

import numpy as np

from mvla_sim.errors import MvlaError
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.projection import RangeProfiles
from mvla_sim.kinds import Kind, Kinds, source_digest

__all__ = ["METHODS", "Method", "SumOverViews", "phase_free_methods", "title_of"]


class MethodKinds(Kinds["Method"]):
    """The methods: classes, and the functions of :mod:`mvla_sim.imaging.methods.functions`."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.of_files: dict[str, type[Method]] = {}
        """Functions of files that were asked for, by name."""
        self._tables: tuple[tuple[type[Method], ...], dict[str, type[Method]]] = ((), {})

    def tables(self) -> dict[str, type[Method]]:
        """This package's methods by the names of their tables."""
        own = self.own()
        if self._tables[0] is not own:  # asked for with every validation
            self._tables = (own, {method.block_name(): method for method in reversed(own)})
        return self._tables[1]

    def block(self, key: str, chosen: str) -> type[Method] | None:
        """The method whose settings stand under ``[imaging.KEY]``; None for none's.

        It is the one that is chosen, or another that is found by its name alone.

        Raises
        ------
        ConfigError
            As :meth:`find`, of the method that is chosen.
        """
        method = self.find(chosen)
        if method.block_name() == key:
            return method
        if key in self.tables():
            return self.tables()[key]
        # Sweeps have the settings of several.
        others = [*self.of_files.values(), *([self.find(key)] if key in self.names() else [])]
        return next((method for method in others if method.block_name() == key), None)


METHODS: Final = MethodKinds("method", "mvla_sim.methods", "mvla_sim.imaging.methods", key=None)
"""All methods by name."""


class Method(Kind):
    """A way from an observation to an image: its settings, and :meth:`image`.

    A method of this package is a module of :mod:`mvla_sim.imaging.methods` with one class. Its settings are its fields;
    they stand under ``[imaging.NAME]``. Other people's may be such classes too, or functions; see
    :mod:`mvla_sim.imaging.methods.functions`.
    """

    kinds: ClassVar[Kinds[Any]] = METHODS

    name: ClassVar[str]
    """Name in settings."""
    block: ClassVar[str | None] = None
    """Name of its settings' table, where that is another than its own name."""
    title: ClassVar[str] = ""
    """Name in figures and tables."""
    score_label: ClassVar[str] = "score s"
    """What its image is called on a figure's axis."""
    uses_peaks: ClassVar[bool] = True
    """Whether it looks at peaks; if it looks at nothing else, it needs one at least."""
    uses_pdp: ClassVar[bool] = False
    """Whether it looks at profiles, which ready-made components do not have."""
    uses_amplitude: ClassVar[bool] = False
    """Whether it looks at complex amplitudes, which profiles lose with noise that is added to their power."""

    @classmethod
    def block_name(cls) -> str:
        """Name of its settings' table in ``[imaging]``."""
        return cls.block or cls.name

    @classmethod
    def digest(cls) -> str:
        """SHA-256 of the files that define it, its own and its bases'; empty where they are none."""
        return source_digest(cls)

    @property
    def projections(self) -> float:
        """About how many projections its image costs, for estimates of time."""
        return 1.0

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


def phase_free_methods() -> tuple[str, ...]:
    """Names of the package's methods that need no phase."""
    return tuple(method.name for method in METHODS.own() if not method.uses_amplitude)


def title_of(name: str) -> str:
    """Name of a method in figures and tables; the name itself where it has no other, or is not to be found here."""
    try:
        return METHODS.find(name).title or name
    except MvlaError:  # of a table that was made elsewhere
        return name
