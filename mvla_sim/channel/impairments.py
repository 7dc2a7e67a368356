"""Impairments of a channel and of its views, each a pure function of a seed."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.loading import Channel
from mvla_sim.constants import range_to_delay
from mvla_sim.errors import ConfigError
from mvla_sim.scene.views import Views, wrapped
from mvla_sim.settings import Settings
from mvla_sim.streams import Stream, stream

__all__ = ["ImpairmentSettings", "assumed_views", "impair", "impair_channel", "remaining_views"]

_SAME_DEG = 1e-6
"""Views so close to an end of a sector stand on it."""
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


def assumed_views(views: Views, settings: ImpairmentSettings) -> Views:
    """Views as imaging believes them to be: true positions plus an error along x and y, and the angles to match.

    The error of view m is the same however many views there are. Antennas with boresights of their own keep them.
    """
    if not settings.position_error_m:
        return views
    error = stream(settings.seed or 0, Stream.POSITION).standard_normal((len(views), 2))
    shift = np.column_stack([settings.position_error_m * error, np.zeros(len(views))])
    receivers = None if views.receivers_m is None else views.receivers_m + shift
    about = (views.midpoints_m + shift)[:, :2] - views.center_m
    return Views(
        views.positions_m + shift,
        wrapped(np.rad2deg(np.arctan2(about[:, 1], about[:, 0]))),
        views.center_m,
        receivers,
        views.boresights,
    )


def impair(cir: Cir, settings: ImpairmentSettings, gate_m: tuple[float, float]) -> Cir:
    """Return the channel with wrong positions, delays and phases, and with false echoes.

    Parameters
    ----------
    cir
        True paths at true positions.
    settings
        What to impair, with the seed; 0 where it has none. Missing and blocked views are left to
        :func:`remaining_views`.
    gate_m
        Where false echoes are, (near, far), one-way metres.

    Raises
    ------
    ConfigError
        A delay would become negative.

    Notes
    -----
    * Position: the paths stay, the views move; see :func:`assumed_views`.
    * Timing: τ + offset + jitter of the view. Gains keep the phase of the true delay: it is the sampling that is late,
      not the oscillator.
    * Phase: every path of a view is turned by one angle.
    * Clutter: a Poisson number of echoes, at delays that are uniform over the gate whatever the timing, with circular
      Gaussian gains of mean power 10^(clutter_db/10) times that of the view's strongest path. A view without paths
      stays empty.
    """
    impaired = replace(cir, views=assumed_views(cir.views, settings))
    seed = settings.seed or 0
    if settings.timing_offset_s or settings.timing_jitter_s:
        jitter = settings.timing_jitter_s * stream(seed, Stream.JITTER).standard_normal(cir.n_view)
        delay = cir.delay_s + np.repeat(settings.timing_offset_s + jitter, cir.row_size)
        if (delay < 0).any():
            name = "timing_offset_s" if settings.timing_offset_s < 0 else "timing_jitter_s"
            raise ConfigError(
                f"impairments.{name} = {getattr(settings, name):g}: a delay would become {delay.min():.3g} s; the "
                f"shortest is {cir.delay_s.min():.3g} s, and none may be below 0"
            )
        impaired = replace(impaired, delay_s=delay)
    if settings.random_phase:
        impaired = impaired.with_phases(2 * np.pi * stream(seed, Stream.PHASE).random(cir.n_view))
    return _with_clutter(impaired, settings, gate_m) if settings.clutter_paths else impaired


def impair_channel(channel: Channel, settings: ImpairmentSettings, gate_m: tuple[float, float]) -> Channel:
    """The same of a channel of any kind: measured ones take a position error alone.

    Raises
    ------
    ConfigError
        An impairment of paths for a channel that has none, or as :func:`impair`.
    """
    if isinstance(channel, Cir):
        return impair(channel, settings, gate_m)
    for name in settings.acting:
        if name in ON_PATHS:
            what = "ready-made components" if isinstance(channel, Components) else "measured frequency responses"
            value = str(getattr(settings, name)).lower()
            raise ConfigError(
                f"impairments.{name} = {value}: needs traced paths, and this file holds {what}; allowed for them: "
                f"{', '.join((*ON_VIEWS, *ON_SELECTION))}"
            )
    return replace(channel, views=assumed_views(channel.views, settings))


def remaining_views(views: Views, chosen: NDArray[np.intp], settings: ImpairmentSettings) -> NDArray[np.intp]:
    """Those of the chosen views that are neither lost at random nor in the blocked sector.

    Parameters
    ----------
    views
        All views of the file, at their true positions.
    chosen
        Indices of the nominal views, ``[n]``.
    settings
        With the seed; 0 where it has none.

    Returns
    -------
    indices
        ``[k]``, in the order given. Both impairments pick from all the chosen views, so neither changes the other, and
        of two shares the larger loses what the smaller does.

    Raises
    ------
    ConfigError
        None is left.
    """
    chance = stream(settings.seed or 0, Stream.LOSS).random(len(views))[chosen]
    count = int(np.floor(settings.missing_share * chosen.size + 0.5))
    lost = np.zeros(chosen.size, bool)
    lost[np.argsort(chance, kind="stable")[:count]] = True
    if (width := settings.sector_width_deg) and settings.blocked_sector_deg is not None:
        along = np.mod(views.angles_deg[chosen] - settings.blocked_sector_deg[0] + _SAME_DEG, 360)
        lost |= along < width
    if lost.all():
        names = [name for name in settings.acting if name in ON_SELECTION]
        values = ((name, getattr(settings, name)) for name in names)
        said = ", ".join(f"{name} = {list(v) if isinstance(v, tuple) else v}" for name, v in values)
        raise ConfigError(f"impairments.{said}: none of the {chosen.size} chosen views is left")
    return np.asarray(chosen[~lost], np.intp)


def _with_clutter(cir: Cir, settings: ImpairmentSettings, gate_m: tuple[float, float]) -> Cir:
    """Add false echoes behind the paths of each view."""
    gains, delays = [cir.gain], [cir.delay_s]
    view = [np.repeat(np.arange(cir.n_view), cir.row_size)]
    for number in range(cir.n_view):
        random = stream(settings.seed or 0, Stream.CLUTTER, number)
        count = int(random.poisson(settings.clutter_paths))
        strongest = float(np.abs(cir.gain[cir.rows(number)]).max(initial=0.0))
        if not count or not strongest:
            continue
        parts = random.standard_normal((count, 2)) @ np.array([1, 1j]) / np.sqrt(2)
        gains.append((strongest * 10 ** (settings.clutter_db / 20) * parts).astype(np.complex64))
        delays.append(np.asarray(range_to_delay(random.uniform(*gate_m, count)), np.float64))
        view.append(np.full(count, number))
    views = np.concatenate(view)
    order = np.argsort(views, kind="stable")
    added = views.size - cir.gain.size
    return replace(
        cir,
        gain=np.concatenate(gains)[order],
        delay_s=np.concatenate(delays)[order],
        interaction=np.concatenate([cir.interaction, np.zeros(added, np.uint8)])[order],
        first_point_m=np.concatenate([cir.first_point_m, np.full((added, 3), np.nan, np.float32)])[order],
        row_size=np.bincount(views, minlength=cir.n_view).astype(np.int64),
    )
