"""The bounded and stepped threshold search against trying every pair that it may choose, in exact fractions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threshold_problems import decibels, every_threshold, problems, thresholded

from mvla_sim.errors import ConfigError
from mvla_sim.evaluation import tuning
from mvla_sim.evaluation.candidates import SUPPORTS_DEG, TOP_PERCENTS, chamfer_table, worst_db
from mvla_sim.evaluation.evaluate import EvaluationSettings, evaluate
from mvla_sim.evaluation.scan import ScanSettings
from mvla_sim.evaluation.tuning import TruthGeometry, optimal_thresholds
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.thresholds import top_count
from mvla_sim.settings import parse


def percents(scan, grid):
    """Every p that may be chosen, with its n, in the words of the settings' descriptions."""
    if scan.step_percent is None:
        pairs = [(100 * n / grid.size, n) for n in range(1, grid.size + 1)]
    else:
        steps = int(round(100 / scan.step_percent, 9))
        pairs = [(p, top_count(p, grid.size)) for p in (round(k * scan.step_percent, 12) for k in range(1, steps + 1))]
    if scan.max_percent is not None:
        pairs = [(p, n) for p, n in pairs if p <= scan.max_percent * (1 + 1e-9)]
    if scan.max_area_m2 is not None:
        pairs = [(p, n) for p, n in pairs if n * grid.spacing_m**2 <= scan.max_area_m2 * (1 + 1e-9)]
    return pairs


def supports(scan, theta):
    values = {0.0} if theta is None else {0.0, *map(float, theta.ravel())}
    if scan.support_step_deg is not None:
        values = {round(k * scan.support_step_deg, 12) for k in range(1 + int(max(values) / scan.support_step_deg))}
    return sorted(t for t in values if scan.max_support_deg is None or t <= scan.max_support_deg)


def best_of_all(score, theta, truth, scan, grid):
    """(CD in spacing², T_θ, n, p), the first by T_θ and then by n of the least."""
    curves = {}
    for value, level, n in every_threshold(score, theta, truth):
        curves.setdefault(level, []).append((n, value))
    tried = []
    for support in supports(scan, theta):
        above = [level for level in curves if level >= np.float32(support)]  # as the angular test compares
        curve = curves[min(above)] if above else []
        for percent, n in percents(scan, grid):
            ended = [value for last, value in curve if last <= n]
            if ended:
                tried.append((ended[-1], support, n, percent))
    return min(tried)


@st.composite
def scans(draw, grid):
    """Bounds and steps of every kind that leave something to try."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    voxel = 100 / grid.size
    chosen = {}
    if rng.random() < 0.6:
        chosen["step_percent"] = float(rng.choice([voxel, 3 * voxel, 0.7 * voxel, 5.0, 12.5, 100.0]).clip(0.01, 100))
    least = max(voxel, chosen.get("step_percent", 0))
    if rng.random() < 0.6:
        percent = float(min(100, least * rng.choice([1.0, 1.5, 4.0, 30.0])))
        area = percent / 100 * grid.size * grid.spacing_m**2
        chosen |= {"max_percent": percent} if rng.random() < 0.5 else {"max_area_m2": area + 0.5 * grid.spacing_m**2}
    if rng.random() < 0.5:
        chosen["max_support_deg"] = float(rng.choice([0.0, 4.9, 10.0, 29.0, 55.5, 360.0]))
    if rng.random() < 0.5:
        chosen["support_step_deg"] = float(rng.choice([0.7, 5.0, 7.0, 40.0, 200.0]))
    return ScanSettings(**chosen)


@pytest.mark.usefixtures("sizes")
def test_the_optimum_is_the_best_of_what_is_scanned():
    @given(problem=problems(), data=st.data())
    @settings(max_examples=40, deadline=None)
    def check(problem, data):
        grid, truth, score, theta = problem
        scan = data.draw(scans(grid))
        value, support, n, percent = best_of_all(score, theta, truth, scan, grid)
        best = optimal_thresholds(score, theta, TruthGeometry.build(truth, grid), scan)
        assert (best.min_support_deg, best.n_top) == (support, n)
        assert best.top_percent == pytest.approx(percent, rel=1e-12)
        assert best.cd_db == pytest.approx(decibels(value, grid), abs=1e-9)  # rounding of one logarithm
        assert best.n_retained == np.count_nonzero(thresholded(score, theta, n, np.float32(support)))

    check()


@given(problem=problems())
@settings(max_examples=30, deadline=None)
def test_a_bound_that_holds_the_optimum_changes_nothing(problem):
    """To the bit; and one just below it never finds a better one."""
    grid, truth, score, theta = problem
    geometry = TruthGeometry.build(truth, grid)
    best = optimal_thresholds(score, theta, geometry)
    area = best.n_top * grid.spacing_m**2
    for scan in (
        ScanSettings(max_percent=best.top_percent, max_support_deg=best.min_support_deg),
        ScanSettings(max_area_m2=area, max_support_deg=360.0),
    ):
        assert optimal_thresholds(score, theta, geometry, scan) == best
    if best.n_top > 1:
        less = optimal_thresholds(score, theta, geometry, ScanSettings(max_area_m2=area * (1 - 1e-6)))
        assert less.cd_db >= best.cd_db
        assert less.n_top < best.n_top


def many_levels():
    """A problem as an experiment's: 120 × 120 voxels, a ring that is brighter than its surroundings, Θ of its own."""
    rng = np.random.default_rng(5)
    grid = VoxelGrid((0, 0, 0), (120, 120, 1), 0.05)
    x, y, _ = grid.centers().T
    off = np.abs(np.hypot(x, y) - 2)
    truth = (off < 0.05).reshape(grid.shape)
    score = (np.exp(-((off / 0.2) ** 2)) + 0.5 * rng.random(grid.size)).astype(np.float32).reshape(grid.shape)
    theta = np.round(90 * np.exp(-off) * rng.random(grid.size)).astype(np.float32).reshape(grid.shape)
    return grid, truth, score, theta


@pytest.mark.parametrize(
    "scan",
    [
        {"max_percent": 5.0},
        {"step_percent": 0.5},
        {"step_percent": 0.05, "support_step_deg": 1.0},
        {"step_percent": 0.01},
    ],
    ids=str,
)
def test_a_scan_takes_no_more_work_than_the_exact_search(monkeypatch, scan):
    """Work is what rows of T_θ hold when they are opened; a coarse step must not make bounds so loose that all are."""
    grid, truth, score, theta = many_levels()
    geometry = TruthGeometry.build(truth, grid)
    sizes_, opened = [], tuning._Row.open

    def counted(ranking, level, limit):
        sizes_.append(limit)
        return opened(ranking, level, limit)

    monkeypatch.setattr(tuning._Row, "open", counted)
    work = []
    for chosen in (ScanSettings(), ScanSettings(**scan)):
        sizes_.clear()
        optimal_thresholds(score, theta, geometry, chosen)
        work.append((len(sizes_), sum(sizes_)))
    assert work[1][0] <= work[0][0] + 5
    assert work[1][1] <= work[0][1] * 1.1


def test_the_area_is_that_of_the_set_before_the_angular_test():
    """In layers too: three layers of 3 × 3 voxels of 1 m side, 10 m² are ten voxels of all layers."""
    grid = VoxelGrid((0, 0, 0), (3, 3, 3), 1.0)
    truth = np.ones(grid.shape, bool)
    score = np.arange(27, dtype=np.float32).reshape(grid.shape)
    best = optimal_thresholds(score, None, TruthGeometry.build(truth, grid), ScanSettings(max_area_m2=10.0))
    assert (best.n_top, best.area_m2) == (10, 10.0)


def test_the_oracle_of_an_evaluation_scans_what_it_is_told():
    """A disc brighter towards its middle; the optimum keeps it all, a tenth of it is within the bound."""
    grid, truth, score, theta = many_levels()
    image = Image(score=score, support_deg=theta, grid=grid, method="mvla-gr", n_view=3)
    geometry = TruthGeometry.build(truth, grid)
    free = evaluate(image, EvaluationSettings(), geometry)
    scan = {"step_percent": 0.1, "max_percent": 0.5, "support_step_deg": 2.0, "max_support_deg": 8.0}
    bounded = evaluate(image, EvaluationSettings(scan=scan), geometry)
    assert free.top_percent > 0.5
    assert bounded.top_percent in (0.1, 0.2, 0.3, 0.4, 0.5)
    assert bounded.min_support_deg in (0.0, 2.0, 4.0, 6.0, 8.0)
    assert bounded.cd_db > free.cd_db
    assert bounded.cd_db == bounded.optimum.cd_db  # the pair reported gives the distance reported
    assert np.count_nonzero(bounded.occupied) == bounded.optimum.n_retained


def test_candidates_of_a_calibration_outside_the_bounds_are_failures():
    grid, truth, score, theta = many_levels()
    image = Image(score=score, support_deg=theta, grid=grid, method="mvla-gr", n_view=3)
    geometry = TruthGeometry.build(truth, grid)
    free = chamfer_table(image, geometry)
    bounded = chamfer_table(image, geometry, ScanSettings(max_percent=2.0, max_support_deg=20.0))
    inside = np.outer(np.array(SUPPORTS_DEG) <= 20, [top_count(p, grid.size) <= 0.02 * grid.size for p in TOP_PERCENTS])
    np.testing.assert_array_equal(bounded, np.where(inside, free, np.float32(worst_db(grid))))
    assert (free[~inside] < worst_db(grid) - 1).any()


@pytest.mark.parametrize(
    ("scan", "words"),
    [
        ({"max_percent": 0.0}, "scan.max_percent = 0.0: should be greater than 0"),
        ({"max_percent": 101.0}, "scan.max_percent = 101.0: should be less than or equal to 100"),
        ({"max_area_m2": -1.0}, "scan.max_area_m2 = -1.0: should be greater than 0"),
        ({"step_percent": 0.0}, "scan.step_percent = 0.0: should be greater than or equal to 0.0001"),
        ({"max_support_deg": -1.0}, "scan.max_support_deg = -1.0: should be greater than or equal to 0"),
        ({"support_step_deg": 0.0}, "scan.support_step_deg = 0.0: should be greater than or equal to 0.001"),
        ({"max_percent": 1.0, "max_area_m2": 1.0}, "scan.max_percent and scan.max_area_m2 both bound p; keep one"),
        ({"max_percent": 1.0, "step_percent": 2.0}, "scan.step_percent = 2 is above scan.max_percent = 1"),
        ({"max_pct": 1.0}, "scan.max_pct: unknown key (did you mean 'max_percent'?)"),
    ],
    ids=str,
)
def test_bad_scans_are_refused(scan, words):
    with pytest.raises(ConfigError) as error:
        parse(EvaluationSettings, {"scan": scan}, "evaluation settings")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("scan", "words"),
    [
        (
            {"max_area_m2": 0.002},
            "evaluation.scan.max_area_m2 = 0.002: is below one voxel of the grid; must be",
        ),
        (
            {"max_percent": 0.005},
            "evaluation.scan.max_percent = 0.005: is below one voxel of the grid; must be",
        ),
        ({"max_area_m2": 0.003, "step_percent": 1.0}, "0.003: is below one step of 1 %; must be at least 0.36 m²"),
    ],
    ids=str,
)
def test_bounds_that_hold_no_voxel_are_refused(scan, words):
    grid, truth, score, theta = many_levels()
    with pytest.raises(ConfigError) as error:
        optimal_thresholds(score, theta, TruthGeometry.build(truth, grid), ScanSettings(**scan))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_bound_of_exactly_one_voxel_is_one_voxel():
    grid, truth, score, theta = many_levels()
    best = optimal_thresholds(score, theta, TruthGeometry.build(truth, grid), ScanSettings(max_area_m2=0.05**2))
    assert best.n_top == 1
    assert math.isfinite(best.cd_db)
