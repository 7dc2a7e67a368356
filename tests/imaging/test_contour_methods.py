"""First-echo carving, Range Points Migration and coherent backprojection: what physics says of their images."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cases import RESOLUTION, channel, make_peaks, ring, scatterers, views_at

from mvla_sim.channel.components import Components
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.beam import BeamSettings, build_beam
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.method import METHODS
from mvla_sim.imaging.methods import rpm
from mvla_sim.imaging.methods.carving import first_echoes
from mvla_sim.imaging.observation import FrontEnd, Observation
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.scene.antennas.horn import Horn
from mvla_sim.scene.views import Views
from mvla_sim.sweep.schedule import groups_of

POINTS = [[1.0, 0.5, 0.0], [-0.8, -0.4, 0.0], [0.3, -1.2, 0.0]]
CARRIER = 36e9  # of the channels in ``cases``
WAVELENGTH = 299_792_458 / CARRIER
NAMES = ("carving", "rpm", "bp-coherent")


def contour_points(seen):
    chosen = seen.settings.model_extra["rpm"]
    return rpm.contour_points(seen, chosen.sigma_x_m, np.deg2rad(chosen.sigma_theta_deg))


def options(**values):
    small = {"grid.size_m": [4.0, 4.0, 0.0], "grid.spacing_m": 0.05}
    return imaging_settings(**(small | values))


def observed(echoes, views, beam=None, **values):
    """What a method sees of views with one list of (range, power) each."""
    settings = options(**values)
    grid = VoxelGrid.from_settings(settings.grid)
    span = grid.range_span_m(views.positions_m, views.receivers_m)
    return Observation(FrontEnd(None, make_peaks(echoes), RESOLUTION), views, grid, settings, 4.0, span, beam)


def shuffled(seen, seed=3):
    return seen.select(np.random.default_rng(seed).permutation(seen.n_view))


def echoes_of(points_m, views):
    """Ranges of points, of pairs half the way there and back, all equally strong."""
    ends = [views.positions_m] if views.receivers_m is None else [views.positions_m, views.receivers_m]
    points = np.asarray(points_m)
    ranges = np.mean([np.linalg.norm(points - end[:, None], axis=2) for end in ends], axis=0)
    return [[(r, 1.0) for r in row] for row in ranges]


def circle(views, radius_m=1.5):
    """The nearest point of a circle about the origin, seen from a ring around it."""
    return [[(np.hypot(*position[:2]) - radius_m, 1.0)] for position in views.positions_m]


def off_circle(seen, radius_m=1.5):
    """Distance of every voxel from a circle about the origin, ``[ny, nx]``; negative inside."""
    x, y, _ = seen.grid.axes()
    return np.hypot(*np.meshgrid(x, y)) - radius_m


def at(seen, point):
    """Index of the voxel at a point."""
    return tuple(int(np.argmin(abs(axis - c))) for axis, c in zip(seen.grid.axes()[::-1], point[::-1], strict=True))


# First-echo carving


def test_carving_leaves_the_outline_of_a_circle():
    seen = observed(circle(ring(72)), ring(72))
    score, away = METHODS.find("carving")().image(seen).score[0], off_circle(seen)
    best = score >= np.sort(score.ravel())[-int(2 * np.pi * 1.5 / 0.05)]
    assert np.abs(away[best]).max() < 0.05
    assert score[np.abs(away) < 0.01].min() > score[np.abs(away) > 0.1].max()
    assert (score[away > 0.1] < 0).all()
    assert (score[away < 0] >= 0).all()


def test_carving_needs_more_than_a_share_of_the_views():
    """One view that missed its first echo takes away nothing; without a share for it, it clears the near side."""
    views = ring(72)
    echoes = circle(views)
    echoes[0] = [(12.0, 1.0)]
    for share, kept in ((0.02, True), (0.0, False)):
        seen = observed(echoes, views)
        score = METHODS.find("carving")(share=share).image(seen).score
        assert (score[at(seen, (1.5, 0.0, 0.0))] > 0) == kept


def test_views_without_a_peak_carve_nothing():
    views = ring(8)
    echoes = [view if m == 0 else [] for m, view in enumerate(circle(views))]
    seen = observed(echoes, views)
    assert first_echoes(seen.peaks)[0] == pytest.approx(8.5)
    assert np.isneginf(first_echoes(seen.peaks)[1:]).all()
    score = METHODS.find("carving")(share=0.1).image(seen).score[0]
    behind = seen.range_m(0)[0] - 8.5
    assert score[behind < -0.03] == pytest.approx(-1 / 8)
    assert (score[behind > -0.02] >= 0).all()


def test_a_beam_carves_only_where_it_reaches():
    views = views_at([0.0])
    beam = build_beam(Horn(azimuth_beamwidth_deg=10.0, elevation_beamwidth_deg=10.0), BeamSettings())
    seen = observed([[(9.0, 1.0)]], views, beam)
    score = METHODS.find("carving")().image(seen).score[0]
    x, y = np.meshgrid(*seen.grid.axes()[:2])
    off = np.abs(np.rad2deg(np.arctan2(y, 10 - x)))
    near = seen.range_m(0)[0] < 8.9
    assert (score[near & (off < 4.9)] == -1).all()
    assert (score[off > 5.1] == 0).all()


@pytest.mark.parametrize("layers", [0.0, 1.0])
def test_carving_takes_pairs_and_volumes(layers):
    height = 3.0 if layers else 0.0  # from one plane, what is above it looks like what is below
    first, second = ring(36, height_m=height), ring(36, height_m=height, start_deg=20)
    views = Views(first.positions_m, first.angles_deg, (0.0, 0.0), second.positions_m)
    point = (0.525, -0.325, 0.025 if layers else 0.0)
    seen = observed(echoes_of([point], views), views, **{"grid.size_m": [3.0, 3.0, layers]})
    score = METHODS.find("carving")().image(seen).score
    assert score.argmax() == np.ravel_multi_index(at(seen, point), score.shape)
    assert (np.delete(score.ravel(), score.argmax()) < score.max()).all()


# Range Points Migration


def test_contour_points_lie_on_the_circle():
    found = contour_points(observed(circle(ring(72)), ring(72)))
    assert len(found.position_m) == 72
    assert np.abs(np.hypot(*found.position_m.T) - 1.5).max() < 0.05


def test_contour_points_are_the_scatterers():
    """Every circle passes through all scatterers; where other circles cross by chance, fewer agree."""
    views = ring(72)
    found = contour_points(observed(echoes_of(POINTS, views), views)).position_m
    apart = np.linalg.norm(found[:, None] - np.asarray(POINTS)[:, :2], axis=2)
    assert np.bincount(apart.argmin(axis=1)).tolist() == [72, 72, 72]
    assert np.quantile(apart.min(axis=1), 0.95) < 0.01
    assert apart.min(axis=1).max() < 0.1


def test_the_direction_is_the_maximum_of_the_sum():
    """Against a brute-force search of all directions with the formula as it is written."""
    views = ring(24)
    rng = np.random.default_rng(5)
    echoes = [[(r, p) for r, p in zip(rng.uniform(9, 11, 3), rng.uniform(0.5, 2, 3), strict=True)] for _ in range(24)]
    seen = observed(echoes, views, **{"rpm.sigma_theta_deg": 2.0, "rpm.sigma_x_m": 3.0})
    found = contour_points(seen)
    order = np.lexsort(views.positions_m.T)
    center, radius, power = np.repeat(order, 3), [], []
    for view in order:
        radius += [r for r, _ in sorted(echoes[view])]
        power += [p for _, p in sorted(echoes[view])]
    x, r, s = views.positions_m[center, :2], np.array(radius), np.sqrt(power)
    trial = np.deg2rad(np.arange(0, 360, 0.02))
    agreement = []
    for i in range(72):
        total = np.zeros(trial.size)
        for j in range(72):
            d = np.linalg.norm(x[j] - x[i])
            if center[i] == center[j] or d > 9 or not abs(r[i] - r[j]) <= d <= r[i] + r[j]:
                continue
            along = (r[i] ** 2 - r[j] ** 2 + d**2) / (2 * d)
            u = (x[j] - x[i]) / d
            for side in (-1, 1):
                p = along * u + side * np.sqrt(max(0, r[i] ** 2 - along**2)) * np.array([-u[1], u[0]])
                if np.abs(x[i] + p).max() <= 2:
                    off = np.angle(np.exp(1j * (trial - np.arctan2(p[1], p[0]))))
                    total += s[j] * np.exp(-(off**2) / (2 * np.deg2rad(2) ** 2)) * np.exp(-(d**2) / 18)
        if total.max() > 0:
            agreement.append(total.max())
    reached = found.agreement / agreement  # of two maxima about as high, the bins may take the lower one
    assert reached.min() > 0.97
    assert reached.max() < 1 + 1e-4
    assert (reached > 1 - 1e-3).mean() > 0.95


def test_rpm_images_stand_out_at_the_points():
    image = reconstruct(scatterers(POINTS, ring(72)), options(method="rpm", snr_db=20))
    centers, flat = image.grid.centers(), image.score.ravel()
    assert image.support_deg is None
    best = centers[flat >= np.quantile(flat, 0.995)]
    assert np.linalg.norm(best[:, None] - np.asarray(POINTS), axis=2).min(axis=1).max() < 0.25
    for point in POINTS:
        near = np.linalg.norm(centers - point, axis=1) < 0.06
        assert flat[near].max() > 0.3 * flat.max()


def test_rpm_sees_its_layer_from_above():
    views = ring(72, height_m=3.0)
    found = contour_points(observed(echoes_of(POINTS[:1], views), views)).position_m
    assert np.abs(found - POINTS[0][:2]).max() < 1e-6


def test_rpm_leaves_out_what_no_beam_sees():
    views = ring(72)
    beam = build_beam(Horn(azimuth_beamwidth_deg=8.0, elevation_beamwidth_deg=8.0), BeamSettings())
    echoes = echoes_of([[0.2, 0.1, 0.0], [1.6, 1.4, 0.0]], views)
    both = contour_points(observed(echoes, views)).position_m
    inner = contour_points(observed(echoes, views, beam)).position_m
    assert (np.linalg.norm(both - [1.6, 1.4], axis=1) < 0.01).sum() >= 70
    seen_from = np.linalg.norm(inner - [1.6, 1.4], axis=1) < 0.01
    assert 0 < seen_from.sum() < 30  # the views that are in line with it
    assert len(inner) < len(both)


# Coherent backprojection


def focus(cir, method="bp-coherent", size_m=0.06, point=(0.5, -0.3, 0.0)):
    """Image around a point at steps of λ/16, scaled to its maximum, and each voxel's distance from the point."""
    chosen = options(method=method, snr_db=None, **{"grid.size_m": [size_m, size_m, 0.0],
                     "grid.spacing_m": WAVELENGTH / 16, "grid.center_m": list(point)})  # fmt: skip
    image = reconstruct(cir, chosen)
    return image.score.ravel(), np.linalg.norm(image.grid.centers() - point, axis=1)


@pytest.mark.parametrize("apart", [False, True])
def test_a_point_is_focused_to_a_quarter_of_a_wavelength(apart):
    """All round the focus is J0²(4πρ/λ): 0.09 of its peak at λ/4, never above 0.17 beyond it."""
    first = ring(360)
    receivers = ring(360, start_deg=3).positions_m if apart else None
    views = Views(first.positions_m, first.angles_deg, (0.0, 0.0), receivers)
    cir = scatterers([[0.5, -0.3, 0.0]], views)
    score, away = focus(cir)
    assert away[score.argmax()] < WAVELENGTH / 16
    assert score[away > WAVELENGTH / 4].max() < 0.2 * score.max()
    assert score.max() == pytest.approx(sum(abs(cir.gain)) ** 2 / abs(cir.gain).max() ** 2, rel=0.02)


def test_random_phase_per_view_takes_the_focus_but_not_from_phase_free_methods():
    cir = scatterers([[0.5, -0.3, 0.0]], ring(360))
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, 360)
    sharp, blurred = focus(cir)[0], focus(cir.with_phases(phase))[0]
    assert blurred.max() < 0.1 * sharp.max()
    for method in ("bp", "mvla-gr", "carving", "rpm"):
        one, other = (focus(c, method)[0] for c in (cir, cir.with_phases(phase)))
        assert np.abs(one - other).max() < 1e-3 * np.abs(one).max()


def test_a_millimetre_of_position_error_is_too_much():
    views = ring(360)
    cir = scatterers([[0.5, -0.3, 0.0]], views)
    error = np.random.default_rng(1).normal(0, 1e-3, (360, 3))
    believed = replace(cir, views=replace(views, positions_m=views.positions_m + error))
    assert focus(believed)[0].max() < 0.3 * focus(cir)[0].max()


def test_complex_noise_keeps_the_phase():
    cir = scatterers([[0.5, -0.3, 0.0]], ring(72))
    area = {"grid.center_m": [0.5, -0.3, 0.0], "grid.size_m": [0.05, 0.05, 0.0], "grid.spacing_m": WAVELENGTH / 8}
    image = reconstruct(cir, options(method="bp-coherent", snr_db=20, **area, **{"noise.kind": "complex"}))
    center = image.grid.centers()[image.score.argmax()]
    assert np.linalg.norm(center - [0.5, -0.3, 0.0]) < WAVELENGTH / 4


def test_coherent_sum_is_the_formula():
    """Against h at each voxel's own delay, which the profile of so few paths has in closed form at its nodes."""
    cir = channel([[(9.5, 1 + 2j), (10.0, -1j)], [(10.2, 0.5)]], views_at([0, 90]))
    area = {"grid.size_m": [0.8, 0.8, 0.0], "grid.spacing_m": 0.02, "pdp.oversampling": 64}
    image = reconstruct(cir, options(method="bp-coherent", snr_db=None, **area))
    coarse = reconstruct(cir, options(method="bp-coherent", snr_db=None, **(area | {"pdp.oversampling": 4})))
    assert np.abs(image.score - coarse.score).max() < 0.01 * image.score.max()


def test_coherent_beams_leave_out_what_is_outside():
    views = views_at([0.0])
    antenna = Horn(azimuth_beamwidth_deg=10.0, elevation_beamwidth_deg=10.0)
    image = reconstruct(
        scatterers([[0.0, 0.0, 0.0]], views, antenna=antenna), options(method="bp-coherent", snr_db=None)
    )
    x, y = np.meshgrid(*image.grid.axes()[:2])
    off, away = np.abs(np.rad2deg(np.arctan2(y, 10 - x))), np.abs(np.hypot(10 - x, y) - 10)
    assert (image.score[0][off > 5.1] == 0).all()
    assert image.score[0][(off < 4.9) & (away < 0.02)].min() > 0.5


# All of them


@pytest.mark.parametrize("method", NAMES)
def test_order_of_the_views_and_a_second_run_change_nothing(method):
    cir = scatterers(POINTS, ring(24))
    chosen = options(method=method, snr_db=None)
    order = np.random.default_rng(2).permutation(24)
    one, again, other = (reconstruct(c, chosen).score for c in (cir, cir, cir.select(order)))
    assert np.array_equal(one, again)
    assert np.array_equal(one, other)


def one_line(caught):
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["gaussian", "exponential"])
def test_noise_on_the_power_is_refused(kind):
    with pytest.raises(ConfigError, match=f"noise.kind = '{kind}'.*use noise.kind = 'complex'") as caught:
        reconstruct(scatterers(POINTS, ring(12)), options(method="bp-coherent", snr_db=20, **{"noise.kind": kind}))
    one_line(caught)


def test_components_have_no_phase_but_range_points():
    views = ring(24)
    rows = echoes_of(POINTS, views)
    flat = np.array([pair for row in rows for pair in sorted(row)])
    parts = Components(flat[:, 0], flat[:, 1], np.full(24, 3), views=views, carrier_hz=36e9, bandwidth_hz=3e9)
    for method in ("carving", "rpm"):
        assert np.isfinite(reconstruct(parts, options(method=method)).score).all()
    with pytest.raises(ConfigError, match="bp-coherent needs profiles") as caught:
        reconstruct(parts, options(method="bp-coherent"))
    one_line(caught)


def test_rpm_refuses_volumes_and_pairs():
    views = ring(12)
    with pytest.raises(ConfigError, match="the grid has 20 layers; rpm works in one") as caught:
        reconstruct(scatterers(POINTS, views), options(method="rpm", **{"grid.size_m": [4.0, 4.0, 1.0]}))
    one_line(caught)
    pairs = Views(views.positions_m, views.angles_deg, (0.0, 0.0), ring(12, start_deg=5).positions_m)
    with pytest.raises(ConfigError, match="receivers stand apart") as caught:
        reconstruct(scatterers(POINTS, pairs), options(method="rpm"))
    one_line(caught)


@pytest.mark.parametrize("values", [{"rpm.sigma_x_m": 0.1}, {"views.interval_deg": 360.0}])
def test_rpm_says_so_if_nothing_intersects(values):
    with pytest.raises(DataError, match=r"rpm\.sigma_x_m = .* intersect on the grid; raise it") as caught:
        reconstruct(scatterers(POINTS, ring(12)), options(method="rpm", snr_db=None, **values))
    one_line(caught)


@pytest.mark.parametrize(
    ("method", "kind", "kept"),
    [("bp", "gaussian", False), ("bp", "complex", True), ("bp-coherent", "gaussian", True)],
)
def test_sweeps_keep_amplitudes_for_methods_that_need_them(method, kind, kept):
    case = SimpleNamespace(channel="one", imaging=options(method=method, **{"noise.kind": kind}), evaluation=None)
    plan = SimpleNamespace(sources={"one": SimpleNamespace(views=ring(12), outline=None, plane_height_m=0.0)})
    (task,) = groups_of(plan, [case], workers=1)
    assert task.wanted.with_amplitude == kept


def test_settings_of_methods_survive_a_dump():
    changed = options(**{"rpm.sigma_x_m": 1.0})
    assert changed.model_dump()["rpm"]["sigma_x_m"] == 1.0
    assert ImagingSettings.model_validate(changed.model_dump(mode="json")) == changed


def test_shuffled_observations_make_the_same_contour_points():
    rng = np.random.default_rng(4)
    views = ring(36)
    seen = observed([[(r, 1.0) for r in rng.uniform(8.5, 11.5, 5)] for _ in range(36)], views)
    one, other = contour_points(seen), contour_points(shuffled(seen))
    assert np.array_equal(one.position_m, other.position_m)
    assert np.array_equal(one.agreement, other.agreement)
