"""Component objects and files: what is written is read, and what is no component file is refused in one line."""

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

from mvla_sim.channel.components import COMPONENT_SCHEMA, COMPONENT_VERSION, Components
from mvla_sim.channel.loading import load_channel
from mvla_sim.errors import DataError, OutputError
from mvla_sim.scene.antenna_settings import Horn, Omni

HORN = Horn(kind="horn", azimuth_beamwidth_deg=20.0, gain_dbi=21.5)
ARRAYS = ("range_m", "power", "row_size")


def random_components(seed=0, count=5, **changes):
    """Components of random views, one view without any."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(1, 9, count)
    rows[count // 2] = 0
    fields = {
        "range_m": np.concatenate([np.sort(rng.uniform(3, 9, n)) for n in rows]),
        "power": 10 ** rng.uniform(-12, 0, int(rows.sum())),
        "row_size": rows.astype(np.int64),
        "views": ring_views(count),
        "carrier_hz": 36e9,
        "bandwidth_hz": 3e9,
        "extent_m": 4.0,
    }
    return Components(**(fields | changes))


def same(one, other):
    """Whether two hold the same bits, NaN equal to NaN."""
    for name in ARRAYS:
        first, second = getattr(one, name), getattr(other, name)
        assert first.dtype == second.dtype, name
        np.testing.assert_array_equal(first, second)
    for name in ("positions_m", "angles_deg", "center_m", "receivers_m"):
        np.testing.assert_equal(getattr(other.views, name), getattr(one.views, name))
    assert (one.views.boresights is None) == (other.views.boresights is None)
    if one.views.boresights is not None:  # divided by their length again, which is 1 to rounding
        np.testing.assert_allclose(other.views.boresights, one.views.boresights, rtol=0, atol=1e-15)
    for name in ("carrier_hz", "bandwidth_hz", "extent_m", "antenna", "config", "provenance"):
        np.testing.assert_equal(getattr(other, name), getattr(one, name))


@settings(max_examples=15, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(2, 9),
    st.tuples(st.booleans(), st.booleans(), st.sampled_from([Omni(), HORN])),
    st.one_of(st.just(float("nan")), st.floats(0.1, 99)),
)
def test_round_trip_keeps_every_bit(tmp_path_factory, seed, count, parts, extent):
    receivers, boresights, antenna = parts
    components = random_components(
        seed, count, extent_m=extent, antenna=antenna, views=views_of(count, receivers, boresights, seed),
        config={"name": "round trip", "none": None}, provenance={"program": "test"},
    )  # fmt: skip
    file = tmp_path_factory.mktemp("components") / "a.nc"
    components.save(file)
    same(components, Components.load(file))
    same(components, load_channel(file))


def test_a_file_may_hold_no_component(tmp_path):
    none = random_components(range_m=np.zeros(0), power=np.zeros(0), row_size=np.zeros(5, np.int64))
    none.save(tmp_path / "a.nc")
    same(none, Components.load(tmp_path / "a.nc"))


def test_outline_survives_and_may_be_absent(tmp_path):
    for shape in (shapely.Point(0, 0).buffer(2) - shapely.Point(0, 0).buffer(1), None):
        random_components(outline=shape).save(tmp_path / "a.nc")
        read = Components.load(tmp_path / "a.nc").outline
        if shape is None:
            assert read is None
        else:
            assert read.equals_exact(shape, tolerance=1e-9)  # written with nine decimals: nanometres


def test_file_opens_in_plain_h5py(tmp_path):
    views = views_of(5)
    components = random_components(views=views, config={"name": "plain"}, antenna=HORN)
    components.save(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        np.testing.assert_array_equal(file["range"][:], components.range_m)
        np.testing.assert_array_equal(file["power"][:], components.power)
        np.testing.assert_array_equal(file["row_size"][:], components.row_size)
        np.testing.assert_array_equal(file["receiver"][:], views.receivers_m)
        np.testing.assert_array_equal(file["boresight"][:], views.boresights)
        for name, unit in {"range": "m", "power": "1", "receiver": "m", "boresight": "1"}.items():
            assert file[name].attrs["units"] == unit
        assert file["row_size"].attrs["sample_dimension"] == "component"
        assert file.attrs["schema"] == COMPONENT_SCHEMA
        assert file.attrs["schema_version"] == COMPONENT_VERSION
        assert file.attrs["title"] == "plain: components"
        assert json.loads(file.attrs["antenna"]) == HORN.model_dump()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "good.nc"
    random_components(views=views_of(5), outline=shapely.box(-1, -1, 1, 1)).save(path)
    return path


def refused(path, match):
    with pytest.raises(DataError, match=match) as caught:
        Components.load(path)
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
    path.write_bytes(b"range_m,power_db\n" * 99)
    refused(path, "not a readable")
    random_cir().save(path)
    refused(path, "schema is 'mvla-sim CIR', not 'mvla-sim components'")


def edit(path, change):
    with h5py.File(path, "a") as content:
        change(content)


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("schema", "some other schema", "some other schema"),
        ("schema_version", COMPONENT_VERSION + 1, f"components version {COMPONENT_VERSION + 1}; this program reads"),
        ("config", "{", "not a readable file of components"),
        ("provenance", "7", "not a readable file of components"),
        ("target_outline_wkt", "POLYGON ((", "not a readable file of components"),
        ("antenna", "{", "not a readable file of components"),
        ("antenna", '{"kind": "dish"}', "antenna"),
    ],
)  # fmt: skip
def test_wrong_attributes_are_refused(file, name, value, match):
    edit(file, lambda content: content.attrs.__setitem__(name, value))
    refused(file, match)


@pytest.mark.parametrize(
    "name", ["range", "power", "row_size", "position", "angle", "carrier_frequency", "bandwidth", "target_extent",
             "center"]
)  # fmt: skip
def test_missing_variable_is_named(file, name):
    edit(file, lambda content: content.__delitem__(name))
    refused(file, f"'{name}'.* is missing from this mvla-sim components file")


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("range", -0.1, "ranges must be finite and at least 0"),
        ("range", np.nan, "ranges must be finite"),
        ("power", 0.0, "powers must be finite and above 0"),
        ("power", -1.0, "powers must be finite and above 0"),
        ("power", np.inf, "powers must be finite"),
        ("row_size", 99, "rows add up to"),
        ("angle", 720.0, "allowed: 0 to below 360"),
        ("position", np.nan, "not finite"),
        ("receiver", np.inf, "receiver 0 .* is not finite"),
        ("boresight", 2.0, "unit vectors"),
        ("center", np.nan, "not finite"),
    ],
)
def test_impossible_values_are_refused(file, name, value, match):
    edit(file, lambda content: content[name].__setitem__(0, value))
    refused(file, match)


@pytest.mark.parametrize("name", ["bandwidth", "carrier_frequency"])
def test_scalars_are_checked(file, name):
    edit(file, lambda content: content[name].__setitem__((), -3e9))
    refused(file, "must be above 0")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # raised by h5netcdf's File.__del__
@settings(max_examples=20, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_damaged_bytes_never_give_a_traceback(tmp_path_factory, seed):
    """Flipped bytes are refused by checksum or structure, or hit what does not matter; nothing else escapes.

    The global heap, 4096 bytes with the texts of the attributes, stays whole: it has no checksum, and HDF5 loops for
    ever over an object in it of index 0 and size 0.
    """
    path = tmp_path_factory.mktemp("damaged") / "a.nc"
    random_components(views=views_of(5)).save(path)
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
        Components.load(path)
    except DataError as error:
        message = str(error)
    assert message.startswith(str(path))
    assert "\n" not in message
    gc.collect()  # a file of h5netcdf that failed to open complains when it is deleted: here, not in some other test


@pytest.mark.parametrize("where", ["none/a.nc", "."])
def test_unwritable_place_is_an_error_and_leaves_nothing(tmp_path, where):
    with pytest.raises(OutputError):
        random_components().save(tmp_path / where)
    assert list(tmp_path.iterdir()) == []


def test_selection_takes_whole_views_in_the_order_given():
    components = random_components(count=6, views=views_of(6))
    start = np.concatenate([[0], np.cumsum(components.row_size)])
    taken = np.array([4, 0, 3])  # view 3 has none
    some = components.select(taken)
    np.testing.assert_array_equal(some.row_size, components.row_size[taken])
    for name in ("range_m", "power"):
        rows = [getattr(components, name)[start[i] : start[i + 1]] for i in taken]
        np.testing.assert_array_equal(getattr(some, name), np.concatenate(rows))
    np.testing.assert_array_equal(some.views.receivers_m, components.views.receivers_m[taken])
    np.testing.assert_array_equal(some.views.boresights, components.views.boresights[taken])
    assert components.select(np.array([3])).range_m.size == 0


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("range_m", np.zeros(1), "1 ranges"),
        ("power", np.zeros(1), "1 powers"),
        ("row_size", np.zeros(5, np.int64), "rows add up to 0"),
        ("views", ring_views(3), "row_size has 5 entries for 3 views"),
        ("carrier_hz", 0.0, "must be above 0"),
        ("bandwidth_hz", float("nan"), "must be above 0"),
    ],
)
def test_inconsistent_objects_are_refused(name, value, match):
    with pytest.raises(DataError, match=match):
        dataclasses.replace(random_components(), **{name: value})


def test_a_negative_row_is_refused_though_the_sum_is_right():
    components = random_components()
    rows = components.row_size.copy()
    rows[[0, 2]] = rows[0] + 1, -1
    with pytest.raises(DataError, match="row_size"):
        dataclasses.replace(components, row_size=rows)
