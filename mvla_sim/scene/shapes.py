"""Outlines of the shapes a scene file can name, and the extent D the paper gives them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon as ShapelyPolygon
from shapely.geometry.polygon import orient

from mvla_sim.errors import ConfigError
from mvla_sim.scene.scene_settings import (
    Car,
    Circle,
    MeshFile,
    ObjectSettings,
    Polygon,
    Rectangle,
    Square,
    Star,
    Triangle,
)

__all__ = ["nominal_extent_m", "outline"]


def outline(settings: ObjectSettings, key: str = "object") -> ShapelyPolygon:
    """Outline of a prism in its own frame, before rotation and placement; counter-clockwise, metres.

    Parameters
    ----------
    settings
        Any prism.
    key
        What the object is called in messages, for example ``objects[0]``.

    Returns
    -------
    shapely.Polygon
        Vertices (x, y) in metres.

    Raises
    ------
    ConfigError
        The polygon crosses itself, touches itself or has no area, or the object is no prism.

    Notes
    -----
    * circle: a regular polygon with its vertices on the circle, turned so that the centre of facet k is seen in
      direction k·360°/facets; the facets' centres then lie at r·cos(180°/facets), at 360 facets 0.15 mm inside 4 m;
    * square, rectangle: centred, sides along x and y;
    * triangle: equilateral, centroid at the origin, a tip towards +y at two thirds of the altitude;
    * star: a tip towards +y; the inner radius of {n/2} is r·cos(2π/n)/cos(π/n), which for n = 5 is r·sin 18°/sin 54°;
    * polygon: as given, in either sense of rotation.

    Examples
    --------
    >>> outline(Square(shape="square", side_m=2.0)).area
    4.0
    """
    if isinstance(settings, MeshFile | Car):
        raise ConfigError(f"{key}: shape = '{settings.shape}' has no outline of its own; it is cut from its mesh")
    shape = ShapelyPolygon(_VERTICES[type(settings)](settings))
    if not shape.is_valid:
        raise ConfigError(f"{key}.vertices_m: is not a simple polygon: {shapely.is_valid_reason(shape)}")
    if shape.area <= 1e-9 * shape.length**2:  # collinear but for rounding; a useful target is never that thin
        raise ConfigError(f"{key}.vertices_m: the polygon's area is {shape.area:g} m²; it must enclose an area")
    return shapely.remove_repeated_points(orient(shape))


def nominal_extent_m(settings: ObjectSettings) -> float | None:
    """Extent D that the paper gives a shape: diameter or side in metres; None where the paper gives none.

    Examples
    --------
    >>> nominal_extent_m(Circle(shape="circle", radius_m=4.0))
    8.0
    """
    if isinstance(settings, Circle):
        return 2 * settings.radius_m
    if isinstance(settings, Square):
        return settings.side_m
    if isinstance(settings, Triangle):
        return _triangle_side_m(settings)
    return None


def _triangle_side_m(settings: Triangle) -> float:
    return settings.altitude_m * 2 / math.sqrt(3)


def _polar(radii: NDArray[np.float64] | float, angles_deg: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    angles = np.deg2rad(angles_deg)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)


def _circle(settings: Circle) -> NDArray[np.float64]:
    return _polar(settings.radius_m, (np.arange(settings.facets) + 0.5) * (360 / settings.facets))


def _box(length_m: float, width_m: float) -> NDArray[np.float64]:
    x, y = length_m / 2, width_m / 2
    return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])


def _triangle(settings: Triangle) -> NDArray[np.float64]:
    side, low = _triangle_side_m(settings), -settings.altitude_m / 3
    return np.array([[-side / 2, low], [side / 2, low], [0.0, 2 * settings.altitude_m / 3]])


def _star(settings: Star) -> NDArray[np.float64]:
    count = settings.points
    inner = settings.inner_radius_m
    if inner is None:
        inner = settings.radius_m * math.cos(2 * math.pi / count) / math.cos(math.pi / count)
    radii = np.where(np.arange(2 * count) % 2 == 0, settings.radius_m, inner)
    return _polar(radii, 90 + np.arange(2 * count) * (180 / count))


_VERTICES: dict[type, Callable[[Any], Any]] = {
    Circle: _circle,
    Square: lambda s: _box(s.side_m, s.side_m),
    Rectangle: lambda s: _box(s.length_m, s.width_m),
    Triangle: _triangle,
    Star: _star,
    Polygon: lambda s: s.vertices_m,
}
