"""What every object of a scene is: a shape in its place, with a material.

The kinds are in :mod:`mvla_sim.scene.shapes`. Whoever adds one derives it from :class:`Prism` and says where its
corners are, or from :class:`Shape` and makes its meshes.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PositiveFloat
from shapely.geometry.polygon import orient

from mvla_sim.errors import ConfigError
from mvla_sim.kinds import Kind, Kinds
from mvla_sim.scene.material import Material, ScatteringPattern

__all__ = ["SHAPES", "Prism", "Shape", "polar"]

SHAPES: Kinds[Shape] = Kinds("shape", "mvla_sim.shapes", "mvla_sim.scene.shapes", key="shape")
"""All shapes by name."""


class Shape(Kind):
    """What every object of a scene has: place, material and surface.

    A setting called ``file`` is relative to the file of the scene.
    """

    kinds: ClassVar[Kinds[Any]] = SHAPES

    name: Annotated[str, Field(pattern=r"^[A-Za-z][\w-]*$")] | None = Field(
        None, description="of the object; by default that of the shape, numbered"
    )
    position_m: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="where the shape's own origin is put, x, y and z"
    )
    rotation_deg: float = Field(0.0, description="about the vertical axis, counter-clockwise")
    obstacle: bool = Field(False, description="is traced, and is no part of the target: not in the ground truth")
    material: Material = Field("metal", description="ITU-R P.2040 name, or permittivity and conductivity")
    thickness_m: PositiveFloat = Field(0.1, description="of the material, which decides how much passes through")
    scattering_coefficient: Annotated[
        float, Field(ge=0, le=1, description="share of the reflected field's amplitude that is scattered diffusely")
    ] = 0.1
    scattering_pattern: ScatteringPattern = ScatteringPattern()
    xpd_coefficient: Annotated[
        float, Field(ge=0, le=1, description="share of scattered power that changes polarization")
    ] = 0.0

    def own_parts(self, key: str = "object") -> dict[str, trimesh.Trimesh]:
        """Meshes in the object's own frame, metres, a new one at each call; each kind of shape has its own.

        Parameters
        ----------
        key
            What the object is called in messages, for example ``objects[0]``.

        Returns
        -------
        dict of str to trimesh.Trimesh
            By the part's name, which is empty where the object is one part. Vertices ``[n_vertex, 3]`` metres, faces
            ``[n_face, 3]``, normals outwards; neither textures nor colours.

        Raises
        ------
        ConfigError
            A polygon that is not simple.
        DataError
            A mesh file that is missing, of an unknown format, broken, empty, or of an implausible size.
        """
        raise NotImplementedError

    @property
    def nominal_extent_m(self) -> float | None:
        """Extent D that the paper gives the shape: diameter or side, metres; None where the paper gives none."""
        return None

    def part(self, name: str) -> Self:
        """Settings of a part: the object's, with the part's own material where it has one."""
        del name
        return self

    def parts(self, key: str = "object") -> dict[str, trimesh.Trimesh]:
        """Meshes in the world: those of :meth:`own_parts` turned about the vertical axis, then placed."""
        parts = self.own_parts(key)
        turn = trimesh.transformations.rotation_matrix(math.radians(self.rotation_deg), [0, 0, 1])
        turn[:3, 3] = self.position_m
        for mesh in parts.values():
            mesh.apply_transform(turn)
        return parts

    def mesh(self, key: str = "object") -> trimesh.Trimesh:
        """All of :meth:`parts` as one mesh."""
        return trimesh.util.concatenate(list(self.parts(key).values()))


class Prism(Shape):
    """A vertical prism over an outline, centred on its position."""

    height_m: PositiveFloat = Field(2.0, description="from bottom to top")

    def corners(self) -> ArrayLike:
        """Corners of the outline in order, in either sense, ``[n_corner, 2]`` metres; each kind has its own."""
        raise NotImplementedError

    def outline(self, key: str = "object") -> shapely.Polygon:
        """Outline in the object's own frame, before rotation and placement; counter-clockwise, (x, y) in metres.

        Parameters
        ----------
        key
            What the object is called in messages.

        Raises
        ------
        ConfigError
            It crosses itself, touches itself or has no area.
        """
        shape = shapely.Polygon(np.asarray(self.corners(), np.float64))
        if not shape.is_valid:
            raise ConfigError(f"{key}.vertices_m: is not a simple polygon: {shapely.is_valid_reason(shape)}")
        if shape.area <= 1e-9 * shape.length**2:  # collinear but for rounding; a useful target is never that thin
            raise ConfigError(f"{key}.vertices_m: the polygon's area is {shape.area:g} m²; it must enclose an area")
        return shapely.remove_repeated_points(orient(shape))

    def own_parts(self, key: str = "object") -> dict[str, trimesh.Trimesh]:
        """Closed prism over the outline, from -height/2 to height/2, normals outwards.

        Notes
        -----
        The caps are Delaunay triangles. Cutting ears, as is usual, leaves triangles of no area between vertices on one
        line, as a star has them; their normals are noise, and each of their edges would diffract.
        """
        shape = self.outline(key)
        ring = shapely.get_coordinates(shape.exterior)[:-1]
        count = len(ring)
        index = {tuple(point): place for place, point in enumerate(ring.tolist())}
        triangles = [orient(part) for part in shapely.constrained_delaunay_triangles(shape).geoms]
        corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
        bottom = np.array([index[tuple(point)] for point in corners.reshape(-1, 2).tolist()]).reshape(-1, 3)
        here = np.arange(count)
        after = (here + 1) % count
        walls = [np.stack([here, after, after + count], axis=1), np.stack([here, after + count, here + count], axis=1)]
        heights = np.repeat([-self.height_m / 2, self.height_m / 2], count)
        vertices = np.column_stack([np.tile(ring, (2, 1)), heights])
        faces = np.concatenate([bottom[:, ::-1], bottom + count, *walls])
        return {"": trimesh.Trimesh(vertices, faces, process=False)}


def polar(radii: NDArray[np.float64] | float, angles_deg: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Points (x, y) at radii and at angles from +x counter-clockwise, ``[n, 2]``."""
    angles = np.deg2rad(angles_deg)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)
