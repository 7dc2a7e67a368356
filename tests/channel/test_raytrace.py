"""The tracer against closed forms, symmetries and a plain joint call of the engine."""

from __future__ import annotations

import contextlib
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
from mvla_sim.constants import SPEED_OF_LIGHT, delay_to_range
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.imaging.detectors.local_maxima import LocalMaxima
from mvla_sim.imaging.pdp import PdpSettings, compute_pdp

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
    scene = build(cylinder, ring(30.0), diffuse_rays=1500, specular_rays=4000)
    cir = simulate(scene, cache=False)
    sagitta = 2.0 * (1 - np.cos(np.pi / 36))  # a facet's centre lies that far inside the circle
    for view in range(cir.n_view):
        assert cir.range_m[cir.rows(view)].min() == pytest.approx(4.0 + sagitta, rel=FLOAT32)
    peaks = LocalMaxima().peaks_of(compute_pdp(cir, PdpSettings(), (3.0, 9.0)))
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


def test_paths_are_those_of_the_solver_itself(monkeypatch):
    """Read from the solver's buffer, they are what Sionna's own tensors hold: delay, magnitude, kind, first point."""
    objects = [{"shape": "square", "side_m": 2.0}, {"shape": "square", "side_m": 0.5, "position_m": [0.0, 1.6, 0.0]}]
    scene = build(objects, ring(90.0, start_deg=40.0), max_depth=2, diffuse_rays=2000, specular_rays=2000)
    tracer = ViewTracer(scene)
    found = tracer.trace(scene.views.positions_m[0])
    expected = []
    monkeypatch.setattr(raytrace, "_buffer_alone", contextlib.nullcontext)
    monkeypatch.setattr(tracer, "_gather", lambda paths, one, *_: expected.append((one, paths)))
    with pytest.raises(AttributeError):  # there is nothing to put together
        tracer.trace(scene.views.positions_m[0])
    rows = []
    for one, paths in expected:
        kinds = paths.interactions.numpy().reshape(2, -1)
        joint = np.bitwise_or.reduce(kinds, axis=0)
        diffuse = (joint & INTERACTIONS["diffuse"]) > 0
        keep = diffuse & (joint != INTERACTIONS["diffuse"]) if one.mixed_only else np.ones(diffuse.size, bool)
        window = LaunchWindow.around(tracer._vertices, scene.views.positions_m[0])
        amplitude = np.abs(paths.a[0].numpy() + 1j * paths.a[1].numpy()).ravel()
        magnitude = amplitude * np.where(diffuse, np.sqrt(window.fraction), 1)
        points = paths.vertices.numpy().reshape(2, -1, 3)[0]
        rows.append(np.column_stack([paths.tau.numpy().ravel(), joint, points, magnitude])[keep])
    theirs = np.concatenate(rows)
    mine = np.column_stack([found.delay_s, found.interaction, found.first_point_m, np.abs(found.gain)])
    assert len(expected) == 3
    assert mine.shape == theirs.shape
    assert len(mine) > 100
    mine, theirs = (table[np.lexsort(table.T[4::-1])] for table in (mine, theirs))
    np.testing.assert_array_equal(mine[:, :5], theirs[:, :5])
    np.testing.assert_allclose(mine[:, 5], theirs[:, 5], rtol=1e-5)


def test_a_view_compiles_nothing_once_another_is_traced():
    """Number of paths, positions and window are no literals in any kernel; compiling took longer than tracing."""
    scene = build(STAR, ring(20.0, start_deg=3.0), diffuse_rays=2000, specular_rays=2000)
    tracer = ViewTracer(scene)
    import drjit as dr  # noqa: PLC0415 - only after the backend has chosen its library

    counts = {tracer.trace(scene.views.positions_m[view]).delay_s.size for view in range(4)}
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history()
        for view in range(4, 8):
            counts.add(tracer.trace(scene.views.positions_m[view]).delay_s.size)
        kernels = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
    assert len(counts) > 4
    assert len(kernels) > 40
    assert [one for one in kernels if not one["cache_hit"] or one["cache_disk"]] == []  # neither made nor read anew


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


# Antennas with a pattern, and pairs of transmitter and receiver that are apart.

PLATE = {"shape": "rectangle", "length_m": 0.2, "width_m": 4.0, "position_m": [-0.1, 0.0, 0.0]}
BEAMWIDTH, GAIN_DBI = 20.0, 15.0
HORN = {"antenna": {"kind": "horn", "azimuth_beamwidth_deg": BEAMWIDTH, "gain_dbi": GAIN_DBI}}


def one_way(off_deg):
    """Amplitude of the horn so far off its axis in one plane: half the power at half the beamwidth."""
    return 10 ** (GAIN_DBI / 20) * 2 ** (-0.5 * (2 * off_deg / BEAMWIDTH) ** 2)


def towards(azimuth_deg, elevation_deg=0.0):
    turn, up = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    return np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])


@pytest.mark.parametrize("off", [(0, 0), (5, 0), (-10, 0), (0, 10), (0, -15)])
def test_plate_through_a_horn_has_its_gain_squared(off):
    """Out and back: the one-way pattern twice, on its axis and beside it; the path itself is what it was."""
    azimuth, elevation = off
    scene = build([PLATE], at((5, 0, 0)), HORN, **SPECULAR_ONLY)
    position, boresight = scene.views.positions_m[0], towards(180.0 + azimuth, elevation)
    omni = ViewTracer(build([PLATE], at((5, 0, 0)), **SPECULAR_ONLY)).trace(position)
    horn = ViewTracer(scene).trace(position, boresight=boresight)
    assert omni.gain.size == 1
    np.testing.assert_array_equal(horn.delay_s, omni.delay_s)
    # Linear in dB between nodes 0.25° apart; all angles here are nodes but for float32 of the hit's place.
    assert horn.gain[0] / omni.gain[0] == pytest.approx(one_way(abs(azimuth) + abs(elevation)) ** 2, rel=1e-4)


def test_simulated_horn_looks_at_the_centre_and_sees_less_beside_it():
    """At default pointing a square's near face is on the axis; its power through the horn falls with its angle."""
    square = [{"shape": "square", "side_m": 3.0}]
    rays = {"specular": False, "diffraction": False, "diffuse_rays": 2000}
    omni, horn = (simulate(build(square, ring(120.0), radio, **rays), cache=False) for radio in ({}, HORN))
    np.testing.assert_array_equal(omni.delay_s, horn.delay_s)
    view = np.repeat(np.arange(3), omni.row_size)
    away = horn.first_point_m - horn.views.positions_m[view]
    ahead = -horn.views.positions_m[view]
    azimuth = np.rad2deg(np.arctan2(np.cross(ahead, away)[:, 2], (ahead * away).sum(axis=1)))
    elevation = np.rad2deg(np.arcsin(away[:, 2] / np.linalg.norm(away, axis=1)))
    level = -10 * np.log10(2) * (2 / BEAMWIDTH) ** 2 * (azimuth**2 + elevation**2)  # of a Gaussian beam, dB
    assert level.min() < -1
    assert level.min() > -35  # the floor of -40 dB is never met
    ratio = 20 * np.log10(np.abs(horn.gain) / np.abs(omni.gain))
    np.testing.assert_allclose(ratio, 2 * (GAIN_DBI + level), atol=0.01)  # dB; nodes 0.25° apart and float32 places


def test_antenna_with_a_pattern_needs_to_be_pointed():
    scene = build([PLATE], at((5, 0, 0)), HORN, **SPECULAR_ONLY)
    with pytest.raises(ConfigError, match="view 3: antennas with a pattern need a boresight"):
        ViewTracer(scene).trace(scene.views.positions_m[0], "view 3")


BISTATIC = [((5, 1.5, 0.2), (3, -0.5, -0.3)), ((4, -1, 0), (9, 1.4, 0.5)), ((6, 0, 0), (6, 0.01, 0))]


@pytest.mark.parametrize(("transmitter", "receiver"), BISTATIC)
def test_plate_between_a_pair_is_its_image_source(transmitter, receiver):
    """The way from the transmitter's image behind the plate to the receiver, and the spreading loss over it."""
    transmitter, receiver = np.array(transmitter, float), np.array(receiver, float)
    tracer = ViewTracer(build([PLATE | {"scattering_coefficient": 0.0}], at((5, 0, 0)), **SPECULAR_ONLY))
    paths = tracer.trace(transmitter, receiver_m=receiver)
    assert paths.interaction.tolist() == [SPECULAR]
    image = transmitter * [-1, 1, 1]
    length = np.linalg.norm(image - receiver)
    assert paths.delay_s[0] * SPEED_OF_LIGHT == pytest.approx(length, rel=FLOAT32)
    # Metal reflects less than all of it: 1e-3 at normal incidence, and up to 2e-3 more at these angles.
    assert abs(paths.gain[0]) == pytest.approx(WAVELENGTH / (4 * np.pi * length), rel=3e-3)
    crossing = image + (receiver - image) * image[0] / (image[0] - receiver[0])
    np.testing.assert_allclose(paths.first_point_m[0], crossing, atol=1e-4)  # metres, float32 at metres' distance
    there_and_back = tracer.trace(receiver, receiver_m=transmitter)
    assert abs(there_and_back.gain[0]) == pytest.approx(abs(paths.gain[0]), rel=1e-5)  # reciprocity, float32


def test_each_antenna_of_a_pair_weighs_its_own_end_of_the_path():
    """Both point along -x; the specular point is under other angles from each."""
    transmitter, receiver = np.array([5, 1.5, 0.0]), np.array([3, -0.5, 0.0])
    omni, horn = (
        ViewTracer(build([PLATE], at((5, 0, 0)), radio, **SPECULAR_ONLY)).trace(
            transmitter, receiver_m=receiver, boresight=towards(180.0)
        )
        for radio in ({}, HORN)
    )
    hit = np.array([0, -0.5 + 2.0 * 3 / 8, 0])  # like the way, the sideways distance is shared as 5 m to 3 m
    np.testing.assert_allclose(omni.first_point_m[0], hit, atol=1e-5)
    off = [np.degrees(np.arctan2(abs(end[1] - hit[1]), end[0])) for end in (transmitter, receiver)]
    assert off[0] == pytest.approx(off[1])  # the law of reflection
    assert abs(horn.gain[0] / omni.gain[0]) == pytest.approx(one_way(off[0]) * one_way(off[1]), rel=2e-3)  # nodes
    skewed = ViewTracer(build([PLATE], at((5, 0, 0)), HORN, **SPECULAR_ONLY)).trace(
        transmitter, receiver_m=receiver, boresight=towards(180.0 + off[0])
    )
    # The transmitter now looks at the point, the receiver twice as far beside it.
    assert abs(skewed.gain[0] / omni.gain[0]) == pytest.approx(one_way(0) * one_way(2 * off[1]), rel=2e-3)


def test_double_bounce_leaves_by_one_wall_and_comes_back_by_the_other():
    """Of its pattern it has the level of both directions once; a single bounce that of its own direction twice."""
    opening, distance, angle = np.pi / 3, 4.0, np.deg2rad(20.0)
    place = np.array([distance * np.cos(angle), distance * np.sin(angle), 0.0])
    rays = {"max_depth": 2, "diffuse": False, "diffraction": False, "specular_rays": 10_000}
    wide = {"antenna": HORN["antenna"] | {"azimuth_beamwidth_deg": 40.0}}
    omni, horn = (
        ViewTracer(build([wedge(opening, 0.1)], at(place), radio, **rays)).trace(place, boresight=towards(190.0))
        for radio in ({}, wide)
    )
    away = omni.first_point_m - place
    off = (np.rad2deg(np.arctan2(away[:, 1], away[:, 0])) - 190.0 + 180) % 360 - 180
    level = np.maximum(-10 * np.log10(2) * (2 * off / 40) ** 2, -40)  # dB, one way, down to the floor
    ratio = 20 * np.log10(np.abs(horn.gain / omni.gain)) - 2 * GAIN_DBI
    double = np.abs(delay_to_range(omni.delay_s) - distance * np.sin(opening)) < 1e-3
    assert double.sum() == 2  # one wall first, or the other
    assert np.ptp(level[double]) > 6  # dB; or both ends would have one level
    np.testing.assert_allclose(ratio[double], level[double].sum(), atol=0.02)  # dB; nodes 0.25° apart, float32 places
    assert (~double).sum() == 2
    np.testing.assert_allclose(ratio[~double], 2 * level[~double], atol=0.02)


def test_diffuse_points_are_as_far_as_both_ways_to_them():
    transmitter, receiver = np.array([4.0, 2.0, 0.5]), np.array([5.0, -3.0, -0.5])
    scene = build(STAR, at((5, 0, 0)), diffuse_rays=1000, specular=False, diffraction=False)
    paths = ViewTracer(scene).trace(transmitter, receiver_m=receiver)
    points = paths.first_point_m.astype(float)
    assert len(points) > 100
    both = np.linalg.norm(points - transmitter, axis=1) + np.linalg.norm(points - receiver, axis=1)
    np.testing.assert_allclose(paths.delay_s * SPEED_OF_LIGHT, both, rtol=0, atol=2e-5)  # metres, float32 places
    one_way_only = 2 * np.linalg.norm(points - transmitter, axis=1)
    assert np.abs(one_way_only - both).max() > 1


def test_speckle_is_drawn_for_each_pair():
    """Pairs that share a transmitter are independent; a receiver at its transmitter is a co-located sensor."""
    scene = build(STAR, at((5, 0, 0)), diffuse_rays=300, specular=False, diffraction=False)
    tracer, place = ViewTracer(scene), scene.views.positions_m[0]
    alone, equal = tracer.trace(place), tracer.trace(place, receiver_m=place.copy())
    for name in ("gain", "delay_s", "interaction", "first_point_m"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(equal, name))
    near = [tracer.trace(place, receiver_m=place + np.array([0.0, 1e-5 * k, 0.0])) for k in (1, 2)]
    # 10 µm move no point and turn no carrier by more than 0.8 % of a turn; only the draw differs.
    np.testing.assert_allclose(near[0].first_point_m, near[1].first_point_m, atol=1e-4)
    unlike = np.abs(np.mean(near[0].gain * near[1].gain.conj())) / np.mean(np.abs(near[0].gain) ** 2)
    weights = np.abs(near[0].gain) ** 2
    assert unlike < 5 * np.sqrt((weights**2).sum()) / weights.sum()  # of a mean of as many random phases
    assert unlike < 0.6  # or the line above could not fail
