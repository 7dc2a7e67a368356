"""Drawing the samples of a design: points of the unit cube, and the values that distributions have there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from mvla_sim.distributions import AnyChoice, Spread, value_at
from mvla_sim.streams import Stream, stream
from mvla_sim.sweep.axes import AxisValue
from mvla_sim.sweep.design import SAMPLE, DesignSettings

__all__ = ["DesignSample", "draw_samples"]


@dataclass(frozen=True, eq=False)
class DesignSample:
    """One combination of settings."""

    label: str  # "s0007", or its name in a list
    values: Mapping[str, AxisValue]  # by the names that the design gives the settings


def draw_samples(design: DesignSettings) -> tuple[DesignSample, ...]:
    """Return the samples of a design; the first of more samples are those of fewer.

    Notes
    -----
    Each setting with a distribution is one coordinate of a point of the unit cube, in the order of the file, and has
    the value at that share of its probability; see :func:`~mvla_sim.distributions.value_at`. The points are those of a
    scrambled Sobol sequence, or independent and even.
    """
    if design.draw == "list":
        rows = [{key: value for key, value in listed.items() if key != SAMPLE} for listed in design.listed]
        names = [listed.get(SAMPLE) for listed in design.listed]
    else:
        drawn = [key for key, value in design.settings.items() if isinstance(value, Spread | AnyChoice)]
        rows = []
        for point in _points(design, len(drawn)):
            at = dict(zip(drawn, point.tolist(), strict=True))
            rows.append({key: value_at(value, at.get(key, 0.0)) for key, value in design.settings.items()})
        names = [None] * len(rows)
    width = max(4, len(str(len(rows) - 1)))
    return tuple(
        DesignSample(f"s{number:0{width}d}" if name is None else str(name), values)
        for number, (name, values) in enumerate(zip(names, rows, strict=True))
    )


def _points(design: DesignSettings, dimensions: int) -> NDArray[np.float64]:
    """Points of the unit cube, ``[sample, dimension]``."""
    count = design.samples or 0
    if design.draw == "random":
        return np.array([stream(design.seed, Stream.DESIGN, number).random(dimensions) for number in range(count)])
    sequence = qmc.Sobol(dimensions, scramble=True, seed=stream(design.seed, Stream.DESIGN))
    points: NDArray[np.float64] = sequence.random_base2((count - 1).bit_length())[:count]
    return points
