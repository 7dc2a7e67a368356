"""CIR objects and files: what is written is read, and what is no CIR file is refused in one line."""

from __future__ import annotations

import dataclasses
import gc
import json

import h5py
import numpy as np
import pytest
import shapely
from channel_scenes import random_cir, ring_views
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.cir import INTERACTIONS, SCHEMA, SCHEMA_VERSION, Cir
from mvla_sim.constants import delay_to_range
from mvla_sim.errors import DataError, OutputError

ARRAYS = ("gain", "delay_s", "interaction", "first_point_m", "row_size")


def same(one, other):
    """Whether two CIRs hold the same bits, NaN equal to NaN."""
    for name in ARRAYS:
        first, second = getattr(one, name), getattr(other, name)
        assert first.dtype == second.dtype, name
        np.testing.assert_array_equal(first, second)
    for name in ("positions_m", "angles_deg", "center_m"):
        np.testing.assert_array_equal(getattr(one.views, name), getattr(other.views, name))
    for name in ("carrier_hz", "bandwidth_hz", "extent_m", "config", "provenance"):
        np.testing.assert_equal(getattr(other, name), getattr(one, name))


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9), st.one_of(st.just(float("nan")), st.floats(0.1, 99)))
def test_round_trip_keeps_every_bit(tmp_path_factory, seed, views, extent):
    config = {"name": "round trip", "objects": [{"shape": "circle", "radius_m": 0.1}], "none": None}
    cir = random_cir(seed, views, extent_m=extent, config=config, provenance={"program": "test"})
    file = tmp_path_factory.mktemp("cir") / "a.nc"
    cir.save(file)
    same(cir, Cir.load(file))


def test_outline_survives_and_may_be_absent(tmp_path):
    outline = shapely.MultiPolygon(
        [shapely.Point(0, 0).buffer(2) - shapely.Point(0, 0).buffer(1), shapely.box(3, 3, 4, 5)]
    )
    for shape in (outline, None):
        random_cir(outline=shape).save(tmp_path / "a.nc")
        read = Cir.load(tmp_path / "a.nc").outline
        if shape is None:
            assert read is None
        else:
            assert read.equals_exact(shape, tolerance=1e-9)  # written with nine decimals: nanometres


def test_file_opens_in_plain_h5py(tmp_path):
    cir = random_cir(config={"name": "plain"}, provenance={"cpu": "one"}, outline=shapely.box(-1, -1, 1, 1))
    cir.save(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        np.testing.assert_array_equal(file["gain_real"][:] + 1j * file["gain_imag"][:], cir.gain)
        np.testing.assert_array_equal(file["delay"][:], cir.delay_s)
        np.testing.assert_array_equal(file["row_size"][:], cir.row_size)
        np.testing.assert_array_equal(file["position"][:], cir.views.positions_m)
        np.testing.assert_array_equal(file["angle"][:], cir.views.angles_deg)
        assert file["first_point"].shape == (cir.gain.size, 3)
        assert file["carrier_frequency"][()] == cir.carrier_hz
        assert file["bandwidth"][()] == cir.bandwidth_hz
        assert file["target_extent"][()] == cir.extent_m
        assert file["row_size"].attrs["sample_dimension"] == "path"
        assert file["interaction"].attrs["flag_meanings"].split() == list(INTERACTIONS)
        assert file["interaction"].attrs["flag_masks"].tolist() == list(INTERACTIONS.values())
        for name, unit in {"delay": "s", "position": "m", "angle": "degree", "bandwidth": "Hz"}.items():
            assert file[name].attrs["units"] == unit
        assert file.attrs["schema"] == SCHEMA
        assert file.attrs["schema_version"] == SCHEMA_VERSION
        assert json.loads(file.attrs["config"]) == {"name": "plain"}
        assert json.loads(file.attrs["provenance"]) == {"cpu": "one"}
        assert shapely.from_wkt(file.attrs["target_outline_wkt"]).area == pytest.approx(4)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "good.nc"
    random_cir(views=4).save(path)
    return path


def refused(path, match):
    with pytest.raises(DataError, match=match) as caught:
        Cir.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
def test_truncated_file_is_refused(file, share):
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    refused(file, "not a readable NetCDF-4 file")


@pytest.mark.parametrize(
    ("content", "match"),
    [(b"", "empty"), (b"range,gain\n1,2\n" * 99, "not a readable"), (b"\x89HDF\r\n\x1a\n", "not a")],
)
def test_other_content_is_refused(tmp_path, content, match):
    path = tmp_path / "other.nc"
    path.write_bytes(content)
    refused(path, match)


def test_missing_file_and_folder_are_refused(tmp_path):
    refused(tmp_path / "none.nc", "no such")
    refused(tmp_path, "is a folder")


def edit(path, change):
    with h5py.File(path, "a") as content:
        change(content)


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("schema", "some other schema", "some other schema"),
        ("schema_version", SCHEMA_VERSION + 1, rf"version {SCHEMA_VERSION + 1}.*reads version {SCHEMA_VERSION}"),
        ("config", "{", "not a readable CIR file"),
        ("config", 7, "not a readable CIR file"),
        ("target_outline_wkt", "POLYGON ((", "not a readable CIR file"),
    ],
)
def test_wrong_attributes_are_refused(file, name, value, match):
    edit(file, lambda content: content.attrs.__setitem__(name, value))
    refused(file, match)


def test_file_without_schema_is_refused(file):
    edit(file, lambda content: content.attrs.__delitem__("schema"))
    refused(file, "schema is None")


@pytest.mark.parametrize(
    "name", ["gain_real", "gain_imag", "delay", "interaction", "first_point", "row_size", "position", "angle",
             "carrier_frequency", "bandwidth", "target_extent", "center"]
)  # fmt: skip
def test_missing_variable_is_named(file, name):
    edit(file, lambda content: content.__delitem__(name))
    refused(file, f"'{name}'.* is missing from this mvla-sim CIR file")


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("row_size", 99, "adds up"),
        ("delay", -1e-9, "negative"),
        ("delay", np.nan, "NaN or infinity"),
        ("gain_real", np.inf, "NaN or infinity"),
        ("angle", 720.0, "allowed: 0 to below 360"),
    ],
)
def test_impossible_values_are_refused(file, name, value, match):
    edit(file, lambda content: content[name].__setitem__(0, value))
    refused(file, match)


def test_scalars_are_checked(file):
    edit(file, lambda content: content["bandwidth"].__setitem__((), -3e9))
    refused(file, "must be above 0")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # raised by h5netcdf's File.__del__
@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_damaged_bytes_never_give_a_traceback(tmp_path_factory, seed):
    """Flipped bytes are refused by checksum or structure, or hit what does not matter; nothing else escapes."""
    path = tmp_path_factory.mktemp("damaged") / "a.nc"
    random_cir(views=4).save(path)
    rng = np.random.default_rng(seed)
    content = bytearray(path.read_bytes())
    for place in rng.integers(0, len(content), 20):
        content[place] = rng.integers(256)
    path.write_bytes(content)
    message = str(path)
    try:
        Cir.load(path)
    except DataError as error:
        message = str(error)
    assert message.startswith(str(path))
    assert "\n" not in message
    gc.collect()  # a file of h5netcdf that failed to open complains when it is deleted: here, not in some other test


@pytest.mark.parametrize("where", ["none/a.nc", "."])
def test_unwritable_place_is_an_error_and_leaves_nothing(tmp_path, where):
    with pytest.raises(OutputError):
        random_cir().save(tmp_path / where)
    assert list(tmp_path.iterdir()) == []


def test_rows_ranges_and_selection():
    cir = random_cir(views=6)
    assert cir.row_start[0] == 0
    assert cir.row_start[-1] == cir.gain.size
    np.testing.assert_array_equal(cir.range_m, delay_to_range(cir.delay_s))
    taken = np.array([4, 0, 3])  # view 3 has no path
    some = cir.select(taken)
    np.testing.assert_array_equal(some.views.angles_deg, cir.views.angles_deg[taken])
    for new, old in enumerate(taken):
        np.testing.assert_array_equal(some.gain[some.rows(new)], cir.gain[cir.rows(old)])
        np.testing.assert_array_equal(some.first_point_m[some.rows(new)], cir.first_point_m[cir.rows(old)])
    assert cir.select(np.zeros(1, np.intp)).n_view == 1


def test_phase_per_view_turns_gains_and_nothing_else():
    cir = random_cir()
    phase = np.linspace(-3, 3, cir.n_view)
    turned = cir.with_phases(phase)
    np.testing.assert_allclose(np.abs(turned.gain), np.abs(cir.gain), rtol=3e-7)  # complex64
    for view in range(cir.n_view):
        angle = np.angle(turned.gain[cir.rows(view)] / cir.gain[cir.rows(view)])
        np.testing.assert_allclose(angle, phase[view], atol=1e-6)  # complex64
    np.testing.assert_array_equal(turned.delay_s, cir.delay_s)


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("delay_s", np.zeros(1), "lengths"),
        ("interaction", np.zeros(1, np.uint8), "lengths"),
        ("first_point_m", np.zeros((1, 3), np.float32), "first_point_m has shape"),
        ("row_size", np.zeros(1, np.int64), "entries for 5 views"),
        ("row_size", np.array([-1, 1, 0, 0, 0]), "adds up"),
        ("views", ring_views(3), "entries for 3 views"),
        ("carrier_hz", 0.0, "must be above 0"),
        ("bandwidth_hz", float("nan"), "must be above 0"),
    ],
)
def test_inconsistent_objects_are_refused(name, value, match):
    with pytest.raises(DataError, match=match):
        dataclasses.replace(random_cir(), **{name: value})
