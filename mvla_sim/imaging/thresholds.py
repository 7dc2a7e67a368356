"""From a continuous image to a binary one: the joint threshold on score and angular support, and rules for it."""

from __future__ import annotations

from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.kinds import Kind, Kinds

__all__ = ["THRESHOLD_RULES", "ThresholdRule", "Thresholds", "joint_threshold", "rank_order", "top_count"]

THRESHOLD_RULES: Final[Kinds[ThresholdRule]] = Kinds(
    "threshold rule", "mvla_sim.threshold_rules", "mvla_sim.imaging.threshold_rules", key="rule", default="given",
    short=True,
)  # fmt: skip
"""All ways to choose thresholds by name; the name alone stands for a rule at its defaults."""


class Thresholds(NamedTuple):
    """A pair of thresholds: p in per cent of all voxels, T_θ in degrees."""

    top_percent: float
    min_support_deg: float


class ThresholdRule(Kind):
    """A way to choose p and T_θ that does not look at the truth.

    A rule has the field ``rule``, a ``Literal`` of its name, and :meth:`thresholds`.
    """

    kinds: ClassVar[Kinds[ThresholdRule]] = THRESHOLD_RULES

    def thresholds(
        self, score: NDArray[Any], support_deg: NDArray[Any] | None, grid: VoxelGrid, resolution_m: float | None
    ) -> Thresholds:
        """Choose thresholds for an image.

        Parameters
        ----------
        score
            Image, ``[nz, ny, nx]`` or flattened.
        support_deg
            Θ_n of the same shape, degrees; None for methods without it.
        grid
            The image's grid.
        resolution_m
            ΔR, metres; None where it is not known.
        """
        raise NotImplementedError


def rank_order(score: NDArray[Any], count: int | None = None) -> NDArray[np.intp]:
    """Flat voxel indices by falling score, ties by rising index, ``[N]``, or the first ``count`` of them.

    For float32 the pair (score, index) is one whole number, and sorting those takes a seventh of a stable sort's time.
    """
    flat = score.ravel()
    if flat.dtype != np.float32:
        return np.argsort(-flat.astype(np.float64), kind="stable")[:count]
    bits = (flat + np.float32(0)).view(np.int32)  # + 0 makes −0 and 0 equal
    rising = bits ^ ((bits >> 31) & 0x7FFFFFFF)
    key = ((~rising).astype(np.int64) << 32) | np.arange(flat.size)
    if count is not None and count < flat.size:
        key = np.partition(key, count - 1)[:count]
    key.sort()
    return np.asarray(key & 0xFFFFFFFF, np.intp)


def top_count(top_percent: float, size: int) -> int:
    """Number of voxels in the top p per cent of N: round(p/100·N), at least one.

    Raises
    ------
    ConfigError
        p is not in (0, 100].
    """
    if not 0 < top_percent <= 100:
        raise ConfigError(f"threshold.top_percent = {top_percent:g}: must be above 0 and at most 100")
    return max(1, round(top_percent / 100 * size))


def joint_threshold(
    score: NDArray[np.float32],
    support_deg: NDArray[np.float32] | None,
    top_percent: float,
    min_support_deg: float = 0.0,
) -> NDArray[np.bool_]:
    """Keep voxels in the top p per cent of all by score whose angular support is at least T_θ.

    Parameters
    ----------
    score
        s_n or the BP image, any shape.
    support_deg
        Θ_n of the same shape, degrees; None for methods without it, which then have no angular test.
    top_percent
        p, per cent of all voxels (0.61 means 0.61 %).
    min_support_deg
        T_θ, degrees.

    Returns
    -------
    ndarray of bool
        The binary image, of the shape of ``score`` (``eq:joint_thresholding_new``).

    Raises
    ------
    ConfigError
        p is not in (0, 100], or T_θ > 0 for a method without angular support.
    """
    if support_deg is None and min_support_deg > 0:
        raise ConfigError(f"threshold.min_support_deg = {min_support_deg:g}: this method has no angular support; use 0")
    top = np.zeros(score.size, bool)
    top[rank_order(score)[: top_count(top_percent, score.size)]] = True
    kept: NDArray[np.bool_] = top.reshape(score.shape)
    return kept if support_deg is None else kept & (support_deg >= min_support_deg)
