"""The tracer against closed forms, symmetries and a plain joint call of the engine."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from channel_scenes import at, build, ring
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mvla_sim.channel import raytrace
from mvla_sim.channel.cir import INTERACTIONS
from mvla_sim.channel.raytrace import LaunchWindow, ViewTracer
from mvla_sim.channel.simulate import simulate
from mvla_sim.config.imaging import PdpSettings, PeakSettings
from mvla_sim.constants import SPEED_OF_LIGHT, delay_to_range
from mvla_sim.errors import DataError
from mvla_sim.imaging.pdp import compute_pdp
from mvla_sim.imaging.peaks import extract_peaks

CARRIER = 36e9
WAVELENGTH = SPEED_OF_LIGHT / CARRIER
SPECULAR, DIFFUSE, DIFFRACTION = (INTERACTIONS[k] for k in ("specular", "diffuse", "diffraction"))
FLOAT32 = 3e-7  # relative: the engine's delays are a few float32 operations
SPECULAR_ONLY = {"diffuse": False, "diffraction": False, "specular_rays": 20_000}
STAR = [{"shape": "star", "radius_m": 2.0}]


def trace(scene):
    tracer = ViewTracer(scene)
    return [tracer.trace(position) for position in scene.views.positions_m]


def ranges(paths, kind):
    return np.sort(delay_to_range(paths.delay_s[paths.interaction == kind]))


def gains(paths, kind):
    return np.sort(np.abs(paths.gain[paths.interaction == kind]))


def power(paths, kind):
    return (np.abs(paths.gain[paths.interaction == kind]) ** 2).sum(dtype=np.float64)


def metal_reflection():
    """|Γ| at normal incidence of ITU-R P.2040's metal, σ = 10⁷ S/m."""
    index = np.sqrt(1 - 1j * 1e7 / (2 * np.pi * CARRIER * 8.8541878128e-12))
    return abs((1 - index) / (1 + index))


def test_plate_head_on_is_its_image_source():
    distances = np.array([3.0, 9.0, 20.0, 50.0])
    plate = {"shape": "rectangle", "length_m": 0.2, "width_m": 4.0, "position_m": [-0.1, 0.0, 0.0]}
    scene = build([plate | {"scattering_coefficient": 0.0}], at(*((d, 0, 0) for d in distances)), **SPECULAR_ONLY)
    for distance, paths in zip(distances, trace(scene), strict=True):
        assert paths.interaction.tolist() == [SPECULAR]
        assert delay_to_range(paths.delay_s[0]) == pytest.approx(distance, rel=FLOAT32)
        expected = metal_reflection() * WAVELENGTH / (4 * np.pi * 2 * distance)
        assert abs(paths.gain[0]) == pytest.approx(expected, rel=1e-5)  # a chain of float32 operations
        np.testing.assert_allclose(paths.first_point_m[0], [0, 0, 0], atol=1e-5 * distance)  # metres, float32


def test_specular_gain_loses_what_is_scattered():
    plate = {"shape": "rectangle", "length_m": 0.2, "width_m": 4.0, "position_m": [-0.1, 0.0, 0.0]}
    smooth, rough = (
        trace(build([plate | {"scattering_coefficient": s}], at((5, 0, 0)), **SPECULAR_ONLY))[0] for s in (0.0, 0.6)
    )
    assert abs(rough.gain[0] / smooth.gain[0]) == pytest.approx(np.sqrt(1 - 0.6**2), rel=1e-5)  # float32


def test_phase_is_that_of_the_delay():
    """Two positions a quarter wavelength of range apart differ by half a turn, as exp(−j2πfτ) says."""
    plate = {"shape": "rectangle", "length_m": 0.2, "width_m": 4.0, "position_m": [-0.1, 0.0, 0.0]}
    near, far = trace(build([plate], at((5, 0, 0), (5 + WAVELENGTH / 4, 0, 0)), **SPECULAR_ONLY))
    turn = np.angle(far.gain[0] / near.gain[0])
    # One float32 step of a delay of 33 ns is 3.6e-15 s or 0.8 mrad at 36 GHz; positions and path length add a few.
    assert abs(abs(turn) - np.pi) < 0.01


def test_cylinder_is_at_its_nearest_point():
    cylinder = [{"shape": "circle", "radius_m": 2.0, "facets": 36}]
    scene = build(cylinder, ring(10.0), diffuse_rays=1500, specular_rays=4000)
    cir = simulate(scene, cache=False)
    sagitta = 2.0 * (1 - np.cos(np.pi / 36))  # a facet's centre lies that far inside the circle
    for view in range(cir.n_view):
        assert cir.range_m[cir.rows(view)].min() == pytest.approx(4.0 + sagitta, rel=FLOAT32)
    peaks = extract_peaks(compute_pdp(cir, PdpSettings(), (3.0, 9.0)), PeakSettings())
    first = peaks.range_m[np.cumsum(peaks.row_size) - peaks.row_size]
    # A quarter of a sample of refinement error, and the echoes around the nearest point in the same cell, stay well
    # below half a range resolution of 5 cm.
    np.testing.assert_allclose(first, 4.0 + sagitta, atol=0.025)


def test_turning_scene_and_sensor_together_changes_nothing():
    def turned(angle):
        objects = [STAR[0] | {"rotation_deg": angle}]
        return trace(build(objects, ring(120.0, start_deg=7.0 + angle), diffuse_rays=3000, specular_rays=5000))

    for angle in (33.0, 90.0):
        for one, other in zip(turned(0.0), turned(angle), strict=True):
            for kind in (SPECULAR, DIFFUSE, DIFFRACTION):
                # The lattice turns with the launch window, so even diffuse paths are the same. Its directions are
                # float32; on a wall that is grazed, an error of 1e-7 in direction moves the hit by up to 1e-4 m.
                np.testing.assert_allclose(ranges(one, kind), ranges(other, kind), rtol=0, atol=5e-4)
                np.testing.assert_allclose(gains(one, kind), gains(other, kind), rtol=1e-3)


def test_sector_launch_is_the_sphere_launch():
    trajectory = ring(60.0, start_deg=7.0)
    sector = trace(build(STAR, trajectory, diffuse_rays=4000))
    sphere = trace(build(STAR, trajectory, diffuse_rays=200_000, specular_rays=200_000, launch="sphere"))
    for one, other in zip(sector, sphere, strict=True):
        for kind in (SPECULAR, DIFFRACTION):
            np.testing.assert_allclose(ranges(one, kind), ranges(other, kind), rtol=0, atol=1e-5)  # metres, float32
            np.testing.assert_allclose(gains(one, kind), gains(other, kind), rtol=1e-5)  # float32
        assert (one.interaction == DIFFUSE).sum() > 2000
        # At random positions, 3,000 hits of equal weight would give 1.8 %; a lattice is several times better.
        assert power(one, DIFFUSE) == pytest.approx(power(other, DIFFUSE), rel=0.01)


def test_doubling_the_rays_changes_the_pdp_by_speckle_alone():
    """The statistic is the PDP's mean over cells and views.

    Cells hold exponential speckle: E[P²] = 2E[P]², so the variance of a sum over independent cells is half the sum of
    P². Samples are correlated over broadening × oversampling.
    """
    trajectory = {"kind": "arc", "start_deg": 3.0, "stop_deg": 78.0, "interval_deg": 3.0, "radius_m": 6.0}
    sums, spreads, energies = [], [], []
    for rays in (6000, 12_000):
        cir = simulate(build(STAR, trajectory, diffuse_rays=rays, specular=False, diffraction=False), cache=False)
        pdp = compute_pdp(cir, PdpSettings(oversampling=4), (3.0, 9.0))
        cell = 4 * pdp.broadening
        sums.append(pdp.power.sum())
        spreads.append(np.sqrt(cell * (pdp.power**2).sum() / 2) / pdp.power.sum())
        energies.append((np.abs(cir.gain) ** 2).sum(dtype=np.float64))
    assert energies[1] == pytest.approx(energies[0], rel=0.01)  # incoherent power, see the test above
    spread = np.hypot(*spreads)
    assert spread < 0.1  # or the next line could not fail
    assert abs(sums[1] / sums[0] - 1) < 4 * spread


def wedge(opening_rad, scattering_coefficient):
    """A prism with a concave corner at the origin between walls in the directions 0 and ``opening_rad``."""
    c, s = np.cos(opening_rad), np.sin(opening_rad)
    outside = -(1 + c) / s  # where the outer walls, 1 m behind, meet
    corners = [(0, 0), (6, 0), (6, -1), (outside, -1), (6 * c - s, 6 * s + c), (6 * c, 6 * s)]
    vertices = [[float(x), float(y)] for x, y in corners]
    return {"shape": "polygon", "vertices_m": vertices, "scattering_coefficient": scattering_coefficient}


def test_passes_give_what_one_joint_call_gives():
    """Paths by kind, mixed ones included, of three passes and of one call with everything enabled."""
    rays = {"max_depth": 2, "diffuse_rays": 100_000, "specular_rays": 100_000}
    scene = build([wedge(np.pi / 3, 0.6)], at((4 * np.cos(0.4), 4 * np.sin(0.4), 0.0)), **rays)
    position = scene.views.positions_m[0]
    split = ViewTracer(scene).trace(position)
    joint_tracer = ViewTracer(scene)
    joint_tracer._passes = [raytrace._Pass("joint", 100_000, specular=True, diffuse=True, diffraction=True)]
    joint = joint_tracer.trace(position)
    kinds = set(np.unique(joint.interaction).tolist())
    assert {SPECULAR, DIFFUSE, DIFFRACTION, SPECULAR | DIFFUSE, SPECULAR | DIFFRACTION} <= kinds
    assert kinds == set(np.unique(split.interaction).tolist())
    for kind in kinds:
        if kind & DIFFUSE:
            count = min((p.interaction == kind).sum() for p in (split, joint))
            assert count > 300
            # Paths of unequal weight at random: three spreads of the mean of as many paths with a kurtosis of a few.
            assert power(split, kind) == pytest.approx(power(joint, kind), rel=3 * np.sqrt(4 / count))
        else:
            np.testing.assert_allclose(ranges(split, kind), ranges(joint, kind), rtol=0, atol=1e-5)  # metres, float32
            np.testing.assert_allclose(gains(split, kind), gains(joint, kind), rtol=1e-4)  # float32


@pytest.mark.parametrize("angle_deg", [20.0, 30.0, 45.0])
def test_concave_corner_has_its_double_bounce(angle_deg):
    """A sensor at r in a wedge of opening α sees its second image, turned by 2α, at the one-way range r·sin α."""
    opening, distance = np.pi / 3, 4.0
    angle = np.deg2rad(angle_deg)
    scene = build(
        [wedge(opening, 0.1)],
        at((distance * np.cos(angle), distance * np.sin(angle), 0.0)),
        max_depth=2,
        diffraction=False,
        diffuse_rays=5000,
    )
    paths = trace(scene)[0]
    single = np.sort([distance * np.sin(angle), distance * np.sin(opening - angle)])
    double = [distance * np.sin(opening)] * 2  # one wall first, or the other
    np.testing.assert_allclose(ranges(paths, SPECULAR), [*single, *double], rtol=FLOAT32 * 3)
    strongest = paths.interaction == SPECULAR
    ideal = WAVELENGTH / (4 * np.pi * 2 * delay_to_range(paths.delay_s[strongest]))
    bounces = np.where(delay_to_range(paths.delay_s[strongest]) > 3.2, 2, 1)
    # A scattering coefficient of 0.1 takes 1 % of the power at each bounce; metal at oblique incidence up to 2e-3 more.
    np.testing.assert_allclose(np.abs(paths.gain[strongest]) / ideal, np.sqrt(0.99) ** bounces, rtol=2e-3)
    assert (paths.interaction == (SPECULAR | DIFFUSE)).any()


def test_same_bits_again_whatever_was_traced_between():
    scene = build(STAR, ring(120.0), diffuse_rays=1000, specular_rays=2000)
    tracer = ViewTracer(scene)
    first = [tracer.trace(p) for p in scene.views.positions_m]
    backwards = [tracer.trace(p) for p in scene.views.positions_m[::-1]][::-1]
    for one, other in zip(first, backwards, strict=True):
        for name in ("gain", "delay_s", "interaction", "first_point_m"):
            assert np.array_equal(getattr(one, name), getattr(other, name))


def digest():
    """Fingerprint of a traced scene; run in another process too."""
    total = hashlib.sha256()
    for paths in trace(build(STAR, ring(180.0), diffuse_rays=1000, specular_rays=2000)):
        for array in (paths.gain, paths.delay_s, paths.interaction, paths.first_point_m):
            total.update(array.tobytes())
    return total.hexdigest()


def test_same_bits_in_another_process():
    code = "import sys; sys.path.insert(0, sys.argv[1]); import test_raytrace; sys.stdout.write(test_raytrace.digest())"
    here = str(Path(__file__).parent)
    other = subprocess.run([sys.executable, "-c", code, here], capture_output=True, text=True, check=True, timeout=120)
    assert other.stdout == digest()


def test_cap_on_paths_is_an_error_not_a_loss():
    scene = build(STAR, ring(180.0), diffuse_rays=1000, max_paths=100)
    with pytest.raises(DataError, match=r"view 7.*100 paths.*ray_tracing\.max_paths"):
        ViewTracer(scene).trace(scene.views.positions_m[0], "view 7")


def test_ray_count_itself_is_never_taken_for_the_cap():
    """Every ray of a pass may give a path: a wall that fills the sky of one half."""
    wall = {"shape": "rectangle", "length_m": 0.2, "width_m": 150.0, "height_m": 150.0, "position_m": [-0.1, 0, 0]}
    scene = build([wall], at((0.5, 0, 0)), diffuse_rays=500, diffraction=False)
    paths = trace(scene)[0]
    assert (paths.interaction == DIFFUSE).sum() > 450


def test_view_without_paths_is_kept_and_counted():
    plate = {"shape": "rectangle", "length_m": 0.2, "width_m": 2.0}
    cir = simulate(build([plate], at((6, 0, 0), (5, 4, 0), (-6, 0, 0)), **SPECULAR_ONLY), cache=False)
    assert cir.row_size.tolist() == [1, 0, 1]
    assert cir.n_view == 3
    with pytest.raises(DataError, match="no path was found at any of 1 views"):
        simulate(build([plate], at((5, 4, 0)), **SPECULAR_ONLY), cache=False)


points = st.tuples(*[st.floats(-5, 5)] * 3)


@settings(max_examples=50)
@given(st.lists(points, min_size=4, max_size=12), points, st.integers(0, 2**32 - 1))
def test_launch_window_holds_the_hull(vertices, sensor, seed):
    """Every direction from the sensor to a point of the convex hull lies in the window."""
    vertices, sensor = np.array(vertices), np.array(sensor) * [4, 4, 1]
    share = np.random.default_rng(seed).dirichlet(np.full(len(vertices), 0.3), 200)
    offset = np.concatenate([vertices, share @ vertices]) - sensor
    length = np.linalg.norm(offset, axis=1)
    assume(length.min() > 1e-3)
    window = LaunchWindow.around(vertices, sensor)
    assert 0 < window.fraction <= 1
    azimuth = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi)
    polar = (1 - offset[:, 2] / length) / 2
    assert ((azimuth - window.x[0]) % 1 <= window.x[1] - window.x[0]).all()
    assert ((polar >= window.y[0] - 1e-12) & (polar <= window.y[1] + 1e-12)).all()  # rounding at the poles


def test_diffuse_power_near_the_specular_point_does_not_grow_with_the_rays():
    """Diffuse paths are incoherent. Without phases of their own those around the specular point add up in amplitude,
    and 16 times the rays gave twice the power in the first cells; speckle over 40 positions averages to within
    1/√40 = 0.16, the difference of two such means to within 0.22, hence a third as the bound."""
    wall = [{"shape": "rectangle", "length_m": 1.0, "width_m": 8.0, "position_m": [-0.5, 0.0, 0.0]}]
    positions = [(6.0, 0.01 * k, 0.0) for k in range(40)]
    means = []
    for rays in (6_000, 96_000):
        cir = simulate(build(wall, at(*positions), specular=False, diffraction=False, diffuse_rays=rays), cache=False)
        pdp = compute_pdp(cir, PdpSettings(), (5.9, 6.2))
        means.append(pdp.power[:, np.abs(pdp.range_m - 6.01) < 0.03].mean())
    assert means[1] / means[0] == pytest.approx(1.0, abs=1 / 3)
