"""Settings of impairments: what goes wrong between a channel and its image."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field, NonNegativeInt

from mvla_sim.settings import Settings

__all__ = ["ON_PATHS", "ON_SELECTION", "ON_VIEWS", "ImpairmentSettings"]

ON_VIEWS: Final = ("position_error_m",)
"""Impairments of where the sensor is believed to be."""
ON_PATHS: Final = ("timing_offset_s", "timing_jitter_s", "random_phase", "clutter_paths")
"""Impairments of delays and gains, which need paths."""
ON_SELECTION: Final = ("missing_share", "blocked_sector_deg")
"""Impairments of which views there are."""

Azimuth = Annotated[float, Field(ge=0, le=360)]


class ImpairmentSettings(Settings):
    """What goes wrong between a channel and its image; by default nothing does.

    Position error, timing, phase and clutter act on the channel, in this order, before profiles are made of it; missing
    and blocked views are taken out of those that ``views.interval_deg`` and ``views.offset`` choose. Every impairment
    has a random stream of its own, so none changes another, and a larger error is the same realisation scaled.
    """

    position_error_m: Annotated[float, Field(ge=0, le=10)] = Field(
        0.0,
        description="standard deviation of the assumed minus the true position along x and along y, Gaussian and "
        "independent in each view; the receiver of a pair moves with its transmitter",
    )
    timing_offset_s: Annotated[float, Field(ge=-1e-6, le=1e-6)] = Field(
        0.0, description="added to every delay, there and back: 1 ns is 0.15 m of range; the carrier's phase stays"
    )
    timing_jitter_s: Annotated[float, Field(ge=0, le=1e-6)] = Field(
        0.0, description="standard deviation of a delay added to all paths of a view, Gaussian, independent in each"
    )
    random_phase: bool = Field(False, description="add a phase to each view, uniform over the circle")
    missing_share: Annotated[float, Field(ge=0, le=1)] = Field(
        0.0, description="share of the chosen views that are lost, picked at random; rounded to whole views"
    )
    blocked_sector_deg: tuple[Azimuth, Azimuth] | None = Field(
        None,
        description="[from, to]: views at true azimuths from the first to below the second are lost, "
        "counter-clockwise, so [350, 10] is 20° wide; [a, a] blocks nothing",
    )
    clutter_paths: Annotated[float, Field(ge=0, le=10_000)] = Field(
        0.0, description="mean number of false echoes a view, Poisson, uniform over the range gate"
    )
    clutter_db: Annotated[float, Field(ge=-100, le=100)] = Field(
        -10.0,
        description="mean power of a false echo relative to its view's strongest path; powers are exponential about "
        "it, as of Rayleigh fading",
    )
    seed: NonNegativeInt | None = Field(None, description="by default that of the noise")

    @property
    def acting(self) -> tuple[str, ...]:
        """Names of the impairments that are at work, in the order in which they act."""
        idle = {name for name in (*ON_VIEWS, *ON_PATHS, "missing_share") if not getattr(self, name)}
        if self.sector_width_deg == 0:
            idle.add("blocked_sector_deg")
        return tuple(name for name in (*ON_VIEWS, *ON_PATHS, *ON_SELECTION) if name not in idle)

    @property
    def sector_width_deg(self) -> float:
        """Width of the blocked sector, degrees; 0 where none is blocked."""
        if self.blocked_sector_deg is None:
            return 0.0
        first, last = self.blocked_sector_deg
        return last - first if last >= first else last - first + 360

    def of_channel(self, noise_seed: int) -> ImpairmentSettings | None:
        """What of it acts on a channel, everything else at its default and the seed resolved; None: nothing does.

        Equal results have equal impaired channels.
        """
        acting = [name for name in self.acting if name not in ON_SELECTION]
        if not acting:
            return None
        kept = {name: getattr(self, name) for name in acting}
        if "clutter_paths" in acting:
            kept["clutter_db"] = self.clutter_db
        if acting != ["timing_offset_s"]:
            kept["seed"] = noise_seed if self.seed is None else self.seed
        return ImpairmentSettings(**kept)
