"""MLEM tomography of the profiles (L. A. Shepp and Y. Vardi, IEEE Trans. Med. Imaging 1(2), 1982)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.imaging.method import Method
from mvla_sim.imaging.observation import Estimate, Observation
from mvla_sim.imaging.tomography import LinearModel, background, scale_of

__all__ = ["Mlem", "maximize"]

_NOTHING: Final = np.float32(1e-30)
"""Of the brightest voxel: less is 0, for threads differ in whether they keep the smallest numbers."""


def maximize(
    model: LinearModel,
    power: NDArray[np.float64],
    noise: NDArray[np.float64],
    iterations: int,
    start: NDArray[np.floating] | None = None,
) -> NDArray[np.float32]:
    """Iterate ``x ← x · Aᵀ(P/(A x + b)) / Aᵀ1``.

    No step lowers the likelihood ``Σ P ln(A x + b) − (A x + b)`` of Poisson counts P, and none makes a voxel negative.

    Parameters
    ----------
    model
        A and Aᵀ.
    power
        P, ``[n_view, n_range]``; what is below 0 counts as 0.
    noise
        b, ``[n_view]``, in the unit of P, above 0.
    iterations
        Number of steps.
    start
        x before the first step, ``[nz, ny, nx]``, in the unit of P, not below 0; voxels of 0 stay 0. By default one
        value everywhere, such that A x + b adds up to P.

    Returns
    -------
    NDArray[np.float32]
        x, ``[nz, ny, nx]``, in the unit of P; 0 where no view sees a voxel, or below 10⁻³⁰ of its maximum.
    """
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    t: Any = model.arrays
    scale = scale_of(power)
    clipped = np.maximum(power, 0) / scale
    floor = np.broadcast_to(noise[:, None] / scale, model.shape)
    observed, expected = model.upload(clipped), model.upload(floor)
    sensitivity = model.transpose(dr.full(t.Float32, 1.0, dr.width(observed)))
    total = float(model.image(sensitivity).sum(dtype=np.float64))
    inverse = dr.select(sensitivity > 0, 1.0 / sensitivity, 0.0)
    if start is None:
        level = max(float((clipped - floor).sum()), float(clipped.sum()) * 1e-3) / total if total > 0 else 0.0
        image = dr.full(t.Float32, level, model.grid.size)
    else:
        image = model.upload(start / scale)
    dr.eval(inverse, image)
    for _ in range(iterations):
        ratio = observed / (model.predict(image) + expected)
        image = image * model.transpose(ratio) * inverse
        dr.eval(image)
        dr.sync_thread()
    found = model.image(image) * np.float32(scale)
    found[found < _NOTHING * found.max(initial=0)] = 0
    return found


class Mlem(Method):
    """``x ← x · Aᵀ(P/(A x + b)) / Aᵀ1`` with P the profiles, A :class:`LinearModel`, b what their noise amounts to."""

    name: ClassVar[str] = "mlem"
    title: ClassVar[str] = "MLEM"
    uses_peaks: ClassVar[bool] = False
    uses_pdp: ClassVar[bool] = True

    iterations: Annotated[int, Field(ge=1, le=10_000, description="steps; more sharpen the image, and the noise")] = 40

    @property
    def projections(self) -> float:
        """About how many projections its image costs."""
        return 2.0 * self.iterations + 1

    def image(self, seen: Observation) -> Estimate:
        """Iterate."""
        power = seen.pdp.power
        return Estimate(maximize(LinearModel.of(seen), power, background(power), self.iterations))
