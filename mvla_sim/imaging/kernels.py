"""The compiled projector: one Dr.Jit program for CPU (LLVM) and GPU (CUDA). Import it only to project.

Every method is ``image_n = Σ_m q_m(r_mn)`` on its own range profile q_m, with r_mn = |p_n − T_m|, or half the length of
the path from transmitter over voxel to receiver. A thread handles several voxels, so that what depends on the view
alone is read once for them; the loop over views is inside the kernel, so no image is ever written and read again
between views. Profiles are sampled uniformly and interpolated linearly.

What a projection does not need is no part of its program: receivers apart from transmitters, beams, support.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from mvla_sim.engine.backend import activate

BACKEND = activate()

import drjit as dr  # noqa: E402 - only after the backend has chosen its library

__all__ = ["BACKEND", "BeamTables", "DeviceTables", "project_block"]

_NO_GAP = 360.0


@dataclass(frozen=True, eq=False)
class BeamTables:
    """Device arrays of the sector that a view's antennas cover.

    Attributes
    ----------
    ahead
        Four numbers a view: boresight x, y, z, and nothing.
    frame
        Four numbers a view: cosine and sine of the boresight's azimuth, its horizontal length, and nothing.
    azimuth, elevation
        Levels in dB at uniform nodes from −180° to 180° and from −90° to 90°, with one more node behind the last.
    per_degree
        Nodes a degree.
    edge_db
        Level at which the sector ends.
    """

    ahead: Any
    frame: Any
    azimuth: Any
    elevation: Any
    per_degree: Any
    edge_db: Any


@dataclass(frozen=True, eq=False)
class DeviceTables:
    """Device arrays of one projection.

    Attributes
    ----------
    view
        Four numbers a view: x, y, z in metres and the angle to the view before it in degrees.
    values, nearest
        Flattened profiles [n_view·n_range], and the range of each cell's nearest peak; ``nearest`` is None
        where no support is asked for.
    receiver
        Four numbers a view, x, y, z and nothing; None where receivers stand at their transmitters.
    beam
        None where every view covers everything.
    ends
        1 where a view is the last of those that share its angle, else 0; None where all angles differ and there is no
        beam.
    gated
        Whether a view adds only to what it supports.
    """

    view: Any
    values: Any
    nearest: Any | None
    receiver: Any | None = None
    beam: BeamTables | None = None
    ends: Any | None = None
    gated: bool = True


@dr.syntax
def project_block(  # type: ignore[no-untyped-def]  # noqa: ANN201, PLR0915, PLR0917
    tables: DeviceTables,
    grid: tuple[Any, ...],
    axis: tuple[Any, ...],
    radius: Any,
    start: Any,
    lanes: int,
    per_lane: int,
    backend: Any,
):
    """Sum profiles, and follow runs of supporting views, for voxels of some rows along x.

    Lane k, counted from ``start``, handles the voxels at x = k mod nx in ``per_lane`` rows that follow each other, from
    row per_lane·⌊k/nx⌋ on: neighbours, which read neighbouring nodes of a profile. Rows are counted over y, then z;
    those beyond the grid are computed too. Returns a dictionary of lists, one entry a voxel of a lane:
    ``total``, the sums; with a beam ``coverage``, how many views see the voxel; with ranges of peaks

    * ``longest``: the longest run's width;
    * ``run``, ``first``: widths of the run that is open at the last view and of that which began at the first
      (−1: none);
    * ``unbroken``: whether every view supports the voxel;

    and, where :attr:`DeviceTables.ends` is given, the same of directions instead of views: a direction is all views of
    one angle; it supports a voxel if any of them does, and one that does not see it neither breaks nor extends a run.
    Then also ``head`` and ``tail``, the angles before the first and after the last direction that sees the voxel,
    ``least``, the smallest gap between two neighbours that do, and ``known``, whether any does.
    """
    t = backend
    nx, ny, x0, y0, z0, spacing = grid
    n_view, n_range, range0, inverse_step = axis
    lane = dr.arange(t.UInt32, lanes) + start
    x = dr.fma(t.Float32(lane % nx), spacing, x0)
    y, z = [], []
    for u in range(per_lane):
        row = lane // nx * per_lane + u
        y.append(dr.fma(t.Float32(row % ny), spacing, y0))
        z.append(dr.fma(t.Float32(row // ny), spacing, z0))
    view_table, value_table, nearest_table = tables.view, tables.values, tables.nearest
    receiver_table, ends, gated = tables.receiver, tables.ends, tables.gated
    covers = functools.partial(_covered, t, tables.beam)  # what a loop captures so is no part of its state
    with_support = nearest_table is not None
    paired, with_beam = receiver_table is not None, tables.beam is not None
    follow = _follow_views if ends is None else _follow_directions
    total = [dr.zeros(t.Float32, lanes) for _ in range(per_lane)]
    coverage = [dr.zeros(t.Float32, lanes) for _ in range(per_lane if with_beam else 0)]
    runs = [_no_runs(t, lanes, ends is not None) for _ in range(per_lane if with_support else 0)]
    last = t.Float32(n_range - 1)
    m = t.UInt32(0)
    while m < n_view:
        view = dr.gather(t.Array4f, view_table, m)
        base = m * n_range
        for u in range(per_lane):
            dx = x - view.x
            dy = y[u] - view.y
            dz = z[u] - view.z
            r = dr.sqrt(dr.fma(dx, dx, dr.fma(dy, dy, dz * dz)))
            covered = t.Bool(True)
            if dr.hint(with_beam, mode="scalar"):
                covered = covers(m, (dx, dy, dz))
            if dr.hint(paired, mode="scalar"):
                receiver = dr.gather(t.Array4f, receiver_table, m)
                ex = x - receiver.x
                ey = y[u] - receiver.y
                ez = z[u] - receiver.z
                r = 0.5 * (r + dr.sqrt(dr.fma(ex, ex, dr.fma(ey, ey, ez * ez))))
                if dr.hint(with_beam, mode="scalar"):
                    covered &= covers(m, (ex, ey, ez))
            cell = (r - range0) * inverse_step
            inside = (cell >= 0.0) & (cell < last)
            node = t.UInt32(dr.select(inside, cell, 0.0))
            share = cell - t.Float32(node)
            place = base + node
            if dr.hint(with_beam, mode="scalar"):
                coverage[u] += dr.select(covered, 1.0, 0.0)
                inside &= covered
            added = inside
            if dr.hint(with_support, mode="scalar"):
                peak = dr.gather(t.Float32, nearest_table, place)
                supported = inside & (dr.abs(r - peak) <= radius)
                added = supported if gated else inside
                end = dr.gather(t.Float32, ends, m) > 0.0 if ends is not None else None
                runs[u] = follow(runs[u], supported, covered, view.w, end)
            q0 = dr.gather(t.Float32, value_table, place, added)
            q1 = dr.gather(t.Float32, value_table, place + 1, added)
            total[u] += dr.fma(share, q1 - q0, q0)
        m += 1
    result = {name: [voxel[name] for voxel in runs] for name in (runs[0] if with_support else ())}
    return {**result, "total": total, "coverage": coverage}


def _no_runs(t: Any, lanes: int, directions: bool) -> dict[str, Any]:
    """State of a voxel before the first view."""
    none, zero = dr.full(t.Float32, -1.0, lanes), dr.zeros(t.Float32, lanes)
    true, false = dr.full(t.Bool, True, lanes), dr.full(t.Bool, False, lanes)
    runs = {"run": none, "longest": zero, "first": t.Float32(none), "unbroken": true}
    if directions:
        runs |= {"head": t.Float32(zero), "tail": t.Float32(zero), "least": dr.full(t.Float32, _NO_GAP, lanes)}
        runs |= {"known": false, "seen": t.Bool(false), "backed": t.Bool(false)}
    return runs


def _follow_views(runs: dict[str, Any], supported: Any, covered: Any, gap: Any, end: Any) -> dict[str, Any]:
    """Take in a view; all differ in angle and see every voxel."""
    del covered, end
    run = dr.select(supported, dr.select(runs["run"] >= 0.0, runs["run"] + gap, 0.0), -1.0)
    unbroken = runs["unbroken"] & supported
    return {
        "run": run,
        "longest": dr.maximum(runs["longest"], run),
        "first": dr.select(unbroken, run, runs["first"]),
        "unbroken": unbroken,
    }


def _follow_directions(runs: dict[str, Any], supported: Any, covered: Any, gap: Any, end: Any) -> dict[str, Any]:
    """Take in a view; a direction is complete at its ``end``, and counts where one of its views saw the voxel.

    ``tail`` is the angle since the last direction that counted.
    """
    seen, backed = runs["seen"] | covered, runs["backed"] | supported
    since, known = runs["tail"] + gap, runs["known"]
    counts = end & seen
    again = dr.select(runs["run"] >= 0.0, runs["run"] + since, 0.0)
    run = dr.select(counts, dr.select(backed, again, -1.0), runs["run"])
    unbroken = runs["unbroken"] & (backed | ~counts)
    return {
        "run": run,
        "longest": dr.maximum(runs["longest"], run),
        "first": dr.select(counts & unbroken, run, runs["first"]),
        "unbroken": unbroken,
        "head": dr.select(counts & ~known, since, runs["head"]),
        "tail": dr.select(counts, 0.0, since),
        "least": dr.select(counts & known, dr.minimum(runs["least"], since), runs["least"]),
        "known": known | counts,
        "seen": seen & ~end,
        "backed": backed & ~end,
    }


def _covered(t: Any, beam: BeamTables | None, view: Any, offset: tuple[Any, Any, Any]) -> Any:
    """Whether a voxel at ``offset`` (x, y, z) from an antenna lies in the covered sector of a view."""
    assert beam is not None
    dx, dy, dz = offset
    ahead = dr.gather(t.Array4f, beam.ahead, view)
    frame = dr.gather(t.Array4f, beam.frame, view)
    forward = dr.fma(dx, ahead.x, dr.fma(dy, ahead.y, dz * ahead.z))
    aside = dr.fma(dy, frame.x, -dx * frame.y)
    above = dr.fma(dz, frame.z, -ahead.z * dr.fma(dx, frame.x, dy * frame.y))
    degrees = 180.0 / dr.pi
    azimuth = degrees * dr.atan2(aside, forward)
    elevation = degrees * dr.atan2(above, dr.sqrt(dr.fma(forward, forward, aside * aside)))
    level = _level(t, beam.azimuth, (azimuth + 180.0) * beam.per_degree)
    return level + _level(t, beam.elevation, (elevation + 90.0) * beam.per_degree) >= beam.edge_db


def _level(t: Any, table: Any, cell: Any) -> Any:
    node = t.UInt32(dr.maximum(cell, 0.0))
    low = dr.gather(t.Float32, table, node)
    return dr.fma(cell - t.Float32(node), dr.gather(t.Float32, table, node + 1) - low, low)
