"""Outlines against closed forms and symmetries."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from mvla_sim.errors import ConfigError
from mvla_sim.scene.shapes.cylinder import Cylinder
from mvla_sim.scene.shapes.mesh_file import MeshFile
from mvla_sim.scene.shapes.polygon import Polygon
from mvla_sim.scene.shapes.rectangle import Rectangle
from mvla_sim.scene.shapes.square import Square
from mvla_sim.scene.shapes.star import Star
from mvla_sim.scene.shapes.triangle import Triangle

ROUNDING = 1e-12  # relative: a few double-precision operations
lengths = st.floats(0.1, 50)


def difference(one, other):
    """Area that belongs to just one of two outlines, as a share of the first's."""
    return one.symmetric_difference(other).area / one.area


@given(lengths, st.integers(3, 400))
@settings(deadline=None, max_examples=50)
def test_circle_is_the_inscribed_polygon(radius, facets):
    area = Cylinder(radius_m=radius, facets=facets).outline().area
    assert area == pytest.approx(facets / 2 * radius**2 * math.sin(2 * math.pi / facets), rel=1e-10)


@pytest.mark.parametrize("facets", [3, 4, 5, 36, 360])
def test_circle_shows_the_centre_of_a_facet_to_each_multiple_of_its_step(facets):
    ring = shapely.get_coordinates(Cylinder(radius_m=4.0, facets=facets).outline())
    edge = np.diff(ring, axis=0)
    middle = (ring[1:] + ring[:-1]) / 2
    angles = np.sort((np.rad2deg(np.arctan2(middle[:, 1], middle[:, 0])) + 0.1) % 360) - 0.1  # 0 may be -1e-15
    np.testing.assert_allclose(angles, np.arange(facets) * 360 / facets, atol=1e-8)  # degrees, of rounding
    outward = np.stack([edge[:, 1], -edge[:, 0]], axis=1)  # counter-clockwise ring
    cross = outward[:, 0] * middle[:, 1] - outward[:, 1] * middle[:, 0]
    np.testing.assert_allclose(cross, 0, atol=1e-12)  # m²: the facet faces the sensor seen from the centre
    np.testing.assert_allclose(np.hypot(*middle.T), 4 * math.cos(math.pi / facets), rtol=ROUNDING)


@given(lengths, lengths)
@settings(deadline=None, max_examples=50)
def test_boxes(length, width):
    shape = Rectangle(length_m=length, width_m=width).outline()
    assert shape.area == pytest.approx(length * width, rel=ROUNDING)
    assert shape.bounds == (-length / 2, -width / 2, length / 2, width / 2)
    assert difference(Square(side_m=length).outline(), shapely.box(*np.array([-1, -1, 1, 1]) * length / 2)) == 0


@given(lengths)
@settings(deadline=None, max_examples=50)
def test_triangle_is_equilateral_about_its_centroid(altitude):
    shape = Triangle(altitude_m=altitude).outline()
    ring = shapely.get_coordinates(shape)
    sides = np.hypot(*np.diff(ring, axis=0).T)
    np.testing.assert_allclose(sides, altitude * 2 / math.sqrt(3), rtol=ROUNDING)
    assert shape.area == pytest.approx(altitude**2 / math.sqrt(3), rel=ROUNDING)
    np.testing.assert_allclose(shapely.get_coordinates(shape.centroid), 0, atol=1e-12 * altitude)
    assert tuple(ring[np.argmax(ring[:, 1])]) == pytest.approx((0, 2 * altitude / 3), abs=1e-12 * altitude)


@given(lengths, st.integers(3, 60), st.floats(0.05, 0.95))
@settings(deadline=None, max_examples=50)
def test_star_area(radius, points, share):
    star = Star(points=points, radius_m=radius, inner_radius_m=share * radius)
    # 2n triangles between neighbouring vertices, with π/n between an outer and an inner one
    expected = points * radius * star.inner_radius_m * math.sin(math.pi / points)
    assert star.outline().area == pytest.approx(expected, rel=1e-10)


def test_pentagram_inner_radius_is_where_its_chords_cross():
    ring = shapely.get_coordinates(Star(radius_m=4.0).outline())[:-1]
    radii = np.sort(np.hypot(*ring.T))
    inner = 4 * math.sin(math.radians(18)) / math.sin(math.radians(54))
    np.testing.assert_allclose(radii, [inner] * 5 + [4.0] * 5, rtol=ROUNDING)
    tips = ring[np.hypot(*ring.T) > 3]
    chord = shapely.LineString([tips[0], tips[2]])  # {5/2} joins every second tip
    distances = shapely.distance(chord, shapely.points(ring))
    assert np.sum(distances < 1e-12) == 4  # two tips and the two inner vertices between them


@given(st.integers(5, 24))
@settings(deadline=None, max_examples=20)
def test_star_polygon_has_straight_chords_for_every_count(points):
    star = Star(points=points).outline()
    ring = shapely.get_coordinates(star)[:-1]
    tip = int(np.argmax(ring[:, 1]))
    around = np.roll(ring, -tip, axis=0)
    chord = shapely.LineString([around[0], around[4]])
    assert chord.distance(shapely.Point(around[1])) < 1e-12
    assert chord.distance(shapely.Point(around[3])) < 1e-12


@pytest.mark.parametrize(
    ("shape", "turn_deg"),
    [
        (Star(), 72),
        (Triangle(), 120),
        (Square(), 90),
        (Cylinder(), 1),
        (Rectangle(length_m=3, width_m=1), 180),
    ],
)
def test_symmetry(shape, turn_deg):
    whole = shape.outline()
    turned = affinity.rotate(whole, turn_deg, origin=(0, 0))
    assert difference(whole, turned) < 1e-9  # an overlay of lines that coincide but for rounding
    assert difference(whole, affinity.rotate(whole, turn_deg / 2, origin=(0, 0))) > 1e-6


def test_polygon_in_either_sense_is_the_same_outline():
    corners = ((0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0))
    one = Polygon(vertices_m=corners).outline()
    other = Polygon(vertices_m=corners[::-1]).outline()
    assert one.equals(other)
    assert one.exterior.is_ccw
    assert other.exterior.is_ccw
    assert one.area == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("corners", "says"),
    [
        (((0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0)), "Self-intersection"),
        (((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 0.0), (0.0, 2.0)), "not a simple polygon"),
        (((0.0, 0.0), (1.0, 1.0), (2.0, 2.0)), "polygon"),
        (((1.0, 1.0), (1.0, 1.0), (1.0, 1.0)), "polygon"),
    ],
)
def test_polygon_that_is_none_is_refused_by_its_key(corners, says):
    with pytest.raises(ConfigError, match=rf"objects\[2\]\.vertices_m.*{says}"):
        Polygon(vertices_m=corners).outline("objects[2]")


def test_extent_of_the_papers_shapes():
    assert Cylinder(radius_m=4.0).nominal_extent_m == 8.0
    assert Square(side_m=8.0).nominal_extent_m == 8.0
    assert Triangle(altitude_m=6.0).nominal_extent_m == pytest.approx(4 * math.sqrt(3), rel=ROUNDING)
    for other in (
        Star(),
        Rectangle(length_m=1, width_m=1),
        Polygon(vertices_m=((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))),
        MeshFile(file="x.ply"),
    ):
        assert other.nominal_extent_m is None
