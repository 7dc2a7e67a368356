"""Frequency responses and their files: what is written is read, and what is none is refused in one line."""

from __future__ import annotations

import dataclasses
import gc
import json

import h5py
import numpy as np
import pytest
import shapely
from channel_scenes import random_cir, ring_views
from full_views import views_of
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.loading import load_channel
from mvla_sim.channel.response import RESPONSE_SCHEMA, RESPONSE_VERSION, FrequencyResponse
from mvla_sim.constants import SPEED_OF_LIGHT
from mvla_sim.errors import DataError, OutputError
from mvla_sim.scene.antenna_settings import Horn, Omni, PatternCuts

ANTENNAS = (
    Omni(),
    Horn(kind="horn", azimuth_beamwidth_deg=20.0, elevation_beamwidth_deg=9.5, shape="cosine", gain_dbi=21.5),
    PatternCuts(kind="cuts", azimuth_db=(0.0,) * 1441, elevation_db=(-1.5,) * 721, gain_dbi=3.0),
)


def random_response(seed=0, count=5, points=33, **changes):
    rng = np.random.default_rng(seed)
    fields = {
        "response": rng.standard_normal((count, points)) + 1j * rng.standard_normal((count, points)),
        "start_hz": 34.5e9,
        "step_hz": 7.5e6,
        "views": ring_views(count),
        "extent_m": 4.0,
    }
    return FrequencyResponse(**(fields | changes))


def same(one, other):
    """Whether two hold the same bits, NaN equal to NaN; the step is read from the frequencies, to rounding."""
    assert other.response.dtype == np.complex128
    np.testing.assert_array_equal(one.response, other.response)
    assert one.start_hz == other.start_hz
    assert other.step_hz == pytest.approx(one.step_hz, rel=1e-12)
    for name in ("positions_m", "angles_deg", "center_m", "receivers_m"):
        np.testing.assert_equal(getattr(other.views, name), getattr(one.views, name))
    assert (one.views.boresights is None) == (other.views.boresights is None)
    if one.views.boresights is not None:  # divided by their length again, which is 1 to rounding
        np.testing.assert_allclose(other.views.boresights, one.views.boresights, rtol=0, atol=1e-15)
    for name in ("extent_m", "antenna", "config", "provenance"):
        np.testing.assert_equal(getattr(other, name), getattr(one, name))


@settings(max_examples=15, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 9), st.integers(2, 50)),
    st.tuples(st.booleans(), st.booleans(), st.sampled_from(ANTENNAS)),
    st.one_of(st.just(float("nan")), st.floats(0.1, 99)),
)
def test_round_trip_keeps_every_bit(tmp_path_factory, seed, shape, parts, extent):
    receivers, boresights, antenna = parts
    response = random_response(
        seed, *shape, extent_m=extent, antenna=antenna, views=views_of(shape[0], receivers, boresights, seed),
        config={"name": "round trip", "none": None, "list": [1, 2.5]}, provenance={"program": "test"},
    )  # fmt: skip
    file = tmp_path_factory.mktemp("response") / "a.nc"
    response.save(file)
    same(response, FrequencyResponse.load(file))
    same(response, load_channel(file))


def test_outline_survives_and_may_be_absent(tmp_path):
    outline = shapely.MultiPolygon([shapely.Point(0, 0).buffer(2), shapely.box(3, 3, 4, 5)])
    for shape in (outline, None):
        random_response(outline=shape).save(tmp_path / "a.nc")
        read = FrequencyResponse.load(tmp_path / "a.nc").outline
        if shape is None:
            assert read is None
        else:
            assert read.equals_exact(shape, tolerance=1e-9)  # written with nine decimals: nanometres


def test_file_opens_in_plain_h5py(tmp_path):
    views = views_of(5)
    response = random_response(views=views, config={"name": "plain"}, antenna=ANTENNAS[1])
    response.save(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        np.testing.assert_array_equal(file["response_real"][:] + 1j * file["response_imag"][:], response.response)
        np.testing.assert_array_equal(file["frequency"][:], response.frequency_hz)
        np.testing.assert_array_equal(file["receiver"][:], views.receivers_m)
        np.testing.assert_array_equal(file["boresight"][:], views.boresights)
        assert file["carrier_frequency"][()] == response.carrier_hz
        assert file["bandwidth"][()] == response.bandwidth_hz
        for name, unit in {"frequency": "Hz", "position": "m", "receiver": "m", "boresight": "1"}.items():
            assert file[name].attrs["units"] == unit
        assert file.attrs["schema"] == RESPONSE_SCHEMA
        assert file.attrs["schema_version"] == RESPONSE_VERSION
        assert file.attrs["title"] == "plain: frequency response"
        assert json.loads(file.attrs["antenna"]) == ANTENNAS[1].model_dump()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "good.nc"
    random_response(views=views_of(5), outline=shapely.box(-1, -1, 1, 1)).save(path)
    return path


def refused(path, match):
    with pytest.raises(DataError, match=match) as caught:
        FrequencyResponse.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
def test_truncated_file_is_refused(file, share):
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    refused(file, "not a readable NetCDF-4 file")


def test_what_is_no_such_file_is_refused(tmp_path):
    refused(tmp_path / "none.nc", "no such")
    refused(tmp_path, "is a folder")
    path = tmp_path / "other.nc"
    path.write_bytes(b"")
    refused(path, "empty")
    path.write_bytes(b"frequency,real,imag\n" * 99)
    refused(path, "not a readable")
    random_cir().save(path)
    refused(path, "schema is 'mvla-sim CIR', not 'mvla-sim frequency response'")


def edit(path, change):
    with h5py.File(path, "a") as content:
        change(content)


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("schema", "some other schema", "some other schema"),
        ("schema_version", RESPONSE_VERSION + 1, rf"version {RESPONSE_VERSION + 1}.*reads version {RESPONSE_VERSION}"),
        ("config", "{", "not a readable file of frequency responses"),
        ("provenance", "[]", "not a readable file of frequency responses"),
        ("target_outline_wkt", "POLYGON ((", "not a readable file of frequency responses"),
        ("antenna", "{", "not a readable file of frequency responses"),
        ("antenna", '{"kind": "dish"}', "antenna"),
        ("antenna", '{"kind": "horn", "azimuth_beamwidth_deg": 0}', "azimuth_beamwidth_deg"),
    ],
)
def test_wrong_attributes_are_refused(file, name, value, match):
    edit(file, lambda content: content.attrs.__setitem__(name, value))
    refused(file, match)


@pytest.mark.parametrize(
    "name", ["response_real", "response_imag", "frequency", "position", "angle", "carrier_frequency", "bandwidth",
             "target_extent", "center"]
)  # fmt: skip
def test_missing_variable_is_named(file, name):
    """A dimension's own variable stays as a mere length when it is taken away, without the frequencies in it."""
    if name == "frequency":
        random_response().to_dataset().drop_vars("frequency").to_netcdf(file, engine="h5netcdf")
    else:
        edit(file, lambda content: content.__delitem__(name))
    refused(file, f"'{name}'.* is missing from this mvla-sim frequency response file")


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("response_real", np.inf, "view 0, frequency 0 is not finite"),
        ("response_imag", np.nan, "is not finite"),
        ("angle", 720.0, "allowed: 0 to below 360"),
        ("position", np.nan, "not finite"),
        ("receiver", np.inf, "receiver 0 .* is not finite"),
        ("boresight", 2.0, "unit vectors"),
        ("center", np.nan, "not finite"),
        ("frequency", 99e9, "the step must be > 0"),
        ("frequency", np.nan, "the step must be > 0"),
    ],
)
def test_impossible_values_are_refused(file, name, value, match):
    edit(file, lambda content: content[name].__setitem__(0, value))
    refused(file, match)


def test_an_antenna_is_omnidirectional_where_a_file_says_none(file):
    edit(file, lambda content: content.attrs.__delitem__("antenna"))
    assert FrequencyResponse.load(file).antenna == Omni()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # raised by h5netcdf's File.__del__
@settings(max_examples=20, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_damaged_bytes_never_give_a_traceback(tmp_path_factory, seed):
    """Flipped bytes are refused by checksum or structure, or hit what does not matter; nothing else escapes.

    The global heap, 4096 bytes with the texts of the attributes, stays whole: it has no checksum, and HDF5 loops for
    ever over an object in it of index 0 and size 0.
    """
    path = tmp_path_factory.mktemp("damaged") / "a.nc"
    random_response(views=views_of(5)).save(path)
    rng = np.random.default_rng(seed)
    content = bytearray(path.read_bytes())
    assert content.count(b"GCOL") == 1
    heap = content.index(b"GCOL")
    outside = np.delete(np.arange(len(content)), slice(heap, heap + 4096))
    for place in rng.choice(outside, 20):
        content[place] = rng.integers(256)
    path.write_bytes(content)
    message = str(path)
    try:
        FrequencyResponse.load(path)
    except DataError as error:
        message = str(error)
    assert message.startswith(str(path))
    assert "\n" not in message
    gc.collect()  # a file of h5netcdf that failed to open complains when it is deleted: here, not in some other test


@pytest.mark.parametrize("where", ["none/a.nc", "."])
def test_unwritable_place_is_an_error_and_leaves_nothing(tmp_path, where):
    with pytest.raises(OutputError):
        random_response().save(tmp_path / where)
    assert list(tmp_path.iterdir()) == []


def test_axis_and_what_follows_from_it():
    response = random_response(points=401)
    assert response.n_view == 5
    np.testing.assert_allclose(response.frequency_hz, np.linspace(34.5e9, 37.5e9, 401), rtol=1e-15)
    assert response.carrier_hz == 36e9
    assert response.bandwidth_hz == 401 * 7.5e6  # each frequency an equal share
    assert response.unambiguous_range_m == pytest.approx(SPEED_OF_LIGHT / 15e6)


def test_selection_and_phases_leave_the_rest_alone():
    response = random_response(views=views_of(5))
    taken = np.array([4, 0, 3])
    some = response.select(taken)
    np.testing.assert_array_equal(some.response, response.response[taken])
    np.testing.assert_array_equal(some.views.receivers_m, response.views.receivers_m[taken])
    np.testing.assert_array_equal(some.views.boresights, response.views.boresights[taken])
    phase = np.linspace(-3, 3, 5)
    turned = response.with_phases(phase)
    np.testing.assert_allclose(turned.response, response.response * np.exp(1j * phase)[:, None], rtol=1e-15)
    assert turned.views is response.views


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("response", np.zeros((5, 1), np.complex128), r"shape \(5, 1\); allowed: \[n_view, n_frequency >= 2\]"),
        ("response", np.zeros(5, np.complex128), "shape"),
        ("response", np.zeros((4, 9), np.complex128), "4 responses for 5 views"),
        ("response", np.full((5, 9), np.nan + 0j), r"not finite \(45 such\)"),
        ("views", ring_views(3), "5 responses for 3 views"),
        ("step_hz", 0.0, "the step must be > 0"),
        ("step_hz", -1e6, "the step must be > 0"),
        ("step_hz", float("nan"), "the step must be > 0"),
        ("start_hz", float("inf"), "start inf Hz"),
        ("start_hz", -36e9, "must be above 0"),
    ],
)
def test_inconsistent_objects_are_refused(name, value, match):
    with pytest.raises(DataError, match=match):
        dataclasses.replace(random_response(), **{name: value})


def test_a_heap_that_never_ends_is_refused(tmp_path):
    """An object of index 0 and size 0 in a heap of attribute texts: HDF5 itself would walk on the spot for ever."""
    file = tmp_path / "r.nc"
    file.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(40) + b"GCOL\x01\0\0\0" + (4096).to_bytes(8, "little") + bytes(64))
    with pytest.raises(DataError, match=r"r\.nc: not a readable NetCDF-4 file"):
        FrequencyResponse.load(file)
