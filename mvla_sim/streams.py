"""Randomness from one root seed: named, independent streams, the same draw in any order of execution."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

__all__ = ["Stream", "stream"]


class Stream(IntEnum):
    """What a stream is for; the number is part of its name and never changes."""

    NOISE = 1
    SPECKLE = 2
    PHASE = 3
    MEASUREMENT = 4
    SAMPLE = 5
    SPLIT = 6
    RECOMPUTE = 7
    POSITION = 8
    JITTER = 9
    LOSS = 10
    CLUTTER = 11
    DESIGN = 12


def stream(seed: int, name: Stream, *key: int) -> np.random.Generator:
    """Generator of the stream ``name`` and ``key`` (whole numbers, of which the lowest 32 bits count) under a seed."""
    spawn_key = (int(name), *(int(k) % 2**32 for k in key))
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=spawn_key)))
