"""Chamfer distances at many candidate pairs (p, T_θ), from which one pair is chosen for many images."""

from __future__ import annotations

import base64
import binascii
import zlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError
from mvla_sim.evaluation.metrics import decibel
from mvla_sim.evaluation.scan import ScanSettings
from mvla_sim.evaluation.tuning import TruthGeometry, chamfer_for_prefixes
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.threshold_rules.given import GivenThresholds
from mvla_sim.imaging.thresholds import top_count

__all__ = [
    "SUPPORTS_DEG", "TOP_PERCENTS", "best_db", "best_pair", "chamfer_table", "pack_table", "unpack_table", "worst_db",
]  # fmt: skip

TOP_PERCENTS: Final = tuple(float(p) for p in np.round(np.geomspace(0.005, 100, 200), 6))
"""Candidates for p, per cent of all voxels: steps of 5 %."""
SUPPORTS_DEG: Final = (*(5.0 * k for k in range(36)), *(180.0 + 20.0 * k for k in range(10)))
"""Candidates for T_θ, degrees; 0 alone for methods without angular support."""
_STEPS_PER_DB: Final = 100.0
"""Resolution of packed tables."""


def worst_db(grid: VoxelGrid) -> float:
    """CD that stands for an empty reconstruction or a failure: every distance is the grid's diagonal, dB(m²)."""
    sides = grid.spacing_m * np.asarray(grid.counts, float)
    return float(decibel(2 * float(sides @ sides)))


def best_db(grid: VoxelGrid) -> float:
    """CD that stands for a perfect reconstruction, whose own is −∞: (a tenth of the spacing)², dB(m²)."""
    return float(decibel((0.1 * grid.spacing_m) ** 2))


def chamfer_table(image: Image, geometry: TruthGeometry, scan: ScanSettings | None = None) -> NDArray[np.float32]:
    """CD at every pair of candidates, ``[n_support, n_percent]`` dB(m²); one row without angular support.

    Candidates outside the bounds of a scan are failures; its steps are not these candidates' and are passed over.
    """
    scan = scan or ScanSettings()
    counts = np.array([top_count(percent, image.grid.size) for percent in TOP_PERCENTS])
    supports = SUPPORTS_DEG if image.support_deg is not None else (0.0,)
    best, worst = best_db(image.grid), worst_db(image.grid)
    largest = 0.0 if image.support_deg is None else float(image.support_deg.max())
    inside = counts <= scan.largest_count(image.grid)
    if scan.max_support_deg is not None:
        largest = min(largest, scan.max_support_deg)
    table = np.full((len(supports), counts.size), worst, np.float32)  # also where nothing is retained
    for row, support in enumerate(supports):
        if support <= largest:
            curve = chamfer_for_prefixes(image.score, image.support_deg, geometry, support)[counts - 1]
            values = np.clip(np.nan_to_num(curve, nan=worst, neginf=best), best, worst)
            table[row] = np.where(inside, values, worst)
    return table


def best_pair(table: NDArray[Any]) -> tuple[GivenThresholds, float]:
    """The candidates with the least entry of a table ``[n_support, n_percent]``, and that entry, dB(m²).

    Where several are equal, the smallest T_θ, then the smallest p.
    """
    row, column = np.unravel_index(int(np.argmin(table)), table.shape)
    pair = GivenThresholds(top_percent=TOP_PERCENTS[column], min_support_deg=SUPPORTS_DEG[row])
    return pair, float(table[row, column])


def pack_table(table: NDArray[np.float32]) -> str:
    """A table as text, to a hundredth of a decibel."""
    steps = np.rint(table * _STEPS_PER_DB).astype("<i2")
    return base64.b64encode(zlib.compress(steps.tobytes(), 6)).decode("ascii")


def unpack_table(text: str) -> NDArray[np.float64]:
    """The table that :func:`pack_table` made a text of.

    Raises
    ------
    DataError
        The text is none of such a table.
    """
    try:
        unpacker = zlib.decompressobj()
        largest = 2 * len(SUPPORTS_DEG) * len(TOP_PERCENTS)
        content = unpacker.decompress(base64.b64decode(text, validate=True), largest + 1)
        steps = np.frombuffer(content, "<i2").reshape(-1, len(TOP_PERCENTS))
    except (ValueError, binascii.Error, zlib.error) as error:
        raise DataError(f"not a packed table of Chamfer distances ({error})") from error
    if len(steps) not in (1, len(SUPPORTS_DEG)):
        raise DataError(f"not a packed table of Chamfer distances: {len(steps)} rows")
    return np.asarray(steps / _STEPS_PER_DB, np.float64)
