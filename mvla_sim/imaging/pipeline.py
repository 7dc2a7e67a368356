"""From a CIR to an image: the stages in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import Cir
from mvla_sim.config.imaging import ImagingSettings, MethodName, ViewSettings
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.imaging.backprojection import backprojection_profiles
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.mvla import hard_profiles, kernel_scales, likelihood_profiles
from mvla_sim.imaging.noise import add_noise
from mvla_sim.imaging.pdp import Pdp, compute_pdp, gate_for
from mvla_sim.imaging.peaks import Peaks, extract_peaks
from mvla_sim.imaging.projection import RangeProfiles, check_grid, project
from mvla_sim.imaging.threshold import joint_threshold
from mvla_sim.runtime.provenance import provenance
from mvla_sim.scene.grid import VoxelGrid
from mvla_sim.scene.trajectory import Views

__all__ = ["FrontEnd", "front_end", "make_profiles", "reconstruct", "select_views"]


@dataclass(frozen=True)
class FrontEnd:
    """What every method starts from: noisy profiles and the components found in them, for all views of a file."""

    pdp: Pdp
    peaks: Peaks


def front_end(cir: Cir, settings: ImagingSettings, grid: VoxelGrid) -> FrontEnd:
    """Compute PDPs, add noise and, unless the method is BP, extract peaks, for all views of the file.

    Raises
    ------
    DataError
        No path inside the gate, or no peak in any view.
    """
    gate = gate_for(grid, cir.views.positions_m, settings.pdp)
    clean = compute_pdp(cir, settings.pdp, gate)
    noisy = add_noise(clean, settings.noise)
    peaks = Peaks.none(cir.n_view) if settings.method == "bp" else extract_peaks(noisy, settings.peaks)
    return FrontEnd(noisy, peaks)


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
    strides = [k for k in range(1, len(views) + 1) if not (views.closed and len(views) % k)]
    if stride not in strides or abs(stride * spacing - settings.interval_deg) > 1e-3 * spacing:
        allowed = [f"{k * spacing:.4g}" for k in strides]
        raise ConfigError(
            f"views.interval_deg = {settings.interval_deg:g} does not divide the file's {len(views)} views at "
            f"{spacing:.4g}°; allowed: {', '.join(allowed[:12])}{', …' if len(allowed) > 12 else ''}"
        )
    if settings.offset >= stride:
        raise ConfigError(f"views.offset = {settings.offset}: at {settings.interval_deg:g}° allowed: 0 to {stride - 1}")
    return np.arange(settings.offset, len(views), stride)


def make_profiles(
    method: MethodName, front: FrontEnd, settings: ImagingSettings, extent_m: float, span_m: tuple[float, float]
) -> RangeProfiles:
    """Turn observations into the range profiles of a method; ``span_m`` are the ranges at which the grid is seen."""
    if method == "bp":
        return backprojection_profiles(front.pdp)
    if method == "mvla-hard":
        tolerance = settings.mvla.tolerance_m
        return hard_profiles(front.peaks, front.pdp.resolution_m if tolerance is None else tolerance, span_m)
    sigma, radius = kernel_scales(settings.mvla, front.pdp.resolution_m, extent_m)
    return likelihood_profiles(front.peaks, sigma, radius, span_m)


def reconstruct(cir: Cir, settings: ImagingSettings | None = None) -> Image:
    """Make an image from a CIR.

    Parameters
    ----------
    cir
        Channels of all views.
    settings
        Method, grid, front end, noise and views; the defaults are the paper's.

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
    chosen = select_views(cir.views, settings.views)
    front = front_end(cir, settings, grid)
    views = cir.views.select(chosen)
    front = FrontEnd(front.pdp.select(chosen), front.peaks.select(chosen))
    if settings.method != "bp" and front.peaks.range_m.size == 0:
        raise DataError(
            f"no peak in any of the {len(views)} chosen views; lower peaks.threshold_sigma or raise the SNR"
        )
    profiles = make_profiles(settings.method, front, settings, cir.extent_m, grid.range_span_m(cir.views.positions_m))
    result = project(grid, views, profiles)
    score = result.total if settings.method == "bp" else result.total / np.float32(len(views))
    occupied = None
    if settings.threshold is not None:
        occupied = joint_threshold(
            score, result.support_deg, settings.threshold.top_percent, settings.threshold.min_support_deg
        )
    return Image(
        score=score,
        support_deg=result.support_deg,
        grid=grid,
        method=settings.method,
        n_view=len(views),
        occupied=occupied,
        outline=cir.outline,
        config={"simulation": dict(cir.config), "imaging": settings.model_dump(mode="json")},
        provenance={**provenance(), **{f"cir.{key}": value for key, value in cir.provenance.items()}},
    )
