"""Which of a file's views an image is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt, PositiveFloat

from mvla_sim.channel.impairments import ImpairmentSettings, remaining_views
from mvla_sim.errors import ConfigError
from mvla_sim.scene.views import Views
from mvla_sim.settings import Settings

__all__ = ["ViewSettings", "chosen_views", "select_views"]


class ViewSettings(Settings):
    """Which of a file's views are used: every ``interval_deg``, beginning with view number ``offset``."""

    interval_deg: PositiveFloat | None = Field(None, description="by default every view")
    offset: NonNegativeInt = Field(0, description="number of the first view")


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


def chosen_views(
    views: Views, settings: ViewSettings, impairments: ImpairmentSettings, noise_seed: int = 0
) -> NDArray[np.intp]:
    """Indices of the views that an image is made of: of those of :func:`select_views` what is neither lost nor blocked.

    Parameters
    ----------
    views
        All views of the file, at their true positions.
    settings
        Interval and offset.
    impairments
        Which views are lost.
    noise_seed
        Seed of the impairments where they have none.

    Raises
    ------
    ConfigError
        As :func:`select_views`, or no view is left.
    """
    chosen = select_views(views, settings)
    if not impairments.missing_share and not impairments.sector_width_deg:
        return chosen
    seed = noise_seed if impairments.seed is None else impairments.seed
    return remaining_views(views, chosen, impairments.model_copy(update={"seed": seed}))
