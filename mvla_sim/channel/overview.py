"""What lets a person notice a mistake in a channel: a line on band and echoes, one on views; and sweeps of nothing."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.header import Channel
from mvla_sim.channel.readers.axis_units import with_prefix
from mvla_sim.channel.readers.source import note
from mvla_sim.channel.references import range_profile
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.constants import delay_to_range, range_resolution
from mvla_sim.errors import DataError
from mvla_sim.scene.views import Views

__all__ = ["check_swept", "echo_line", "overview", "strongest_ranges_m", "view_line"]

_MOST_PROFILES: Final = 128
"""Views whose strongest echo is looked for; more tell a person no more."""
_EVEN: Final = 0.01  # of a step of angle


def overview(channel: Channel) -> tuple[str, str]:
    """Two lines on a channel: band, step and ranges of the strongest echoes; angles, sense of turning and distance."""
    return echo_line(channel), view_line(channel.views)


def echo_line(channel: Channel) -> str:
    """Band, step, range resolution and unambiguous range, and where the strongest echo of each view is."""
    lowest, highest = (channel.carrier_hz + sign * channel.bandwidth_hz / 2 for sign in (-1, 1))
    step = ""
    if isinstance(channel, FrequencyResponse):
        lowest, highest = float(channel.frequency_hz[0]), float(channel.frequency_hz[-1])
        step = (
            f" in steps of {with_prefix(channel.step_hz, 'Hz', 4)}, unambiguous to {channel.unambiguous_range_m:.4g} m"
        )
    band = f"band {with_prefix(lowest, 'Hz')} to {with_prefix(highest, 'Hz')}{step}"
    ranges = strongest_ranges_m(channel)
    if not ranges.size:
        return f"{band}; no echo"
    middle, ends = np.median(ranges), f"{ranges.min():.3g} to {ranges.max():.3g} m"
    resolution = range_resolution(channel.bandwidth_hz)
    return f"{band}, resolution {resolution:.3g} m; strongest echoes of the views at {ends}, median {middle:.3g} m"


def strongest_ranges_m(channel: Channel) -> NDArray[np.float64]:
    """One-way range of the strongest echo of up to 128 evenly chosen views, those without an echo left out, metres."""
    chosen = np.unique(np.linspace(0, channel.n_view - 1, _MOST_PROFILES).round().astype(np.intp))
    if isinstance(channel, FrequencyResponse):
        found = []
        for sweep in channel.response[chosen]:
            profile, step_m = range_profile(sweep, channel.start_hz, channel.step_hz)
            if (level := np.abs(profile)).any():
                found.append(float(level.argmax()) * step_m)
        return np.array(found)
    some = channel.select(chosen)
    if isinstance(some, Cir):
        level, ranges = np.abs(some.gain), delay_to_range(some.delay_s)
    elif isinstance(some, Components):
        level, ranges = some.power, some.range_m
    else:
        return np.empty(0)
    rows = [np.flatnonzero(some.row_index == view) for view in range(some.n_view)]
    return np.array([ranges[row[level[row].argmax()]] for row in rows if row.size], np.float64)


def view_line(views: Views) -> str:
    """Angles from the first view to the last, their steps and sense of turning, and the sensor's distance."""
    place = np.asarray(views.positions_m[:, :2]) - np.asarray(views.center_m)
    distance = np.hypot(*place.T)
    away = f"{distance.min():.4g}" + (f" to {distance.max():.4g}" if np.ptp(distance) > 1e-3 * distance.max() else "")
    tail = f"sensor {away} m from ({views.center_m[0]:g}, {views.center_m[1]:g})"
    angles = views.angles_deg
    if len(views) < 2:
        return f"1 view at {angles[0]:.6g}°, {tail}"
    steps = (np.diff(angles) + 180) % 360 - 180
    span = f"{len(views)} views from {angles[0]:.6g}° to {angles[-1]:.6g}°"
    if (steps > 0).all() or (steps < 0).all():
        size = np.abs(steps)
        even = np.ptp(size) <= _EVEN * size.mean()
        by = f"{size.mean():.4g}°" if even else f"{size.min():.4g} to {size.max():.4g}°"
        sense = ("clockwise", "counter-clockwise")[:: 1 if steps[0] > 0 else -1]
        turned = f"{np.abs(steps.sum()):.6g}° in steps of {by}, seen from above sensor {sense[1]} or target {sense[0]}"
        return f"{span}: {turned}, {tail}"
    return f"{span} in no one sense of turning, {tail}"


def check_swept(response: NDArray[np.complex128], source: str) -> None:
    """Refuse sweeps ``[n_view, n_frequency]`` none of which holds an echo; name those that do not among others.

    Raises
    ------
    DataError
        Every sweep is 0, or has one value at all frequencies.
    """
    flat = (response == response[:, :1]).all(axis=1)
    zero = flat & (response[:, 0] == 0)
    if zero.all():
        raise DataError(f"{source}: every sweep is 0 at all frequencies; there is nothing in it to image")
    if flat.all():
        value = f"{response[~zero][0, 0]:.4g}"
        raise DataError(f"{source}: every sweep has one value at all frequencies, as {value}; it holds no ranges")
    if len(response) > 1 and (response == response[0]).all():
        note(f"{source}: all {len(response)} views hold the same sweep")
    for what, views in {"0": zero, "one value": flat & ~zero}.items():
        if views.any():
            first = ", ".join(str(view) for view in np.flatnonzero(views)[:8])
            note(
                f"{source}: the sweeps of {np.count_nonzero(views)} views are {what} at all frequencies: {first} from 0"
            )
