"""From a CIR to an image: the stages in order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.impairments import assumed_views, impair_channel, remaining_views
from mvla_sim.channel.loading import Channel
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import range_resolution
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.automatic import thresholds_of
from mvla_sim.imaging.beam import build_beam
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.imaging_settings import ImagingSettings, NoiseSettings, ViewSettings
from mvla_sim.imaging.methods.base import Method
from mvla_sim.imaging.methods.registry import find_method
from mvla_sim.imaging.noise import add_noise
from mvla_sim.imaging.observation import FrontEnd, Observation
from mvla_sim.imaging.pdp import compute_pdp, gate_for
from mvla_sim.imaging.peaks import Peaks, extract_peaks
from mvla_sim.imaging.projection import check_grid
from mvla_sim.imaging.threshold import joint_threshold
from mvla_sim.scene.views import Views

__all__ = ["check_peaks", "chosen_views", "front_end", "impaired", "reconstruct", "select_views"]


def impaired(channel: Channel, settings: ImagingSettings, grid: VoxelGrid) -> Channel:
    """Return the channel as the settings impair it; it alone is what imaging sees of it.

    The range gate, where false echoes are too, is that of the assumed positions.

    Raises
    ------
    ConfigError
        An impairment that this kind of channel does not take, or a delay would become negative.
    """
    own = settings.impairments.of_channel(settings.noise.seed)
    if own is None:
        return channel
    return impair_channel(channel, own, gate_for(grid, assumed_views(channel.views, own), settings.pdp))


def front_end(channel: Channel, settings: ImagingSettings, grid: VoxelGrid) -> FrontEnd:
    """Compute PDPs, add noise and, for methods that look at them, extract peaks, for all views of the file.

    Components are taken as they are. Frequency responses are measured and get no noise but their own, unless the
    settings ask for it by name.

    Raises
    ------
    ConfigError
        A method that needs profiles of components, which are none, or a gate that does not fit the data.
    DataError
        No path inside the gate, or no peak in any view.
    """
    method = find_method(settings.method)
    if isinstance(channel, Components):
        if method.uses_pdp:
            raise ConfigError(
                f"method = '{settings.method}': this file holds ready-made components; {settings.method} needs "
                "profiles, use mvla-gr"
            )
        peaks = Peaks(channel.range_m, channel.power, channel.row_size)
        return FrontEnd(None, peaks, range_resolution(channel.bandwidth_hz))
    assert isinstance(channel, Cir | FrequencyResponse)
    gate = gate_for(grid, channel.views, settings.pdp)
    pdp = add_noise(compute_pdp(channel, settings.pdp, gate), _noise(channel, settings.noise))
    peaks = extract_peaks(pdp, settings.peaks) if method.uses_peaks else Peaks.none(channel.n_view)
    return FrontEnd(pdp, peaks, pdp.resolution_m)


def _noise(channel: Channel, settings: NoiseSettings) -> NoiseSettings:
    """Settings of the noise that is really added: none to components, nor to measured channels unless it is set."""
    asked = not isinstance(channel, FrequencyResponse) or "snr_db" in settings.model_fields_set
    added = asked and not isinstance(channel, Components)
    return settings if added else settings.model_copy(update={"snr_db": None})


def select_views(views: Views, settings: ViewSettings) -> NDArray[np.intp]:
    """Indices of every ``interval_deg``-th view from view ``offset`` on.

    Raises
    ------
    ConfigError
        The views are not evenly spaced, the interval is no multiple of their spacing or, on a closed trajectory, does
        not divide them, or the offset is not below the number of patterns.
    """
    if settings.interval_deg is None:
        if settings.offset:
            raise ConfigError(f"views.offset = {settings.offset} needs views.interval_deg")
        return np.arange(len(views))
    angles = np.unwrap(np.deg2rad(views.angles_deg))
    steps = np.rad2deg(np.diff(angles))
    spacing = abs(float(steps[0])) if steps.size else 0.0
    if spacing == 0 or np.abs(steps - steps[0]).max() > 1e-3 * spacing:
        raise ConfigError(f"views.interval_deg = {settings.interval_deg:g}: the file's views are not evenly spaced")
    stride = round(settings.interval_deg / spacing)
    turn = min(len(views), round(360 / spacing)) if views.closed else len(views)  # of several turns, a turn each height
    strides = [k for k in range(1, turn + 1) if not (views.closed and turn % k)]
    if stride not in strides or abs(stride * spacing - settings.interval_deg) > 1e-3 * spacing:
        allowed = [f"{k * spacing:.4g}" for k in strides]
        raise ConfigError(
            f"views.interval_deg = {settings.interval_deg:g} does not divide the file's {len(views)} views at "
            f"{spacing:.4g}°; allowed: {', '.join(allowed[:12])}{', …' if len(allowed) > 12 else ''}"
        )
    if settings.offset >= stride:
        raise ConfigError(f"views.offset = {settings.offset}: at {settings.interval_deg:g}° allowed: 0 to {stride - 1}")
    return np.arange(settings.offset, len(views), stride)


def chosen_views(views: Views, settings: ImagingSettings) -> NDArray[np.intp]:
    """Indices of the views that an image is made of: of those of :func:`select_views` what is neither lost nor blocked.

    Parameters
    ----------
    views
        All views of the file, at their true positions.
    settings
        ``views``, ``impairments``, and the seed of ``noise`` where the impairments have none.

    Raises
    ------
    ConfigError
        As :func:`select_views`, or no view is left.
    """
    chosen = select_views(views, settings.views)
    own = settings.impairments
    if not own.missing_share and not own.sector_width_deg:
        return chosen
    seed = settings.noise.seed if own.seed is None else own.seed
    return remaining_views(views, chosen, own.model_copy(update={"seed": seed}))


def check_peaks(method: Method, front: FrontEnd) -> None:
    """Refuse to make an image of peaks where no chosen view has one.

    Raises
    ------
    DataError
        The number of views, and what helps.
    """
    if method.uses_peaks and not method.uses_pdp and front.peaks.range_m.size == 0:
        raise DataError(
            f"no peak in any of the {front.peaks.n_view} chosen views; lower peaks.threshold_sigma or raise the SNR"
        )


def reconstruct(channel: Channel, settings: ImagingSettings | None = None) -> Image:
    """Make an image from a channel.

    Parameters
    ----------
    channel
        All views: traced paths, measured frequency responses, or ready-made components.
    settings
        Method, grid, front end, noise, views and impairments; the defaults are the paper's.

    Returns
    -------
    Image
        Score and, for methods with peaks, angular support; with ``settings.threshold`` the binary image too.

    Raises
    ------
    ConfigError, DataError
        A setting does not fit the file, or nothing is left to project.
    """
    settings = settings or ImagingSettings()
    grid = VoxelGrid.from_settings(settings.grid)
    check_grid(grid)
    chosen = chosen_views(channel.views, settings)
    channel = impaired(channel, settings, grid)
    front = front_end(channel, settings, grid).select(chosen)
    method = find_method(settings.method)
    check_peaks(method, front)
    seen = Observation(
        front=front,
        views=channel.views.select(chosen),
        grid=grid,
        settings=settings,
        extent_m=channel.extent_m,
        span_m=grid.range_span_m(channel.views.positions_m, channel.views.receivers_m),
        beam=build_beam(channel.antenna, settings.beam),
    )
    result = method.image(seen)
    occupied = None
    if settings.threshold is not None:
        chosen_pair = thresholds_of(settings.threshold, result.score, result.support_deg, grid, seen.resolution_m)
        occupied = joint_threshold(
            result.score, result.support_deg, chosen_pair.top_percent, chosen_pair.min_support_deg
        )
    used = settings.model_copy(update={"noise": _noise(channel, settings.noise)})
    return Image(
        score=result.score,
        support_deg=result.support_deg,
        grid=grid,
        method=settings.method,
        n_view=seen.n_view,
        occupied=occupied,
        outline=channel.outline,
        resolution_m=seen.resolution_m,
        config={"simulation": dict(channel.config), "imaging": used.model_dump(mode="json")},
        provenance={**provenance(), **{f"cir.{key}": value for key, value in channel.provenance.items()}},
    )
