"""Diffraction at the edges of a scene in closed form, as Sionna RT has it: what of a gain is reflection at the faces.

The tracer keeps a diffracted path's gain alone. It is a sum: what the uniform theory of diffraction makes of the faces'
reflection, which falls as they scatter more, and what it makes of the shadow boundary, which does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import INTERACTIONS, Cir
from mvla_sim.constants import SPEED_OF_LIGHT
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.material import ITU_CONSTANTS, CustomMaterial, Material
from mvla_sim.scene.radio import RadioSettings
from mvla_sim.scene.world import Scene

__all__ = ["DiffractedGain", "diffracted_gain", "permittivity"]

Vectors = NDArray[np.float64]
Numbers = NDArray[np.complex128]

_AT_ONCE: Final = 1_000_000  # distances between points and edges
_ON_EDGE_M: Final = 1e-3  # points are float32, metres
_FLAT: Final = 1e-6  # sine of the angle between faces that are one plane
_POLE: Final = 1e-9  # sine of the cotangent's argument
_VACUUM_PERMITTIVITY: Final = 8.8541878128e-12


@dataclass(frozen=True, eq=False)
class DiffractedGain:
    """Gains of the paths diffracted once, ``reflected``·√(1 − S²) + ``fixed``, ``[n]`` complex128 each.

    ``paths`` are their places in the channel, ``[n]``.
    """

    paths: NDArray[np.intp]
    reflected: Numbers
    fixed: Numbers


def permittivity(material: Material, carrier_hz: float) -> complex:
    """Relative permittivity of a material, losses included: ε_r − jσ/(2πf·ε_0) (ITU-R P.2040-4).

    Raises
    ------
    ConfigError
        The recommendation does not give the material at this frequency.
    """
    if isinstance(material, CustomMaterial):
        real, conductivity = material.relative_permittivity, material.conductivity_s_per_m
    else:
        ghz = carrier_hz / 1e9
        found = [row for low, high, *row in ITU_CONSTANTS[material] if low <= ghz <= high]
        if not found:
            raise ConfigError(f"material = '{material}': ITU-R P.2040 does not give it at {ghz:g} GHz")
        a, b, c, d = found[0]
        real, conductivity = a * ghz**b, c * ghz**d
    return complex(real, -conductivity / (2 * np.pi * carrier_hz * _VACUUM_PERMITTIVITY))


def diffracted_gain(cir: Cir, scene: Scene) -> DiffractedGain:
    """Split the gains of all paths that are one diffraction, from the scene that they were traced in.

    Raises
    ------
    DataError
        A path begins at no edge of the scene.

    Notes
    -----
    Sionna RT 2 follows Kouyoumjian and Pathak's UTD with Holm's coefficients for faces that are no perfect conductors:
    D = R_0(D_1 − D_4) + R_n(D_2 − D_3), R_0 and R_n the slab's Fresnel coefficients times √(1 − S²), and R_n = −1 where
    the edge's n-face is in shadow.
    """
    paths = np.flatnonzero(cir.interaction == INTERACTIONS["diffraction"])
    views = np.searchsorted(cir.row_start, paths, side="right") - 1
    point = cir.first_point_m[paths].astype(np.float64)
    source = cir.views.positions_m[views]
    target = source if cir.views.receivers_m is None else cir.views.receivers_m[views]
    edges = _Edges.of(scene)
    near, away = _nearest(point, edges)
    if not (away < _ON_EDGE_M).all():
        raise DataError(f"view {views[away.argmax()]}: a diffracted path is {away.max():.3g} m off every edge")
    reflected, fixed = _wedge(point, source, target, edges.take(near), scene.settings.radio)
    scale = np.exp(-2j * np.pi * cir.carrier_hz * cir.delay_s[paths])
    pattern = scene.settings.radio.antenna.pattern()
    if pattern is not None:
        ahead = cir.views.directions[views]
        scale = scale * pattern.amplitude(point - source, ahead) * pattern.amplitude(point - target, ahead)
    return DiffractedGain(paths, reflected * scale, fixed * scale)


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges between two faces: both ends, both normals and a point of both faces, ``[n, 2, 3]``; their material."""

    ends: Vectors
    normals: Vectors
    middles: Vectors
    permittivity: Numbers
    thickness_m: Vectors

    @classmethod
    def of(cls, scene: Scene) -> _Edges:
        """The edges of every object."""
        parts: list[tuple[NDArray[np.generic], ...]] = []
        for item in scene.objects:
            mesh = item.mesh
            pairs = mesh.face_adjacency
            normals = mesh.face_normals[pairs]
            sharp = np.linalg.norm(np.cross(normals[:, 0], normals[:, 1]), axis=1) > _FLAT
            sharp |= (normals[:, 0] * normals[:, 1]).sum(axis=1) < 0
            count = int(sharp.sum())
            parts.append((
                mesh.vertices[mesh.face_adjacency_edges[sharp]], normals[sharp], mesh.triangles_center[pairs[sharp]],
                np.full(count, permittivity(item.settings.material, scene.settings.radio.carrier_hz)),
                np.full(count, item.settings.thickness_m),
            ))  # fmt: skip
        return cls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    def take(self, which: NDArray[np.intp]) -> _Edges:
        """Edges by number, ``[k]``."""
        return _Edges(*(getattr(self, name)[which] for name in _Edges.__dataclass_fields__))


def _nearest(points: Vectors, edges: _Edges) -> tuple[NDArray[np.intp], Vectors]:
    """Number of the edge that each point ``[n, 3]`` is on, and how far it is off, metres."""
    start, along = edges.ends[:, 0], edges.ends[:, 1] - edges.ends[:, 0]
    squared = (along**2).sum(axis=1)
    found, away = np.empty(len(points), np.intp), np.full(len(points), np.inf)
    step = max(1, _AT_ONCE // max(1, len(start)))
    for first in range(0, len(points) if len(start) else 0, step):
        offset = points[first : first + step, None] - start
        share = np.clip((offset * along).sum(axis=2) / squared, 0, 1)
        distance = np.linalg.norm(offset - share[:, :, None] * along, axis=2)
        found[first : first + step] = distance.argmin(axis=1)
        away[first : first + step] = distance.min(axis=1)
    return found, away


def _wedge(
    point: Vectors, source: Vectors, target: Vectors, edge: _Edges, radio: RadioSettings
) -> tuple[Numbers, Numbers]:
    """Both parts of the amplitude of ``[n]`` paths over their edges, without antennas and the carrier's phase."""
    k_in, before = _unit(point - source)
    k_out, after = _unit(target - point)
    wavelength = SPEED_OF_LIGHT / radio.carrier_hz
    wavenumber = 2 * np.pi / wavelength
    n0, nn, e = _oriented(edge, k_in)
    sine = np.linalg.norm(np.cross(k_in, e), axis=1)
    exterior = 2 * np.pi - np.arccos(np.clip(-_dot(n0, nn), -1, 1))
    tangent = _unit(np.cross(n0, e))[0]
    phi_in, phi_out = (_angle(_unit(v - _dot(v, e)[:, None] * e)[0], tangent, n0) for v in (-k_in, k_out))
    length = wavenumber * before * after / (before + after) * sine**2
    d1, d2, d3, d4 = (
        _cot_times_transition(angle, sign, exterior, length)
        for angle in (phi_out - phi_in, phi_out + phi_in)
        for sign in (1, -1)
    )
    common = -np.exp(-0.25j * np.pi) / (2 * exterior / np.pi * np.sqrt(2 * np.pi * wavenumber) * sine)
    common = common * wavelength / (4 * np.pi) / np.sqrt(before * after * (before + after))
    lit = (exterior <= np.pi + phi_in)[:, None, None]
    d14, d23 = (d1 - d4)[:, None, None], (d2 - d3)[:, None, None]
    bases = [_unit(np.cross(k, e))[0] for k in (k_in, k_out)]
    faces = _reflection(k_in, n0, e, edge, wavelength) * d14
    faces = faces + np.where(lit, _reflection(k_in, nn, e, edge, wavelength) * d23, 0)
    shadow = np.where(lit, 0, -np.eye(2) * d23)
    sent = _rotation(k_in, _vertical(k_in), bases[0])
    received = _rotation(k_out, -bases[1], _vertical(k_out))
    index, sign = (0, 1) if radio.polarization == "V" else (1, -1)
    reflected, fixed = (sign * common * (received @ part @ sent)[:, index, index] for part in (faces, shadow))
    return reflected, fixed


def _oriented(edge: _Edges, k_in: Vectors) -> tuple[Vectors, Vectors, Vectors]:
    """Normals of the 0-face, which the wave comes to, and of the n-face, and the direction of the edge, ``[n, 3]``.

    The wedge is the smaller of the two between the faces; normal and edge of the 0-face span its inside.
    """
    corner = edge.ends[:, 0]
    outwards = []
    for one, other in ((0, 1), (1, 0)):
        inwards = _dot(edge.normals[:, one], edge.middles[:, other] - corner) > _ON_EDGE_M * _FLAT
        outwards.append(np.where(inwards[:, None], -edge.normals[:, one], edge.normals[:, one]))
    swap = (_dot(k_in, outwards[0]) > 0)[:, None]
    n0, nn = np.where(swap, outwards[1], outwards[0]), np.where(swap, outwards[0], outwards[1])
    middle = np.where(swap, edge.middles[:, 1], edge.middles[:, 0])
    n0 = np.where((_dot(k_in, n0) > 0)[:, None], -n0, n0)
    e = _unit(edge.ends[:, 1] - corner)[0]
    e = np.where((_dot(np.cross(n0, e), middle - corner) < 0)[:, None], -e, e)
    return n0, nn, e


def _angle(v: Vectors, tangent: Vectors, normal: Vectors) -> Vectors:
    """Angle of unit vectors across the edge from the 0-face, ``[n]``, 0 to 2π."""
    angle = np.arccos(np.clip(_dot(v, tangent), -1, 1))
    return np.where(_dot(v, normal) >= 0, angle, 2 * np.pi - angle)


def _cot_times_transition(beta: Vectors, sign: int, exterior: Vectors, length: Vectors) -> Numbers:
    """cot((π ± β)/(2n))·F(kL·a±(β)), with its finite limit where both factors have none."""
    from scipy.special import fresnel  # noqa: PLC0415 - what no other command would import

    n = exterior / np.pi
    psi = (np.pi + sign * beta) / (2 * n)
    turns = np.round((beta + sign * np.pi) / (2 * exterior))
    root = np.sqrt(2 * length) * np.abs(np.cos(exterior * turns - beta / 2))
    s, c = fresnel(root * np.sqrt(2 / np.pi))
    slope = np.sqrt(np.pi / 2) * np.exp(1j * root**2) * (1 + 1j - 2j * (c - 1j * s))  # F(x)/√x
    sine = np.sin(psi)
    pole = np.abs(sine) < _POLE
    quotient = root / np.where(pole, 1, sine)
    limit = np.where(sine >= 0, 1, -1) * n * np.sqrt(2 * length)
    return np.asarray(np.cos(psi) * np.where(pole, limit, quotient) * slope, np.complex128)


def _reflection(k: Vectors, normal: Vectors, e: Vectors, edge: _Edges, wavelength: float) -> Numbers:
    """Fresnel reflection of a slab between the edge's bases of polarization, ``[n, 2, 2]``."""
    across = _dot(k, normal)
    cosine = np.abs(across)
    a = np.sqrt(edge.permittivity - (1 - cosine**2))
    decay = np.exp(-4j * np.pi / wavelength * edge.thickness_m * a)
    slab = np.zeros((len(k), 2, 2), np.complex128)
    for index, factor in enumerate((1, edge.permittivity)):
        r = (factor * cosine - a) / (factor * cosine + a)
        slab[:, index, index] = r * (1 - decay) / (1 - r**2 * decay)
    boundary = _unit(k - 2 * across[:, None] * normal)[0]
    plane = np.cross(k, normal)
    head_on = (_dot(plane, plane) < 1e-12)[:, None]  # any transverse direction will do
    plane = _unit(np.where(head_on, _any_across(k), plane))[0]
    into = _rotation(k, _unit(np.cross(k, e))[0], plane)
    out = _rotation(boundary, plane, -_unit(np.cross(boundary, e))[0])
    return np.asarray(out @ slab @ into, np.complex128)


def _any_across(k: Vectors) -> Vectors:
    """A vector across each of ``k``: that of the x axis, or of the y axis along x."""
    axis = np.where(np.abs(k[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    return np.asarray(axis - _dot(axis, k)[:, None] * k, np.float64)


def _vertical(k: Vectors) -> Vectors:
    """Unit vector θ of spherical coordinates at directions ``[n, 3]``; along z that of −x."""
    flat = np.hypot(k[:, 0], k[:, 1])
    steep = np.abs(k[:, 2]) > 1 - 5e-7
    safe = np.where(steep, 1, flat)
    theta = np.stack([k[:, 2] * k[:, 0] / safe, k[:, 2] * k[:, 1] / safe, -flat], axis=1)
    upright = np.array([-1.0, 0.0, 0.0]) + k[:, :1] * k
    return _unit(np.where(steep[:, None], upright, theta))[0]


def _rotation(k: Vectors, current: Vectors, wanted: Vectors) -> Vectors:
    """From one basis of polarization across ``k`` to another, each by its first vector, ``[n, 2, 2]``."""
    c, s = _dot(current, wanted), _dot(k, np.cross(current, wanted))
    return np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)


def _dot(one: Vectors, other: Vectors) -> Vectors:
    return np.asarray((one * other).sum(axis=-1), np.float64)


def _unit(vectors: Vectors) -> tuple[Vectors, Vectors]:
    """Vectors ``[n, 3]`` of length 1, and the lengths that they had."""
    lengths = np.linalg.norm(vectors, axis=-1)
    return vectors / lengths[:, None], lengths
