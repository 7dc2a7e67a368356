"""The compiled forward operator: what every view would see of an image, one histogram over range a view.

It is the projector's transpose, with the same ranges and the same interpolation: the value of a voxel at range r
between two nodes is shared between them as ``x·(1 − share)`` and ``x·share``, the very weights with which the
projector reads their values. A thread owns the rows of a few views and of one part of the grid, and walks over that
part, so no two threads ever write to one place, and nothing depends on their number. Both shares of a voxel lie side by
side and are added at once; rows and shares are put together afterwards.

Nothing here imports Dr.Jit before it is called, after the backend has chosen its library.
"""

from __future__ import annotations

from typing import Any

__all__ = ["convolve", "fold", "spread"]


def spread(
    tables: Any,
    image: Any,
    grid: tuple[Any, ...],
    axis: tuple[Any, ...],
    *,
    parts: int,
    together: int,
    n_view: int,
    nodes: int,
) -> Any:
    """Add up the voxels of an image over range, for every view.

    Parameters
    ----------
    tables
        :class:`~mvla_sim.imaging.kernels.DeviceTables` of the views; the profiles in them are not looked at.
    image
        x_n, flat ``[n_voxel]`` on the device.
    grid
        nx, ny, and the number of voxels; x, y, z of voxel 0 and the spacing, metres; all on the device.
    axis
        n_range, first range in metres and nodes a metre, on the device.
    parts
        Number of parts that the grid is cut into.
    together
        Views a thread.
    n_view, nodes
        Number of views M, and n_range on the host, where asking the device for it would wait for all its work.

    Returns
    -------
    Any
        Pairs (Σ x·(1 − share), Σ x·share) a node, ``[together, parts, ⌈M/together⌉, n_range, 2]`` flat on the device.
        View number ``u·⌈M/together⌉ + k`` is in rows ``[u, :, k]``; rows without a view hold copies of the last.
    """
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    from mvla_sim.imaging import kernels  # noqa: PLC0415 - compiles: only where something is projected

    t = kernels.BACKEND.arrays
    nx, ny, size, x0, y0, z0, spacing = grid
    n_range, range0, inverse_step = axis
    columns = -(-n_view // together)
    lanes = columns * parts
    lane, lane_count = dr.arange(t.UInt32, lanes), dr.opaque(t.UInt32, lanes)
    column_count = dr.opaque(t.UInt32, columns)
    column, part = lane % column_count, lane // column_count
    length = (size + dr.opaque(t.UInt32, parts - 1)) // dr.opaque(t.UInt32, parts)
    first = part * length
    stop = dr.minimum(first + length, size)
    numbers = [dr.minimum(column + column_count * u, dr.opaque(t.UInt32, n_view - 1)) for u in range(together)]
    views = [dr.gather(t.Array4f, tables.view, m) for m in numbers]
    receivers = [] if tables.receiver is None else [dr.gather(t.Array4f, tables.receiver, m) for m in numbers]
    bases = [(lane + lane_count * u) * n_range for u in range(together)]
    last = t.Float32(n_range - 1)
    rows = dr.zeros(t.Float32, 2 * together * lanes * nodes)

    def step(n: Any, ix: Any, iy: Any, iz: Any) -> tuple[Any, Any, Any, Any]:
        value = dr.gather(t.Float32, image, n)
        x = dr.fma(t.Float32(ix), spacing, x0)
        y = dr.fma(t.Float32(iy), spacing, y0)
        z = dr.fma(t.Float32(iz), spacing, z0)
        for u in range(together):
            offset, r = _offset(dr, (x, y, z), views[u])
            covered = t.Bool(True) if tables.beam is None else kernels._covered(t, tables.beam, numbers[u], offset)
            if receivers:
                offset, back = _offset(dr, (x, y, z), receivers[u])
                r = 0.5 * (r + back)
                if tables.beam is not None:
                    covered &= kernels._covered(t, tables.beam, numbers[u], offset)
            cell = (r - range0) * inverse_step
            inside = (cell >= 0.0) & (cell < last)
            node = t.UInt32(dr.select(inside, cell, 0.0))
            upper = value * (cell - t.Float32(node))
            pair = t.Array2f(value - upper, upper)
            dr.scatter_add(rows, pair, bases[u] + node, inside & covered, mode=dr.ReduceMode.NoConflicts)
        ix = ix + 1
        ended = ix == nx
        ix, iy = dr.select(ended, 0, ix), dr.select(ended, iy + 1, iy)
        ended = iy == ny
        return n + 1, ix, dr.select(ended, 0, iy), dr.select(ended, iz + 1, iz)

    row = first // nx
    dr.while_loop((first, first % nx, row % ny, row // ny), lambda n, *_: n < stop, step)
    return rows


def _offset(dr: Any, voxel: tuple[Any, Any, Any], end: Any) -> tuple[tuple[Any, Any, Any], Any]:
    """From an antenna to a voxel: x, y, z, and the distance, in the projector's own order of operations."""
    dx, dy, dz = voxel[0] - end.x, voxel[1] - end.y, voxel[2] - end.z
    return (dx, dy, dz), dr.sqrt(dr.fma(dx, dx, dr.fma(dy, dy, dz * dz)))


def fold(rows: Any, weight: Any | None, n_range: Any, *, parts: int, together: int, n_view: int, nodes: int) -> Any:
    """Put the rows of :func:`spread` together to profiles, ``[n_view·n_range]`` flat on the device, not yet evaluated.

    A node receives the lower shares of its own cell and the upper shares of the cell before. ``weight`` ``[n_range]``
    scales every node; None: 1.
    """
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    from mvla_sim.imaging import kernels  # noqa: PLC0415 - compiles: only where something is projected

    t = kernels.BACKEND.arrays
    columns = -(-n_view // together)
    column_count, part_count = dr.opaque(t.UInt32, columns), dr.opaque(t.UInt32, parts)
    place = dr.arange(t.UInt32, n_view * nodes)
    view, node = place // n_range, place % n_range
    row = view // column_count * (part_count * column_count) + view % column_count
    stride = 2 * column_count * n_range
    start = 2 * (row * n_range + node)

    def step(k: Any, at: Any, total: Any) -> tuple[Any, Any, Any]:
        lower = dr.gather(t.Float32, rows, at)
        upper = dr.gather(t.Float32, rows, at - 1, node > 0)
        return k + 1, at + stride, total + (lower + upper)

    state = (t.UInt32(0), start, dr.zeros(t.Float32, dr.width(place)))
    total = dr.while_loop(state, lambda k, *_: k < part_count, step)[2]
    return total if weight is None else total * dr.gather(t.Float32, weight, node)


def convolve(profiles: Any, taps: Any, n_range: Any) -> Any:
    """Convolve every profile with an even pulse along range, nothing outside the axis.

    Parameters
    ----------
    profiles
        ``[n_view·n_range]`` flat on the device, evaluated.
    taps
        The pulse at nodes 0, 1, …, h; on the device.
    n_range
        Nodes, on the device.

    Returns
    -------
    Any
        ``[n_view·n_range]``, flat, not yet evaluated.
    """
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    from mvla_sim.imaging import kernels  # noqa: PLC0415 - compiles: only where something is projected

    t = kernels.BACKEND.arrays
    place = dr.arange(t.UInt32, dr.width(profiles))
    node = place % n_range
    count = dr.opaque(t.UInt32, dr.width(taps))

    def step(k: Any, total: Any) -> tuple[Any, Any]:
        left = dr.gather(t.Float32, profiles, place - k, node >= k)
        right = dr.gather(t.Float32, profiles, place + k, node + k < n_range)
        return k + 1, dr.fma(dr.gather(t.Float32, taps, k), left + right, total)

    centre = dr.gather(t.Float32, taps, t.UInt32(0)) * dr.gather(t.Float32, profiles, place)
    return dr.while_loop((t.UInt32(1), centre), lambda k, _: k < count, step)[1]
