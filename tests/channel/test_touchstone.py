"""Touchstone files: what another program wrote is read equal, and what is no sweep is refused in one line."""

from __future__ import annotations

import time

import numpy as np
import pytest
import skrf
from foreign_files import damaged
from hypothesis import given, settings
from hypothesis import strategies as st
from skrf.io.touchstone import Touchstone

from mvla_sim.channel.readers import touchstone_files
from mvla_sim.channel.readers.angles import missing_angles
from mvla_sim.channel.readers.touchstone import TouchstoneFolder, read_folder
from mvla_sim.channel.readers.touchstone_files import read_touchstone, write_touchstone
from mvla_sim.channel.references import BackgroundSettings, ReferenceSettings
from mvla_sim.errors import ConfigError, DataError, OutputError

START, STEP, COUNT = 34.5e9, 30e6, 101
FREQUENCY = START + STEP * np.arange(COUNT)
OPTION = "# Hz S RI R 50\n"


def random_s(seed, ports=2, count=COUNT):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((count, ports, ports)) + 1j * rng.standard_normal((count, ports, ports))


def rows(frequency, values=2):
    """Data lines of these frequencies, each with so many numbers."""
    return "".join(f"{float(f)!r}" + " 0.5" * values + "\n" for f in frequency)


def refused(file, text, match, parameter="S11"):
    """Write a text or bytes and expect a one-line error with the file's name."""
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DataError, match=match) as caught:
        read_touchstone(file, parameter)
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


# --- reading -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["Hz", "kHz", "MHz", "GHz"])
@pytest.mark.parametrize("form", ["ri", "ma", "db"])
@pytest.mark.parametrize(("ports", "impedance"), [(1, 50), (1, 75), (2, 50), (2, 75), (2, [50, 75]), (4, 50)])
def test_files_of_another_writer_are_read_equal(tmp_path, unit, form, ports, impedance):
    s = random_s(1, ports)
    network = skrf.Network(f=FREQUENCY, f_unit="Hz", s=s, z0=impedance)
    network.frequency.unit = unit
    keep = {} if np.ndim(impedance) == 0 else {"r_ref": 60}  # one impedance a file: S is renormalised on writing
    network.write_touchstone("a", dir=tmp_path, form=form, **keep)
    expected = network.copy()
    if keep:
        expected.renormalize(60)
    for row in range(min(ports, 2)):
        for column in range(min(ports, 2)):
            sweep = read_touchstone(tmp_path / f"a.s{ports}p", f"s{row + 1}{column + 1}")
            assert sweep.response.dtype == np.complex128
            assert sweep.start_hz == pytest.approx(START, rel=1e-12)
            assert sweep.step_hz == pytest.approx(STEP, rel=1e-9)
            # 1e-12: degrees and decibels are written with all digits, and turned back
            np.testing.assert_allclose(sweep.response, expected.s[:, row, column], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    "line", ["# GHz S MA R 50", "#", "# R 50", "# MA S GHZ r 50", "  # s ghz R 75 ma", "#MA", "#GHz\tS\tMA\tR50"]
)
def test_option_line_may_be_short_or_in_any_order(tmp_path, line):
    file = tmp_path / "a.s1p"
    file.write_text(f"! first\n{line} ! after\n34.5 2 90\n35 1 180 ! one\n# Hz S RI R 50\n\n35.5 1 0\n")
    sweep = read_touchstone(file, "S11")
    assert (sweep.start_hz, sweep.step_hz) == (34.5e9, 0.5e9)
    np.testing.assert_allclose(sweep.response, [2j, -1, 1], atol=1e-15)


@pytest.mark.parametrize(("order", "expected"), [("21_12", 0.3), ("12_21", 0.5)])
def test_version_2_and_its_order_of_two_ports(tmp_path, order, expected):
    file = tmp_path / "a.ts"
    file.write_text(
        f"[Version] 2.0\n{OPTION}[Number of Ports] 2\n[Two-Port Data Order] {order}\n[Number of Frequencies] 2\n"
        "[Reference] 50\n 75\n[Network Data]\n1e9 .1 0 .3 0 .5 0 .7 0\n2e9 .1 0 .3 0 .5 0 .7 0\n[End]\n"
    )
    np.testing.assert_allclose(read_touchstone(file, "S21").response, expected)
    refused(file, file.read_text().replace("Frequencies] 2", "Frequencies] 3"), "declares 3 frequencies and holds 2")


def test_noise_data_of_a_two_port_are_no_frequencies(tmp_path):
    file = tmp_path / "a.s2p"
    file.write_text(OPTION + rows([1e9, 2e9, 3e9], 8) + "! noise\n1e9 2 .3 40 .5\n2e9 2 .3 40 .5\n")
    assert read_touchstone(file, "S12").response.shape == (3,)


@pytest.mark.parametrize("mark", ["\x85", "\f", "\v", "\x1c", "\u2028", "\u2029"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_only_line_ends_end_a_line(tmp_path, mark, end):
    """What str.splitlines takes for one may stand in a comment, with numbers after it that are no data."""
    lines = ["# Hz S RI R 50", "1e9 1 0", f"! then{mark}1.5e9 7 7", f"2e9 2 0 ! peak{mark}2.5e9 7 7", "3e9 3 0", ""]
    for encoding in ("utf-8", "utf-16", "cp1252") if mark != "\x85" else ("utf-8", "latin-1"):
        (tmp_path / "a.s1p").write_bytes(end.join(lines).encode(encoding, "ignore"))
        np.testing.assert_array_equal(read_touchstone(tmp_path / "a.s1p", "S11").response, [1, 2, 3])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig"])
def test_encodings_of_windows_editors(tmp_path, encoding):
    file = tmp_path / "a.s1p"
    text = "! Tür 3 °\r\n" * (encoding == "utf-16") + OPTION + rows(FREQUENCY)
    file.write_bytes(text.encode(encoding))
    assert read_touchstone(file, "S11").start_hz == START
    file.write_bytes("\ufeff".encode("utf-16-le") + b"\x00\xd8\x00")
    with pytest.raises(DataError, match="is marked as UTF-16 and is not"):
        read_touchstone(file, "S11")


@pytest.mark.parametrize("prefix", [b"", b"\xef\xbb\xbf", "! Tür bei 3 °\n".encode("latin-1"), b"! any\r\n\r\n"])
def test_encodings_and_line_ends(tmp_path, prefix):
    file = tmp_path / "a.S1P"
    file.write_bytes(prefix + (OPTION + rows(FREQUENCY)).replace("\n", "\r\n").encode())
    assert read_touchstone(file, "S11").response.shape == (COUNT,)


def test_rounded_frequencies_are_a_uniform_axis(tmp_path):
    """GHz with six decimals, as instruments write: 500 Hz off at most, 0.03 % of a step."""
    file = tmp_path / "a.s1p"
    step = 1.875e6
    exact = START + step * np.arange(1601)
    file.write_text("# GHz S RI R 50\n" + "".join(f"{f / 1e9:.6f} 1 0\n" for f in exact))
    sweep = read_touchstone(file, "S11")
    read = sweep.start_hz + sweep.step_hz * np.arange(1601)
    assert abs(read - exact).max() < 1e3
    assert not sweep.rounded


@pytest.mark.parametrize(("decimals", "step"), [(3, 1.875e6), (3, 1.3e6), (2, 15e6), (4, 187.5e3)])
def test_frequencies_that_the_printing_program_rounded_are_the_even_ones(tmp_path, decimals, step):
    """Up to 0.8 of a step; start and end are back to a small part of the last digit, and a folder says so once."""
    file = tmp_path / "0.s1p"
    exact = START + step * np.arange(401)
    file.write_text("# GHz S RI R 50\n" + "".join(f"{f / 1e9:.{decimals}f} 1 0\n" for f in exact))
    sweep = read_touchstone(file, "S11")
    read = sweep.start_hz + sweep.step_hz * np.arange(401)
    assert abs(read - exact).max() < 0.2 * 10.0 ** (9 - decimals)
    assert sweep.rounded


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_missing_frequency_is_not_taken_for_rounding(tmp_path, step):
    """Steps of 1, 2 and 3 MHz, printed in whole MHz, one frequency left out."""
    frequencies = np.delete(1000 + step * np.arange(101), 50)
    text = "# MHz S RI R 50\n" + "".join(f"{f} 1 0\n" for f in frequencies)
    refused(tmp_path / "a.s1p", text, "is not in even steps")


def test_a_rounded_axis_is_noted_once(tmp_path, caplog):
    text = "# GHz S RI R 50\n" + "".join(f"{f / 1e9:.3f} 1 0\n" for f in START + 1.875e6 * np.arange(401))
    for angle in range(4):
        (tmp_path / f"{angle}.s1p").write_text(text)
    read_folder(TouchstoneFolder(parameter="S11"), tmp_path)
    [note] = [record.getMessage() for record in caplog.records]
    assert "frequencies are rounded by more than 1% of a step; read as even steps of 18" in note


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "is empty"),
        ("! only\n! comments\n\n", "holds no data, only comments"),
        (OPTION, "holds no data, only an option line"),
        ("Hello world, this is text\n", "no option line"),
        (rows(FREQUENCY), "no option line"),
        (OPTION + "these are words\n", "line 2: 'these' is not a number"),
        (OPTION + "1e9 0.5 0,5\n2e9 .5 .5\n", "line 2: '0,5' is not a number"),
        (OPTION + rows(FREQUENCY)[:-5], r"line 102: has 2 values; a file of 1 port has 3"),
        (OPTION + rows(FREQUENCY) + "36e9 0.5 -1.2e", "line 103: '-1.2e' is not a number"),
        (OPTION + rows(FREQUENCY[:1]), "must be a list of at least 2 values"),
        (OPTION + "1e9 .5 .5\n2e9 nan .5\n3e9 .5 .5\n", "S11 is not finite at 2000000000 Hz"),
        (OPTION + "1e9 .5 .5\n2e9 .5 -inf\n3e9 1 1\n", "S11 is not finite"),
        ("# Hz S DB R 50\n1e9 1 1\n2e9 1e9 1\n", "S11 is not finite"),
        (OPTION + "1e9 1 1\nnan 1 1\n3e9 1 1\n", "a frequency is not finite"),
        (OPTION + "1e9 1 1\n1e400 1 1\n", "a frequency is not finite"),
        (OPTION + "-1 1 1\n1 1 1\n", "starts at -1 Hz"),
        (OPTION + rows(FREQUENCY[::-1]), "frequencies fall from 37500000000 Hz on; they must rise"),
        (OPTION + rows([1e9, 2e9, 2e9, 3e9]), "strictly: at place 2 .* 2000000000 follows 2000000000"),
        (OPTION + rows(np.geomspace(1e9, 2e9, 9).tolist()), "is not in even steps"),
        (OPTION + rows([1e9, 2e9, 4e9, 5e9]), "is not in even steps"),
        ("# Hz Z RI R 50\n" + rows(FREQUENCY), "line 1: holds Z-parameters; allowed: S-parameters"),
        ("# Hz Y RI R 50\n" + rows(FREQUENCY), "holds Y-parameters"),
        ("# THz S RI R 50\n" + rows(FREQUENCY), "'thz' is unknown in an option line"),
        ("# S S RI R 50\n" + rows(np.arange(9) * 1e-5), "line 1: '# S S RI R 50' is of a sweep over time"),
        ("# ms S RI R 50\n" + rows(range(9)), "is of a sweep over time"),
        ("# dBm S RI R 50\n" + rows(range(9)), "is of a sweep over power"),
        ("# Hz SY RI R 50\n" + rows(FREQUENCY), "'sy' is unknown"),
        ("# Hz S RI R fifty\n" + rows(FREQUENCY), "'fifty' is unknown"),
        (OPTION + rows(FREQUENCY, 0), "line 2: has one value"),
        (OPTION + rows(FREQUENCY, 8), "line 2: has 9 values; a file of 1 port has 3 a line"),
        (b"\x80\x04\x95garbage\x00\xff" * 99, "no option line"),
    ],
)  # fmt: skip
def test_what_is_no_sweep_is_refused(tmp_path, text, match):
    refused(tmp_path / "a.s1p", text, match)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (OPTION + rows(FREQUENCY[::-1], 8), "frequencies fall at 37470000000 Hz; they must rise"),
        (OPTION + rows(FREQUENCY[:99], 2), "line 2: has 3 values; a file of 2 ports has 9 a line"),
        (OPTION + rows(FREQUENCY, 8) + "37.6e9 .5 .5 .5 .5", "line 103: has 5 values"),
        ("[Version] 2.0\n" + OPTION + "[Mixed-Mode Order] D2,3 C2,3\n", "line 3: has mixed-mode parameters"),
        (
            "[Version] 2.0\n" + OPTION + "[Number of Ports] two\n[Network Data]\n" + rows(FREQUENCY, 8),
            "number of ports",
        ),
    ],
)
def test_what_is_no_sweep_of_two_ports_is_refused(tmp_path, text, match):
    """99 frequencies of one port in an .s2p would otherwise pass for 33 of two ports, three steps apart."""
    refused(tmp_path / "a.s2p", text, match, "S21")


def test_parameter_that_is_not_there(tmp_path):
    refused(tmp_path / "a.s1p", OPTION + rows(FREQUENCY), "has no S21; a file of 1 port has S11 only", "S21")
    refused(tmp_path / "a.s2p", OPTION + rows(FREQUENCY, 8), "has no S31; a file of 2 ports has S11 to S22", "s31")
    for parameter in ("S2", "S123", "S0_1", "S10", "S1,2,3", "T21", "S٢1"):
        with pytest.raises(ConfigError, match=f"parameter = '{parameter}': allowed: S11, S21"):
            read_touchstone(tmp_path / "a.s1p", parameter)


@pytest.mark.parametrize("ports", [3, 4, 12])
def test_any_parameter_of_any_number_of_ports(tmp_path, ports):
    s = random_s(4, ports, 11)
    skrf.Network(f=FREQUENCY[:11], f_unit="Hz", s=s).write_touchstone("7", dir=tmp_path, form="ri")
    names = {"S31": (2, 0), "s13": (0, 2), f"S{ports},1": (ports - 1, 0), f"S3_{ports}": (2, ports - 1)}
    for name, (row, column) in names.items():
        read = read_folder(TouchstoneFolder(parameter=name), tmp_path)
        np.testing.assert_allclose(read.response[0], s[:, row, column], rtol=1e-12)


def test_names_and_places_that_are_no_file(tmp_path):
    refused(tmp_path / "a.csv", OPTION + rows(FREQUENCY), r"ends in \.s1p, \.s2p")
    refused(tmp_path / "a.ts", OPTION + rows(FREQUENCY), "does not say its number of ports")
    for path in (tmp_path / "none.s1p", tmp_path):
        with pytest.raises(DataError, match=r"no such|is a folder"):
            read_touchstone(path, "S11")


# --- hostile and damaged files -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.s9999p", OPTION + rows(FREQUENCY)),
        ("a.s99999p", OPTION + rows(FREQUENCY)),
        ("a.s300p", OPTION + "1\n" * 10_000),
        ("a.s2p", f"[Version] 2.0\n{OPTION}[Number of Ports] 9999\n[Network Data]\n" + rows(FREQUENCY)),
        ("a.s2p", f"[Version] 2.0\n{OPTION}[Number of Ports] {'9' * 5000}\n[Network Data]\n" + rows(FREQUENCY)),
        ("a.s2p", f"[Version] 2.0\n{OPTION}[Number of Frequencies] {10**18}\n[Network Data]\n" + rows(FREQUENCY, 8)),
        ("a.s2p", f"[Version] 2.0\n{OPTION}[Number of Ports] 2\n[Reference]\n[Network Data]\n" + rows(FREQUENCY, 8)),
        ("a.ts", f"[Version] 2.0\n{OPTION}[Number of Ports] 0\n[Network Data]\n" + rows(FREQUENCY, 8)),
    ],
)
def test_sizes_that_a_file_only_claims_take_no_memory(tmp_path, name, text, monkeypatch):
    """The parser would allocate ports² · frequencies of them, and fill that from a single number."""
    allocated = [0]
    empty = np.empty

    def counted(shape, *rest, **more):
        allocated.append(int(np.prod(shape)))
        return empty(shape, *rest, **more)

    monkeypatch.setattr(np, "empty", counted)
    start = time.perf_counter()
    refused(tmp_path / name, text, ".")
    assert time.perf_counter() - start < 1  # a hundredth of a second as a rule
    assert max(allocated) <= 16 * COUNT


def test_long_comments_take_no_time(tmp_path):
    """The parser's search for port names takes seconds for a line of 20 000 exclamation marks, minutes for this one."""
    file = tmp_path / "a.s1p"
    file.write_text("!" * 200_000 + "\n" + OPTION + rows(FREQUENCY) + "! Port Impedance" + " 1" * 100_000 + "\n")
    start = time.perf_counter()
    assert read_touchstone(file, "S11").response.shape == (COUNT,)
    assert time.perf_counter() - start < 1


def test_too_large_a_file_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(touchstone_files, "LARGEST_FILE", 1000)
    refused(tmp_path / "a.s1p", OPTION + rows(FREQUENCY), "is not read")


GOOD = [
    ("a.s1p", OPTION + rows(FREQUENCY)),
    ("a.s2p", "! any\n# GHz S MA R 75\n" + rows((FREQUENCY[:20] / 1e9).tolist(), 8) + "1 2 .3 40 .5\n"),
    ("a.s3p", OPTION + "".join(f"{f} 1 2 3 4 5 6\n 1 2 3 4 5 6\n 1 2 3 4 5 6\n" for f in range(9))),
    (
        "a.ts",
        f"[Version] 2.0\n{OPTION}[Number of Ports] 2\n[Two-Port Data Order] 12_21\n[Matrix Format] Lower\n"
        f"[Number of Frequencies] 20\n[Reference] 50 75\n[Network Data]\n{rows(FREQUENCY[:20].tolist(), 6)}[End]\n",
    ),
]


def sweep_or_error(file, content):
    """Anything else than a sweep or a one-line DataError is a failure."""
    file.write_bytes(content)
    sweep, message = None, str(file)
    try:
        sweep = read_touchstone(file, "S11")
    except DataError as error:
        message = str(error)
    assert message.startswith(str(file))
    assert "\n" not in message
    assert len(message) < len(str(file)) + 200
    if sweep is None:
        return None
    assert np.isfinite(sweep.response).all()
    assert sweep.step_hz > 0
    return sweep


@pytest.mark.parametrize(("name", "text"), GOOD)
def test_good_files_of_the_fuzz_tests_are_read(tmp_path, name, text):
    assert sweep_or_error(tmp_path / name, text.encode()) is not None


@settings(max_examples=150, derandomize=True)
@given(
    st.sampled_from(GOOD),
    st.integers(0, 300),
    st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=9),
)
def test_damaged_files_give_a_sweep_or_an_error(tmp_path_factory, good, cuts, changes):
    name, text = good
    sweep_or_error(tmp_path_factory.mktemp("damaged") / name, damaged(text.encode(), cuts, changes))


WORDS = (
    "1|2.5|-3e5|nan|1e999|0x1|1_0|#|Hz|GHz|S|Y|RI|DB|R|50|!|²|\0|\n|\n|\n|\r|\f|\u2028|[Version] 2.0|"
    "[Number of Ports] 3|[Number of Frequencies] 7|[Network Data]|[Noise Data]|[Matrix Format] Upper|[Reference]|[End]|"
    "[Mixed-Mode Order] S1|! Port[1] = x|! Port Impedance|! Gamma|1 .5 .5\n|2 .5 .5\n|# Hz S RI\n"
)
WORDY = st.lists(st.sampled_from(WORDS.split("|"))).map(" ".join)


@settings(max_examples=150, derandomize=True)
@given(
    st.one_of(st.binary(max_size=300), WORDY.map(str.encode), st.text().map(str.encode)),
    st.sampled_from(["a.s1p", "a.s2p", "a.s4p", "a.ts"]),
    st.booleans(),
)
def test_any_content_gives_a_sweep_or_an_error(tmp_path_factory, content, name, option):
    sweep_or_error(tmp_path_factory.mktemp("any") / name, OPTION.encode() * option + content)


# --- a folder of views -------------------------------------------------------------------------------------------


def fill(folder, names, count=11, start=START, step=STEP):
    """A file each, with a response that tells its place in the list."""
    for number, name in enumerate(names):
        frequency = start + step * np.arange(count)
        write_touchstone(folder / name, frequency, np.full((count, 2, 2), number + 1j))


def test_views_are_sorted_by_the_angle_in_their_names(tmp_path):
    fill(tmp_path, ["car_100.0deg.s2p", "car_020.5deg.s2p", "car_-5.0deg.s2p", "car_003.0deg.S2P"])
    (tmp_path / "notes.txt").write_text("no sweep")
    (tmp_path / ".car_7.s2p").write_text("hidden")
    (tmp_path / "sub").mkdir()
    fill(tmp_path / "sub", ["car_200deg.s2p"])
    read = read_folder(TouchstoneFolder(), tmp_path)
    assert read.angles_deg.tolist() == [-5, 3, 20.5, 100]
    assert read.files[0].name == "car_-5.0deg.s2p"
    np.testing.assert_array_equal(read.response[:, 0], [2 + 1j, 3 + 1j, 1 + 1j, 1j])
    assert read.response.shape == (4, 11)
    assert (read.start_hz, read.step_hz) == (START, STEP)


@pytest.mark.parametrize(
    ("name", "pattern", "angle"),
    [
        ("010.5.s2p", "{angle}", 10.5),
        ("car_-10deg.s2p", "{angle}", -10),
        ("car-10deg.s2p", "{angle}", 10),
        ("car-10deg.s2p", "car{angle}deg", -10),
        ("+45.s2p", "{angle}", 45),
        ("run2_a030_v1.s2p", "_a{angle}_", 30),
        ("run2_030deg.s2p", "{angle}deg", 30),
        ("car_030deg.s2p", "car_{angle}deg.s2p", 30),
        ("a.b(7)+.s2p", "({angle})+", 7),
        ("car_12.s2p.s2p", "car_{angle}", 12),
        ("car_12,5deg.s2p", "car_{angle}deg", 12.5),
        ("car_12,5.s2p", "{angle}", 12.5),
        ("car_12,5.s2p", "car_{angle}", 12.5),
        ("car_-012p50deg.s2p", "{angle}", -12.5),
        ("12P5.s2p", "{angle}", 12.5),
        ("az30p3.s2p", "az{angle}p3", 30),
        ("az30,3.s2p", "az{angle},3", 30),
        ("p30p.s2p", "{angle}", 30),
    ],
)
def test_angle_patterns(tmp_path, name, pattern, angle):
    fill(tmp_path, [name])
    assert read_folder(TouchstoneFolder(angle_pattern=pattern), tmp_path).angles_deg.tolist() == [angle]


def test_a_decimal_mark_that_is_no_point_is_noted(tmp_path, caplog):
    fill(tmp_path, ["car_0deg.s2p", "car_7p5deg.s2p", "car_15deg.s2p", "car_22p5deg.s2p"])
    read_folder(TouchstoneFolder(), tmp_path)
    [note] = [record.getMessage() for record in caplog.records]
    assert note.endswith("'22p5' in its name is read as 22.5°")


def folder_refused(settings, folder, match):
    with pytest.raises((DataError, ConfigError), match=match) as caught:
        read_folder(settings, folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (["car.s2p", "car_10.s2p"], "car.s2p: its name has no angle by sweeps.angle_pattern = '{angle}'"),
        (["run2_010.s2p"], r"has 2 angles \(2, 010\)"),
        (["car_10,5,2.s2p"], "has no angle"),
        (["1p2p3.s2p"], "has no angle"),
        (["1.2,3.s2p"], "has no angle"),
        (["car_0,5deg.s2p", "car_0p5deg.s2p"], "the same view twice"),
        (["1.2.3.s2p"], "has no angle"),
        (["9" * 99 + ".s2p", "10.s2p", "010.0.s2p"], "10°, 10.s2p has 10°: the same view|010.0.s2p: has the angle 10°"),
        (["0.s2p", "90.s2p", "720.s2p"], "has the angle 0°, 720.s2p has 720°: the same view twice"),
        (["-10.s2p", "350.s2p"], "the same view twice"),
    ],
)
def test_names_without_one_angle_each_are_refused(tmp_path, names, match):
    fill(tmp_path, names)
    folder_refused(TouchstoneFolder(), tmp_path, match)


@pytest.mark.parametrize("pattern", [None, "car", "{angle}{angle}", ""])
def test_patterns_without_one_place_for_the_angle_are_refused(tmp_path, pattern):
    fill(tmp_path, ["1.s2p"])
    folder_refused(TouchstoneFolder(angle_pattern=pattern), tmp_path, r"must hold \{angle\} once, or give")


def test_angles_of_a_file(tmp_path):
    fill(tmp_path, ["a.s2p", "b.s2p"])
    table = tmp_path / "angles.csv"
    chosen = TouchstoneFolder(angle_file=str(table))
    table.write_text("file,angle_deg\na.s2p,30\nb.s2p,-20.25\n")
    read = read_folder(chosen, tmp_path)
    assert [file.name for file in read.files] == ["b.s2p", "a.s2p"]
    assert read.angles_deg.tolist() == [-20.25, 30]
    for content, match in (
        ("file,angle_deg\na.s2p,30\n", "b.s2p: has no angle in .*angles.csv"),
        ("file,angle_deg\na.s2p,1\nb.s2p,2\nc.s2p,3\n", "file 'c.s2p' is none of the 2 views"),
        ("file,angle_deg\na.s2p,1\nb.s2p,2\na.s2p,3\n", "lists file 'a.s2p' twice"),
        ("file,angle_deg\na.s2p,1\nb.s2p,361\n", "the same view twice"),
        ("file,angle_deg\na.s2p,one\nb.s2p,2\n", "line 2, column angle_deg: 'one' is not a number"),
        ("name,angle\n", "unknown column"),
    ):
        table.write_text(content)
        folder_refused(chosen, tmp_path, match)


def test_background_and_reference_are_no_views(tmp_path, monkeypatch):
    fill(tmp_path, ["10.s2p", "20.s2p", "empty1.s2p", "empty2.s2p", "sphere3.s2p"])
    reference = ReferenceSettings(file=str(tmp_path / "sphere3.s2p"), kind="plate", range_m=5,
                                  background=str(tmp_path / "." / "empty2.s2p"))  # fmt: skip
    monkeypatch.chdir(tmp_path)
    chosen = TouchstoneFolder(background=BackgroundSettings(file="empty1.s2p"), reference=reference)
    assert read_folder(chosen, tmp_path).angles_deg.tolist() == [10, 20]
    for name in ("10.s2p", "20.s2p"):
        (tmp_path / name).unlink()
    folder_refused(chosen, tmp_path, r"only empty1.s2p, empty2.s2p, sphere3.s2p of background and reference")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"count": 12}, r"20.s2p: has 12 frequencies, 10.s2p has 11; they must be the same"),
        ({"start": START + STEP}, r"20.s2p: starts at 34530000000 Hz, 10.s2p at 34500000000 Hz"),
        ({"step": STEP * 1.01}, r"20.s2p: ends at 34803000000 Hz, 10.s2p at 34800000000 Hz"),
    ],
)
def test_mixed_frequency_axes_are_refused(tmp_path, change, match):
    fill(tmp_path, ["10.s2p"])
    fill(tmp_path, ["20.s2p"], **change)
    folder_refused(TouchstoneFolder(), tmp_path, match)


def test_folders_without_views_are_refused(tmp_path):
    folder_refused(TouchstoneFolder(), tmp_path, "no file matches sweeps.files = .*; the folder holds no file")
    for number in range(5):
        (tmp_path / f"{number}.txt").write_text("x")
    folder_refused(TouchstoneFolder(), tmp_path, "holds 5 files: 0.txt, 1.txt, 2.txt, …")
    folder_refused(TouchstoneFolder(), tmp_path / "none", "no such folder")
    folder_refused(TouchstoneFolder(), tmp_path / "0.txt", "is no folder")
    fill(tmp_path, ["1.s2p"])
    (tmp_path / "sub").mkdir()
    for outside in ("../*.s2p", str(tmp_path / "*.s2p"), "sub/../*.s2p", "..\\*.s2p"):
        folder_refused(TouchstoneFolder(files=outside), tmp_path / "sub", "a pattern of names in the folder")


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        (np.arange(0, 360, 10), []),
        (np.delete(np.arange(0, 360, 10), [7, 20]), [70, 200]),
        (np.delete(np.arange(0, 360, 10), [7, 8]), [70, 80]),
        (np.arange(0, 350, 10), [350]),
        (np.arange(10, 360, 10), [0]),
        (np.arange(-180, 170, 10), [170]),
        (np.arange(0, 181, 10), []),
        (np.delete(np.arange(0, 181, 10), 3), [30]),
        (np.array([0, 0.3, 0.7, 1.0, 1.3, 1.7]), []),
        (np.array([0, 10, 11, 50, 170]), []),
        (np.array([0, 180]), []),
        (np.zeros(0), []),
        (np.zeros(9), []),
    ],
)
def test_missing_angles_of_an_even_grid(angles, expected):
    shuffled = np.random.default_rng(0).permutation(angles)
    assert missing_angles(shuffled) == expected


# --- writing -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ports", [1, 2])
def test_what_is_written_is_read_exactly(tmp_path, ports):
    s = random_s(3, ports) * 10.0 ** np.linspace(-300, 5, COUNT)[:, None, None]
    frequency = START + STEP / 7 * np.arange(COUNT)
    file = tmp_path / f"a.s{ports}p"
    write_touchstone(file, frequency, s)
    read = Touchstone(file)
    np.testing.assert_array_equal(read.s, s)
    np.testing.assert_array_equal(read.f, frequency)
    assert "synthetic" in read.comments
    assert read.z0[0, 0] == 50
    for row in range(ports):
        for column in range(ports):
            np.testing.assert_array_equal(read_touchstone(file, f"S{row + 1}{column + 1}").response, s[:, row, column])


def test_what_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(DataError, match="shape"):
        write_touchstone(tmp_path / "a.s3p", FREQUENCY, random_s(0, 3))
    with pytest.raises(DataError, match="shape"):
        write_touchstone(tmp_path / "a.s2p", FREQUENCY[1:], random_s(0))
    with pytest.raises(ConfigError, match=r"must end in \.s2p"):
        write_touchstone(tmp_path / "a.s1p", FREQUENCY, random_s(0))
    with pytest.raises(DataError, match="not finite"):
        write_touchstone(tmp_path / "a.s2p", FREQUENCY, random_s(0) * np.nan)
    with pytest.raises(OutputError):
        write_touchstone(tmp_path / "none" / "a.s2p", FREQUENCY, random_s(0))
    assert list(tmp_path.iterdir()) == []
