"""Small problems of the threshold search, and every threshold tried on them, in exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from hypothesis import strategies as st

from mvla_sim.grid import VoxelGrid


def thresholded(score, theta, n, level):
    """The joint threshold, written out: the n best voxels, ties by index, of which those with Θ ≥ T_θ."""
    order = sorted(range(score.size), key=lambda voxel: (-float(score.flat[voxel]), voxel))
    mask = np.zeros(score.size, bool)
    mask[order[:n]] = True
    if theta is not None:
        mask &= theta.ravel() >= level
    return mask.reshape(score.shape)


def every_threshold(score, theta, truth):
    """Every (CD in spacing², T_θ, n) whose n-th voxel is retained, CD as an exact fraction."""
    voxels = np.stack(np.unravel_index(np.arange(score.size), score.shape), axis=1)
    targets = voxels[truth.ravel()]
    order = sorted(range(score.size), key=lambda voxel: (-float(score.flat[voxel]), voxel))
    supports = np.zeros(score.size) if theta is None else theta.ravel()
    for level in sorted({0.0, *map(float, supports)}):
        forth, back, kept = None, 0, 0
        for n, voxel in enumerate(order, 1):
            if supports[voxel] < level:
                continue
            squared = ((voxels[voxel] - targets) ** 2).sum(axis=1)
            forth = squared if forth is None else np.minimum(forth, squared)
            back, kept = back + int(squared.min()), kept + 1
            yield Fraction(int(forth.sum()), len(targets)) + Fraction(back, kept), level, n


def decibels(fraction, grid):
    return 10 * math.log10(fraction * grid.spacing_m**2) if fraction else -math.inf


@st.composite
def problems(draw, flat=False):
    """Small problems of every kind: ties, constant images, few and many levels, truth where the score is lowest.

    Kinds come from the seeded generator, for Hypothesis would draw the first of a list far more often than the others.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    layers = 1 if flat else int(rng.choice([1, 1, 3]))
    grid = VoxelGrid((0, 0, 0), (draw(st.integers(1, 16)), draw(st.integers(1, 16)), layers), 0.05)
    truth = rng.random(grid.shape) < rng.choice([0.0, 0.05, 0.4])
    truth.flat[rng.integers(grid.size)] = True
    score = rng.random(grid.shape)
    kind = rng.choice(["any", "ties", "constant", "signs", "best far from truth", "best at truth"])
    if kind == "ties":
        score = np.round(3 * score)
    elif kind == "constant":
        score = np.ones(grid.shape)
    elif kind == "signs":
        score = np.round(4 * score - 2) * rng.choice([-1.0, 1.0], grid.shape)  # holds 0 and −0
    elif kind.startswith("best"):
        x, y, z = grid.centers(np.flatnonzero(truth)[:1])[0]
        near = -np.linalg.norm(grid.centers() - [x, y, z], axis=1).reshape(grid.shape)
        score = near + 0.1 * score if kind == "best at truth" else -near + 0.1 * score
    supports = {
        "none": None,
        "zero": np.zeros(grid.shape),
        "few": 5 * rng.integers(0, 5, grid.shape),
        "many": 100 * rng.random(grid.shape),
        "one level above zero": np.full(grid.shape, 30.0),
    }[rng.choice(["none", "zero", "few", "few", "many", "one level above zero"])]
    return grid, truth, score.astype(np.float32), None if supports is None else supports.astype(np.float32)
