"""What an image is made from: paths, measured frequency responses, or ready-made components, and their files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import BANDWIDTH, PAPER_METHODS, RESOLUTION, response, ring, scatterers

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.loading import load_channel
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
from mvla_sim.imaging.pdp import compute_pdp, gate_for
from mvla_sim.imaging.pipeline import observe, reconstruct
from mvla_sim.imaging.view_selection import ViewSettings
from mvla_sim.netcdf import write_netcdf
from mvla_sim.scene.antennas.horn import Horn
from mvla_sim.settings import parse

RADIO = {"carrier_hz": 36e9, "bandwidth_hz": BANDWIDTH}
POINTS = [[1.0, 0.5, 0.0], [-0.8, -0.4, 0.0], [0.3, -1.2, 0.0]]


def options(**values):
    return imaging_settings(**({"grid.size_m": [4.0, 4.0, 0.0], "grid.spacing_m": 0.05} | values))


def swept(cir, **fields):
    """The frequency responses of a CIR."""
    rows = [cir.rows(m) for m in range(cir.n_view)]
    paths = [list(zip(cir.range_m[r], cir.gain[r].astype(complex), strict=True)) for r in rows]
    return response(paths, cir.views, antenna=cir.antenna, **fields)


def extracted(cir, settings):
    """The components that are found in a CIR."""
    chosen = settings.model_copy(update={"views": ViewSettings()})
    peaks = observe(cir, chosen).peaks
    return Components(
        peaks.range_m, peaks.power, peaks.row_size, views=cir.views, carrier_hz=36e9, bandwidth_hz=cir.bandwidth_hz,
        extent_m=cir.extent_m, antenna=cir.antenna,
    )  # fmt: skip


def power(channel, settings):
    """Profiles that reach the methods, and those before any noise."""
    grid = VoxelGrid.from_settings(settings.grid)
    clean = compute_pdp(channel, settings.pdp, gate_for(grid, channel.views, settings.pdp))
    return observe(channel, settings).front.pdp.power, clean.power


# Frequency responses.


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_sweep_of_points_shows_them_at_their_places(method):
    image = reconstruct(swept(scatterers(POINTS, ring(72))), options(method=method))
    points, flat = image.grid.centers(), image.score.ravel().astype(float)
    for point in POINTS:
        near = np.linalg.norm(points - point, axis=1) < 0.06
        assert flat[near].max() > 0.999 * np.quantile(flat, 0.995)
    best = points[flat.argmax()]
    assert min(np.linalg.norm(best - point) for point in POINTS) < 0.06  # a voxel's diagonal is 7 cm


def test_measured_responses_get_no_noise_unless_it_is_asked_for():
    cir = scatterers(POINTS, ring(4))
    measured = swept(cir)
    for chosen in (options(), options(snr_db=None), options(**{"noise.seed": 5})):
        found, clean = power(measured, chosen)
        np.testing.assert_array_equal(found, clean)
    found, clean = power(measured, options(snr_db=10.0))
    noise = found - clean
    # White, and 10 dB below the mean square of the profiles; a mean square of some 400 normal samples a view.
    ratio = (clean**2).mean(axis=1) / (noise**2).mean(axis=1)
    assert clean.shape[1] > 200
    np.testing.assert_allclose(ratio, 10, rtol=5 * np.sqrt(2 / clean.shape[1]))
    found, clean = power(cir, options())
    assert not np.array_equal(found, clean)  # traced paths have noise by default


@pytest.mark.parametrize(("chosen", "recorded"), [({}, None), ({"snr_db": 10.0}, 10.0), ({"snr_db": None}, None)])
def test_image_records_the_noise_that_was_added_and_can_be_made_again(chosen, recorded):
    measured = swept(scatterers(POINTS, ring(6)))
    image = reconstruct(measured, options(**chosen))
    assert image.config["imaging"]["noise"]["snr_db"] == recorded
    again = reconstruct(measured, parse(ImagingSettings, image.config["imaging"], "image"))
    np.testing.assert_array_equal(again.score, image.score)
    assert reconstruct(scatterers(POINTS, ring(6)), options()).config["imaging"]["noise"]["snr_db"] == 20.0


def test_grid_beyond_the_unambiguous_range_is_refused():
    """From 10 m away the corners of 4 m × 4 m are seen at up to 12.14 m, but 200 points fold at 10 m."""
    few = response([[(9.0, 1.0)]] * 4, ring(4), count=200)
    with pytest.raises(DataError, match=r"the grid is seen at .*unambiguous range of 10\.00 m; .*at least 243 points"):
        reconstruct(few, options())
    with pytest.raises(ConfigError, match=r"pdp\.gate_m = \[7, 11\].*unambiguous range of 10\.00 m"):
        reconstruct(few, options(**{"pdp.gate_m": [7.0, 11.0]}))
    assert reconstruct(few, options(**{"pdp.gate_m": [7.0, 10.0]})).score.max() > 0


# Components.


@pytest.mark.parametrize("method", ["mvla-gr", "mvla-hard"])
def test_components_enter_where_peaks_leave_the_detector(method):
    """The components found in a CIR make its image, to the bit."""
    cir = scatterers(POINTS, ring(24), antenna=Horn(azimuth_beamwidth_deg=20.0))
    chosen = options(method=method, snr_db=20, interval_deg=30, offset=1)
    direct, again = reconstruct(cir, chosen), reconstruct(extracted(cir, chosen), chosen)
    np.testing.assert_array_equal(direct.score, again.score)
    np.testing.assert_array_equal(direct.support_deg, again.support_deg)
    assert again.n_view == 12
    assert again.config["imaging"]["noise"]["snr_db"] is None  # none was added to them


def test_components_need_no_gate_and_may_lie_anywhere():
    far = Components(np.array([9.5, 400.0]), np.array([2.0, 1.0]), np.array([1, 0, 1]), views=ring(3), **RADIO)
    front = observe(far, options()).front
    assert front.pdp is None
    assert front.resolution_m == pytest.approx(RESOLUTION)
    np.testing.assert_array_equal(front.peaks.range_m, far.range_m)
    np.testing.assert_array_equal(front.peaks.power, far.power)
    np.testing.assert_array_equal(front.peaks.row_size, far.row_size)
    assert reconstruct(far, options(eta=0.0)).score.max() > 0


def test_backprojection_of_components_is_refused():
    some = extracted(scatterers(POINTS, ring(4)), options())
    with pytest.raises(ConfigError, match=r"method = 'bp': this file holds ready-made components; .*") as caught:
        reconstruct(some, options(method="bp"))
    assert "\n" not in str(caught.value)


def test_chosen_views_without_components_are_an_error():
    some = Components(np.array([9.5]), np.ones(1), np.array([1, 0, 0, 0]), views=ring(4), **RADIO, extent_m=4.0)
    with pytest.raises(DataError, match="no peak in any of the 2 chosen views"):
        reconstruct(some, options(interval_deg=180, offset=1))


def test_components_must_rise_in_range_within_a_view():
    """The search for the nearest one relies on it."""
    falling = {"range_m": np.array([9.0, 8.0, 9.5]), "power": np.ones(3), "views": ring(2)}
    with pytest.raises(DataError, match="ranges of view 0 do not rise"):
        Components(**falling, row_size=np.array([2, 1]), **RADIO)
    assert Components(**falling, row_size=np.array([1, 2]), **RADIO).n_view == 2
    with pytest.raises(DataError, match="ranges of view 1 do not rise"):
        Components(
            np.array([9.0, 8.0, 9.5, 9.4]), np.ones(4), np.array([1, 3]), views=ring(2), **RADIO
        )  # fmt: skip


# Files.


@pytest.fixture
def three():
    """One channel of each kind, with everything views can have."""
    views = ring(6)
    turn = np.deg2rad(views.angles_deg)
    aside = np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1)
    views = replace(
        views,
        positions_m=views.positions_m + aside,
        receivers_m=views.positions_m - aside,
        boresights=-views.positions_m / 10,
    )
    horn = Horn(azimuth_beamwidth_deg=30.0, gain_dbi=12.0)
    cir = scatterers(POINTS, views, antenna=horn)
    return {Cir: cir, FrequencyResponse: swept(cir), Components: extracted(cir, options())}


@pytest.mark.parametrize("kind", [Cir, FrequencyResponse, Components])
def test_any_kind_of_file_loads_by_its_schema_and_images_alike(three, kind, tmp_path):
    made = three[kind]
    made.save(tmp_path / "channel.nc")
    read = load_channel(tmp_path / "channel.nc")
    assert type(read) is kind
    assert read.antenna == made.antenna
    for name in ("positions_m", "receivers_m", "boresights", "angles_deg"):
        np.testing.assert_array_equal(getattr(read.views, name), getattr(made.views, name))
    one, other = reconstruct(made, options()), reconstruct(read, options())
    if kind is not FrequencyResponse:  # whose frequency step is read off an axis of rounded frequencies
        np.testing.assert_array_equal(one.score, other.score)
    assert np.abs(one.score - other.score).max() < 1e-6


@pytest.mark.parametrize("kind", [Cir, FrequencyResponse, Components])
def test_selection_of_any_kind_is_that_of_its_views(three, kind):
    made, taken = three[kind], np.array([4, 0, 3])
    some = made.select(taken)
    np.testing.assert_array_equal(some.views.receivers_m, made.views.receivers_m[taken])
    chosen = options(snr_db=None)
    one, other = observe(some, chosen).front.peaks, observe(made, chosen).front.peaks.select(taken)
    np.testing.assert_array_equal(one.row_size, other.row_size)
    # Of paths the gate of three pairs may be narrower than that of six, and with it the number of frequencies.
    np.testing.assert_allclose(one.range_m, other.range_m, atol=1e-3 if kind is Cir else 1e-9)  # metres


def test_other_files_are_refused_with_the_schemas_that_are_read(three, tmp_path):
    file = tmp_path / "other.nc"
    with pytest.raises(DataError, match="no such channel file"):
        load_channel(file)
    dataset = three[Components].to_dataset()
    write_netcdf(dataset.assign_attrs(schema="something else"), file, ())
    with pytest.raises(DataError, match=r"'something else'; allowed: 'mvla-sim CIR', 'mvla-sim frequency response', '"):
        load_channel(file)
    file.write_bytes(b"no channel" * 50)
    with pytest.raises(DataError, match="not a readable NetCDF-4 file"):
        load_channel(file)
    three[Cir].save(file)
    with pytest.raises(DataError, match=r"schema is 'mvla-sim CIR', not 'mvla-sim components'"):
        Components.load(file)


def test_file_of_components_that_do_not_rise_is_refused_with_its_name(tmp_path):
    some = Components(np.array([8.0, 9.0]), np.ones(2), np.array([2]), views=ring(1), **RADIO)
    dataset = some.to_dataset()
    dataset["range"].values[:] = [9.0, 8.0]
    write_netcdf(dataset, tmp_path / "some.nc", ())
    with pytest.raises(DataError, match=r"some\.nc: components: ranges of view 0 do not rise"):
        load_channel(tmp_path / "some.nc")
