"""From a channel to an image: the stages in order, each a function, and what they made last kept."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.impairments import ImpairmentSettings, assumed_views, impair_channel
from mvla_sim.channel.loading import Channel
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import range_resolution
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import ConfigError, DataError, MvlaWarning, check_argument
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import build_beam
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.noise import NOISES, Noise
from mvla_sim.imaging.observation import FrontEnd, Observation
from mvla_sim.imaging.paths import PathSettings, choose_paths
from mvla_sim.imaging.pdp import Pdp, PdpSettings, compute_pdp, gate_for
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.projection import check_grid
from mvla_sim.imaging.thresholds import joint_threshold
from mvla_sim.imaging.view_selection import chosen_views
from mvla_sim.scene.antenna import Antenna
from mvla_sim.scene.views import SAME_HEIGHT_M, Views

__all__ = [
    "Pipeline", "ProfiledChannel", "effective_noise", "observe", "profile_channel", "profile_key", "reconstruct",
    "views_needed",
]  # fmt: skip

Value = TypeVar("Value")
ProfileKey = tuple[PathSettings, ImpairmentSettings | None, PdpSettings, tuple[float, float]]


@dataclass(frozen=True, eq=False, repr=False)
class ProfiledChannel:
    """A channel behind the first stages: its paths chosen, impaired, its profiles computed, no noise added yet.

    Attributes
    ----------
    pdp
        Profiles of the views ``numbers``; None for channels that hold components alone.
    components
        The channel's own components of these views; None for the others.
    numbers
        Which views of the file these are, ``[n]``, rising.
    views
        All views of the file, where imaging believes them to be.
    true_views
        All views of the file, where they are; these decide which are chosen.
    resolution_m
        ΔR, metres.
    extent_m
        The target's extent D, metres; NaN where it is not known.
    outline
        The target's cross-section, which imaging never looks at; None where it is not known.
    plane_height_m
        Height of the imaging plane, metres, where the grid lies by default; None where it is not known.
    antenna
        Pattern of the antennas, which tells where their beam reaches.
    measured
        Whether it has noise of its own, so that none is added unless the settings ask for it by name.
    """

    pdp: Pdp | None
    components: Peaks | None
    numbers: NDArray[np.intp]
    views: Views
    true_views: Views
    resolution_m: float
    extent_m: float
    outline: Any
    plane_height_m: float | None
    antenna: Antenna
    measured: bool

    def __repr__(self) -> str:
        return f"ProfiledChannel({self.numbers.size} of {len(self.views)} views, ΔR {self.resolution_m:.3g} m)"


def views_needed(views: Views, settings: ImagingSettings) -> NDArray[np.intp]:
    """Views of a file, at their true positions, whose profiles an image is made of, ``[n]`` rising.

    They are the chosen ones, or all where the noise's power depends on all.

    Raises
    ------
    ConfigError
        The settings choose views that the file does not have, or none.
    """
    chosen = chosen_views(views, settings.views, settings.impairments, settings.noise.seed)
    return np.arange(len(views)) if settings.noise.reference == "all" else chosen


def profile_key(settings: ImagingSettings, views: Views, plane_height_m: float | None = None) -> ProfileKey:
    """What decides a channel's profiles before noise: paths, impairments, PDP settings, range gate [m].

    The gate, where false echoes are too, is that of the assumed positions.
    """
    impairments = settings.impairments.of_channel(settings.noise.seed)
    seen = views if impairments is None else assumed_views(views, impairments)
    gate_m = gate_for(VoxelGrid.from_settings(settings.grid, plane_height_m), seen, settings.pdp)
    return settings.paths, impairments, settings.pdp, gate_m


def profile_channel(
    channel: Channel,
    settings: ImagingSettings,
    only: NDArray[np.intp] | None = None,
    *,
    with_amplitude: bool = True,
) -> ProfiledChannel:
    """Run the first stages: choice of paths, impairments, then power delay profiles.

    Parameters
    ----------
    channel
        Paths, frequency responses or components.
    settings
        Paths, impairments, PDP settings, and the grid, which decides the range gate.
    only
        Views whose profiles are needed, ``[n]`` rising; by default all. It changes no number.
    with_amplitude
        Keep the complex amplitudes, which complex noise and coherent methods alone need.

    Raises
    ------
    ConfigError
        A choice of paths or an impairment that this kind of channel does not take, or a gate that does not fit the
        data.
    DataError
        No path is chosen, or none inside the gate.
    """
    paths, impairments, pdp_settings, gate_m = profile_key(settings, channel.views, channel.plane_height_m)
    numbers = np.arange(channel.n_view) if only is None else only
    seen = choose_paths(channel, paths)
    seen = seen if impairments is None else impair_channel(seen, impairments, gate_m)
    pdp, components = None, None
    if isinstance(seen, Components):
        components = Peaks(seen.range_m, seen.power, seen.row_size).select(numbers)
    else:
        assert isinstance(seen, Cir | FrequencyResponse)
        pdp = compute_pdp(seen, pdp_settings, gate_m, numbers)
        if not with_amplitude:
            pdp = replace(pdp, amplitude=None)
    return ProfiledChannel(
        pdp=pdp,
        components=components,
        numbers=numbers,
        views=seen.views,
        true_views=channel.views,
        resolution_m=range_resolution(channel.bandwidth_hz),
        extent_m=channel.extent_m,
        outline=channel.outline,
        plane_height_m=channel.plane_height_m,
        antenna=channel.antenna,
        measured=not isinstance(channel, Cir),
    )


class Pipeline:
    """The stages behind the profiles of one channel: noise, peaks, the method's own profiles, projection, thresholds.

    What a stage made last is kept until it is asked for something else, so images in an order in which neighbours share
    settings cost little.

    Parameters
    ----------
    channel
        What :func:`profile_channel` returned, for the settings that are used here.
    """

    def __init__(self, channel: ProfiledChannel) -> None:
        self.channel = channel
        self._kept: dict[str, tuple[Hashable, Any]] = {}

    def keep(self, stage: str, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return what a stage makes, the last value where the key is the last one's."""
        if stage not in self._kept or self._kept[stage][0] != key:
            self._kept[stage] = (key, make())
        value: Value = self._kept[stage][1]
        return value

    def front_end(self, settings: ImagingSettings) -> FrontEnd:
        """Profiles with noise and, for methods that look at them, peaks, of the views ``channel.numbers``.

        Components are taken as they are. Measured channels get no noise but their own, unless the settings ask for it.

        Raises
        ------
        ConfigError
            A method that needs profiles of components, which are none; or a method or noise that needs phases, of
            profiles of powers.
        """
        channel, method = self.channel, settings.chosen
        if channel.components is not None:
            if method.uses_pdp:
                raise ConfigError(
                    f"method = '{settings.method}': this file holds ready-made components; {settings.method} needs "
                    "profiles, use mvla-gr"
                )
            return FrontEnd(None, channel.components, channel.resolution_m)
        clean, noise = channel.pdp, effective_noise(channel, settings.noise)
        assert clean is not None
        if settings.pdp.sum == "powers":
            _check_phaseless(settings, noise)
        pdp = self.keep("noise", noise, lambda: _with_noise(channel, clean, noise))
        peaks = Peaks.none(channel.numbers.size)
        if method.uses_peaks:
            peaks = self.keep("peaks", (noise, settings.peaks), lambda: settings.peaks.peaks_of(pdp))
        return FrontEnd(pdp, peaks, channel.resolution_m)

    def observation(self, settings: ImagingSettings) -> Observation:
        """What a method sees of the chosen views. Raises as :meth:`front_end`."""
        return self._of_all(settings).select(self._rows(settings))

    def _rows(self, settings: ImagingSettings) -> NDArray[np.intp]:
        """Where the chosen views are among ``channel.numbers``."""
        views = self.channel.true_views
        return np.searchsorted(
            self.channel.numbers, chosen_views(views, settings.views, settings.impairments, settings.noise.seed)
        )

    def _of_all(self, settings: ImagingSettings) -> Observation:
        """What a method would see of the views ``channel.numbers``."""
        channel = self.channel
        grid = VoxelGrid.from_settings(settings.grid, channel.plane_height_m)
        return Observation(
            front=self.front_end(settings),
            views=self.keep("views", None, lambda: channel.views.select(channel.numbers)),
            grid=grid,
            settings=settings,
            extent_m=channel.extent_m,
            span_m=self.keep(
                "span", settings.grid, lambda: grid.range_span_m(channel.views.positions_m, channel.views.receivers_m)
            ),
            beam=self.keep("beam", settings.beam, lambda: build_beam(channel.antenna, settings.beam)),
        )

    def image(self, settings: ImagingSettings) -> Image:
        """Make the image; with ``settings.threshold`` the binary one too.

        Raises
        ------
        ConfigError, DataError
            A setting does not fit the channel, or nothing is left to project.
        """
        method, rows, every = settings.chosen, self._rows(settings), self._of_all(settings)
        if method.uses_peaks and not method.uses_pdp and not every.peaks.row_size[rows].any():
            raise DataError(
                f"no peak in any of the {rows.size} chosen views; lower peaks.threshold_sigma (now "
                f"{settings.peaks.threshold_sigma:g}) or raise the SNR"
            )
        key = (method.name, method, settings.mvla, settings.noise, settings.peaks, every.span_m)
        made = self.keep("profiles", key, lambda: method.profiles(every))
        seen = replace(every, made=made).select(rows)
        result = method.image(seen)
        occupied = None
        if settings.threshold is not None:
            pair = settings.threshold.thresholds(result.score, result.support_deg, seen.grid, seen.resolution_m)
            occupied = joint_threshold(result.score, result.support_deg, *pair)
        return Image(
            score=result.score,
            support_deg=result.support_deg,
            grid=seen.grid,
            method=settings.method,
            n_view=seen.n_view,
            occupied=occupied,
            outline=self.channel.outline,
            plane_height_m=self.channel.plane_height_m,
            resolution_m=seen.resolution_m,
        )


def _with_noise(channel: ProfiledChannel, clean: Pdp, noise: Noise) -> Pdp:
    """The profiles with noise; what was added to a measured channel is not all the noise that it has."""
    pdp = noise.add(clean, channel.numbers)
    return replace(pdp, noise_mean=None, noise_sigma=None) if channel.measured else pdp


def _check_phaseless(settings: ImagingSettings, noise: Noise) -> None:
    """Refuse what needs amplitudes, of profiles that have none."""
    kind = NOISES.name_of(type(noise)) if noise.snr_db is not None and noise.uses_amplitude else None
    needs = f"noise.kind = '{kind}'" if kind else f"method = '{settings.method}'"
    if kind or settings.chosen.uses_amplitude:
        raise ConfigError(f"pdp.sum = 'powers': leaves no phase, which {needs} needs; use pdp.sum = 'amplitudes'")


def effective_noise(channel: ProfiledChannel, noise: Noise) -> Noise:
    """The noise that is really added: none to components, nor to measured channels unless it is set."""
    asked = not channel.measured or "snr_db" in noise.model_fields_set
    added = asked and channel.components is None
    return noise if added else noise.model_copy(update={"snr_db": None})


def observe(
    channel: Channel,
    settings: ImagingSettings | None = None,
    *,
    method: str | Callable[..., Any] | None = None,
    **values: Any,
) -> Observation:
    """What a method would see of a channel: noisy profiles and peaks of the chosen views, and the grid.

    Parameters and errors are those of :func:`reconstruct`.

    Returns
    -------
    Observation
        ``pdp``, ``peaks`` and ``views`` of the same views. Of components ``front.pdp`` is None.
    """
    settings = _given(settings, method, values)
    return _started(channel, settings).observation(settings)


def reconstruct(
    channel: Channel,
    settings: ImagingSettings | None = None,
    *,
    method: str | Callable[..., Any] | None = None,
    **values: Any,
) -> Image:
    """Make an image from a channel.

    Parameters
    ----------
    channel
        All views: traced paths, measured frequency responses, or ready-made components.
    settings
        Method, grid, front end, noise, views and impairments; the defaults are the paper's.
    method, **values
        Instead of ``settings``, as for :func:`imaging_settings`: ``reconstruct(cir, method="bp", interval_deg=10)``.

    Returns
    -------
    Image
        Score and, for methods with peaks, angular support; with ``settings.threshold`` the binary image too.

    Raises
    ------
    ConfigError, DataError
        A setting does not fit the file, or nothing is left to project.
    """
    settings = _given(settings, method, values)
    stages = _started(channel, settings)
    grid = settings.grid.model_copy(update={"center_m": settings.grid.middle_m(channel.plane_height_m)})
    used = settings.model_copy(update={"noise": effective_noise(stages.channel, settings.noise), "grid": grid})
    return replace(
        stages.image(settings),
        config={"simulation": dict(channel.config), "imaging": used.model_dump(mode="json")},
        provenance={**provenance(), **{f"cir.{key}": value for key, value in channel.provenance.items()}},
    )


def _given(settings: ImagingSettings | None, method: Any, values: dict[str, Any]) -> ImagingSettings:
    if settings is None:
        return imaging_settings(method=method, **values)
    check_argument("settings", settings, ImagingSettings, "see imaging_settings")
    if method is not None or values:
        names = ", ".join([*(["method"] if method is not None else []), *values])
        raise ConfigError(f"settings are given, and {names} beside them; give one or the other")
    return settings


def _started(channel: Channel, settings: ImagingSettings) -> Pipeline:
    """The stages behind the profiles of the views that an image needs."""
    check_argument("channel", channel, Channel, "for a file: load_channel")
    grid = VoxelGrid.from_settings(settings.grid, channel.plane_height_m)
    check_grid(grid)
    _say_height(channel, grid)
    return Pipeline(profile_channel(channel, settings, views_needed(channel.views, settings)))


def _say_height(channel: Channel, grid: VoxelGrid) -> None:
    """Tell that a grid of one layer is at another height than the sensor, where no scene has said so."""
    heights, z = channel.views.midpoints_m[:, 2], grid.center_m[2]
    away = heights[np.argmin(abs(heights - z))]
    if channel.plane_height_m is None and grid.counts[2] == 1 and abs(away - z) > SAME_HEIGHT_M:
        warnings.warn(
            f"the sensor is at z = {away:.4g} m and the grid at {z:g} m: upright faces mirror its waves at its own "
            "height; set the z of grid.center_m",
            MvlaWarning,
            stacklevel=4,
        )
