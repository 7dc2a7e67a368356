"""The compiled projector against its slow twin, and its invariances."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import twin
from cases import make_peaks, per_view, random_peaks, ring, views_at
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.likelihood import MvlaSettings, hard_profiles, kernel_scales, likelihood_profiles
from mvla_sim.imaging.methods.bp import backprojection_profiles
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.projection import RangeProfiles, check_grid, project

SIGMA, RADIUS = 0.025, 0.32  # the paper's κ = 0.5 and η = 0.04 at 3 GHz and D = 8 m
LAYER = VoxelGrid((0.0, 0.0, 0.0), (120, 110, 1), 0.08)
BLOCK = VoxelGrid((0.3, -0.2, 0.1), (31, 23, 17), 0.2)
POINT = VoxelGrid((0.0, 0.0, 0.0), (1, 1, 1), 0.1)  # 10 m from every sensor of a ring


def soft(grid, views, peaks, sigma=SIGMA, radius=RADIUS, **options):
    return project(
        grid, views, likelihood_profiles(peaks, sigma, radius, grid.range_span_m(views.positions_m)), **options
    )


def compare(grid, views, peaks):
    """Score and Θ of a closed trajectory against the twin."""
    result = soft(grid, views, peaks)
    points = grid.centers()
    expected = twin.score(points, views.positions_m, per_view(peaks), SIGMA, RADIUS)
    # Linear interpolation at 16 nodes a σ errs by 4.9e-4 of a kernel's peak; float32 adds a few 1e-6 a view.
    np.testing.assert_allclose(result.total.ravel(), expected, rtol=0, atol=1e-3 * max(expected.max(), 1e-3))
    b = twin.supports(points, views.positions_m, per_view(peaks), RADIUS)
    widths = twin.support_widths(views.angles_deg, b, closed=True)
    # A voxel within 1e-6 m of the edge of R_T may fall on either side in float32, and so may one in a gap between two
    # peaks' supports that is narrower than two nodes.
    agree = np.abs(result.support_deg.ravel() - widths) < 1e-3  # degrees; sums of float32 gaps
    assert agree.mean() >= 0.9999
    return result


@pytest.mark.parametrize("counts", [[10] * 24, [1] * 24, [200, 0, 1, 30] * 6, [0] * 23 + [1]])
def test_score_and_support_equal_the_twin(counts):
    rng = np.random.default_rng(len(set(counts)) + sum(counts))
    compare(LAYER, ring(len(counts)), random_peaks(rng, counts, 3.0, 17.0))


def test_score_and_support_equal_the_twin_in_3d():
    """A volume, and sensors that are neither in its plane nor at one height."""
    rng = np.random.default_rng(3)
    views = ring(20, radius_m=7.0)
    positions = views.positions_m.copy()
    positions[:, 2] = rng.uniform(-2, 5, 20)
    views = type(views)(positions, views.angles_deg, views.center_m)
    compare(BLOCK, views, random_peaks(rng, [8] * 20, 3.0, 11.0))


def test_score_equals_the_twin_where_the_kernel_is_cut_short():
    """R_T = σ_R (η = 0): the kernel ends at exp(−1/2) of its height, and its edge must be sharp."""
    rng = np.random.default_rng(4)
    peaks = make_peaks([[(r, 1.0) for r in rng.uniform(0, 0.5) + np.arange(4, 16, 1.0)] for _ in range(24)])
    views, sigma = ring(24), 0.1
    result = soft(LAYER, views, peaks, sigma, sigma)
    expected = twin.score(LAYER.centers(), views.positions_m, per_view(peaks), sigma, sigma)
    wrong = np.abs(result.total.ravel() - expected) > 1e-3 * expected.max()
    # Each view's edge decides wrongly within float32's 1e-6 m: 24 views × 24 edges × 2e-6 m of a span of 12 m.
    assert wrong.mean() <= 2e-4


def test_one_view_many_views_and_order_of_the_width():
    """Θ across 0°/360°, of one view, of all views, of every other view."""
    at_center = [[(10.0, 1.0)]]
    nothing = [[]]

    def width(pattern):
        views = ring(len(pattern))
        peaks = make_peaks((at_center if hit else nothing)[0] for hit in pattern)
        return float(soft(POINT, views, peaks).support_deg.item())

    assert width([1] + [0] * 35) == 0
    assert width([1] * 36) == 350  # the cut at any gap of 10°
    assert width([1, 0] * 18) == 0
    assert width([1, 1, 0] * 12) == 10
    assert width([1, 1] + [0] * 32 + [1, 1]) == 30  # 340°, 350°, 0°, 10°
    assert width([0] + [1] * 35) == 340
    assert width([1] * 35 + [0]) == 340
    assert width([1] * 17 + [0] + [1] * 17 + [0]) == 160
    assert width([1] * 20 + [0] + [1] * 14 + [0]) == 190


def test_all_views_of_an_uneven_ring_are_cut_at_the_smallest_gap():
    angles = [0, 20, 35, 60, 90, 120, 145, 180, 200, 230, 255, 280, 310, 330]
    views = views_at(angles)
    assert views.closed
    assert soft(POINT, views, make_peaks([[(10.0, 1.0)]] * 14)).support_deg.item() == pytest.approx(360 - 15)


@pytest.mark.parametrize("start", [0.0, 20.0, -45.0, 300.0, 271.0])
@pytest.mark.parametrize("turn", [1, -1])
def test_arc_does_not_wrap_but_may_cross_zero(start, turn):
    """Views on an open arc of 90°, wherever it lies and whichever way it runs."""
    angles = start + np.arange(0, 91, 2.0)[::turn]
    views = views_at(angles)
    assert not views.closed

    def width(pattern):
        peaks = make_peaks([[(10.0, 1.0)] if hit else [] for hit in pattern])
        return soft(POINT, views, peaks).support_deg.item()

    count = len(angles)
    assert width([1] * count) == pytest.approx(90, abs=1e-4)  # sums of float32 gaps
    assert width([1] + [0] * (count - 2) + [1]) == 0  # both ends, nothing between
    assert width([1] * 5 + [0] * (count - 8) + [1] * 3) == pytest.approx(8, abs=1e-4)
    middle = count // 2
    pattern = [abs(k - middle) <= 10 for k in range(count)]
    assert width(pattern) == pytest.approx(40, abs=1e-4)


@settings(max_examples=30)
@given(st.lists(st.booleans(), min_size=3, max_size=40), st.integers(0, 359))
def test_width_equals_the_twin_for_any_pattern(pattern, start):
    views = ring(len(pattern), start_deg=float(start))
    if not any(pattern):
        pattern = [True, *pattern[1:]]
    peaks = make_peaks([[(10.0, 1.0)] if hit else [] for hit in pattern])
    order = np.argsort(views.angles_deg)
    expected = twin.support_width(views.angles_deg[order], np.array(pattern)[order], closed=True)
    result = soft(POINT, views, peaks)
    assert result.support_deg.item() == pytest.approx(expected, abs=1e-3)  # degrees; sums of float32 gaps
    assert result.total.item() == pytest.approx(sum(pattern), abs=1e-3 * len(pattern))


@pytest.mark.parametrize("grid", [LAYER, BLOCK])
def test_backprojection_equals_interpolation(grid):
    rng = np.random.default_rng(5)
    views = ring(24, radius_m=8.0, height_m=1.0)
    pdp = Pdp(rng.exponential(size=(24, 500)), None, 4.0, 0.02, 0.05, 1.5)  # shorter than the ranges that are seen
    result = project(grid, views, backprojection_profiles(pdp))
    assert result.support_deg is None
    expected = twin.backprojection(grid.centers(), views.positions_m, pdp.power / pdp.power.max(), pdp.range_m)
    # A range is good to 1e-6 m in float32: 5e-5 of a sample, over which white power changes by up to its maximum.
    error = np.abs(result.total.ravel() - expected)
    assert np.quantile(error, 0.999) < 24 * 1e-4
    # At an end of the axis the same 1e-6 m decides whether a view counts at all.
    assert error.max() <= 1.0


def test_voxel_at_the_very_end_of_the_axis_receives_nothing_beyond():
    profiles = RangeProfiles(np.ones((1, 11), np.float32), 9.0, 0.1)
    grid = VoxelGrid((0.0, 0.0, 0.0), (81, 1, 1), 0.05)
    total = project(grid, views_at([0.0]), profiles).total.ravel()
    ranges = 10 - grid.axes()[0]
    np.testing.assert_array_equal(total[(ranges > 9.01) & (ranges < 9.99)], 1)
    np.testing.assert_array_equal(total[(ranges < 8.99) | (ranges > 10.01)], 0)


@pytest.mark.parametrize("block", [1, 7, 1000, 1 << 13])
def test_size_of_blocks_changes_no_bit(block):
    grid = LAYER if block > 7 else VoxelGrid((0, 0, 0), (9, 7, 1), 1.0)
    rng = np.random.default_rng(6)
    views, peaks = ring(24), random_peaks(rng, [10] * 24, 3.0, 17.0)
    whole, parts = soft(grid, views, peaks), soft(grid, views, peaks, block=block)
    assert np.array_equal(whole.total, parts.total)
    assert np.array_equal(whole.support_deg, parts.support_deg)
    pdp = backprojection_profiles(Pdp(rng.exponential(size=(24, 1500)), None, 2.0, 0.01, 0.05, 1.5))
    assert np.array_equal(project(grid, views, pdp).total, project(grid, views, pdp, block=block).total)


@settings(max_examples=10)
@given(st.permutations(range(24)))
def test_order_of_the_views_changes_nothing(order):
    """Not even the order of summation: the projector always follows the angle."""
    rng = np.random.default_rng(7)
    views, peaks, order = ring(24), random_peaks(rng, [10] * 24, 3.0, 17.0), np.array(order)
    one, other = soft(LAYER, views, peaks), soft(LAYER, views.select(order), peaks.select(order))
    assert np.array_equal(one.total, other.total)
    assert np.array_equal(one.support_deg, other.support_deg)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_turning_peaks_and_sensors_turns_the_image(quarters):
    rng = np.random.default_rng(8)
    grid = VoxelGrid((0.0, 0.0, 0.0), (120, 120, 1), 0.08)
    peaks = random_peaks(rng, [10] * 24, 3.0, 17.0)
    one = soft(grid, ring(24), peaks)
    other = soft(grid, ring(24, start_deg=90.0 * quarters), peaks)
    # x to y is counter-clockwise for us; rot90 turns the axes it is given the other way round, as rows are y.
    np.testing.assert_allclose(np.rot90(one.total[0], -quarters), other.total[0], atol=24 * 1e-4)  # float32 ranges
    same = np.rot90(one.support_deg[0], -quarters) == other.support_deg[0]
    assert same.mean() > 0.999  # voxels within float32 of the edge of R_T


def test_hard_vote_counts_supporting_views():
    rng = np.random.default_rng(9)
    views, peaks = ring(24), random_peaks(rng, [10, 0, 3] * 8, 3.0, 17.0)
    profiles = hard_profiles(peaks, 0.05, LAYER.range_span_m(views.positions_m))
    result = project(LAYER, views, profiles)
    b = twin.supports(LAYER.centers(), views.positions_m, per_view(peaks), 0.05)
    exact = result.total.ravel() == b.sum(axis=0)
    assert exact.mean() >= 0.9999 * 0.999  # edges within float32, 24 views × 20 edges × 1e-6 m of 14 m, and merged gaps
    assert np.abs(result.total.ravel() - b.sum(axis=0)).max() <= 1


def test_weights_sum_to_one_so_a_score_is_at_most_one_a_view():
    rng = np.random.default_rng(10)
    views, peaks = ring(12), random_peaks(rng, [6] * 12, 8.0, 12.0)
    np.testing.assert_allclose(np.bincount(peaks.view, peaks.weight), 1, rtol=1e-12)
    total = soft(LAYER, views, peaks).total
    assert total.min() >= 0
    assert total.max() <= 12 * (1 + 1e-6)  # float32


def test_kernel_scales_are_the_papers():
    assert kernel_scales(MvlaSettings(kappa=0.5, eta=0.04), 0.05, 8.0) == pytest.approx((0.025, 0.32))
    assert kernel_scales(MvlaSettings(kappa=2.0, eta=0.001), 0.05, 8.0) == pytest.approx((0.1, 0.1))  # max(σ_R, η·D)
    assert kernel_scales(MvlaSettings(kappa=0.5, eta=0.0), 0.05, float("nan")) == pytest.approx((0.025, 0.025))
    assert kernel_scales(MvlaSettings(eta=0.1, extent_m=3.0), 0.05, 8.0)[1] == pytest.approx(0.3)
    with pytest.raises(ConfigError, match=r"mvla\.extent_m"):
        kernel_scales(MvlaSettings(), 0.05, float("nan"))


@pytest.mark.parametrize("counts", [(7, 5, 3), (1, 9, 1), (1, 1, 6), (40, 1, 1), (3, 2, 2)])
@pytest.mark.parametrize("block", [1, 3, 16, 1 << 18])
def test_shape_of_grid_and_size_of_blocks_change_nothing(counts, block):
    """Rows that no thread's share divides, layers, and rows longer than a block: the sum over views, voxel by voxel."""
    grid, views = VoxelGrid((0.1, -0.2, 0.3), counts, 0.11), ring(7)
    values = np.random.default_rng(1).random((7, 80)).astype(np.float32)
    found = project(grid, views, RangeProfiles(values, 8.0, 0.05), block=block).total
    ranges = np.linalg.norm(grid.centers()[:, None] - views.positions_m, axis=-1)
    nodes = 8.0 + 0.05 * np.arange(80)
    expected = sum(np.interp(ranges[:, m], nodes, values[m], 0.0, 0.0) for m in range(7))
    np.testing.assert_allclose(found.ravel(), expected, rtol=2e-4)


def test_bad_input_is_refused():
    with pytest.raises(ConfigError, match="3 profiles for 4 views"):
        project(POINT, ring(4), RangeProfiles(np.ones((3, 5), np.float32), 9.0, 0.1))
    with pytest.raises(ConfigError, match="n_range"):
        RangeProfiles(np.ones((3, 1), np.float32), 9.0, 0.1)
    with pytest.raises(ConfigError, match="nearest"):
        RangeProfiles(np.ones((3, 5), np.float32), 9.0, 0.1, np.ones((3, 4), np.float32))


def test_grid_too_large_for_the_memory_is_refused_with_one_that_fits():
    with pytest.raises(ConfigError, match=r"grid\.spacing_m = 1e-05.*GiB.*a spacing of .* m fits"):
        check_grid(VoxelGrid((0, 0, 0), (10**6, 10**6, 1), 1e-5))


def test_projecting_needs_no_other_import_first():
    """Dr.Jit must not be loaded before the backend has chosen its library, in a process that only projects."""
    code = """
import numpy as np
from mvla_sim.imaging.projection import RangeProfiles, project
from mvla_sim.grid import VoxelGrid
from mvla_sim.scene.views import Views
views = Views(np.array([[10.0, 0.0, 0.0]]), np.zeros(1), (0.0, 0.0))
profiles = RangeProfiles(np.ones((1, 50), np.float32), 8.0, 0.1)
assert project(VoxelGrid((0, 0, 0), (1, 1, 1), 0.1), views, profiles).total.item() == 1
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
