"""Ready-made multipath components: ranges and powers a view, which enter after the peak detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.header import Channel
from mvla_sim.errors import DataError
from mvla_sim.netcdf import Variable
from mvla_sim.ragged import Ragged

__all__ = ["Components"]


@dataclass(frozen=True, eq=False, repr=False)
class Components(Ragged, Channel):
    """Multipath components C_m = {(R_mi, p_mi)} of M views (``eq:obs``), measured or detected elsewhere.

    Attributes
    ----------
    range_m
        R_mi, ``[n_component]`` float64, metres; view after view, rising within a view.
    power
        p_mi, ``[n_component]`` float64, above 0, linear; only ratios within a view count.
    row_size
        Components of each view, ``[n_view]`` int64.
    views, carrier_hz, bandwidth_hz, extent_m, outline, antenna, config, provenance
        As of any :class:`~mvla_sim.channel.header.Channel`; the bandwidth decides ΔR and so the kernel.
    """

    SCHEMA: ClassVar = "mvla-sim components"
    VERSION: ClassVar = 1
    WHAT: ClassVar = "components"
    VARIABLES: ClassVar = (
        Variable("range", "range_m", ("component",), "f8", "one-way range of the component", "m"),
        Variable("power", "power", ("component",), "f8", "power of the component", "1"),
        Variable(
            "row_size", "row_size", ("view",), "i8", "number of components of the view", sample_dimension="component"
        ),
    )

    range_m: NDArray[np.float64]
    power: NDArray[np.float64]
    row_size: NDArray[np.int64]

    def __post_init__(self) -> None:
        """Check shapes, finiteness, that the rows add up, and that ranges rise within them."""
        super().__post_init__()
        if self.range_m.shape != self.power.shape:
            raise DataError(f"components: {self.range_m.size} ranges and {self.power.size} powers; these must agree")
        self.check_rows("components", self.n_view, self.range_m.size)
        if not (np.isfinite(self.range_m).all() and (self.range_m >= 0).all()):
            raise DataError("components: ranges must be finite and at least 0")
        if not (np.isfinite(self.power).all() and (self.power > 0).all()):
            raise DataError("components: powers must be finite and above 0")
        view = self.row_index
        falls = np.flatnonzero((np.diff(self.range_m) < 0) & (np.diff(view) == 0))
        if len(falls):
            raise DataError(f"components: ranges of view {view[falls[0]]} do not rise; sort them within each view")

    @property
    def summary(self) -> str:
        """How many views and components there are, in a few words."""
        return f"{self.n_view} views, {self.range_m.size} components"
