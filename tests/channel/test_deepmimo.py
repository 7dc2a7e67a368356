"""DeepMIMO scenarios: what stands in the arrays arrives, and folders of strangers can do no harm."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pickle
import shutil
import struct
import time
import types
import zipfile
import zlib

import numpy as np
import psutil
import pytest
import scipy.io
from foreign_files import (
    DIFFRACTION,
    DIFFUSE,
    REFRACTION,
    SPECULAR,
    Link,
    Ray,
    assert_holds,
    damaged,
    random_links,
    write_array,
    write_deepmimo,
    write_params,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.readers.deepmimo import read_deepmimo
from mvla_sim.channel.readers.pairs import PairPaths, select_pairs
from mvla_sim.errors import DataError

pytestmark = pytest.mark.usefixtures("quick_children")

TRANSMITTER = (1.5, -2.0, 10.0)
CODE = "t000_tx000_r001"
FORMS = ("npz", "npy", "mat", "plain mat")
LINKS = random_links(5, 4)


def write(folder, links=LINKS, form="npz", **more):
    """A scenario of one set of transmitters and one of receivers."""
    return write_deepmimo(folder, TRANSMITTER, links, form=form, **more)


def array(folder, name, form="npz"):
    return folder / f"{name}_{CODE}.{form.split()[-1]}"


def refused(folder):
    """The one line with which a scenario is refused; it names the folder or a file in it."""
    with pytest.raises(DataError) as caught:
        read_deepmimo(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message
    return message


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("seed", range(4))
def test_what_is_written_is_read(tmp_path, form, seed):
    links = random_links(seed, 1 + 2 * seed)
    paths = read_deepmimo(write(tmp_path / "city", links, form, dtype=np.float64))
    assert_holds(paths, TRANSMITTER, links)
    assert paths.carrier_hz == 3.5e9
    assert paths.source == {
        "format": "DeepMIMO v4",
        "folder": "city",
        "deepmimo_version": "4.0.5",
        "raytracer": "Remcom Wireless Insite 3.3.0",
        "phase": "of the file",
        "arrays": "1 of a transmitter and a receiver set",
        "interaction_codes_cut": "0",
    }


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("links", [[], [Link((1.0, 2.0, 3.0))] * 3, [Link((0.0, 0.0, 0.0), [Ray(-60, 0, 1e-7)])]])
def test_no_receivers_no_paths_and_no_interactions(tmp_path, form, links):
    assert_holds(read_deepmimo(write(tmp_path, links, form, dtype=np.float64)), TRANSMITTER, links)


def test_single_precision_as_deepmimo_stores_it(tmp_path):
    paths = read_deepmimo(write(tmp_path))
    exact = read_deepmimo(write(tmp_path, dtype=np.float64))
    np.testing.assert_array_equal(paths.interaction, exact.interaction)
    np.testing.assert_allclose(paths.delay_s, exact.delay_s, rtol=2**-24)
    np.testing.assert_allclose(paths.gain, exact.gain, rtol=1e-12)  # eighths of decibels and degrees are exact


@pytest.mark.parametrize(
    ("code", "bits"),
    [
        (0, 0), (1, SPECULAR), (2, DIFFRACTION), (3, DIFFUSE), (4, REFRACTION), (11, SPECULAR),
        (121, SPECULAR | DIFFRACTION), (4321, SPECULAR | DIFFRACTION | DIFFUSE | REFRACTION),
        (1111111, SPECULAR), (33333333, DIFFUSE),
    ],
)  # fmt: skip
@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
def test_each_digit_has_its_bit(tmp_path, code, bits, dtype):
    write(tmp_path, [Link((0.0, 0.0, 0.0), [Ray(-60, 0, 1e-7)])])
    write_array(tmp_path, "inter", np.array([[code]], dtype))
    assert read_deepmimo(tmp_path).interaction == [bits]


def test_codes_too_long_for_their_numbers_keep_their_leading_digits(tmp_path):
    """Float32 holds seven digits; eight to ten are rounded, so the last ones are not what was written."""
    rng = np.random.default_rng(0)
    digits = rng.integers(1, 3, (300, 10))  # 1 and 2, of which rounding would make 0 and others
    digits[:, 6:] = 4
    codes = np.array([[int("".join(map(str, row[: rng.integers(8, 11)]))) for row in digits]], np.float64)
    write(tmp_path, [Link((0.0, 0.0, 0.0), [Ray(-60, 0, 1e-7)] * codes.size)])
    write_array(tmp_path, "inter", codes.astype(np.float32))
    paths = read_deepmimo(tmp_path)
    leading = [np.bitwise_or.reduce(np.array([0, SPECULAR, DIFFRACTION])[row[:6]]) for row in digits]
    cut = codes[0] > 2**24
    assert paths.source["interaction_codes_cut"] == str(np.count_nonzero(cut))
    np.testing.assert_array_equal((paths.interaction & (SPECULAR | DIFFRACTION))[cut], np.array(leading)[cut])
    write_array(tmp_path, "inter", codes)
    assert read_deepmimo(tmp_path).source["interaction_codes_cut"] == "0"


def test_phases_of_sionna_get_the_part_of_the_carrier(tmp_path):
    plain = read_deepmimo(write(tmp_path, frequency=36_000_000_000))
    turned = read_deepmimo(write(tmp_path, frequency=36_000_000_000, raytracer="Sionna Ray Tracing"))
    expected = plain.gain * np.exp(-2j * np.pi * 36e9 * plain.delay_s)
    np.testing.assert_allclose(turned.gain, expected, rtol=1e-9)  # 10^4 cycles of float64
    assert turned.source["phase"] == "of the file, less 2 pi carrier delay"
    unknown = read_deepmimo(write(tmp_path, frequency=0, raytracer="Sionna Ray Tracing"))
    np.testing.assert_array_equal(unknown.gain, plain.gain)
    assert unknown.source["phase"] == "of the file"


@pytest.mark.parametrize(
    ("frequency", "carrier_hz"), [(None, None), (0, None), (28e9, 28e9), (28000000000, 28e9), ("3.5e9", 3.5e9)]
)
def test_carrier(tmp_path, frequency, carrier_hz):
    assert read_deepmimo(write(tmp_path, frequency=frequency)).carrier_hz == carrier_hz


@pytest.mark.parametrize("frequency", [-1, "fast", True, [1], {}, float("nan"), float("inf"), 10**400])
def test_a_frequency_that_is_none_is_refused(tmp_path, frequency):
    assert "params.json: rt_params.frequency is" in refused(write(tmp_path, frequency=frequency))


def test_every_transmitter_and_set_is_read_and_co_located_ones_are_found(tmp_path):
    """Base stations hear each other too: their set is one of transmitters and of receivers."""
    stations = [(0.0, 0.0, 5.0), (8.0, 0.0, 5.0)]
    echoes = [
        [Link(station, [Ray(-80 - i - j, 0, 1e-7, ("R",), ((1.0, 1.0, 1.0),))]) for j, station in enumerate(stations)]
        for i in range(2)
    ]
    for i, station in enumerate(stations):
        write_deepmimo(tmp_path, station, LINKS, code=f"t000_tx{i:03}_r001")
        write_deepmimo(tmp_path, station, echoes[i], code=f"t000_tx{i:03}_r000")
    paths = read_deepmimo(tmp_path)
    assert paths.n_pair == 2 * (2 + len(LINKS))
    assert paths.source["arrays"] == "4 of a transmitter and a receiver set"
    own = select_pairs(paths, "auto", 0.01)
    np.testing.assert_array_equal(own.receivers_m, stations)
    np.testing.assert_allclose(20 * np.log10(np.abs(own.gain)), [-80, -82])


def test_interaction_points_may_be_missing_or_begin_late(tmp_path):
    write(tmp_path, [Link((0.0, 0.0, 0.0), [Ray(-60, 0, 1e-7, ("R", "R"), ((1.0, 1.0, 1.0), (2.0, 2.0, 2.0)))])])
    np.testing.assert_array_equal(read_deepmimo(tmp_path).first_point_m, [[1, 1, 1]])
    write_array(tmp_path, "inter_pos", np.array([[[[np.nan, 1, 1], [2, 2, 2], [3, 3, 3]]]]))
    np.testing.assert_array_equal(read_deepmimo(tmp_path).first_point_m, [[2, 2, 2]])
    array(tmp_path, "inter_pos").unlink()
    np.testing.assert_array_equal(read_deepmimo(tmp_path).first_point_m, [[np.nan] * 3])


def test_zero_power_is_a_gain_of_zero(tmp_path):
    paths = read_deepmimo(write(tmp_path, [Link((0.0, 0.0, 0.0), [Ray(-np.inf, 0, 1e-7)])]))
    np.testing.assert_array_equal(paths.gain, [0])


def test_other_files_and_names_in_the_parameters_are_never_opened(tmp_path):
    inside = write(tmp_path / "inside")
    wanted = read_deepmimo(inside)
    write_deepmimo(tmp_path, (9.0, 9.0, 9.0), LINKS)
    params = json.loads((inside / "params.json").read_text())
    sets = params["txrx_sets"]
    sets["txrx_set_0"] |= {"id": "../000", "name": "/etc/passwd", "num_points": 10**15}
    sets["txrx_set_1"] |= {"id": -1, "name": "../../power_t000_tx000_r001.npz"}
    params["scene"] = {"num_scenes": 10**15, "folder": ".."}
    (inside / "params.json").write_text(json.dumps(params))
    (inside / "power_t000_tx000_r001.npz.bak").write_text("x")
    (inside / "power_t0_tx0_r1.json").write_text("x")
    (inside / "objects.json").write_text("[")
    np.testing.assert_array_equal(read_deepmimo(inside).transmitters_m, wanted.transmitters_m)


def test_no_scenario(tmp_path):
    assert "no such folder" in refused(tmp_path / "nowhere")
    assert "no such DeepMIMO v4 scenario" in refused(tmp_path)
    write_params(tmp_path)
    assert "holds no arrays of paths" in refused(tmp_path)
    (tmp_path / "scenes").mkdir()
    write(tmp_path / "scenes" / "scene_0")
    assert "holds scenes in folders of their own; give one of them, such as" in refused(tmp_path / "scenes")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"{", "is not readable JSON"),
        (b"\xff\xfe{", "is not readable JSON"),
        (b"[" * 100_000, "is not readable JSON"),
        (b'{"rt_params": {"frequency": ' + b"9" * 5000 + b"}}", "is not readable JSON"),
        (b"[]", "has no object rt_params"),
        (b'{"rt_params": 3}', "has no object rt_params"),
    ],
)
def test_parameters_that_are_none(tmp_path, content, message):
    write(tmp_path)
    (tmp_path / "params.json").write_bytes(content)
    assert message in refused(tmp_path)


def test_parameters_larger_than_any_are_not_read(tmp_path):
    write(tmp_path)
    os.truncate(tmp_path / "params.json", 1 << 32)
    assert "params.json: is larger than 64 MiB" in refused(tmp_path)


@pytest.mark.parametrize("name", ["rx_pos", "tx_pos", "power", "phase", "delay", "inter"])
def test_each_array_is_needed(tmp_path, name):
    write(tmp_path)
    array(tmp_path, name).unlink()
    assert f"{name}_{CODE}: no such array" in refused(tmp_path)


def test_the_same_array_twice(tmp_path):
    write(tmp_path)
    write_array(tmp_path, "delay", np.zeros((4, 4)), form="mat")
    assert f"delay_{CODE}.npz: delay_{CODE}.mat holds the same array" in refused(tmp_path)


FULL = [Link((0.0, 0.0, float(i)), [Ray(-60, 10, 1e-7, ("R",), ((1.0, 1.0, 1.0),))] * 3) for i in range(2)]


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("rx_pos", np.zeros((3, 3)), "power has shape (2, 3), must be [3 receivers, paths]"),
        ("rx_pos", np.zeros((2, 2)), "rx_pos has shape (2, 2), must be [receivers, 3]"),
        ("rx_pos", np.zeros((2, 3), np.complex128), "must be real numbers"),
        ("rx_pos", np.full((2, 3), np.nan), "receivers_m holds NaN"),
        ("rx_pos", np.full((2, 3), 0x7F800001, np.uint32).view(np.float32), "receivers_m holds NaN"),  # it signals
        ("tx_pos", np.zeros((2, 3)), "tx_pos has shape (2, 3), must be [1, 3]"),
        ("tx_pos", np.array([[0, np.inf, 0]]), "transmitters_m holds NaN"),
        ("power", np.zeros(6), "power has shape (6,)"),
        ("power", np.full((2, 3), "loud"), "must be an array of numbers"),
        ("power", np.full((2, 3), np.inf), "a gain is NaN or above 200 dB"),
        ("power", np.full((2, 3), 1e300), "a gain is NaN or above 200 dB"),
        ("power", np.array([[1, 1, np.nan]] * 2), "receiver 0, path 2 is NaN either in phase or in power only"),
        ("phase", np.full((2, 3), np.inf), "a gain is NaN or above 200 dB"),
        ("phase", np.zeros((2, 4)), "phase has shape (2, 4), power has (2, 3)"),
        ("delay", np.full((2, 3), -1e-9), "delay -1e-09 s"),
        ("delay", np.full((2, 3), np.inf), "delay inf s"),
        ("delay", np.array([[0, np.nan, 0]] * 2), "receiver 0, path 1 is NaN either in delay or in power only"),
        ("inter", np.full((2, 3), 5), "interaction code 5: must be 0 or of the digits 1 to 4"),
        ("inter", np.full((2, 3), 10), "interaction code 10:"),
        ("inter", np.full((2, 3), 1.5), "interaction code 1.5:"),
        ("inter", np.full((2, 3), -1), "interaction code -1:"),
        ("inter", np.full((2, 3), np.inf), "interaction code inf:"),
        ("inter", np.full((2, 3), 1e15), "interaction code 1e+15:"),
        ("inter", np.full((2, 3), 2**63 - 1), "interaction code 9.22337203685478e+18:"),
        ("inter_pos", np.zeros((2, 3, 3)), "inter_pos has shape (2, 3, 3), must be (2, 3, 'interactions', 3)"),
        ("inter_pos", np.zeros((2, 2, 1, 3)), "inter_pos has shape (2, 2, 1, 3)"),
        ("inter_pos", np.zeros((2, 3, 101, 3)), "room for 101 interactions"),
        ("inter_pos", np.full((2, 3, 1, 3), 1e300), "first_point_m holds values beyond"),
    ],
)
@pytest.mark.parametrize("form", ["npz", "mat"])
def test_arrays_at_odds_are_refused(tmp_path, name, values, message, form):
    write(tmp_path, FULL, form)
    write_array(tmp_path, name, values, form=form)
    if form == "mat" and values.shape == (6,):
        message = "power has shape (1, 6)"
    assert message in refused(tmp_path)


class Exploit:
    """Would write a file if ever unpickled."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return (os.mkdir, (str(self.file),))


@pytest.mark.parametrize("form", ["npz", "npy"])
def test_nothing_is_ever_unpickled(tmp_path, form):
    write(tmp_path, form=form)
    poison = np.empty((4, 4), object)
    poison[:] = Exploit(tmp_path / "exploited")
    write_array(tmp_path, "power", poison, form=form)
    assert "variable 'power' is text or objects, must be an array of numbers" in refused(tmp_path)
    array(tmp_path, "power", form).write_bytes(pickle.dumps(Exploit(tmp_path / "exploited")))
    assert f"is not a readable .{form} file" in refused(tmp_path)
    assert not (tmp_path / "exploited").exists()


def npy(shape, descr="<f8", data=b""):
    """An .npy file whose header says what it likes."""
    header = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy("(1000000000000, 10)"), "variable 'power' announces shape (1000000000000, 10), "),
        (npy("(4, -4)", data=bytes(128)), "announces shape (4, -4), its 256 bytes do not hold that"),
        (npy("(-4, -4)", data=bytes(128)), "announces shape (-4, -4), its 256 bytes do not hold that"),
        (npy("(4, 4)", data=bytes(127)), "announces shape (4, 4), its 255 bytes do not hold that"),
        (npy("(4, 4)", data=bytes(129)), "announces shape (4, 4), its 257 bytes do not hold that"),
        (npy("(0, 1000000000000000000)"), "power has shape (0, 1000000000000000000), must be"),
        (npy("(4, 0)", "|O"), "is text or objects, must be an array of numbers"),
        (npy("(4, 4)", "|V1000000000000"), "power_t000_tx000_r001.npy"),
        (npy("(4, 4)", [("a", "<f8", (1000000, 1000000))]), "power_t000_tx000_r001.npy"),
        (npy("(4, 4)", "<M8[s]", bytes(128)), "is of type datetime64[s], must be an array of numbers"),
        (npy("[" * 90 + "]" * 90), "is not a readable .npy file"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(200), "is not a readable .npy file"),
        (b"\x93NUMPY\x03\x00" + npy("()")[8:], "is of .npy version 3.0, must be an array of numbers"),
        (b"\x93NUMPY", "is not a readable .npy file"),
    ],
)
@pytest.mark.parametrize("form", ["npz", "npy"])
def test_headers_that_lie_are_refused_before_anything_is_allocated(tmp_path, content, message, form):
    write(tmp_path, form=form)
    if form == "npz":
        message = message.replace(".npy", ".npz") if "version" not in message else message
        with zipfile.ZipFile(array(tmp_path, "power"), "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("power.npy", content)
    else:
        array(tmp_path, "power", form).write_bytes(content)
    assert message in refused(tmp_path)


def test_an_archive_without_the_array_or_packed_in_another_way(tmp_path):
    write(tmp_path)
    for name, method, message in (
        ("delay.npy", zipfile.ZIP_DEFLATED, "has no variable 'power'"),
        ("../power.npy", zipfile.ZIP_DEFLATED, "has no variable 'power'"),
        ("power.npy", zipfile.ZIP_BZIP2, "is packed by method 12, which NumPy does not write"),
        ("power.npy", zipfile.ZIP_LZMA, "is packed by method 14, which NumPy does not write"),
    ):
        with zipfile.ZipFile(array(tmp_path, "power"), "w", method) as archive:
            archive.writestr(name, npy("(4, 4)", data=bytes(128)))
        assert message in refused(tmp_path)


def test_files_larger_than_memory_or_the_cap_are_refused_at_once(tmp_path, monkeypatch):
    write(tmp_path, form="npy")
    array(tmp_path, "power", "npy").write_bytes(npy("(268435456, 20)"))
    os.truncate(array(tmp_path, "power", "npy"), 128 + 268435456 * 160)
    start = time.perf_counter()
    assert "power_t000_tx000_r001.npy: takes 40.00 GiB; at most" in refused(tmp_path)
    assert time.perf_counter() - start < 1  # second; reading 40 GiB of zeros takes longer
    write(tmp_path, form="npy")
    monkeypatch.setattr(psutil, "virtual_memory", lambda: types.SimpleNamespace(available=3000))
    assert "GiB are free; keep fewer in the file" in refused(tmp_path)


def bomb(size):
    """A zip file of zeros that claims to unpack to what it does unpack to."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("power.npy", npy(f"({size // 8}, 1)", data=bytes(size)))
    return content.getvalue()


def test_archives_that_blow_up_are_refused(tmp_path, monkeypatch):
    """Where 30 MiB are free, 64 MiB of zeros, 64 kB when packed, are not unpacked."""
    write(tmp_path)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: types.SimpleNamespace(available=30 << 20))
    array(tmp_path, "power").write_bytes(bomb(64 << 20))
    assert "power_t000_tx000_r001.npz: the numbers of 'power' need 0.4 GiB, 0.0 GiB are free" in refused(tmp_path)


@pytest.mark.parametrize("claimed", [200, 0xFFFFFFF0])
def test_an_archive_that_lies_about_its_size(tmp_path, claimed):
    write(tmp_path)
    packed = bytearray(bomb(1 << 20))
    at = packed.index(b"PK\x01\x02") + 24  # size in the directory, which is the one that is believed
    packed[at : at + 4] = struct.pack("<I", claimed)
    array(tmp_path, "power").write_bytes(packed)
    refused(tmp_path)


DAMAGED = "is damaged or not a .mat file"


def matlab(*elements, version=b"\x00\x01IM"):
    return b"MATLAB 5.0".ljust(124) + version + b"".join(elements)


def element(kind, data, size=None, order="<"):
    return struct.pack(f"{order}2I", kind, len(data) if size is None else size) + data


def variable(name="power", *, shape=(4, 4), kind=6, stored=9, data=bytes(128), size=None, order="<"):
    """A MATLAB variable: its class, shape, name and numbers."""
    parts = (
        (6, struct.pack(f"{order}2I", kind, 0), 8),
        (5, struct.pack(f"{order}2i", *shape), 8),
        (1, name.encode().ljust(8, b"\0"), len(name)),
        (stored, data, size),
    )
    return element(14, b"".join(element(*part, order=order) for part in parts), order=order)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (matlab(version=b"\x00\x02IM"), "is no MATLAB 5 to 7.3 file"),
        (bytes(20) + b"power", "is no MATLAB 5 to 7.3 file"),
        (matlab(), "has no variable 'power'; it has none"),
        (matlab(b"\x0e"), DAMAGED),
        (matlab(element(14, b"", 1 << 31)), DAMAGED),
        (matlab(element(15, b"", 0xFFFFFFFF)), DAMAGED),
        (matlab(element(99, bytes(8))), DAMAGED),
        (matlab(element(15, b"no zlib")), DAMAGED),
        (matlab(element(15, zlib.compress(b"abc"))), DAMAGED),
        (matlab(element(15, zlib.compress(element(14, bytes(50), 10_000)))), DAMAGED),
        (matlab(element(15, zlib.compress(element(14, b"", 0xFFFFFFF0)))), "power_t000_tx000_r001.mat: "),
        (matlab(*[variable("delay")] * 1000), "has two variables of one name"),
        (matlab(*[variable()] * 2), "has two variables of one name"),
        (matlab(element(14, b"")), DAMAGED),
        (matlab(element(14, bytes(64))), DAMAGED),
        (
            matlab(variable(shape=(2**31 - 1, 2**31 - 1))),
            "announces shape (2147483647, 2147483647), 320 bytes",
        ),
        (matlab(variable(shape=(-1, 4))), "phase has shape (4, 3), power has (4, 4)"),
        (matlab(variable(shape=(-4, -4))), DAMAGED),
        (matlab(variable(stored=200)), DAMAGED),
        (matlab(variable(stored=14)), DAMAGED),
        (matlab(variable(size=1 << 31)), DAMAGED),
        (matlab(variable(size=127)), DAMAGED),
        # cells and structures of a claimed size, sparse and complex numbers
        (matlab(variable(kind=3)), "is of class object, which only MATLAB can take apart"),
        (matlab(variable(kind=5)), "must be an array of numbers"),
        *[(matlab(variable(kind=kind)), DAMAGED) for kind in (1, 2, 4, 0x806)],
    ],
)
def test_matlab_files_that_are_none(tmp_path, content, message):
    """The other arrays are of another form: a process of its own reads MATLAB's, and then one file each."""
    write(tmp_path)
    array(tmp_path, "power").unlink()
    array(tmp_path, "power", "mat").write_bytes(content)
    assert message in refused(tmp_path)


def test_matlab_variables_that_are_no_numbers(tmp_path):
    write(tmp_path)
    array(tmp_path, "power").unlink()
    cells = np.empty((4, 4), object)
    cells[:] = 1.0
    cells[3, 3] = "x"
    for values in (cells, {"a": 1.0}, "text", scipy.sparse.eye(4).tocsc()):
        scipy.io.savemat(array(tmp_path, "power", "mat"), {"power": values})
        assert "must be an array of numbers" in (message := refused(tmp_path)) or "it has power.a" in message
    scipy.io.savemat(array(tmp_path, "power", "mat"), {"power": np.ones((4, 4))}, format="4")
    assert "is no MATLAB 5 to 7.3 file" in refused(tmp_path)


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
def test_every_type_of_matlab_numbers(tmp_path, dtype):
    write(tmp_path)
    array(tmp_path, "rx_pos").unlink()
    values = np.arange(12).reshape(4, 3).astype(dtype)
    scipy.io.savemat(array(tmp_path, "rx_pos", "mat"), {"other": [[1]], "rx_pos": values, "third": "text"})
    np.testing.assert_array_equal(read_deepmimo(tmp_path).receivers_m, values)


def test_matlab_files_of_the_other_byte_order(tmp_path):
    write(tmp_path, [Link((1.0, 1.0, 1.0))] * 4, form="mat")
    numbers = variable("rx_pos", shape=(4, 3), data=struct.pack(">12d", *range(12)), order=">")
    array(tmp_path, "rx_pos", "mat").write_bytes(matlab(numbers, version=b"\x01\x00MI"))
    expected = np.arange(12).reshape(3, 4).T  # column after column
    np.testing.assert_array_equal(read_deepmimo(tmp_path).receivers_m, expected)


def test_what_is_no_file_is_not_waited_for(tmp_path):
    write(tmp_path)
    array(tmp_path, "power").unlink()
    os.mkfifo(array(tmp_path, "power"))
    assert "is empty" in refused(tmp_path)
    array(tmp_path, "power").unlink()
    array(tmp_path, "power").mkdir()
    assert "is a folder" in refused(tmp_path)
    array(tmp_path, "power").rmdir()
    array(tmp_path, "power").symlink_to("/dev/zero")
    assert "is empty" in refused(tmp_path)


@pytest.fixture(scope="module")
def scenarios(tmp_path_factory):
    """A good scenario in each form, to be damaged and mended again."""
    return {form: write(tmp_path_factory.mktemp("scenario"), random_links(5, 3), form) for form in FORMS}


def survives(folder, file, content):
    """Read a scenario with one file replaced: paths or one line on what is wrong, and nothing else."""
    good = file.read_bytes()
    file.write_bytes(content)
    try:
        with contextlib.suppress(DataError):
            assert isinstance(read_deepmimo(folder), PairPaths)
    finally:
        file.write_bytes(good)


NAMES = st.sampled_from(["rx_pos", "tx_pos", "power", "phase", "delay", "inter", "inter_pos", "params"])
CHANGES = st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 255)), max_size=4)


def file_of(folder, name, form):
    return folder / "params.json" if name == "params" else array(folder, name, form)


MATLAB_EXAMPLES = 4
"""Fewer, for a process of its own reads each; damage to MATLAB files as such is tested with the reader of arrays."""


def fuzz(examples, *strategies):
    """Each form, the two of MATLAB with fewer examples."""

    def decorate(test):
        @pytest.mark.parametrize("form", FORMS)
        def run(scenarios, form):
            few = settings(max_examples=MATLAB_EXAMPLES if "mat" in form else examples)
            few(given(st.tuples(*strategies))(lambda drawn: test(scenarios, form, *drawn)))()

        run.__doc__ = test.__doc__
        return run

    return decorate


@fuzz(100, NAMES, st.integers(0, 1 << 16), CHANGES)
def test_damaged_scenarios_never_crash(scenarios, form, name, cut, changes):
    file = file_of(scenarios[form], name, form)
    survives(scenarios[form], file, damaged(file.read_bytes(), cut if cut % 2 else 0, changes))


@fuzz(60, NAMES, st.binary(min_size=1, max_size=300), st.booleans())
def test_anything_at_all_never_crashes(scenarios, form, name, content, headed):
    """Random bytes, and random bytes after the first quarter of the file, which may hold a whole header."""
    file = file_of(scenarios[form], name, form)
    good = file.read_bytes()
    survives(scenarios[form], file, good[: len(good) // 4] + content if headed else content)


@settings(max_examples=100)
@given(st.integers(0, 1 << 16), CHANGES)
def test_damage_beneath_the_compression_never_crashes(scenarios, cut, changes):
    """Flips in compressed bytes only break the checksum; these reach the parsers."""
    folder = scenarios["npz"]
    file = array(folder, "power")
    with zipfile.ZipFile(file) as archive:
        member = archive.read("power.npy")
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("power.npy", damaged(member, cut if cut % 2 else 0, changes))
    survives(folder, file, content.getvalue())


def test_the_readers_leave_no_file_open_or_changed(tmp_path):
    folder = write(tmp_path / "one")
    shutil.copytree(folder, tmp_path / "two")
    read_deepmimo(folder)
    for file in folder.iterdir():
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()
    shutil.rmtree(folder)
