"""Channel files of every kind: what is written is read, and what is no such file is refused in one line."""

from __future__ import annotations

import gc
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import shapely
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from kinds_of_channel import EVERY_KIND, MAKERS, name_of, random_components, random_response, same, views_of

import mvla_sim.netcdf
from mvla_sim.channel.cir import INTERACTIONS, Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.header import HEADER
from mvla_sim.channel.loading import load_channel
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import DataError, OutputError
from mvla_sim.scene.antennas.cuts import PatternCuts
from mvla_sim.scene.antennas.horn import Horn
from mvla_sim.scene.antennas.omni import Omni

HORN = Horn(kind="horn", azimuth_beamwidth_deg=20.0, elevation_beamwidth_deg=9.5, shape="cosine", gain_dbi=21.5)
ANTENNAS = (
    Omni(),
    HORN,
    PatternCuts(kind="cuts", azimuth_db=(0.0,) * 1441, elevation_db=(-1.5,) * 721, gain_dbi=3.0),
)

every_kind = pytest.mark.parametrize("kind", EVERY_KIND, ids=name_of)


@every_kind
@settings(max_examples=10, derandomize=True)
@given(
    st.tuples(st.integers(0, 2**32 - 1), st.integers(2, 9)),
    st.tuples(st.booleans(), st.booleans(), st.sampled_from(ANTENNAS)),
    st.one_of(st.just(float("nan")), st.floats(0.1, 99)),
)
def test_round_trip_keeps_every_bit(tmp_path_factory, kind, size, parts, extent):
    (seed, count), (receivers, boresights, antenna) = size, parts
    channel = MAKERS[kind](
        seed, count, extent_m=extent, antenna=antenna, views=views_of(count, receivers, boresights, seed),
        config={"name": "round trip", "objects": [{"radius_m": 0.1}], "none": None}, provenance={"program": "test"},
    )  # fmt: skip
    file = tmp_path_factory.mktemp("channel") / "a.nc"
    channel.save(file)
    for read in (load_channel(file), kind.from_dataset(channel.to_dataset())):
        same(channel, read)
    with xr.open_dataset(file, engine="h5netcdf", decode_timedelta=False) as opened:
        same(channel, kind.from_dataset(opened))


@pytest.mark.parametrize("step_hz", [7.5e6, 3e9 / 1600, 1e9 / 3, np.float64(3e9) / 7])
def test_a_step_is_read_as_it_was_though_frequencies_are_rounded(tmp_path, step_hz):
    random_response(points=401, step_hz=float(step_hz)).save(tmp_path / "a.nc")
    assert FrequencyResponse.load(tmp_path / "a.nc").step_hz == step_hz


def test_a_file_may_hold_no_component(tmp_path):
    none = random_components(range_m=np.zeros(0), power=np.zeros(0), row_size=np.zeros(5, np.int64))
    none.save(tmp_path / "a.nc")
    same(none, Components.load(tmp_path / "a.nc"))


@every_kind
def test_outline_survives_and_may_be_absent(tmp_path, kind):
    outline = shapely.MultiPolygon(
        [shapely.Point(0, 0).buffer(2) - shapely.Point(0, 0).buffer(1), shapely.box(3, 3, 4, 5)]
    )
    for shape in (outline, None):
        MAKERS[kind](outline=shape).save(tmp_path / "a.nc")
        read = kind.load(tmp_path / "a.nc").outline
        if shape is None:
            assert read is None
        else:
            assert read.equals_exact(shape, tolerance=1e-9)  # written with nine decimals: nanometres


@every_kind
def test_file_opens_in_plain_h5py(tmp_path, kind):
    """Every variable under its name, with its meaning and unit."""
    channel = MAKERS[kind](
        views=views_of(5), config={"name": "plain"}, provenance={"cpu": "one"}, antenna=HORN,
        outline=shapely.box(-1, -1, 1, 1),
    )  # fmt: skip
    channel.save(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        np.testing.assert_array_equal(file["position"][:], channel.views.positions_m)
        np.testing.assert_array_equal(file["angle"][:], channel.views.angles_deg)
        np.testing.assert_array_equal(file["receiver"][:], channel.views.receivers_m)
        np.testing.assert_array_equal(file["boresight"][:], channel.views.boresights)
        assert file["carrier_frequency"][()] == channel.carrier_hz
        assert file["bandwidth"][()] == channel.bandwidth_hz
        assert file["target_extent"][()] == channel.extent_m
        for variable in (*kind.VARIABLES, *HEADER):
            assert file[variable.name].dtype == variable.dtype
            for name, text in (("units", variable.units), ("long_name", variable.long_name)):
                assert file[variable.name].attrs.get(name, "") == text
        assert file.attrs["schema"] == kind.SCHEMA
        assert file.attrs["schema_version"] == kind.VERSION
        assert file.attrs["title"] == f"plain: {kind.WHAT}"
        assert json.loads(file.attrs["config"]) == {"name": "plain"}
        assert json.loads(file.attrs["provenance"]) == {"cpu": "one"}
        assert json.loads(file.attrs["antenna"]) == HORN.model_dump()
        assert shapely.from_wkt(file.attrs["target_outline_wkt"]).area == pytest.approx(4)


def test_names_and_units_are_those_that_other_programs_read(tmp_path):
    """The declaration says so; this says it again, for files outlive declarations."""
    units = {
        Cir: {"gain_real": "1", "gain_imag": "1", "delay": "s", "first_point": "m", "position": "m", "angle": "degree"},
        FrequencyResponse: {"frequency": "Hz", "receiver": "m", "boresight": "1", "bandwidth": "Hz"},
        Components: {"range": "m", "power": "1", "carrier_frequency": "Hz", "target_extent": "m", "center": "m"},
    }
    held = {}
    for kind, wanted in units.items():
        channel = MAKERS[kind](views=views_of(5))
        channel.save(tmp_path / "a.nc")
        with h5py.File(tmp_path / "a.nc") as file:
            assert {name: file[name].attrs["units"] for name in wanted} == wanted
            held[kind] = channel, {name: file[name][()] for name in file}
            if kind is Cir:
                assert file["row_size"].attrs["sample_dimension"] == "path"
                assert file["interaction"].attrs["flag_meanings"].split() == list(INTERACTIONS)
                assert file["interaction"].attrs["flag_masks"].tolist() == list(INTERACTIONS.values())
            elif kind is Components:
                assert file["row_size"].attrs["sample_dimension"] == "component"
    cir, stored = held[Cir]
    np.testing.assert_array_equal(stored["gain_real"] + 1j * stored["gain_imag"], cir.gain)
    np.testing.assert_array_equal(stored["delay"], cir.delay_s)
    np.testing.assert_array_equal(stored["row_size"], cir.row_size)
    response, stored = held[FrequencyResponse]
    np.testing.assert_array_equal(stored["response_real"] + 1j * stored["response_imag"], response.response)
    np.testing.assert_array_equal(stored["frequency"], response.frequency_hz)
    components, stored = held[Components]
    for name, field in (("range", "range_m"), ("power", "power"), ("row_size", "row_size")):
        np.testing.assert_array_equal(stored[name], getattr(components, field))
    assert [kind.SCHEMA for kind in units] == ["mvla-sim CIR", "mvla-sim frequency response", "mvla-sim components"]


def test_a_file_is_looked_through_once_and_never_held_in_memory_whole(tmp_path, monkeypatch):
    file, seen = tmp_path / "a.nc", []
    random_response().save(file)
    check = mvla_sim.netcdf.check_heaps
    monkeypatch.setattr(mvla_sim.netcdf, "check_heaps", lambda path: (seen.append(path), check(path)))
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read whole"))
    load_channel(file)
    FrequencyResponse.load(file)
    assert len(seen) == 2


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """The bytes of a file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    for kind in EVERY_KIND:
        MAKERS[kind](views=views_of(5), outline=shapely.box(-1, -1, 1, 1)).save(folder / f"{name_of(kind)}.nc")
    return {kind: (folder / f"{name_of(kind)}.nc").read_bytes() for kind in EVERY_KIND}


@pytest.fixture
def file(tmp_path, kind, good):
    path = tmp_path / "good.nc"
    path.write_bytes(good[kind])
    return path


def refused(kind, path, match, *, both=True):
    """The kind's own reader refuses the file, and the one that looks for its kind, which then goes the same way."""
    for read in (kind.load, load_channel) if both else (load_channel,):
        with pytest.raises(DataError, match=match) as caught:
            read(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def edit(path, change):
    with h5py.File(path, "a") as content:
        change(content)


@every_kind
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
def test_truncated_file_is_refused(kind, file, share):
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    refused(kind, file, "not a readable NetCDF-4 file")


@every_kind
def test_what_is_no_such_file_is_refused(tmp_path, kind):
    refused(kind, tmp_path / "none.nc", "no such")
    refused(kind, tmp_path, "is a folder")
    path = tmp_path / "other.nc"
    for content, match in (
        (b"", "empty"),
        (b"range,gain\n1,2\n" * 99, "not a readable"),
        (b"\x89HDF\r\n\x1a\n", "not a"),
    ):
        path.write_bytes(content)
        refused(kind, path, match)
    # an object of index 0 and size 0 in a heap of attribute texts: HDF5 itself would walk on the spot for ever
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(40) + b"GCOL\x01\0\0\0" + (4096).to_bytes(8, "little") + bytes(64))
    refused(kind, path, r"other\.nc: not a readable NetCDF-4 file")


@every_kind
def test_other_schemas_are_refused(tmp_path, kind):
    other = EVERY_KIND[EVERY_KIND.index(kind) - 1]
    MAKERS[other]().save(tmp_path / "a.nc")
    with pytest.raises(DataError, match=f"schema is '{other.SCHEMA}', not '{kind.SCHEMA}'"):
        kind.load(tmp_path / "a.nc")
    with pytest.raises(DataError, match=f"dataset: schema is '{other.SCHEMA}', not '{kind.SCHEMA}'"):
        kind.from_dataset(MAKERS[other]().to_dataset())
    edit(tmp_path / "a.nc", lambda content: content.attrs.__setitem__("schema", "some other schema"))
    refused(kind, tmp_path / "a.nc", "schema is 'some other schema'")
    edit(tmp_path / "a.nc", lambda content: content.attrs.__delitem__("schema"))
    refused(kind, tmp_path / "a.nc", "schema is None")


@every_kind
def test_a_file_of_another_version_is_refused(kind, file):
    edit(file, lambda content: content.attrs.__setitem__("schema_version", kind.VERSION + 1))
    refused(kind, file, f"{kind.SCHEMA} version {kind.VERSION + 1}; this program reads version {kind.VERSION}")


@every_kind
@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("config", "{", "not a readable mvla-sim"),
        ("config", 7, "not a readable mvla-sim"),
        ("provenance", "[]", "not a readable mvla-sim"),
        ("target_outline_wkt", "POLYGON ((", "not a readable mvla-sim"),
        ("antenna", "{", "not a readable mvla-sim"),
        ("antenna", '{"kind": "dish"}', "antenna"),
        ("antenna", '{"kind": "horn", "azimuth_beamwidth_deg": 0}', "azimuth_beamwidth_deg"),
    ],
)
def test_wrong_attributes_are_refused(kind, file, name, value, match):
    edit(file, lambda content: content.attrs.__setitem__(name, value))
    refused(kind, file, match)


@every_kind
def test_an_antenna_is_omnidirectional_where_a_file_says_none(kind, file):
    edit(file, lambda content: content.attrs.__delitem__("antenna"))
    assert kind.load(file).antenna == Omni()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (kind, item.name) for kind in EVERY_KIND for item in (*kind.VARIABLES, *HEADER)
        if not item.optional and item.name != "frequency"
    ],
)  # fmt: skip
def test_missing_variable_is_named(kind, file, name):
    edit(file, lambda content: content.__delitem__(name))
    refused(kind, file, f"'{name}'.* is missing from this {kind.SCHEMA} file", both=False)


def test_missing_frequencies_are_named(tmp_path):
    """A dimension's own variable stays as a mere length when it is taken away, without the frequencies in it."""
    random_response().to_dataset().drop_vars("frequency").to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    refused(FrequencyResponse, tmp_path / "a.nc", "'frequency'.* is missing from this mvla-sim frequency response file")


VIEWS = [
    ("angle", 720.0, "allowed: 0 to below 360"),
    ("position", np.nan, "not finite"),
    ("receiver", np.inf, "receiver 0 .* is not finite"),
    ("boresight", 2.0, "unit vectors"),
    ("center", np.nan, "not finite"),
]
OWN = {
    Cir: [
        ("row_size", 99, "adds up"),
        ("delay", -1e-9, "negative"),
        ("delay", np.nan, "NaN or infinity"),
        ("gain_real", np.inf, "NaN or infinity"),
        ("interaction", 16, r"interaction holds values other than sums of \[1, 2, 4, 8\]"),
    ],
    FrequencyResponse: [
        ("response_real", np.inf, "view 0, frequency 0 is not finite"),
        ("response_imag", np.nan, "is not finite"),
        ("frequency", 99e9, "apart"),
        ("frequency", np.nan, "apart"),
    ],
    Components: [
        ("range", -0.1, "ranges must be finite and at least 0"),
        ("range", np.nan, "ranges must be finite"),
        ("power", 0.0, "powers must be finite and above 0"),
        ("power", -1.0, "powers must be finite and above 0"),
        ("power", np.inf, "powers must be finite"),
        ("row_size", 99, "adds up"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "name", "value", "match"), [(kind, *case) for kind in EVERY_KIND for case in (*VIEWS, *OWN[kind])]
)
def test_impossible_values_are_refused(kind, file, name, value, match):
    edit(file, lambda content: content[name].__setitem__(0, value))
    refused(kind, file, match, both=False)


@pytest.mark.parametrize("kind", [Cir, Components], ids=name_of)
@pytest.mark.parametrize("name", ["bandwidth", "carrier_frequency"])
def test_scalars_are_checked(kind, file, name):
    edit(file, lambda content: content[name].__setitem__((), -3e9))
    refused(kind, file, "must be above 0")


@pytest.mark.parametrize("value", [99e9, np.nan, -7.5e6])
def test_a_frequency_axis_and_its_step_agree(tmp_path, value):
    random_response().save(tmp_path / "a.nc")
    edit(tmp_path / "a.nc", lambda content: content["frequency"].attrs.__setitem__("step", value))
    refused(FrequencyResponse, tmp_path / "a.nc", "frequencies are 7.5e\\+06 Hz apart")
    edit(tmp_path / "a.nc", lambda content: content["frequency"].attrs.__delitem__("step"))
    assert FrequencyResponse.load(tmp_path / "a.nc").step_hz == pytest.approx(7.5e6, rel=1e-12)  # from the axis


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # raised by h5netcdf's File.__del__
@every_kind
def test_damaged_bytes_never_give_a_traceback(file, kind):
    """Flipped bytes are refused by checksum or structure, or hit what does not matter; nothing else escapes."""
    undamaged = file.read_bytes()

    @settings(max_examples=20)
    @given(st.integers(0, 2**32 - 1))
    def load_damaged(seed):
        rng = np.random.default_rng(seed)
        content = bytearray(undamaged)
        for place in rng.integers(0, len(content), 20):
            content[place] = rng.integers(256)
        file.write_bytes(content)
        message = str(file)
        try:
            kind.load(file)
        except DataError as error:
            message = str(error)
        assert message.startswith(str(file))
        assert "\n" not in message

    load_damaged()
    gc.collect()  # a file of h5netcdf that failed to open complains when it is deleted: here, not in some other test


@every_kind
@pytest.mark.parametrize("where", ["none/a.nc", "."])
def test_unwritable_place_is_an_error_and_leaves_nothing(tmp_path, kind, where):
    with pytest.raises(OutputError):
        MAKERS[kind]().save(tmp_path / where)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda data: data.drop_vars("delay"), "variable 'delay' is missing"),
        (lambda data: data.assign(delay=data["delay"].astype("timedelta64[s]")), "delay holds timedelta64"),
        (lambda data: data.assign(center=("xyz", [0.0, 0.0, 0.0])), r"center has shape \(3,\)"),
        (lambda data: data.assign(row_size=data["row_size"] + 1), "adds up"),
    ],
)
def test_datasets_are_checked_as_files_are(change, match):
    with pytest.raises(DataError, match=f"^mine: .*{match}"):
        Cir.from_dataset(change(MAKERS[Cir]().to_dataset()), "mine")
