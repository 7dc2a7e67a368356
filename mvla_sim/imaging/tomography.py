"""A linear model of power delay profiles, P ≈ A x + b, on which methods of tomography iterate.

``A_(m,l),n = |p(τ_l − τ_mn)|²·(r₀/r_mn)⁴``: voxel n reflects x_n ≥ 0 alike to every view, its echo is a pulse at its
own range that fades with the fourth power of it, and echoes add by power, for nothing is known of their phases.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from mvla_sim.dsp import Window, noise_level
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import Beam
from mvla_sim.imaging.forward import RangeOperator
from mvla_sim.imaging.observation import Observation
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.scene.views import Views

__all__ = ["LinearModel", "background", "pulse_power", "scale_of"]

_FREQUENCIES = 4096  # of the sum over the band that makes a pulse
_FINE = 64  # nodes a resolution cell where the main lobe's end is looked for
_REACH_CELLS = 32  # no main lobe reaches farther: β = 40 of a Kaiser window ends at 12.8 cells
_LEAST = 1e-6  # of the strongest sample: the background where profiles have none
_TINY = 1e-12  # of the strongest sample: a deviation that is none


def pulse_power(window: Window, oversampling: int) -> NDArray[np.float64]:
    """Power of an isolated path at nodes 0, 1, …, h of the range axis from its own, 1 at 0; up to the main lobe's end.

    As in a PDP, ``|p(τ)|² = |Σ_k W_k exp(j2πf_kτ)|²/(Σ_k W_k)²`` of the window's weights W_k over the band, with
    ``τ = j/(oversampling·B)`` at node j.
    """
    weights = window.weights(_FREQUENCIES)
    band = (np.arange(_FREQUENCIES) + 0.5) / _FREQUENCIES - 0.5

    def power(cells: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((np.cos(2 * np.pi * np.outer(cells, band)) @ weights / weights.sum()) ** 2)

    fine = power(np.arange(_REACH_CELLS * _FINE) / _FINE)
    end = int(np.flatnonzero(np.diff(fine) > 0)[0])
    taps = power(np.arange(end * oversampling // _FINE + 1) / oversampling)
    return np.asarray(taps[: np.flatnonzero(taps > _LEAST)[-1] + 1])


def background(power: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean b of each profile's noise once it is clipped at 0, ``[n_view]``, above 0.

    For a normal distribution of level μ and deviation σ it is ``μ Φ(μ/σ) + σ φ(μ/σ)``, with Φ and φ the standard normal
    distribution and density; μ itself where it is far above σ, 0.4 σ where it is 0. At least 10⁻⁶ of the strongest
    sample of all, or of 1 where there is none.
    """
    level, sigma = noise_level(power)
    scale = scale_of(power)
    ratio = level / np.maximum(sigma, _TINY * scale)
    density = np.exp(-0.5 * ratio**2) / np.sqrt(2 * np.pi)
    return np.asarray(np.maximum(level * ndtr(ratio) + sigma * density, _LEAST * scale), np.float64)


def scale_of(power: NDArray[np.float64]) -> float:
    """The strongest sample; 1 where none is above 0. Divided by it, powers fit float32."""
    largest = float(power.max(initial=0.0))
    return largest if largest > 0 else 1.0


class LinearModel:
    """A and Aᵀ of a grid, views and a pulse: ``A = C D S``.

    S is :class:`~mvla_sim.imaging.forward.RangeOperator`, D the fading at the nodes, C the convolution with the pulse
    along range. Aᵀ is the projection of convolved, weighted profiles. Images are flat ``[N]`` and profiles flat
    ``[n_view·n_range]`` float32, on the device.

    Parameters
    ----------
    grid, views, beam
        As for the projector.
    pdp
        Its range axis, kernel, window and oversampling; powers are not looked at.
    fading
        Whether echoes fade with the fourth power of the range; if not, D is 1, for profiles that say nothing of power.

    Attributes
    ----------
    grid
        As above.
    shape
        Of profiles, (n_view, n_range).
    taps
        The pulse's power, :func:`pulse_power`; of one sample for profiles of ``kernel = "nearest"``.
    weight
        ``(r₀/r_l)⁴`` ``[n_range]``, r₀ the middle of the axis, r_l at least a resolution cell.
    arrays
        Dr.Jit's module of array types.

    Notes
    -----
    The antenna's pattern weakens echoes within its beam; the model leaves that out.

    Raises
    ------
    ConfigError
        The grid does not fit into memory.
    """

    def __init__(
        self, grid: VoxelGrid, views: Views, pdp: Pdp, *, beam: Beam | None = None, fading: bool = True
    ) -> None:
        self.grid = grid
        self.shape = (len(views), pdp.power.shape[1])
        nearest = pdp.kernel == "nearest"
        self.taps = np.ones(1) if nearest else pulse_power(pdp.window, pdp.oversampling)
        ranges = np.maximum(pdp.range_m, pdp.resolution_m)
        self.weight = (0.5 * (ranges[0] + ranges[-1]) / ranges) ** 4 if fading else np.ones_like(ranges)
        self._operator = RangeOperator(grid, views, pdp.start_m, pdp.step_m, self.shape[1], beam=beam)
        self.arrays: Any = self._operator.arrays
        self._taps = self.upload(self.taps)
        self._weight = self.upload(self.weight)

    @classmethod
    def of(cls, seen: Observation, *, fading: bool = True) -> LinearModel:
        """The model of what a method sees."""
        return cls(seen.grid, seen.views, seen.pdp, beam=seen.beam, fading=fading)

    def upload(self, values: NDArray[np.floating]) -> Any:
        """Flatten to the device as float32."""
        return self.arrays.Float32(np.ascontiguousarray(values, np.float32).ravel())

    def image(self, values: Any) -> NDArray[np.float32]:
        """An image ``[N]`` from the device, ``[nz, ny, nx]``."""
        return np.asarray(values.numpy(), np.float32).reshape(self.grid.shape)

    def profiles(self, values: Any) -> NDArray[np.float32]:
        """Profiles ``[n_view·n_range]`` from the device, ``[n_view, n_range]``."""
        return np.asarray(values.numpy(), np.float32).reshape(self.shape)

    def predict(self, image: Any) -> Any:
        """A x of an image x, not yet evaluated."""
        import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

        from mvla_sim.imaging import forward_kernel  # noqa: PLC0415 - as above

        seen = self._operator.forward(image, self._weight)
        dr.eval(seen)
        return forward_kernel.convolve(seen, self._taps, self._operator.node_count)

    def transpose(self, profiles: Any) -> Any:
        """Aᵀ y of profiles y, evaluated."""
        import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

        from mvla_sim.imaging import forward_kernel  # noqa: PLC0415 - as above

        t = self.arrays
        dr.eval(profiles)
        count = self._operator.node_count
        wide = forward_kernel.convolve(profiles, self._taps, count)
        place = dr.arange(t.UInt32, dr.width(profiles))
        weighted = wide * dr.gather(t.Float32, self._weight, place % count)
        dr.eval(weighted)
        return self._operator.project(weighted)
