"""Non-negative least squares of the profiles, by accelerated projected gradients."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.dsp import noise_level
from mvla_sim.imaging.method import Method
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.tomography import LinearModel, scale_of

__all__ = ["Nnls", "minimize"]


def minimize(
    model: LinearModel,
    power: NDArray[np.float64],
    noise: NDArray[np.float64],
    iterations: int,
    start: NDArray[np.floating] | None = None,
) -> NDArray[np.float32]:
    """Minimise ``f(x) = ‖A x − (P − b)‖²`` over x ≥ 0.

    A step goes from a point z along the scaled gradient, ``x = max(0, z − Aᵀ(A z − P + b)/d)``, with
    ``d = AᵀA1``: as no element of A is negative, diag(d) − AᵀA has no negative eigenvalue, so d bounds the curvature
    voxel by voxel, where one step for all would follow the largest (A. R. De Pierro, IEEE Trans. Med. Imaging 14(1),
    1995). z runs ahead of x as in FISTA (A. Beck and M. Teboulle, SIAM J. Imaging Sci. 2(1), 2009). A step that would
    raise f is not taken; it starts the acceleration anew (B. O'Donoghue and E. Candès, Found. Comput. Math. 15, 2015).
    A is linear, so A z follows from A x of the last two steps, and f costs nothing.

    Parameters
    ----------
    model
        A and Aᵀ.
    power
        P, ``[n_view, n_range]``.
    noise
        b, ``[n_view]``, in the unit of P.
    iterations
        Number of steps.
    start
        x before the first step, ``[nz, ny, nx]``, in the unit of P, not below 0; by default 0.

    Returns
    -------
    NDArray[np.float32]
        x, ``[nz, ny, nx]``, in the unit of P; as it was at the start where no view sees a voxel.
    """
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    t: Any = model.arrays
    scale = scale_of(power)
    wanted = model.upload((power - noise[:, None]) / scale)
    curvature = model.transpose(model.predict(dr.full(t.Float32, 1.0, model.grid.size)))
    inverse = dr.select(curvature > 0, 1.0 / curvature, 0.0)
    image = dr.zeros(t.Float32, model.grid.size) if start is None else model.upload(start / scale)
    seen = model.predict(image)
    error = dr.squared_norm(seen - wanted)
    momentum = dr.opaque(t.Float32, 1.0)
    ahead, ahead_seen = t.Float32(image), t.Float32(seen)
    dr.eval(inverse, image, seen, error, ahead, ahead_seen)
    for _ in range(iterations):
        trial = dr.maximum(ahead - model.transpose(ahead_seen - wanted) * inverse, 0.0)
        dr.eval(trial)
        trial_seen = model.predict(trial)
        dr.eval(trial_seen)
        trial_error = dr.squared_norm(trial_seen - wanted)
        better = trial_error <= error
        following = dr.select(better, 0.5 + dr.sqrt(0.25 + momentum * momentum), 1.0)
        run = dr.select(better, (momentum - 1.0) / following, 0.0)
        moved = dr.select(better, trial, image)
        moved_seen = dr.select(better, trial_seen, seen)
        ahead = moved + run * (moved - image)
        ahead_seen = moved_seen + run * (moved_seen - seen)
        image, seen, momentum, error = moved, moved_seen, following, dr.minimum(error, trial_error)
        dr.eval(ahead, ahead_seen, image, seen, momentum, error)
        dr.sync_thread()
    return model.image(image) * np.float32(scale)


class Nnls(Method):
    """``min ‖A x − (P − b)‖²``, x ≥ 0, with P the profiles, A :class:`LinearModel`, b the median of each profile."""

    name: ClassVar[str] = "nnls"
    title: ClassVar[str] = "NNLS"
    uses_peaks: ClassVar[bool] = False
    uses_pdp: ClassVar[bool] = True

    iterations: Annotated[int, Field(ge=1, le=10_000, description="steps; more sharpen the image, and the noise")] = 20

    @property
    def projections(self) -> float:
        """About how many projections its image costs."""
        return 2.0 * self.iterations + 2

    def image(self, seen: Observation) -> Estimate:
        """Iterate."""
        power = seen.pdp.power
        level, _ = noise_level(power)
        return Estimate(minimize(LinearModel.of(seen), power, level, self.iterations))
