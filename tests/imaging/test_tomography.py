"""The forward operator against the projector and a slow twin; MLEM and NNLS on it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import twin
from cases import ring, scatterers
from scipy.optimize import nnls

from mvla_sim.dsp import Window, noise_level
from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import BeamSettings, build_beam
from mvla_sim.imaging.forward import RangeOperator, forward
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.methods.mlem import maximize
from mvla_sim.imaging.methods.nnls import minimize
from mvla_sim.imaging.pdp import Pdp, PdpSettings, compute_pdp
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.imaging.projection import RangeProfiles, project
from mvla_sim.imaging.tomography import LinearModel, background, pulse_power
from mvla_sim.scene.antennas.horn import Horn
from mvla_sim.scene.views import Views

LAYER = VoxelGrid((0.1, -0.2, 0.0), (42, 39, 1), 0.22)
BLOCK = VoxelGrid((0.3, -0.2, 0.1), (9, 8, 7), 0.7)
SMALL = VoxelGrid((0.0, 0.0, 0.0), (12, 11, 1), 0.1)
POINT = VoxelGrid((0.0, 0.0, 0.0), (1, 1, 1), 0.1)
HORN = build_beam(Horn(azimuth_beamwidth_deg=35.0, elevation_beamwidth_deg=30.0), BeamSettings(edge_db=-3.0))
EDGE_DB = 1e-3  # a voxel this near to a beam's edge may fall on either side in float32


def somewhere(count, paired, seed=0):
    """Views of a ring at random heights, with receivers up to a metre away where they are pairs."""
    rng = np.random.default_rng(seed)
    views = ring(count, radius_m=8.0)
    positions = views.positions_m + np.column_stack([np.zeros((count, 2)), rng.uniform(-1, 1, count)])
    receivers = positions + rng.uniform(-1, 1, (count, 3)) if paired else None
    return Views(positions, views.angles_deg, views.center_m, receivers)


def axis_of(grid, views, step_m=0.0125, cut=0.0):
    """Range axis over the ranges of a grid, less a share of them at both ends: start, step, count."""
    near, far = grid.range_span_m(views.positions_m, views.receivers_m)
    near, far = near + cut * (far - near) - step_m, far - cut * (far - near) + step_m
    return near, step_m, int((far - near) / step_m) + 2


def named(axis):
    return dict(zip(("start_m", "step_m", "count"), axis, strict=True))


def triangles(grid, views, axis, covered=True):
    """S as a float64 matrix ``[n_view, n_range, n]``: the weights of linear interpolation, nothing off the axis."""
    start, step, count = axis
    points = grid.centers()
    covered = np.broadcast_to(covered, (len(views), len(points)))
    matrix = np.zeros((len(views), count, len(points)))
    for m, end in enumerate(twin.ends(views)):
        cell = (twin.distances(points, end) - start) / step
        seen = covered[m] & (cell >= 0) & (cell < count - 1)
        node = np.where(seen, cell, 0).astype(int)
        for k, share in ((node, 1 - (cell - node)), (node + 1, cell - node)):
            matrix[m, k, np.arange(len(points))] += np.where(seen, share, 0)
    return matrix


def dense(grid, views, pdp):
    """A as a float64 matrix ``[n_view·n_range, n]``: convolution with the pulse, fading, triangles."""
    matrix = triangles(grid, views, (pdp.start_m, pdp.step_m, pdp.power.shape[1]))
    ranges = pdp.range_m
    matrix *= ((ranges[0] + ranges[-1]) / 2 / ranges[:, None]) ** 4
    taps = pulse_power(pdp.window, pdp.oversampling)
    away = np.abs(np.arange(len(ranges))[:, None] - np.arange(len(ranges)))
    convolution = np.where(away < len(taps), np.append(taps, 0)[np.minimum(away, len(taps))], 0)
    return np.einsum("kl,mln->mkn", convolution, matrix).reshape(-1, grid.size)


def profiles_of(points_m, grid, views, noise=0.0, **options):
    """Profiles of isotropic points, with normal noise in units of the strongest sample."""
    settings = PdpSettings(**options)
    pdp = compute_pdp(scatterers(points_m, views), settings, grid.range_span_m(views.positions_m, views.receivers_m))
    draw = np.random.default_rng(0).standard_normal(pdp.power.shape)
    power = pdp.power + noise * pdp.power.max() * draw
    return Pdp(power, None, pdp.start_m, pdp.step_m, pdp.resolution_m, pdp.broadening, pdp.window, pdp.oversampling)


def problem(noise=0.02, views=9):
    """A small grid with two points: model, profiles and the matrix."""
    around = ring(views)
    pdp = profiles_of([[0.2, 0.1, 0.0], [-0.3, -0.2, 0.0]], SMALL, around, noise)
    return LinearModel(SMALL, around, pdp), pdp.power, dense(SMALL, around, pdp)


@pytest.mark.parametrize("beam", [None, HORN], ids=["everywhere", "beams"])
@pytest.mark.parametrize("paired", [False, True], ids=["together", "pairs"])
@pytest.mark.parametrize("count", [1, 3, 4, 13])
@pytest.mark.parametrize("grid", [LAYER, BLOCK, POINT], ids=["layer", "block", "point"])
def test_forward_is_the_transpose_of_the_projector(grid, count, paired, beam):
    rng = np.random.default_rng(count)
    views = somewhere(count, paired)
    start, step, nodes = axis_of(grid, views, cut=0.1 if grid is not POINT else 0.0)
    image = rng.random(grid.shape, np.float32)
    values = rng.random((count, nodes), np.float32)
    seen = forward(grid, views, image, start_m=start, step_m=step, count=nodes, beam=beam)
    total = project(grid, views, RangeProfiles(values, start, step), beam=beam).total
    one, other = (np.sum(a.astype(np.float64) * b) for a, b in ((seen, values), (image, total)))
    assert one == pytest.approx(other, rel=1e-6)  # float32 sums
    assert other > 0


@pytest.mark.parametrize("paired", [False, True], ids=["together", "pairs"])
@pytest.mark.parametrize("grid", [LAYER, BLOCK], ids=["layer", "block"])
def test_its_own_projection_is_the_projector(grid, paired):
    views = somewhere(6, paired)
    start, step, nodes = axis_of(grid, views, cut=0.2)
    values = np.random.default_rng(0).random((6, nodes), np.float32)
    operator = RangeOperator(grid, views, start, step, nodes, beam=HORN)
    own = operator.project(operator.arrays.Float32(values.ravel())).numpy()
    assert np.array_equal(own, project(grid, views, RangeProfiles(values, start, step), beam=HORN).total.ravel())


@pytest.mark.parametrize("beam", [None, HORN], ids=["everywhere", "beams"])
@pytest.mark.parametrize("paired", [False, True], ids=["together", "pairs"])
@pytest.mark.parametrize("grid", [LAYER, BLOCK], ids=["layer", "block"])
def test_forward_equals_the_twin(grid, paired, beam):
    views = somewhere(7, paired)
    axis = axis_of(grid, views, step_m=0.05)
    image, covered = np.random.default_rng(1).random(grid.size), True
    if beam is not None:
        level = twin.levels_db(grid.centers(), views, beam.antenna, views.directions)
        covered = level >= beam.edge_db
        image[(np.abs(level - beam.edge_db) < EDGE_DB).any(axis=0)] = 0
    expected = triangles(grid, views, axis, covered) @ image
    seen = forward(grid, views, image.reshape(grid.shape), **named(axis), beam=beam)
    # A range is good to 1e-6 m of float32, so a share is to 1e-6 m/0.05 m, and a node has those of some 15 voxels.
    np.testing.assert_allclose(seen, expected, rtol=0, atol=3e-4)


def test_sums_of_a_million_voxels():
    """A node of a volume holds thousands of voxels: their sum loses nothing, and no part of it is off."""
    grid = VoxelGrid((0.0, 0.0, 0.0), (101, 100, 99), 0.05)
    views = somewhere(2, False)
    start, step, nodes = axis_of(grid, views, step_m=0.05)
    image = np.random.default_rng(2).random(grid.shape, np.float32)
    seen = forward(grid, views, image, start_m=start, step_m=step, count=nodes)
    np.testing.assert_allclose(seen.sum(axis=1, dtype=np.float64), image.sum(dtype=np.float64), rtol=1e-6)
    for m, end in enumerate(twin.ends(views)):
        cell = (twin.distances(grid.centers(), end) - start) / step
        node = cell.astype(int)
        share, x = cell - node, image.ravel().astype(np.float64)
        expected = np.bincount(node, x * (1 - share), nodes) + np.bincount(node + 1, x * share, nodes)
        np.testing.assert_allclose(seen[m], expected, rtol=0, atol=3e-6 * expected.max())


@pytest.mark.parametrize("window", ["hann", "hamming", "blackman", "kaiser", "rectangular"])
@pytest.mark.parametrize("oversampling", [1, 4, 7])
def test_a_pulse_is_the_main_lobe_of_an_isolated_path(window, oversampling):
    taps = pulse_power(Window(window), oversampling)
    assert taps[0] == pytest.approx(1)
    assert (np.diff(taps) < 0).all()
    views = ring(1)
    pdp = profiles_of([[0.0, 0.0, 0.0]], LAYER, views, window=window, oversampling=oversampling)
    place = (10.0 - pdp.start_m) / pdp.step_m
    assert place == pytest.approx(round(place), abs=1e-6)  # 10 m is a node of the axis
    seen = pdp.power[0, round(place) :][: len(taps)]
    np.testing.assert_allclose(seen, taps * 1e-4, rtol=0, atol=1e-4 * 2e-3)  # 10 m: power 10⁻⁴; a gate's few cells


@pytest.mark.parametrize("paired", [False, True], ids=["together", "pairs"])
def test_forward_of_one_voxel_is_a_pulse_at_its_range(paired):
    """And as strong as an isotropic point's: the model is the front end's, but for interpolation between nodes."""
    views = somewhere(5, paired)
    grid = VoxelGrid((0.1, -0.2, 0.0), (41, 39, 1), 0.22)
    pdp = profiles_of([[0.1, -0.2, 0.0]], grid, views, oversampling=8)
    image = np.zeros(grid.shape, np.float32)
    image[0, 19, 20] = 1
    model = LinearModel(grid, views, pdp)
    seen = model.profiles(model.predict(model.upload(image)))
    for m, end in enumerate(twin.ends(views)):
        r = twin.distances(np.array([[0.1, -0.2, 0.0]]), end)[0]
        assert abs(pdp.range_m[seen[m].argmax()] - r) <= pdp.step_m / 2 + 1e-5
    scaled = pdp.power * (pdp.range_m[[0, -1]].mean() ** 4)
    # A pair's 1/(d₁d₂)² is taken for 1/r⁴; nodes an eighth of a cell apart cut a pulse's top by 1 per cent.
    np.testing.assert_allclose(seen, scaled, rtol=0, atol=(0.05 if paired else 0.02) * scaled.max())


def test_transpose_of_the_model():
    model, power, matrix = problem()
    rng = np.random.default_rng(3)
    image, values = rng.random(SMALL.shape, np.float32), rng.random(power.shape, np.float32)
    seen = model.profiles(model.predict(model.upload(image)))
    back = model.image(model.transpose(model.upload(values)))
    np.testing.assert_allclose(seen.ravel(), matrix @ image.ravel(), rtol=0, atol=2e-4)
    np.testing.assert_allclose(back.ravel(), matrix.T @ values.ravel(), rtol=1e-4)
    assert np.vdot(seen, values) == pytest.approx(np.vdot(image, back), rel=1e-6)


def test_background_is_the_mean_of_clipped_noise():
    rng = np.random.default_rng(4)
    for level in (0.0, 0.5, -1.0, 3.0):
        power = level + rng.standard_normal((4, 20_000))
        power[:, :50] = 100.0  # a few echoes
        expected = np.maximum(power[:, 50:], 0).mean()
        np.testing.assert_allclose(background(power), expected, rtol=0.05, atol=0.02)
        np.testing.assert_allclose(noise_level(power), [[level] * 4, [1] * 4], atol=0.05)
    clean = np.zeros((2, 50))
    assert (background(clean) > 0).all()
    clean[0, 3] = 7.0
    np.testing.assert_allclose(background(clean), 7e-6)


def test_no_step_of_mlem_lowers_the_likelihood():
    model, power, matrix = problem()
    noise = background(power)
    counts, floor = np.maximum(power, 0).ravel(), np.repeat(noise, power.shape[1])
    image, likelihood = None, []
    for _ in range(25):
        image = maximize(model, power, noise, 1, image)
        assert image.min() >= 0
        expected = matrix @ image.ravel().astype(np.float64) + floor
        likelihood.append((counts * np.log(expected) - expected).sum())
    rise = np.diff(likelihood)
    assert (rise >= -1e-6 * np.abs(likelihood[0])).all()
    assert rise[0] > 0


def test_no_step_of_nnls_raises_the_residual():
    model, power, matrix = problem()
    level, _ = noise_level(power)
    wanted = (power - level[:, None]).ravel()
    images = [minimize(model, power, level, count) for count in range(1, 25)]
    assert min(image.min() for image in images) >= 0
    residual = [((matrix @ image.ravel() - wanted) ** 2).sum() for image in images]
    assert (np.diff(residual) <= 1e-6 * residual[0]).all()


def test_mlem_equals_a_twin_in_float64():
    model, power, matrix = problem()
    noise = background(power)
    counts, floor = np.maximum(power, 0).ravel(), np.repeat(noise, power.shape[1])
    sensitivity = matrix.sum(axis=0)
    image = np.full(SMALL.size, (counts - floor).sum() / sensitivity.sum())
    for _ in range(40):
        image *= matrix.T @ (counts / (matrix @ image + floor)) / sensitivity
    found = maximize(model, power, noise, 40).ravel()
    np.testing.assert_allclose(found, image, rtol=0, atol=1e-3 * image.max())


def test_nnls_reaches_the_minimum():
    model, power, matrix = problem()
    level, _ = noise_level(power)
    wanted = (power - level[:, None]).ravel()
    least = nnls(matrix, wanted)[1] ** 2
    found = ((matrix @ minimize(model, power, level, 600).ravel() - wanted) ** 2).sum()
    assert found <= least * (1 + 1e-4)


@pytest.mark.parametrize("solve", [maximize, minimize])
def test_the_unit_of_powers_is_the_unit_of_the_image(solve):
    model, power, _ = problem()
    noise = background(power)
    np.testing.assert_allclose(solve(model, 1e-9 * power, 1e-9 * noise, 10), 1e-9 * solve(model, power, noise, 10),
                               rtol=1e-3, atol=1e-16)  # fmt: skip


def test_voxels_of_zero_stay_zero_in_mlem():
    model, power, _ = problem()
    start = np.ones(SMALL.shape)
    start[0, 3:6] = 0
    image = maximize(model, power, background(power), 10, start)
    assert (image[0, 3:6] == 0).all()
    assert (image[0, :3] > 0).any()
    assert not maximize(model, power, background(power), 10, 0 * start).any()


@pytest.mark.parametrize("solve", [maximize, minimize])
def test_profiles_of_nothing_make_an_empty_image(solve):
    model, power, _ = problem()
    assert not solve(model, 0 * power, background(0 * power), 5).any()


@pytest.mark.filterwarnings("ignore:the sensor is at z:mvla_sim.errors.MvlaWarning")
@pytest.mark.parametrize("oversampling", [1, 4])
@pytest.mark.parametrize("paired", [False, True], ids=["together", "pairs"])
@pytest.mark.parametrize("method", ["mlem", "nnls"])
def test_points_are_found_at_their_places(method, paired, oversampling):
    points = np.array([[1.05, 0.55, 0.0], [-0.75, -0.45, 0.0]])
    options = {"grid.size_m": [4.0, 4.0, 0.0], "grid.spacing_m": 0.1, "pdp.oversampling": oversampling}
    image = reconstruct(
        scatterers(points, somewhere(24, paired)), imaging_settings(method=method, snr_db=20, **options)
    )
    assert image.support_deg is None
    assert image.score.min() >= 0
    best = image.grid.centers(np.argsort(-image.score.ravel())[:2])
    assert np.abs(best[np.argsort(-best[:, 0])] - points).max() < 0.05  # their own voxels


@pytest.mark.parametrize("method", ["mlem", "nnls"])
def test_points_are_found_in_a_volume(method):
    options = {"grid.size_m": [2.0, 2.0, 1.0], "grid.spacing_m": 0.2}
    image = reconstruct(
        scatterers([[0.3, -0.5, 0.2]], somewhere(16, False)), imaging_settings(method=method, **options)
    )
    assert image.score.shape == (5, 10, 10)
    np.testing.assert_allclose(image.grid.centers(image.score.argmax()), [0.3, -0.5, 0.2], atol=0.01)


@pytest.mark.parametrize("method", ["mlem", "nnls"])
def test_what_no_view_sees_is_zero(method):
    """A gate that ends before the far side."""
    views = ring(1)
    far = twin.distances(LAYER.centers(), views.positions_m[0]) > 10.1
    options = {"grid.size_m": [9.2, 8.6, 0.0], "grid.center_m": [0.1, -0.2, 0.0], "grid.spacing_m": 0.22}
    image = reconstruct(scatterers([[1.0, 0.5, 0.0]], views), imaging_settings(
        method=method, snr_db=None, **options, pdp={"gate_m": [5.0, 10.0]}))  # fmt: skip
    assert image.score.shape == LAYER.shape
    assert 0.2 < far.mean() < 0.8
    assert not image.score.ravel()[far].any()
    assert image.score.any()


@pytest.mark.parametrize("method", ["mlem", "nnls"])
@pytest.mark.parametrize("value", [0, -3, 10_001, 2.5, "many"])
def test_bounds_of_the_settings_are_one_line(method, value):
    with pytest.raises(ConfigError, match=rf"{method}\.iterations") as caught:
        imaging_settings(**{f"{method}.iterations": value})
    assert "\n" not in str(caught.value)


def test_an_image_of_another_grid_is_refused():
    with pytest.raises(ConfigError, match=r"image has shape \(3, 4\), the grid \(1, 11, 12\)"):
        forward(SMALL, ring(3), np.zeros((3, 4)), start_m=9.0, step_m=0.1, count=20)


def test_forward_needs_no_other_import_first():
    """Dr.Jit must not be loaded before the backend has chosen its library, nor by an import."""
    code = """
import sys
import numpy as np
from mvla_sim.imaging.forward import forward
from mvla_sim.imaging.methods import mlem, nnls
from mvla_sim.grid import VoxelGrid
from mvla_sim.scene.views import Views
assert "drjit" not in sys.modules
views = Views(np.array([[10.0, 0.0, 0.0]]), np.zeros(1), (0.0, 0.0))
seen = forward(VoxelGrid((0, 0, 0), (1, 1, 1), 0.1), views, np.ones((1, 1, 1)), start_m=8.0, step_m=0.5, count=9)
assert np.allclose(seen, np.eye(9)[4])
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
