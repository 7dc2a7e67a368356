"""From a scene to the paths of one view at a time, with Sionna RT. The only module that imports Sionna.

One pair of transmitter and receiver, co-located or apart, is moved from view to view; scene and solver are built once.

What makes this fast, and what makes it converge:

* **Passes.** With specular reflection on, only a share S² of the hits becomes a diffuse path, so a pass of diffuse
  reflection alone gathers 1/S² times the diffuse paths of a joint one, and specular reflection with diffraction needs
  far fewer rays. Paths of a single interaction fall into exactly one pass. Paths that mix diffuse with specular
  interactions exist from depth 2 on; a third pass traces everything and keeps only those.
* **Sector launch.** Sionna launches a Fibonacci lattice over the whole sphere. The same lattice over the rectangle of
  azimuth × cos(polar angle) that holds every object hits the target with most of its rays. The map from the lattice's
  unit square to the sphere preserves area, so every ray tube keeps the same solid angle, 4π·f/n for a rectangle that
  is the fraction f of the square. Sionna scales a diffuse path by the square root of the tube it assumes, 4π/n, so
  those paths, and only those, are multiplied by √f.
* **Speckle.** Sionna gives diffuse paths no phase of their own, so on a smooth face those near the specular point would
  add up coherently, and the more so the more rays there are. Diffuse scattering is incoherent: each diffuse path gets a
  phase drawn from a stream named by seed and the antennas' positions, and the PDP converges as rays are added.
* **Antennas.** Sionna traces isotropic ones; a pattern multiplies each path's gain afterwards, by the directions in
  which it leaves and arrives.
* **Nothing is compiled twice.** The rectangle, antenna positions and material constants enter the kernels as data, not
  as literals. Results are taken from the solver's buffer as they are: the tensors that Sionna makes of them hold the
  number of paths as a literal, so they are compiled anew for nearly every view, which took longer than tracing it.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mvla_sim.channel.cir import INTERACTIONS
from mvla_sim.engine.backend import activate_sionna
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.antenna import AntennaPattern
from mvla_sim.scene.material import CustomMaterial
from mvla_sim.scene.placing import SceneObject
from mvla_sim.scene.radio import RayTracingSettings
from mvla_sim.scene.world import Scene
from mvla_sim.streams import Stream, stream

__all__ = ["LaunchWindow", "ViewPaths", "ViewTracer"]

_MARGIN = 2e-3  # of the unit square's width: keeps silhouettes inside the window, whatever the rounding


@dataclass(frozen=True, eq=False)
class ViewPaths:
    """The paths of one view; attributes as in :class:`~mvla_sim.channel.cir.Cir`."""

    gain: NDArray[np.complex64]
    delay_s: NDArray[np.float64]
    interaction: NDArray[np.uint8]
    first_point_m: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LaunchWindow:
    """Rectangle of the unit square into which rays are launched: x = azimuth/2π, y = (1 − cos θ)/2."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def fraction(self) -> float:
        """Share f of the sphere's solid angle."""
        return (self.x[1] - self.x[0]) * (self.y[1] - self.y[0])

    @classmethod
    def sphere(cls) -> LaunchWindow:
        """All directions."""
        return cls((0.0, 1.0), (0.0, 1.0))

    @classmethod
    def around(cls, vertices: NDArray[np.float64], position: NDArray[np.float64]) -> LaunchWindow:
        """Smallest window, with a margin, where ``vertices`` [n, 3] and their hull are seen from ``position`` [3]."""
        hull = shapely.MultiPoint(vertices[:, :2]).convex_hull
        sensor = shapely.Point(position[:2])
        near = hull.distance(sensor)
        offset = vertices - position
        horizontal = np.hypot(offset[:, 0], offset[:, 1])
        if near <= 0:
            return cls((0.0, 1.0), (0.0, 1.0))
        middle = np.arctan2(hull.centroid.y - position[1], hull.centroid.x - position[0])
        azimuth = np.angle(np.exp(1j * (np.arctan2(offset[:, 1], offset[:, 0]) - middle)))
        far = horizontal.max()
        low, high = offset[:, 2].min(), offset[:, 2].max()
        top = high / np.hypot(near if high > 0 else far, high)
        bottom = low / np.hypot(near if low < 0 else far, low)
        x0, x1 = (float((middle + a) / (2 * np.pi)) for a in (azimuth.min(), azimuth.max()))
        y0, y1 = (float((1 - z) / 2) for z in (top, bottom))
        return cls(
            (x0 - _MARGIN, min(x1 + _MARGIN, x0 - _MARGIN + 1)), (max(0.0, y0 - _MARGIN), min(1.0, y1 + _MARGIN))
        )


@dataclass(frozen=True, eq=False)
class _Pass:
    """One call of the path solver for a view."""

    name: str
    rays: int
    specular: bool
    diffuse: bool
    diffraction: bool
    mixed_only: bool = False


def plan_passes(settings: RayTracingSettings) -> list[_Pass]:
    """Split what is to be traced into solver calls; see the module's docstring."""
    passes = []
    if settings.diffuse:
        passes.append(_Pass("diffuse", settings.diffuse_rays, False, True, False))
    if settings.specular or settings.diffraction:
        passes.append(
            _Pass("specular and diffraction", settings.specular_rays, settings.specular, False, settings.diffraction)
        )
    if settings.max_depth > 1 and settings.diffuse and settings.specular:
        passes.append(_Pass("mixed", settings.diffuse_rays, settings.specular, True, False, True))
    return passes


@dataclass(frozen=True, eq=False)
class _Beam:
    """The antennas of one view: pattern, transmitter [3] and receiver [3] in metres, boresight [3]."""

    antenna: AntennaPattern
    transmitter_m: NDArray[np.float64]
    receiver_m: NDArray[np.float64]
    boresight: NDArray[np.float64]

    def amplitude(self, first_m: NDArray[np.float64], last_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Product of both field patterns along paths by their first and last interaction points ``[n, 3]``."""
        departing = self.antenna.amplitude(first_m - self.transmitter_m, self.boresight)
        return departing * self.antenna.amplitude(last_m - self.receiver_m, self.boresight)


class ViewTracer:
    """Traces a scene from any position; build once, call :meth:`trace` per view.

    Parameters
    ----------
    scene
        The scene; its settings decide rays, depth and what is traced.

    Raises
    ------
    RuntimeUnfitError
        No backend can run here.
    """

    def __init__(self, scene: Scene) -> None:
        self._rt = activate_sionna()
        self._settings = scene.settings.ray_tracing
        self._passes = plan_passes(self._settings)
        self._vertices = np.concatenate([np.asarray(o.mesh.vertices, np.float64) for o in scene.objects])
        self._carrier_hz = scene.settings.radio.carrier_hz
        self._antenna = scene.settings.radio.antenna.pattern()
        self._scene = self._build(scene)
        self._solver = self._rt.PathSolver(deterministic=True)
        self._counter = _CountingGenerator(self._solver._candidate_generator)
        self._solver._candidate_generator = self._counter

    def trace(
        self,
        position_m: NDArray[np.float64],
        label: str = "view",
        *,
        receiver_m: NDArray[np.float64] | None = None,
        boresight: NDArray[np.float64] | None = None,
    ) -> ViewPaths:
        """Trace one pair.

        Parameters
        ----------
        position_m
            Transmitter ``[3]``, metres.
        label
            What the view is called in messages.
        receiver_m
            Receiver ``[3]``, metres; None: at the transmitter.
        boresight
            Unit vector ``[3]`` along which both antennas point; needed unless they are omnidirectional.

        Raises
        ------
        DataError
            The cap on paths was reached: paths are missing.
        """
        receiver = position_m if receiver_m is None else receiver_m
        self._scene.get("tx").position = _opaque_point(position_m)
        self._scene.get("rx").position = _opaque_point(receiver)
        window = (
            LaunchWindow.around(self._vertices, position_m)
            if self._settings.launch == "sector"
            else LaunchWindow.sphere()
        )
        ends = [position_m] if np.array_equal(position_m, receiver) else [position_m, receiver]
        key = np.rint(np.concatenate(ends) * 1e6).astype(np.int64)
        random = stream(self._settings.seed, Stream.SPECKLE, *(int(k) for k in key))
        beam = None
        if self._antenna is not None:
            if boresight is None:
                raise ConfigError(f"{label}: antennas with a pattern need a boresight")
            beam = _Beam(self._antenna, position_m, receiver, boresight)
        parts = [self._run(one, window, random, label, beam) for one in self._passes]
        return ViewPaths(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ViewPaths.__dataclass_fields__)
        )

    def _run(
        self, one: _Pass, window: LaunchWindow, random: np.random.Generator, label: str, beam: _Beam | None
    ) -> ViewPaths:
        depth = self._settings.max_depth
        cap = min(self._settings.max_paths, one.rays * depth + 1)  # a ray gives at most one path per interaction
        with _launch_into(window), _buffer_alone():
            found = self._solver(
                self._scene,
                max_depth=depth,
                samples_per_src=one.rays,
                max_num_paths_per_src=cap,
                los=False,
                refraction=False,
                specular_reflection=one.specular,
                diffuse_reflection=one.diffuse,
                diffraction=one.diffraction,
                seed=self._settings.seed,
            )
        if self._counter.found >= cap:
            raise DataError(
                f"{label}: the {one.name} pass met the cap of {cap} paths and would lose some; "
                f"raise ray_tracing.max_paths (now {self._settings.max_paths}) or lower the ray counts"
            )
        return self._gather(found, one, window, random, beam)

    def _gather(
        self, found: Any, one: _Pass, window: LaunchWindow, random: np.random.Generator, beam: _Beam | None
    ) -> ViewPaths:
        """Bring the solver's buffer to NumPy: valid paths only, absolute delays, phases applied in float64."""
        import drjit as dr  # noqa: PLC0415 - only after the backend is chosen

        if found.buffer_size == 0:
            return ViewPaths(
                np.zeros(0, np.complex64), np.zeros(0), np.zeros(0, np.uint8), np.zeros((0, 3), np.float32)
            )
        dr.eval(found.tau, found.a)
        delay = found.tau.numpy().astype(np.float64)
        amplitude = found.a[0][0].real.numpy().astype(np.float64) + 1j * found.a[0][0].imag.numpy()
        kinds = found.interaction_types.numpy().T
        points = np.stack([found.vertices_x.numpy(), found.vertices_y.numpy(), found.vertices_z.numpy()], axis=-1)
        points = points.transpose(1, 0, 2)  # [depth, path, xyz]
        interaction = np.bitwise_or.reduce(kinds.astype(np.uint8), axis=0)
        diffuse = (interaction & INTERACTIONS["diffuse"]) > 0
        keep = found.valid.numpy().astype(bool)
        if one.mixed_only:
            keep &= diffuse & (interaction != INTERACTIONS["diffuse"])
        # The solver's set of paths is deterministic; their order is that in which its threads finish.
        order = np.lexsort((amplitude.imag, amplitude.real, *points[0].T, interaction, delay))
        order = order[keep[order]]
        amplitude, delay, interaction, diffuse = (a[order] for a in (amplitude, delay, interaction, diffuse))
        gain = amplitude * np.exp(-2j * np.pi * self._carrier_hz * delay)
        speckle = np.exp(2j * np.pi * random.random(delay.size))
        gain *= np.where(diffuse, np.sqrt(window.fraction) * speckle, 1.0)
        if beam is not None:
            depth = np.maximum((kinds[:, order] > 0).sum(axis=0) - 1, 0)
            gain *= beam.amplitude(points[0][order], points[depth, order])
        return ViewPaths(gain.astype(np.complex64), delay, interaction, points[0][order].astype(np.float32))

    def _build(self, scene: Scene) -> Any:
        """Make Sionna's scene: objects with materials, one transmitter and one receiver."""
        rt = self._rt
        world = rt.Scene()
        world.frequency = scene.settings.radio.carrier_hz
        world.bandwidth = scene.settings.radio.bandwidth_hz
        with tempfile.TemporaryDirectory(prefix="mvla-") as folder:
            objects = []
            for number, item in enumerate(scene.objects):
                file = Path(folder) / f"{number}.ply"
                item.mesh.export(file)
                objects.append(
                    rt.SceneObject(fname=str(file), name=item.name, radio_material=_material(rt, item, number))
                )
            try:
                world.edit(add=objects)
            except ValueError as error:  # an ITU material outside the frequencies it is defined for
                raise ConfigError(
                    f"{scene.name}: radio.carrier_hz = {scene.settings.radio.carrier_hz:g}: {error}"
                ) from error
        for item in objects:
            _make_opaque(item.radio_material)
        array = rt.PlanarArray(
            num_rows=1, num_cols=1, vertical_spacing=0.5, horizontal_spacing=0.5,
            pattern="iso", polarization=scene.settings.radio.polarization,
        )  # fmt: skip
        world.tx_array = array
        world.rx_array = array
        start = [float(c) for c in scene.views.positions_m[0]]
        world.add(rt.Transmitter("tx", position=start))
        world.add(rt.Receiver("rx", position=start))
        return world


class _CountingGenerator:
    """Wraps the solver's candidate generator to read how many candidates it found: the cap cuts off in silence."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner
        self.found = 0

    def __call__(self, **arguments: Any) -> Any:
        buffer = self._inner(**arguments)
        self.found = int(buffer.paths_counter[0])
        return buffer


@contextlib.contextmanager
def _launch_into(window: LaunchWindow) -> Iterator[None]:
    """Within the block, Sionna's deterministic generator launches its lattice into ``window``."""
    import drjit as dr  # noqa: PLC0415
    import mitsuba as mi  # noqa: PLC0415
    from sionna.rt.path_solvers import sb_deterministic  # noqa: PLC0415

    whole = sb_deterministic.fibonacci_lattice
    x0, width = (dr.opaque(mi.Float, v) for v in (window.x[0], window.x[1] - window.x[0]))
    y0, height = (dr.opaque(mi.Float, v) for v in (window.y[0], window.y[1] - window.y[0]))

    def lattice(count: int) -> Any:
        square = whole(count)
        return mi.Point2f(x0 + square.x * width, y0 + square.y * height)

    sb_deterministic.fibonacci_lattice = lattice
    try:
        yield
    finally:
        sb_deterministic.fibonacci_lattice = whole


@contextlib.contextmanager
def _buffer_alone() -> Iterator[None]:
    """Within the block, the path solver returns its buffer: one entry a path, in no order."""
    from sionna.rt.path_solvers import path_solver  # noqa: PLC0415
    from sionna.rt.path_solvers.paths_buffer import PathsBuffer  # noqa: PLC0415

    whole = path_solver.Paths

    def buffer(*arguments: Any) -> Any:
        return next(one for one in arguments if isinstance(one, PathsBuffer))

    path_solver.Paths = buffer
    try:
        yield
    finally:
        path_solver.Paths = whole


def _opaque_point(position_m: NDArray[np.float64]) -> Any:
    """A point ``[3]`` that enters kernels as data."""
    import drjit as dr  # noqa: PLC0415
    import mitsuba as mi  # noqa: PLC0415

    return mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in position_m))


def _make_opaque(material: Any) -> None:
    """Keep a material's constants out of the kernels, which would be compiled anew for each scene's."""
    import drjit as dr  # noqa: PLC0415
    import mitsuba as mi  # noqa: PLC0415

    for name in (
        "relative_permittivity", "conductivity", "thickness", "scattering_coefficient", "xpd_coefficient",
    ):  # fmt: skip
        setattr(material, name, dr.opaque(mi.Float, float(getattr(material, name)[0])))


def _material(rt: Any, item: SceneObject, number: int) -> Any:
    """Sionna radio material of one object."""
    settings = item.settings
    pattern = settings.scattering_pattern
    surface: dict[str, Any] = {
        "thickness": settings.thickness_m,
        "scattering_coefficient": settings.scattering_coefficient,
        "xpd_coefficient": settings.xpd_coefficient,
        "scattering_pattern": pattern.kind,
    }
    if pattern.kind != "lambertian":
        surface["alpha_r"] = pattern.alpha_r
    if pattern.kind == "backscattering":
        surface |= {"alpha_i": pattern.alpha_i, "lambda_": pattern.lobe_ratio}
    name = f"material-{number}"
    if isinstance(settings.material, CustomMaterial):
        return rt.RadioMaterial(
            name,
            relative_permittivity=settings.material.relative_permittivity,
            conductivity=settings.material.conductivity_s_per_m,
            **surface,
        )
    return rt.ITURadioMaterial(name, settings.material, **surface)
