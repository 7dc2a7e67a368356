"""MVLA-GR and its hard-decision variant as range profiles (paper, Section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat

from mvla_sim.errors import ConfigError
from mvla_sim.imaging.peaks import Peaks
from mvla_sim.imaging.projection import RangeProfiles
from mvla_sim.memory import check_memory
from mvla_sim.settings import Settings

__all__ = [
    "MvlaSettings",
    "hard_profiles",
    "kernel_samples",
    "kernel_scales",
    "likelihood_profiles",
    "nearest_peak",
    "range_axis",
]

_SAMPLES_PER_SIGMA = 16
"""Nodes per σ_R: linear interpolation then errs by at most h²/(8σ²) = 4.9·10⁻⁴ of a kernel's peak."""
_NEGLIGIBLE_SIGMAS = 6.5
"""Beyond it the kernel is below 10⁻⁹, a hundredth of float32's resolution of a score, and is not evaluated."""
_FAR_M = 1e6
_BYTES_PER_NODE = 24  # value and distance, with copies in float64 while they are made


class MvlaSettings(Settings):
    """MVLA-GR's kernel: σ_R = κ·ΔR (``eq:sigmaR_general``), R_T = max(σ_R, η·D) (``eq:RT_def_new``)."""

    kappa: PositiveFloat = Field(0.5, description="κ: width of the kernel in ΔR")
    eta: NonNegativeFloat = Field(0.04, description="η: least reach of a peak in D")
    extent_m: PositiveFloat | None = Field(None, description="D; by default the target's extent in the CIR file")
    tolerance_m: PositiveFloat | None = Field(None, description="ε_R of the hard vote; by default ΔR")


def kernel_scales(settings: MvlaSettings, resolution_m: float, extent_m: float) -> tuple[float, float]:
    """σ_R = κ·ΔR (``eq:sigmaR_general``) and R_T = max(σ_R, η·D) (``eq:RT_def_new``), metres.

    Raises
    ------
    ConfigError
        η > 0 and the target's extent D is not known.
    """
    extent = settings.extent_m if settings.extent_m is not None else extent_m
    if settings.eta > 0 and not np.isfinite(extent):
        raise ConfigError(
            "mvla.extent_m: the CIR does not say the target's extent D; set it in metres, or mvla.eta = 0"
        )
    sigma = settings.kappa * resolution_m
    return sigma, max(sigma, settings.eta * extent) if settings.eta > 0 else sigma


def likelihood_profiles(
    peaks: Peaks,
    sigma_m: float,
    radius_m: float,
    span_m: tuple[float, float],
    weight: NDArray[np.float64] | None = None,
) -> RangeProfiles:
    """Profiles of MVLA-GR: q_m(r) = Σ_i w_mi φ(r − R_mi) (``eq:view_support_new``), and the nearest peak.

    Parameters
    ----------
    peaks
        Observations C_m.
    sigma_m, radius_m
        σ_R and R_T, metres.
    span_m
        Ranges at which the grid is seen; the axis covers them.
    weight
        Weight of each peak, ``[n_peak]``; by default w_mi, its share of the view's power.

    Returns
    -------
    RangeProfiles
        The projector adds q only where the nearest peak is within R_T. That makes the support indicator b_mn, and the
        outer edge of the truncated kernel, exact to float32, save midway between peaks 2·R_T apart to within half
        a node; so q itself is continued by one node beyond R_T. Only where kernels of two peaks overlap *and* R_T is so
        short (below about 3.7 σ_R) that the truncated kernel jumps, the inner edge is resolved to two nodes.
    """
    step = sigma_m / _SAMPLES_PER_SIGMA
    start, count = _axis(span_m, step, peaks.n_view)
    reach = min(radius_m + step, _NEGLIGIBLE_SIGMAS * sigma_m)
    around = kernel_samples(sigma_m, radius_m)
    half = int(around[-1])
    middle = np.rint((peaks.range_m - start) / step).astype(np.intp)
    distance = (start + step * middle - peaks.range_m)[:, None] + step * around
    kernel = np.exp(distance**2 / (-2 * sigma_m**2))
    kernel *= (peaks.weight if weight is None else weight)[:, None] * (np.abs(distance) <= reach)
    margin = 2 * half + 1  # on both sides, so that a kernel may reach over an end; farther ones are moved onto it
    width = count + 2 * margin
    place = (peaks.view * width + margin + np.clip(middle, -half - 1, count + half))[:, None] + around
    values = np.bincount(place.ravel(), kernel.ravel(), peaks.n_view * width).reshape(peaks.n_view, width)
    return RangeProfiles(
        np.ascontiguousarray(values[:, margin : margin + count], np.float32),
        start,
        step,
        nearest_peak(peaks, start, step, count),
        radius_m,
    )


def kernel_samples(sigma_m: float, radius_m: float) -> NDArray[np.intp]:
    """Nodes around a peak's own at which its kernel is evaluated, of σ_R and R_T in metres."""
    step = sigma_m / _SAMPLES_PER_SIGMA
    half = int(np.ceil(min(radius_m + step, _NEGLIGIBLE_SIGMAS * sigma_m) / step)) + 1
    return np.arange(-half, half + 1)


def hard_profiles(peaks: Peaks, tolerance_m: float, span_m: tuple[float, float]) -> RangeProfiles:
    """Profiles of the hard vote: 1 where some |R_mi − r| ≤ ε_R (``eq:event_hard``, ``eq:hard_posterior``)."""
    step = tolerance_m / _SAMPLES_PER_SIGMA
    start, count = _axis(span_m, step, peaks.n_view)
    values = np.ones((peaks.n_view, count), np.float32)
    return RangeProfiles(values, start, step, nearest_peak(peaks, start, step, count), tolerance_m)


def range_axis(span_m: tuple[float, float], sigma_m: float, n_view: int) -> tuple[float, float, NDArray[np.float64]]:
    """First range, spacing and nodes, ``[n_range]`` metres, of an axis fine enough for kernels of width σ_R."""
    step = sigma_m / _SAMPLES_PER_SIGMA
    start, count = _axis(span_m, step, n_view)
    return start, step, np.asarray(start + step * np.arange(count), np.float64)


def _axis(span_m: tuple[float, float], step: float, n_view: int) -> tuple[float, int]:
    """First range and number of nodes of an axis that covers a span."""
    first = int(np.floor(span_m[0] / step)) - 1
    count = int(np.ceil(span_m[1] / step)) - first + 2
    check_memory(
        _BYTES_PER_NODE * n_view * count,
        f"range profiles of {n_view} views at steps of {step:.2g} m",
        "raise mvla.kappa (or mvla.tolerance_m) {factor:.2g} times, or make the grid smaller",
    )
    return first * step, count


def nearest_peak(peaks: Peaks, start: float, step: float, count: int) -> NDArray[np.float32]:
    """Range of the peak nearest to the middle of each node and the next, ``[n_view, count]`` m; far where none is."""
    nearest = np.full((peaks.n_view, count), _FAR_M, np.float32)
    ranges = peaks.range_m
    stop = np.full(ranges.size, count, np.intp)  # one behind the last node that each peak is nearest to
    between = np.ceil(((ranges[:-1] + ranges[1:]) / 2 - start) / step - 0.5)
    last = np.cumsum(peaks.row_size)[peaks.row_size > 0] - 1  # of each view's peaks
    stop[:-1] = np.clip(between, 0, count)
    stop[last] = count
    length = np.diff(stop, prepend=0)
    length[last[:-1] + 1] += count
    nearest[peaks.row_size > 0] = np.repeat(ranges, length).reshape(-1, count)
    return nearest
