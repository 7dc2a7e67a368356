"""The compiled projector: one Dr.Jit program for CPU (LLVM) and GPU (CUDA). Import it only to project.

Every method is ``image_n = Σ_m q_m(|p_n − T_m|)`` on its own range profile q_m. A thread handles several voxels, so
that what depends on the view alone is read once for them; the loop over views is inside the kernel, so no image is ever
written and read again between views. Profiles are sampled uniformly and interpolated linearly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mvla_sim.runtime.backend import activate

BACKEND = activate()

import drjit as dr  # noqa: E402 - only after the backend has chosen its library

__all__ = ["BACKEND", "Tables", "project_block"]


@dataclass(frozen=True)
class Tables:
    """Device arrays of one projection.

    Attributes
    ----------
    view
        Four numbers a view: x, y, z in metres and the angle to the view before it in degrees.
    values, distance
        Flattened profiles [n_view·n_range (+ 1 pad)]; ``distance`` is None where no support is asked for.
    """

    view: Any
    values: Any
    distance: Any | None


@dr.syntax
def project_block(  # type: ignore[no-untyped-def]  # noqa: ANN201, PLR0917
    tables: Tables,
    grid: tuple[Any, ...],
    axis: tuple[Any, ...],
    radius: Any,
    start: Any,
    lanes: int,
    per_lane: int,
    backend: Any,
):
    """Sum profiles, and follow runs of supporting views, for ``lanes·per_lane`` voxels from flat index ``start`` on.

    Lane k handles voxels start + k, start + lanes + k, … Returns lists, one entry a voxel of a lane: the sums; with a
    distance table also the longest run's width, the width of the run that is open at the last view (−1: none), the
    width of the run that began at the first view (−1: none), and whether every view supports the voxel.
    """
    t = backend
    nx, ny, x0, y0, z0, spacing = grid
    n_view, n_range, range0, inverse_step = axis
    lane = dr.arange(t.UInt32, lanes)
    lane_count = dr.opaque(t.UInt32, lanes)  # not a literal: one program for every size
    x, y, z = [], [], []
    for u in range(per_lane):
        index = lane + start + lane_count * u
        row = index // nx
        x.append(dr.fma(t.Float32(index % nx), spacing, x0))
        y.append(dr.fma(t.Float32(row % ny), spacing, y0))
        z.append(dr.fma(t.Float32(row // ny), spacing, z0))
    view_table, value_table, distance_table = tables.view, tables.values, tables.distance
    with_support = distance_table is not None
    total = [dr.zeros(t.Float32, lanes) for _ in range(per_lane)]
    run = [dr.full(t.Float32, -1.0, lanes) for _ in range(per_lane if with_support else 0)]
    longest = [dr.zeros(t.Float32, lanes) for _ in range(per_lane if with_support else 0)]
    first = [dr.full(t.Float32, -1.0, lanes) for _ in range(per_lane if with_support else 0)]
    unbroken = [dr.full(t.Bool, True, lanes) for _ in range(per_lane if with_support else 0)]
    last = t.Float32(n_range - 1)
    m = t.UInt32(0)
    while m < n_view:
        view = dr.gather(t.Array4f, view_table, m)
        base = m * n_range
        for u in range(per_lane):
            dx = x[u] - view.x
            dy = y[u] - view.y
            dz = z[u] - view.z
            cell = (dr.sqrt(dr.fma(dx, dx, dr.fma(dy, dy, dz * dz))) - range0) * inverse_step
            inside = (cell >= 0.0) & (cell < last)
            node = t.UInt32(dr.select(inside, cell, 0.0))
            share = cell - t.Float32(node)
            place = base + node
            q0 = dr.gather(t.Float32, value_table, place)
            q1 = dr.gather(t.Float32, value_table, place + 1)
            q = dr.fma(share, q1 - q0, q0)
            if dr.hint(with_support, mode="scalar"):
                d0 = dr.gather(t.Float32, distance_table, place)
                d1 = dr.gather(t.Float32, distance_table, place + 1)
                supported = inside & (dr.fma(share, d1 - d0, d0) <= radius)
                total[u] += dr.select(supported, q, 0.0)
                run[u] = dr.select(supported, dr.select(run[u] >= 0.0, run[u] + view.w, 0.0), -1.0)
                longest[u] = dr.maximum(longest[u], run[u])
                unbroken[u] &= supported
                first[u] = dr.select(unbroken[u], run[u], first[u])
            else:
                total[u] += dr.select(inside, q, 0.0)
        m += 1
    return total, longest, run, first, unbroken
