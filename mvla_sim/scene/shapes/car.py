"""A car as closed meshes, one a part: sheet metal, glass, wheels and mirrors, in proportion to its size.

Every part is lofted: rings of points, alike in number and order, are joined by walls and closed by two caps. The tables
below are metres of a car of the default size; lengths, breadths and heights scale with the car's own.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Final, Literal

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from mvla_sim.scene.material import CustomMaterial, Material
from mvla_sim.scene.shape import Shape

__all__ = ["RUBBER", "Car"]

SIZE_M: Final = (4.22, 1.76, 1.60)
"""Length, width and height of the car that the tables describe."""

AXLES: Final = (1.30, -1.28)
"""Where the front and the rear axle are along x."""
WHEEL_RADIUS: Final = 0.335
WHEEL_SIDES: Final = 12
WHEEL_WIDTH: Final = 0.21
WHEEL_INSET: Final = 0.015
"""From the car's side to a wheel's outer face."""

LEVELS: Final = (0.20, 0.42, 0.70, 1.00)
"""Heights of the body's rings below the top one: underside, bumpers, foot and head of the upright panels."""
SHOULDER: Final = 0.03
"""Least height of the body's top above the panels' head."""
BREADTH: Final = ((0.20, 0.42, 0.70), (0.92, 0.975, 1.0))
"""Half-breadth of the body at a height, as a share of half the car's width; upright from there on."""
TOP_INSET: Final = 0.045
"""How far the top ring is inside the panels."""
BACK: Final = ((0.10, 0.0, 0.05, 0.05, 0.12), (0.12, 0.0, 0.09, 0.09, 0.15))
"""How far each ring stays behind the bumper, at the front and at the rear."""
ARCH_STEP: Final = 0.04
"""Least height between two rings, where a wheel arch presses them together."""

NOSE: Final = ((2.11, 0.52, 0.22, 0.95), (2.04, 0.74, 0.22, 0.955), (1.90, 0.90, 0.22, 0.965))
TAIL: Final = ((-1.92, 0.90, 0.24, 1.05), (-2.05, 0.76, 0.24, 1.05), (-2.11, 0.55, 0.24, 1.05))
"""Stations of the body: x, share of the half-breadth, underside, top."""
ARCH: Final = ((0.42, 0.20), (0.25, 0.70), (-0.25, 0.70), (-0.42, 0.20))
"""Outline of a wheel arch: x from the axle and underside, for the wheel of the tables."""
ARCH_SHARES: Final = ((0.965, 0.985, 1.0, 1.0), (1.0, 1.0, 0.985, 0.965))
ARCH_TOPS: Final = ((0.975, 0.99, 1.02, 1.04), (1.06, 1.06, 1.06, 1.06))
"""Share of the half-breadth, and top, at the stations of the front and of the rear arch."""

CABIN_HEIGHTS: Final = (1.00, 1.50)
"""Foot and head of the cabin: inside the body, and inside the roof."""
CABIN: Final = (
    ((0.98, 0.50), (0.86, 0.68), (0.30, 0.78), (-1.20, 0.78), (-1.83, 0.68), (-1.96, 0.50)),
    ((0.22, 0.46), (0.14, 0.56), (-0.10, 0.64), (-1.15, 0.64), (-1.58, 0.56), (-1.66, 0.46)),
)
ROOF: Final = (
    ((0.29, 0.48, 1.46), (0.21, 0.59, 1.46), (-0.10, 0.66, 1.46), (-1.15, 0.66, 1.46), (-1.63, 0.59, 1.46),
     (-1.72, 0.48, 1.46)),
    ((0.25, 0.47, 1.51), (0.17, 0.57, 1.52), (-0.12, 0.64, 1.53), (-1.15, 0.64, 1.53), (-1.61, 0.57, 1.53),
     (-1.71, 0.47, 1.53)),
    ((0.00, 0.38, 1.56), (-0.10, 0.46, 1.57), (-0.32, 0.52, 1.60), (-1.10, 0.52, 1.60), (-1.48, 0.46, 1.585),
     (-1.62, 0.38, 1.575)),
)  # fmt: skip
"""Left half of each ring from front to rear: x and y, with the roof's height."""

MIRROR_AT: Final = (0.72, 1.02)
MIRROR: Final = ((-0.03, 0.045, 0.05), (0.12, 0.055, 0.075))
"""Where the mirrors are, x and z; y beyond the car's side and half the size along x and z of a mirror's two ends."""

METAL: Final = ("body", "roof", "mirror-left", "mirror-right")


RUBBER: Final = CustomMaterial(relative_permittivity=4.0, conductivity_s_per_m=0.8)
"""Round figures, not measured ones: rubber filled with carbon black, with a loss tangent of 0.1 at 36 GHz."""


class Car(Shape):
    """A car that stands on its position, front towards +x; ``material`` is that of its sheet metal."""

    shape: Literal["car"] = "car"
    length_m: Annotated[float, Field(ge=3, le=6, description="bumper to bumper")] = 4.22
    width_m: Annotated[float, Field(ge=1.4, le=2.4, description="without the mirrors")] = 1.76
    height_m: Annotated[float, Field(ge=1.2, le=2.4, description="road to roof")] = 1.60
    glass: Material = Field("glass", description="material of the windows")
    glass_thickness_m: Annotated[float, Field(gt=0, le=0.1, description="of the windows")] = 0.005
    tyres: Material = Field(RUBBER, description="material of the tyres")

    def own_parts(self, key: str = "object") -> dict[str, trimesh.Trimesh]:
        """Meshes of the parts: front towards +x, standing on z = 0, the car's middle at x = y = 0.

        Parameters
        ----------
        key
            Not used.

        Returns
        -------
        dict of str to trimesh.Trimesh
            By name: ``body``, ``cabin`` (its windows), ``roof``, ``wheel-front-left`` and three more, ``mirror-left``
            and ``mirror-right``. Each is closed, with normals outwards; vertices in metres. All but the mirrors fill
            the box length × width × height exactly.

        Notes
        -----
        Parts reach into each other, so that no two faces lie in one place: the cabin's foot is inside the body, its
        head inside the roof. The doors are upright from 0.70 to 1.00 m (at the default height) and flat between the
        wheels. Wheels keep round: they scale with the smaller of the car's length and height.

        Examples
        --------
        >>> [round(float(side), 3) for side in Car().own_parts()["body"].extents]
        [4.22, 1.76, 0.86]
        """
        del key
        scale = np.array([self.length_m, self.width_m, self.height_m]) / SIZE_M
        wheel_scale = float(min(scale[0], scale[2]))
        cabin = [np.column_stack([r, [z] * len(r)]) for r, z in zip(CABIN, CABIN_HEIGHTS, strict=True)]
        parts = {"body": _loft(_body(scale, wheel_scale)), "cabin": _loft(_rings(cabin)), "roof": _loft(_rings(ROOF))}
        for part in ("cabin", "roof"):
            parts[part].vertices *= scale
        half_width = self.width_m / 2
        for end, axle in zip(("front", "rear"), AXLES, strict=True):
            left = _loft(_wheel(axle * scale[0], half_width, wheel_scale))
            parts |= {f"wheel-{end}-left": left, f"wheel-{end}-right": _mirrored(left)}
        left = _loft(_mirror(MIRROR_AT[0] * scale[0], half_width, MIRROR_AT[1] * scale[2]))
        return parts | {"mirror-left": left, "mirror-right": _mirrored(left)}

    def part(self, name: str) -> Car:
        """Settings of a part: the car's, with the material and thickness of that part."""
        if name == "cabin":
            return self.model_copy(update={"material": self.glass, "thickness_m": self.glass_thickness_m})
        return self if name in METAL else self.model_copy(update={"material": self.tyres})


def _body(scale: NDArray[np.float64], wheel_scale: float) -> NDArray[np.float64]:
    """Rings ``[5, 28, 3]`` of the body in metres, from the underside up, open where the wheels are."""
    stations: list[tuple[float, ...]] = list(NOSE)
    for axle, shares, tops in zip(AXLES, ARCH_SHARES, ARCH_TOPS, strict=True):
        # An arch scales with its wheel, and the body with the car: seen in the tables' metres the arch shrinks.
        along, up = wheel_scale / scale[[0, 2]]
        stations += [
            (axle + offset * along, share, max(LEVELS[0], low * up), top)
            for (offset, low), share, top in zip(ARCH, shares, tops, strict=True)
        ]
    x, share, low, top = np.array([*stations, *TAIL]).T
    middle = [np.maximum(level, low + ARCH_STEP * (1 + k)) for k, level in enumerate(LEVELS[1:-1])]
    heights = [low, *middle, np.minimum(LEVELS[-1], top - SHOULDER), top]
    rings = []
    for height, front, rear in zip(heights, *BACK, strict=True):
        back = np.zeros(len(x))
        back[: len(NOSE)] = -front
        back[-len(TAIL) :] = rear
        half = share * np.interp(height, *BREADTH) * (SIZE_M[1] / 2)
        rings.append(np.column_stack([x + back, half, height]))
    rings[-1][:, 1] -= TOP_INSET
    return _rings(rings) * scale


def _wheel(x: float, side: float, scale: float) -> NDArray[np.float64]:
    """Rings ``[2, 12, 3]`` of the wheel on the left, standing on one of its flats."""
    angles = (np.arange(WHEEL_SIDES) + 0.5) * (2 * math.pi / WHEEL_SIDES)
    radius = WHEEL_RADIUS * scale
    along, up = x + radius * np.sin(angles), radius * np.cos(angles)
    outer = side - WHEEL_INSET
    faces = (outer - WHEEL_WIDTH, outer)
    return np.stack([np.column_stack([along, np.full(WHEEL_SIDES, y), up - up.min()]) for y in faces])


def _mirror(x: float, side: float, z: float) -> NDArray[np.float64]:
    """Rings ``[2, 4, 3]`` of the mirror on the left, its foot inside the door."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])  # z, x
    rings = [
        np.column_stack([x + along * corners[:, 1], np.full(4, side + beyond), z + up * corners[:, 0]])
        for beyond, along, up in MIRROR
    ]
    return np.stack(rings)


def _rings(halves: Any) -> NDArray[np.float64]:
    """Closed rings ``[n_ring, 2·n, 3]`` from their left halves ``[n_ring, n, 3]``, given from front to rear."""
    left = np.asarray(halves, np.float64)
    return np.concatenate([left, left[:, ::-1] * [1.0, -1.0, 1.0]], axis=1)


def _loft(rings: NDArray[np.float64]) -> trimesh.Trimesh:
    """Closed mesh over rings ``[n_ring, 2·n, 3]``, counter-clockwise as seen from the last one's side.

    Point k of a ring and point 2·n − 1 − k face each other; the caps are strips between the two. Quadrilaterals are cut
    so that a ring that is mirror-symmetric in these pairs yields a mirror-symmetric mesh.
    """
    count, around = rings.shape[:2]
    here = np.arange(around)
    faces: list[ArrayLike] = []
    for ring in range(count - 1):
        a, b = here + ring * around, (here + 1) % around + ring * around
        c, d = b + around, a + around
        first = here < around // 2
        faces += [
            np.where(first[:, None], np.column_stack([a, b, c]), np.column_stack([a, b, d])),
            np.where(first[:, None], np.column_stack([a, c, d]), np.column_stack([b, c, d])),
        ]
    left = np.arange(around // 2 - 1)
    right = around - 1 - left
    cap = np.concatenate([np.column_stack([left, left + 1, right - 1]), np.column_stack([left, right - 1, right])])
    faces += [cap[:, ::-1], cap + (count - 1) * around]
    return trimesh.Trimesh(rings.reshape(-1, 3), np.concatenate(faces), process=False)


def _mirrored(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same part on the other side of the car, normals still outwards."""
    return trimesh.Trimesh(mesh.vertices * [1.0, -1.0, 1.0], mesh.faces[:, ::-1], process=False)
