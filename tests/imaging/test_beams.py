"""Beams, pairs of transmitter and receiver, and directions that several views share, against the slow twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import twin
from cases import PAPER_METHODS, channel, make_peaks, per_view, random_peaks, ring, scatterers, views_at
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.importing import import_channel, import_settings
from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import BeamSettings, build_beam
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.likelihood import likelihood_profiles
from mvla_sim.imaging.methods.bp import backprojection_profiles
from mvla_sim.imaging.pdp import Pdp
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.imaging.projection import project
from mvla_sim.scene.antennas.horn import Horn
from mvla_sim.scene.antennas.omni import Omni
from mvla_sim.scene.antennas.pattern_file import PatternFile
from mvla_sim.scene.views import Views

SIGMA, RADIUS = 0.025, 0.32  # the paper's κ = 0.5 and η = 0.04 at 3 GHz and D = 8 m
LAYER = VoxelGrid((0.1, -0.2, 0.0), (22, 19, 1), 0.44)
BLOCK = VoxelGrid((0.3, -0.2, 0.1), (8, 7, 6), 0.8)
POINT = VoxelGrid((0.0, 0.0, 0.0), (1, 1, 1), 0.1)
EDGE_DB = 1e-3
"""A voxel this near to a beam's edge may fall on either side: angles are good to some 1e-4° in float32, and the
steepest pattern here falls by 3 dB a degree."""
GAUSSIAN = Horn(azimuth_beamwidth_deg=30.0, elevation_beamwidth_deg=20.0)
COSINE = Horn(shape="cosine", azimuth_beamwidth_deg=25.0)


@pytest.fixture(scope="module")
def lopsided(tmp_path_factory):
    """A measured pattern whose sides differ, so that left and right or up and down cannot be mistaken."""
    file = tmp_path_factory.mktemp("antenna") / "pattern.csv"
    file.write_text(
        "angle_deg,azimuth_db,elevation_db\n-60,-30,-25\n-20,-4,-12\n0,0,0\n5,-1,-2\n15,-9,-3.4\n60,-30,-28\n"
    )
    return PatternFile(file=str(file))


def moved(views, seed, lift_m=2.0, apart_m=0.0, turn_deg=None):
    """Views at random heights, with receivers up to ``apart_m`` away along each axis, turned off the centre."""
    rng = np.random.default_rng(seed)
    count = len(views)
    positions = views.positions_m + np.column_stack([np.zeros((count, 2)), rng.uniform(-lift_m, lift_m, count)])
    receivers = positions + rng.uniform(-apart_m, apart_m, (count, 3)) if apart_m else None
    views = Views(positions, views.angles_deg, views.center_m, receivers)
    if turn_deg is None:
        return views
    off = np.deg2rad(rng.uniform(-turn_deg, turn_deg, (count, 2)))
    azimuth = np.arctan2(*-views.midpoints_m[:, 1::-1].T) + off[:, 0]
    up = np.arctan2(-positions[:, 2], 9.0) + off[:, 1]
    return replace(
        views, boresights=np.stack([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)], axis=1)
    )


def storeys(angles_deg, heights_m=(-0.8, 0.3, 1.5), radius_m=9.0):
    """All angles once at each height."""
    angles = np.tile(angles_deg, len(heights_m))
    turn = np.deg2rad(angles)
    z = np.repeat(heights_m, len(angles_deg))
    return Views(
        np.stack([radius_m * np.cos(turn), radius_m * np.sin(turn), z], axis=1), np.mod(angles, 360), (0.0, 0.0)
    )


def soft(grid, views, peaks, beam=None, **options):
    span = grid.range_span_m(views.positions_m, views.receivers_m)
    return project(grid, views, likelihood_profiles(peaks, SIGMA, RADIUS, span), beam=beam, **options)


def aimed(views):
    """Boresights, written out anew: given, or from the middle of a pair horizontally at the centre."""
    if views.boresights is not None:
        return views.boresights
    receivers = views.positions_m if views.receivers_m is None else views.receivers_m
    rows = []
    for transmitter, receiver in zip(views.positions_m, receivers, strict=True):
        x, y = np.array(views.center_m) - (transmitter[:2] + receiver[:2]) / 2
        rows.append([x / np.hypot(x, y), y / np.hypot(x, y), 0.0])
    return np.array(rows)


def seen(grid, views, antenna, edge_db=-3.0):
    """Covers c_mn ``[n_view, n]`` by the twin, and which voxels ``[n]`` are near no view's edge."""
    points = grid.centers()
    if isinstance(antenna, Omni):
        return np.ones((len(views), len(points)), bool), np.ones(len(points), bool)
    level = twin.levels_db(points, views, antenna.pattern(), aimed(views))
    return level >= edge_db, (np.abs(level - edge_db) > EDGE_DB).all(axis=0)


def compare(grid, views, peaks, antenna, edge_db=-3.0):
    """Score, coverage and Θ against the twin."""
    result = soft(grid, views, peaks, build_beam(antenna, BeamSettings(edge_db=edge_db)))
    covered, sure = seen(grid, views, antenna, edge_db)
    assert sure.mean() > 0.98  # or nothing would be compared
    points, ends = grid.centers(), twin.ends(views)
    expected = twin.score(points, ends, per_view(peaks), SIGMA, RADIUS, covered=covered)
    # Linear interpolation at 16 nodes a σ errs by 4.9e-4 of a kernel's peak; float32 adds a few 1e-6 a view.
    error = np.abs(result.total.ravel() - expected)[sure]
    assert error.max() <= 1e-3 * max(expected.max(), 1e-3)
    if not isinstance(antenna, Omni):
        np.testing.assert_array_equal(result.coverage.ravel()[sure], covered.sum(axis=0)[sure])
    b = twin.supports(points, ends, per_view(peaks), RADIUS)
    widths = twin.direction_widths(views.angles_deg, b, covered, views.closed)
    assert np.unique(widths[sure]).size > 3  # Θ of few values would be no test
    agree = np.abs(result.support_deg.ravel() - widths)[sure] < 1e-3  # degrees; sums of float32 gaps
    # Within 1e-6 m of the edge of R_T float32 decides, and so it may in a gap between two peaks' supports that is
    # narrower than two nodes: per view some 20 edges of a few 1e-6 m and a gap now and then, over a span of 10 m.
    assert agree.mean() >= 0.999
    return result


RING, ARC = ring(24, radius_m=9.0), views_at(np.arange(-70.0, 71.0, 7.0), radius_m=9.0)
SHARED = [0.0, 20.0, 40.0, 75.0, 90.0, 140.0, 165.0, 200.0, 245.0, 270.0, 300.0, 340.0]
VIEWS = {
    "closed": RING,
    "open": ARC,
    "clockwise": views_at(-15.0 * np.arange(24), radius_m=9.0),
    "pairs": moved(RING, 1, lift_m=0.5, apart_m=1.0),
    "open pairs": moved(ARC, 2, lift_m=0.5, apart_m=1.0),
    "turned": moved(RING, 3, lift_m=1.0, turn_deg=15.0),
    "turned pairs": moved(RING, 4, lift_m=1.0, apart_m=0.6, turn_deg=20.0),
    "storeys": storeys(SHARED),
    "open storeys": storeys(np.arange(200.0, 400.0, 12.0)),
    "storeys of turned pairs": moved(storeys(SHARED), 5, lift_m=0.2, apart_m=0.6, turn_deg=15.0),
}


@pytest.mark.parametrize("kind", VIEWS)
@pytest.mark.parametrize("antenna", ["omni", "gaussian", "file"])
def test_score_coverage_and_support_equal_the_twin(kind, antenna, lopsided):
    views = VIEWS[kind]
    rng = np.random.default_rng(len(kind))
    peaks = random_peaks(rng, rng.integers(0, 20, len(views)), 4.0, 15.0)
    chosen = {"omni": Omni(), "gaussian": GAUSSIAN, "file": lopsided}[antenna]
    compare(LAYER, views, peaks, chosen)


@pytest.mark.parametrize("kind", ["turned", "turned pairs", "storeys", "storeys of turned pairs"])
def test_score_coverage_and_support_equal_the_twin_in_3d(kind, lopsided):
    views = VIEWS[kind]
    rng = np.random.default_rng(6)
    peaks = random_peaks(rng, [10] * len(views), 4.0, 15.0)
    for antenna in (Omni(), COSINE, lopsided):
        compare(BLOCK, views, peaks, antenna)


@pytest.mark.parametrize("edge_db", [-1.0, -10.0, -39.0])
def test_other_edges_equal_the_twin(edge_db):
    rng = np.random.default_rng(7)
    compare(LAYER, VIEWS["turned pairs"], random_peaks(rng, [10] * 24, 4.0, 15.0), GAUSSIAN, edge_db)


@pytest.mark.parametrize("kind", ["closed", "turned pairs", "storeys of turned pairs"])
def test_backprojection_adds_the_views_that_cover(kind, lopsided):
    views = VIEWS[kind]
    # Smooth profiles: 1e-6 m of range in float32 moves them by 1e-6·dP/dr.
    range_m = 3.0 + 0.02 * np.arange(700)
    power = np.array([1 + np.sin(3 * range_m + m) for m in range(len(views))])
    pdp = Pdp(power, None, 3.0, 0.02, 0.05, 1.5)
    covered, sure = seen(LAYER, views, lopsided)
    result = project(LAYER, views, backprojection_profiles(pdp), beam=build_beam(lopsided, BeamSettings()))
    expected = twin.backprojection(LAYER.centers(), twin.ends(views), power / power.max(), range_m, covered)
    np.testing.assert_allclose(result.total.ravel()[sure], expected[sure], rtol=0, atol=len(views) * 1e-5)
    np.testing.assert_array_equal(result.coverage.ravel()[sure], covered.sum(axis=0)[sure])
    assert result.support_deg is None
    assert 0 < covered.mean() < 0.6


# One voxel, and views that are told one by one whether they see it and whether they support it.


def told(angles_deg, covers, heights_m=None):
    """Views that look at the origin, or away from it where they shall not see it."""
    views = views_at(angles_deg, radius_m=10.0)
    heights = np.zeros(len(views)) if heights_m is None else np.asarray(heights_m, float)
    positions = views.positions_m + np.column_stack([np.zeros((len(views), 2)), heights])
    towards = -positions / np.linalg.norm(positions, axis=1, keepdims=True)
    return Views(positions, views.angles_deg, (0.0, 0.0), None, np.where(covers, 1, -1)[:, None] * towards)


def at_origin(views, hits, beam=build_beam(GAUSSIAN, BeamSettings())):  # noqa: B008 - an immutable value
    """Projection onto the voxel at the origin, of views with a peak at its range where they shall hit it."""
    ranges = np.linalg.norm(views.positions_m, axis=1)
    peaks = [[(r, 1.0)] if hit else [] for r, hit in zip(ranges, hits, strict=True)]
    return soft(POINT, views, make_peaks(peaks), beam)


sights = st.tuples(st.integers(0, 23), st.booleans(), st.booleans(), st.integers(-2, 2))


@settings(max_examples=50)
@given(st.lists(sights, min_size=1, max_size=40), st.sampled_from([15.0, 7.0, 31.0]))
def test_width_follows_the_rule_of_directions(sights, spacing):
    """Any number of views at any of 24 angles, closed (15°), open (7°) or uneven (31°, beyond a turn)."""
    number, covers, hits, heights = (np.array(column) for column in zip(*sights, strict=True))
    assume(covers.any())
    views = told(np.mod(spacing * number, 360), covers, heights)
    expected = twin.direction_width(views.angles_deg, hits, covers, views.closed)
    result = at_origin(views, hits)
    assert result.support_deg.item() == pytest.approx(expected, abs=1e-3)  # degrees; sums of float32 gaps
    assert result.coverage.item() == covers.sum()
    assert result.total.item() == pytest.approx((covers & hits).sum(), abs=1e-3 * len(views))  # see compare


@settings(max_examples=20)
@given(st.lists(sights, min_size=1, max_size=40))
def test_width_without_a_beam_follows_the_rule_of_directions(sights):
    """Views that share angles by their heights alone."""
    number, _, hits, heights = (np.array(column) for column in zip(*sights, strict=True))
    views = told(15.0 * number, np.ones(len(number), bool), heights)
    expected = twin.direction_width(views.angles_deg, hits, np.ones(len(number), bool), views.closed)
    assert at_origin(views, hits, None).support_deg.item() == pytest.approx(expected, abs=1e-3)  # float32 gaps


@settings(max_examples=30)
@given(
    st.lists(st.tuples(st.booleans(), st.booleans()), min_size=12, max_size=12),
    st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=12),
    st.booleans(),
)
def test_views_that_miss_the_voxel_change_nothing(pattern, others, closed):
    """Wherever on the trajectory they are, and whether they have a peak at the voxel's range or not."""
    covers, hits = (np.array(column) for column in zip(*pattern, strict=True))
    assume(covers.any())
    span = 360.0 if closed else 110.0
    angles = span / (12 if closed else 11) * np.arange(12)
    between = np.minimum(span * np.array([share for share, _ in others]), np.nextafter(360, 0))
    few, many = told(angles, covers), told([*angles, *between], [*covers, *[False] * len(others)])
    assume(many.closed == closed)  # closed or not is decided by all views together
    one, other = at_origin(few, hits), at_origin(many, [*hits, *(hit for _, hit in others)])
    assert few.closed == closed
    assert other.support_deg.item() == pytest.approx(one.support_deg.item(), abs=1e-3)  # degrees; other float32 sums
    assert other.total.item() == pytest.approx(one.total.item(), abs=1e-5)  # ranges rounded otherwise in float32
    assert other.coverage.item() == one.coverage.item()


def test_width_where_all_that_see_the_voxel_support_it():
    """360° minus the smallest gap between those that see it; nothing of one direction alone."""
    angles = np.arange(0.0, 360.0, 10.0)

    def width(*visible, heights=None):
        chosen = np.isin(angles, visible)
        return at_origin(told(angles, chosen), np.ones(36, bool)).support_deg.item()

    assert width(*angles) == 350
    assert width(0, 90, 180, 270) == pytest.approx(270, abs=1e-3)  # float32, here and below
    assert width(0, 90, 180, 260) == pytest.approx(280, abs=1e-3)
    assert width(350, 10) == pytest.approx(340, abs=1e-3)  # over the far side, as for a pair of views 20° apart
    assert width(130) == pytest.approx(0, abs=1e-3)
    two_storeys = told([130, 130, 130], [True] * 3, [0, 1, 2])
    assert at_origin(two_storeys, [True] * 3).support_deg.item() == 0


def test_any_view_of_a_direction_supports_for_all():
    angles, heights = np.tile(np.arange(0.0, 360.0, 30.0), 2), np.repeat([0.0, 1.0], 12)
    lower, upper = heights == 0, heights == 1

    def width(hits, covers=np.ones(24, bool)):  # noqa: B008 - never written to
        return at_origin(told(angles, covers, heights), hits).support_deg.item()

    assert width(lower) == width(upper) == width(lower | upper) == 330
    assert width(lower & (angles < 180) | upper & (angles >= 180)) == 330
    assert width(lower & (angles < 90)) == 60
    # The upper storey alone sees the voxel from 90° on, and does not support it there.
    assert width(lower, lower & (angles < 90) | upper) == 60


@pytest.mark.parametrize("angle", [0.0, 45.0, 359.0])
def test_angles_that_differ_by_rounding_alone_are_one_direction(angle):
    """Three directions, of which two are there twice: once as they are and once as another way to compute them gives.
    Only one of each two supports the voxel, so Θ is 0 where they are taken for two directions."""
    twice = [angle, (angle - 1e-13) % 360, angle + 120, angle + 120 + 1e-13, angle + 240]
    hits = [True, False, False, True, False]
    views = told(np.mod(twice, 360), [True] * 5)
    for beam in (None, build_beam(GAUSSIAN, BeamSettings())):
        assert at_origin(views, hits, beam).support_deg.item() == pytest.approx(120, abs=1e-3)  # float32 gaps


# Limits and invariances.


def test_beam_that_never_meets_the_grid_is_refused_in_one_line():
    away = told([0.0, 120.0, 240.0], [False] * 3)
    with pytest.raises(ConfigError, match=r"beam\.edge_db = -3: no view's beam meets the grid; turn .*") as info:
        at_origin(away, [True] * 3)
    assert "\n" not in str(info.value)
    cir = scatterers([[0.5, 0.0, 0.0]], away, antenna=GAUSSIAN)
    with pytest.raises(ConfigError, match="no view's beam meets the grid"):
        reconstruct(cir, imaging_settings(snr_db=None))


def test_no_edge_and_no_pattern_are_no_beam():
    assert build_beam(Omni(), BeamSettings()) is None
    assert build_beam(GAUSSIAN, BeamSettings(edge_db=None)) is None
    assert build_beam(GAUSSIAN, BeamSettings()).edge_db == -3


def test_a_channel_is_imaged_after_its_pattern_file_was_deleted(tmp_path):
    """A pattern is read once; what held it holds it, and a channel's file carries it."""
    csv = tmp_path / "pattern.csv"
    csv.write_text("angle_deg,azimuth_db\n-90,-30\n-7.2,-3\n0,0\n8,-3.5\n90,-30\n")
    chosen = imaging_settings(method="bp", **{"grid.size_m": [4.0, 4.0, 0.0]})
    cir = scatterers([[1.0, 0.5, 0.0]], ring(24), antenna=PatternFile(file=str(csv)))
    before = reconstruct(cir, chosen).score
    cir.save(tmp_path / "cir.nc")
    response = tmp_path / "r.npz"
    arrays = {"response": np.exp(-1j * np.arange(300)) * np.ones((24, 1)), "frequency": 36e9 + 6e6 * np.arange(300)}
    np.savez(response, **arrays, a=15.0 * np.arange(24))
    data = {"arrays": {"angles": "a"}, "geometry": {"radius_m": 10.0}, "antenna": {"kind": "file", "file": str(csv)}}
    imported = import_channel(import_settings(response, data=data))
    csv.unlink()
    np.testing.assert_array_equal(reconstruct(cir, chosen).score, before)
    loaded = reconstruct(Cir.load(tmp_path / "cir.nc"), chosen).score
    assert np.isclose(loaded, before, atol=1e-5).mean() > 0.99  # files keep 0.001 dB: edges of beams move by as little
    assert reconstruct(imported, chosen).n_view == 24


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_switched_off_edge_images_as_omnidirectional_antennas_do(method):
    cir = scatterers([[1.0, 0.5, 0.0], [-0.8, -0.4, 0.0]], ring(24))
    narrow = replace(cir, antenna=Horn(azimuth_beamwidth_deg=5.0))
    chosen = {"method": method, "grid.size_m": [4.0, 4.0, 0.0]}
    plain = reconstruct(cir, imaging_settings(**chosen))
    without = reconstruct(narrow, imaging_settings(**chosen, **{"beam.edge_db": None}))
    within = reconstruct(narrow, imaging_settings(**chosen))
    np.testing.assert_array_equal(without.score, plain.score)
    if method != "bp":
        np.testing.assert_array_equal(without.support_deg, plain.support_deg)
    assert not np.array_equal(within.score, plain.score)


@pytest.mark.parametrize("kind", ["closed", "open", "pairs", "turned pairs"])
def test_beam_that_covers_everything_changes_no_sum(kind):
    """An edge at or below the pattern's floor is met everywhere, behind the antennas too, and where the sum of the cuts
    would be below the floor."""
    views = VIEWS[kind]
    rng = np.random.default_rng(8)
    peaks = random_peaks(rng, [10] * len(views), 4.0, 15.0)
    plain = soft(BLOCK, views, peaks)
    narrow = Horn(azimuth_beamwidth_deg=8.0, elevation_beamwidth_deg=6.0)
    for edge_db in (narrow.floor_db, -60.0):
        wide = soft(BLOCK, views, peaks, build_beam(narrow, BeamSettings(edge_db=edge_db)))
        assert (wide.coverage == len(views)).all()
        np.testing.assert_array_equal(wide.total, plain.total)
        np.testing.assert_allclose(wide.support_deg, plain.support_deg, atol=1e-3)  # degrees; other float32 sums
    assert plain.coverage is None


def test_receivers_at_their_transmitters_are_a_colocated_sensor():
    """Half of r + r is r, so not a bit differs."""
    rng = np.random.default_rng(9)
    views, peaks = VIEWS["turned"], random_peaks(rng, [10] * 24, 4.0, 15.0)
    pairs = replace(views, receivers_m=views.positions_m)
    assert LAYER.range_span_m(pairs.positions_m, pairs.receivers_m) == LAYER.range_span_m(views.positions_m)
    for beam in (None, build_beam(GAUSSIAN, BeamSettings())):
        one, other = soft(LAYER, views, peaks, beam), soft(LAYER, pairs, peaks, beam)
        np.testing.assert_array_equal(one.total, other.total)
        np.testing.assert_array_equal(one.support_deg, other.support_deg)


def test_transmitters_and_receivers_may_change_places():
    """Reciprocity: the way back is as long as the way there."""
    rng = np.random.default_rng(10)
    views, peaks = VIEWS["turned pairs"], random_peaks(rng, [10] * 24, 4.0, 15.0)
    swapped = replace(views, positions_m=views.receivers_m, receivers_m=views.positions_m)
    beam = build_beam(GAUSSIAN, BeamSettings())
    one, other = soft(LAYER, views, peaks, beam), soft(LAYER, swapped, peaks, beam)
    np.testing.assert_array_equal(one.coverage, other.coverage)
    np.testing.assert_allclose(one.total, other.total, atol=24 * 1e-6)  # the sum of both ways is rounded alike
    assert (one.support_deg == other.support_deg).mean() > 0.999  # voxels within float32 of the edge of R_T


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_turning_everything_turns_the_image(quarters, lopsided):
    """Pairs, boresights, an antenna that is not symmetric, and peaks."""
    grid = VoxelGrid((0.0, 0.0, 0.0), (60, 60, 1), 0.16)
    views, rng = VIEWS["turned pairs"], np.random.default_rng(11)
    c, s = [(0, 1), (-1, 0), (0, -1)][quarters - 1]
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T
    turned = Views(
        views.positions_m @ turn, np.mod(views.angles_deg + 90 * quarters, 360), (0.0, 0.0),
        views.receivers_m @ turn, views.boresights @ turn,
    )  # fmt: skip
    peaks = random_peaks(rng, [10] * 24, 4.0, 15.0)
    beam = build_beam(lopsided, BeamSettings())
    one, other = soft(grid, views, peaks, beam), soft(grid, turned, peaks, beam)
    _, sure = seen(grid, views, lopsided)
    sure = np.rot90(sure.reshape(60, 60), -quarters)
    np.testing.assert_array_equal(np.rot90(one.coverage[0], -quarters)[sure], other.coverage[0][sure])
    error = np.abs(np.rot90(one.total[0], -quarters) - other.total[0])[sure]
    assert error.max() <= 24 * 1e-4  # float32 ranges
    # Voxels within float32 of the edge of R_T, and widths that are summed from another first view.
    same = np.abs(np.rot90(one.support_deg[0], -quarters) - other.support_deg[0])[sure] < 1e-3
    assert same.mean() > 0.999


@settings(max_examples=10)
@given(st.permutations(range(36)))
def test_order_of_the_views_changes_nothing(order):
    rng = np.random.default_rng(12)
    views, order = VIEWS["storeys of turned pairs"], np.array(order)
    peaks, beam = random_peaks(rng, [8] * 36, 4.0, 15.0), build_beam(GAUSSIAN, BeamSettings())
    one, other = soft(LAYER, views, peaks, beam), soft(LAYER, views.select(order), peaks.select(order), beam)
    np.testing.assert_array_equal(one.coverage, other.coverage)
    np.testing.assert_array_equal(one.support_deg, other.support_deg)
    # Views of one angle are summed in the order they come; rounding of a float32 sum of 36.
    np.testing.assert_allclose(one.total, other.total, rtol=0, atol=36 * 1e-7)


@pytest.mark.parametrize("block", [7, 1000])
def test_size_of_blocks_changes_no_bit(block):
    grid = LAYER if block > 7 else VoxelGrid((0, 0, 0), (9, 7, 1), 1.0)
    rng = np.random.default_rng(13)
    views, beam = VIEWS["storeys of turned pairs"], build_beam(GAUSSIAN, BeamSettings())
    peaks = random_peaks(rng, [8] * 36, 4.0, 15.0)
    whole, parts = soft(grid, views, peaks, beam), soft(grid, views, peaks, beam, block=block)
    for name in ("total", "support_deg", "coverage"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_range_span_of_pairs_holds_every_voxel(seed, volume):
    rng = np.random.default_rng(seed)
    grid = BLOCK if volume else LAYER
    transmitters, receivers = rng.uniform(-12, 12, (2, 5, 3))
    near, far = grid.range_span_m(transmitters, receivers)
    ranges = [twin.distances(grid.centers(), pair) for pair in np.stack([transmitters, receivers], axis=1)]
    assert near <= np.min(ranges)
    assert far >= np.max(ranges)
    alone = [twin.distances(grid.centers(), position) for position in transmitters]
    near, far = grid.range_span_m(transmitters)
    assert far == pytest.approx(np.max(alone))  # a corner voxel's centre, which is one of the distances
    assert near <= np.min(alone)


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_points_stand_out_at_their_places_for_pairs_far_apart(method):
    """Transmitter and receiver 4 m from each other, side by side, with horns that look at the centre."""
    points = np.array([[1.0, 0.5, 0.0], [-0.8, -0.4, 0.0], [0.3, -1.2, 0.0]])
    middle = ring(72)
    turn = np.deg2rad(middle.angles_deg)
    aside = 2.0 * np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1)
    views = replace(middle, positions_m=middle.positions_m + aside, receivers_m=middle.positions_m - aside)
    wide = Horn(azimuth_beamwidth_deg=60.0)
    chosen = imaging_settings(**{"method": method, "grid.size_m": [4.0, 4.0, 0.0], "snr_db": 20})

    cir = scatterers(points, views, antenna=wide)

    def farthest(cir):
        image = reconstruct(cir, chosen)
        best = image.grid.centers()[np.argsort(image.score.ravel())[-3:]]
        return max(np.linalg.norm(points - place, axis=1).min() for place in best)

    assert farthest(cir) < 0.08  # metres; a voxel's diagonal is 7 cm
    # The same data taken for that of sensors in the middle: ranges are 20 cm too long.
    assert farthest(replace(cir, views=middle)) > 0.1


def test_nothing_is_projected_beside_a_beam():
    """One view from +x with a beam of 6°: all of its ring within ±3° of the boresight, and nothing else."""
    cir = channel([[(9.0, 1.0)]], views_at([0.0]), antenna=Horn(azimuth_beamwidth_deg=6.0))
    image = reconstruct(cir, imaging_settings(**{"method": "bp", "grid.size_m": [4.0, 4.0, 0.0], "snr_db": None}))
    x, y, _ = image.grid.centers().T
    off = np.abs(np.degrees(np.arctan2(y, 10 - x)))
    near = np.abs(np.hypot(y, 10 - x) - 9.0) < 0.05  # the main lobe, a cell on both sides
    score = image.score.ravel()
    assert (score[near & (off < 2.98)] > 0.1).all()  # the edge is at -3 dB, half the power at -3.01 dB
    assert (near & (off < 2.98)).sum() > 20
    assert (score[off > 3.0] == 0).all()
