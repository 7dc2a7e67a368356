"""Families of random objects: each draws shapes of its kind, whose numbers are fixed, uniform or chosen from a list."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mvla_sim.distributions import DECIMALS, Drawn, Real, TextChoice, Weight, Whole, bounded, draw
from mvla_sim.scene.material import ItuMaterial
from mvla_sim.scene.shape import Prism
from mvla_sim.scene.shapes.cylinder import Cylinder
from mvla_sim.scene.shapes.polygon import Polygon
from mvla_sim.scene.shapes.rectangle import Rectangle
from mvla_sim.scene.shapes.square import Square
from mvla_sim.scene.shapes.star import Star
from mvla_sim.scene.shapes.triangle import Triangle
from mvla_sim.settings import Settings

__all__ = ["FamilySettings", "Name", "random_polygon", "smooth_outline"]

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w-]*$", max_length=80)]

Vertices = NDArray[np.float64]

NARROWEST: Final = 0.25
"""Least angle between neighbouring corners, relative to that of a regular polygon."""


class MaterialChoice(TextChoice):
    """One of the materials listed."""

    choices: Annotated[tuple[ItuMaterial, ...], Field(min_length=1)]


class Family(Settings):
    """What every family has: how often it is drawn, and size, place and surface of its objects.

    All objects of a sample are of one family, and each is drawn on its own. ``size_m`` is the paper's extent D where it
    gives one: diameter, side of square or triangle; of a rectangle the length, of the others the diameter of the
    circle about the object's centre that its outermost point lies on.
    """

    name: Name = Field(description="of the family")
    weight: Weight = Field(1.0, description="how often the family is drawn, relative to the others")
    objects: Annotated[Whole, bounded(least=1, most=100)] = Field(1, description="objects of a sample")
    size_m: Annotated[Real, bounded(least=0.001)] = Field(description="extent of an object: diameter, side or length")
    x_m: Real = Field(0.0, description="of an object's centre, from the middle of the grid")
    y_m: Real = Field(0.0, description="of an object's centre, from the middle of the grid")
    rotation_deg: Real = Field(0.0, description="about the vertical axis, counter-clockwise")
    height_m: Annotated[Real, bounded(above=0)] = Field(2.0, description="from bottom to top")
    material: Annotated[ItuMaterial, Drawn(MaterialChoice)] = Field("metal", description="ITU-R P.2040 names")
    scattering_coefficient: Annotated[Real, bounded(least=0, most=1)] = Field(
        0.1, description="share of the reflected field's amplitude that is scattered diffusely"
    )

    makes: ClassVar[type[Prism]]
    """The shape of its objects."""

    def drawn(self, random: np.random.Generator) -> Prism:
        """Draw an object of the family, without its place."""
        size_m = draw(self.size_m, random)
        return self.makes(
            **self.form(size_m, random),
            height_m=draw(self.height_m, random),
            material=draw(self.material, random),
            scattering_coefficient=draw(self.scattering_coefficient, random),
        )

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """Draw what the shape has beside its height and surface."""
        raise NotImplementedError


class CircleFamily(Family):
    """Cylinders."""

    makes: ClassVar = Cylinder
    shape: Literal["circle"]
    facets: Annotated[int, Field(ge=3, le=10_000, description="flat sides that stand for the round one")] = 360

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """The diameter is the size."""
        del random
        return {"radius_m": size_m / 2, "facets": self.facets}


class SquareFamily(Family):
    """Squares."""

    makes: ClassVar = Square
    shape: Literal["square"]

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """The side is the size."""
        del random
        return {"side_m": size_m}


class RectangleFamily(Family):
    """Rectangles."""

    makes: ClassVar = Rectangle
    shape: Literal["rectangle"]
    aspect: Annotated[Real, bounded(above=0, most=1)] = Field(description="width over length")

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """The length is the size."""
        return {"length_m": size_m, "width_m": _rounded(size_m * draw(self.aspect, random))}


class TriangleFamily(Family):
    """Equilateral triangles."""

    makes: ClassVar = Triangle
    shape: Literal["triangle"]

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """The side is the size."""
        del random
        return {"altitude_m": _rounded(size_m * math.sqrt(3) / 2)}


class StarFamily(Family):
    """Star polygons."""

    makes: ClassVar = Star
    shape: Literal["star"]
    points: Annotated[Whole, bounded(least=3, most=100)] = Field(5, description="number of tips")
    inner_ratio: Annotated[Real, bounded(above=0, below=1)] = Field(description="inner over outer radius")

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """The outer diameter is the size."""
        points, ratio = draw(self.points, random), draw(self.inner_ratio, random)
        return {"points": points, "radius_m": size_m / 2, "inner_radius_m": _rounded(size_m / 2 * ratio)}


class PolygonFamily(Family):
    """Random simple polygons: corners in rising direction about the centre, at random directions and radii."""

    makes: ClassVar = Polygon
    shape: Literal["polygon"]
    corners: Annotated[Whole, bounded(least=3, most=100)] = Field(6, description="number of corners")
    roughness: Annotated[Real, bounded(least=0, most=0.95)] = Field(
        0.5, description="radii of the corners are uniform between 1 - roughness and 1 times the largest"
    )

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """The outermost corner is at half the size."""
        corners, roughness = draw(self.corners, random), draw(self.roughness, random)
        return _vertices(size_m, random_polygon(random, corners, roughness))


class SmoothFamily(Family):
    """Random smooth closed outlines: a circle whose radius is modulated by a few random Fourier terms."""

    makes: ClassVar = Polygon
    shape: Literal["smooth"]
    harmonics: Annotated[Whole, bounded(least=2, most=20)] = Field(4, description="highest Fourier term; terms from 2")
    roughness: Annotated[Real, bounded(least=0, most=0.95)] = Field(
        0.5, description="the terms' amplitudes add up to this share of the mean radius"
    )
    facets: Annotated[int, Field(ge=12, le=2000, description="flat sides that stand for the smooth outline")] = 120

    def form(self, size_m: float, random: np.random.Generator) -> dict[str, Any]:
        """The outermost point is at half the size."""
        harmonics, roughness = draw(self.harmonics, random), draw(self.roughness, random)
        return _vertices(size_m, smooth_outline(random, harmonics, roughness, self.facets))


FamilySettings = Annotated[
    CircleFamily | SquareFamily | RectangleFamily | TriangleFamily | StarFamily | PolygonFamily | SmoothFamily,
    Field(discriminator="shape"),
]


def random_polygon(random: np.random.Generator, corners: int, roughness: float) -> Vertices:
    """Corners of a random simple polygon, counter-clockwise, ``[corners, 2]``; the outermost lies on the unit circle.

    Radii are uniform between 1 − roughness and 1, and then scaled until the largest is 1. The corners, at least 3, are
    in rising direction about the centre, and no two are half a turn or more apart, so the centre sees all of the
    outline and no side crosses another.
    """
    share = _steps(random, corners)
    angles = 2 * np.pi * (random.random() + np.concatenate([[0.0], np.cumsum(share)[:-1]]))
    radii = np.asarray(1 - roughness * random.random(corners), np.float64)
    return _around(radii / radii.max(), angles)


def smooth_outline(random: np.random.Generator, harmonics: int, roughness: float, facets: int) -> Vertices:
    """Points on a random smooth closed curve, counter-clockwise, ``[facets, 2]``; the outermost at a radius of 1.

    r(θ) ∝ 1 + Σ_k a_k·cos(kθ + φ_k) for k = 2 … ``harmonics``, a_k uniform times 1/k, so that coarse features prevail.
    The first term is left out: it would move the curve sideways. The amplitudes add up to ``roughness``, which is below
    1, so that the radius stays above 0.
    """
    order = np.arange(2, harmonics + 1)
    amplitude = (0.1 + 0.9 * random.random(order.size)) / order
    amplitude *= roughness / amplitude.sum()
    phase = 2 * np.pi * random.random(order.size)
    angles = np.asarray(2 * np.pi / facets * np.arange(facets), np.float64)
    radii = np.asarray(1 + np.cos(order[:, None] * angles + phase[:, None]).T @ amplitude, np.float64)
    return _around(radii / radii.max(), angles)


def _steps(random: np.random.Generator, corners: int) -> Vertices:
    """Angles between neighbouring corners as shares of a turn, ``[corners]``, each below 0.45.

    Where a share is wider, it and the others are moved towards equal ones, which 3 corners need most of all.
    """
    raw = NARROWEST + (1 - NARROWEST) * 2 * random.random(corners)
    share = raw / raw.sum()
    equal = 1 / corners
    if (widest := share.max()) > 0.45:
        share = equal + (share - equal) * (0.45 - equal) / (widest - equal)
    return np.asarray(share, np.float64)


def _around(radii: Vertices, angles: Vertices) -> Vertices:
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1)


def _vertices(size_m: float, unit: Vertices) -> dict[str, Any]:
    return {"vertices_m": np.round(size_m / 2 * unit, DECIMALS).tolist()}


def _rounded(length_m: float) -> float:
    return max(round(length_m, DECIMALS), 10.0**-DECIMALS)
