"""One ray through the whole engine; ``mvla doctor`` runs it in a child process, where a crash is only a finding."""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any, Final

import numpy as np

from mvla_sim.constants import SPEED_OF_LIGHT, delay_to_range
from mvla_sim.engine.backend import activate, activate_sionna
from mvla_sim.errors import MvlaError, RuntimeUnfitError

__all__ = ["main", "trace_one_ray"]

CARRIER_HZ: Final[float] = 36e9
POSITION_M: Final = (0.0, 0.0, 1.0)
"""Inside Sionna's metal box of 10 m × 10 m × 5 m, whose floor is at z = 0 and whose axis is x = y = 0."""
WALLS_M: Final = (1.0, 4.0, 5.0)
"""Distances from there to the floor, the ceiling and any side wall, metres: whichever the ray hits."""


def trace_one_ray() -> float:
    """Trace one ray from inside a metal box and return the range of its reflection, metres.

    The sensor sees its own image behind the wall, so the range is the wall's distance R and the gain λ/(4π·2R).

    Raises
    ------
    RuntimeUnfitError
        No backend can run, or the path found is not that reflection.
    """
    rt: Any = activate_sionna()
    import mitsuba as mi  # noqa: PLC0415 - only after the backend is chosen

    scene = rt.load_scene(rt.scene.box)
    scene.frequency = CARRIER_HZ
    scene.tx_array = scene.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    scene.add(rt.Transmitter("tx", position=mi.Point3f(*POSITION_M)))
    scene.add(rt.Receiver("rx", position=mi.Point3f(*POSITION_M)))
    paths = rt.PathSolver(deterministic=True)(
        scene, max_depth=1, samples_per_src=1, los=False, refraction=False, diffraction=True, seed=1
    )
    gain, delay = paths.cir(normalize_delays=False, out_type="numpy")
    ranges = delay_to_range(np.asarray(delay, np.float64).ravel())
    found = ranges > 0
    if found.sum() != 1:
        raise RuntimeUnfitError(f"one ray in a closed box gave {found.sum()} paths, not 1: reinstall sionna-rt")
    range_m = float(ranges[found][0])
    amplitude = float(np.abs(gain).ravel()[found][0])
    expected = SPEED_OF_LIGHT / CARRIER_HZ / (4 * math.pi * 2 * range_m)
    near_wall = min(abs(range_m - wall) for wall in WALLS_M) < 1e-3  # float32 delays are good to micrometres here
    if not near_wall or abs(amplitude / expected - 1) > 0.01:  # metal reflects 99.9 % of the amplitude
        raise RuntimeUnfitError(
            f"one ray in a closed box gave a path of {range_m:.4f} m and gain {amplitude:.3e}, not a wall's: "
            f"reinstall sionna-rt, mitsuba and drjit"
        )
    return range_m


def main() -> int:
    """Write what was found to standard output, one JSON object a line; the backend before the trace is tried."""
    try:
        backend = activate()
        import drjit as dr  # noqa: PLC0415

        _say(
            backend=backend.name,
            libllvm=str(backend.libllvm or ""),
            libllvm_version=backend.libllvm_version or "",
            origin=backend.origin or "",
            threads=dr.thread_count(),
        )
        began = time.perf_counter()
        _say(range_m=trace_one_ray(), seconds=time.perf_counter() - began)
    except MvlaError as error:
        _say(error=str(error))
        return 1
    return 0


def _say(**facts: object) -> None:
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
