"""Frequency responses in CSV: every number arrives in its place in every layout, and errors are one line."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from foreign_files import damaged
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.importing import import_channel, import_settings, source_kind
from mvla_sim.channel.readers.response_tables import read_response_table
from mvla_sim.errors import DataError

ANGLES = [0.0, 30.0, 60.5]
GHZ = [34.5, 34.515, 34.53, 34.545]
RNG = np.random.default_rng(5)
H = RNG.standard_normal((3, 4)) + 1j * RNG.standard_normal((3, 4))


def wide(names, cells, separator=","):
    """A table of frequencies in GHz; ``names`` and ``cells`` of a view are lists."""
    lines = [separator.join(["Frequency (GHz)", *(name for angle in ANGLES for name in names(angle))])]
    for k, ghz in enumerate(GHZ):
        lines.append(separator.join([f"{ghz}", *(cell for h in H[:, k] for cell in cells(h))]))
    return "\n".join(lines) + "\n"


def parts(h):
    return [f"{h.real:.17g}", f"{h.imag:.17g}"]


def levels(h):
    return [f"{20 * np.log10(abs(h)):.17g}", f"{np.angle(h, deg=True):.17g}"]


def long(first, second, cells, order=None):
    rows = [
        ",".join([f"{v}", f"{ANGLES[v]}", f"{GHZ[k] * 1e3!r}", *cells(complex(H[v, k])), "ok"])
        for v in range(3)
        for k in range(4)
    ]
    rows = [rows[i] for i in (order or range(12))]
    return "\n".join([f"view,angle_deg,frequency_mhz,{first},{second},flag", *rows]) + "\n"


TABLES = {
    "complex": wide(lambda a: [f"{a}"], lambda h: [str(complex(h))]),
    "matlab": wide(lambda a: [f"S21 {a} deg"], lambda h: [f"{h.real:.17g}{h.imag:+.17g}i"]),
    "parts": wide(lambda a: [f"{a}_re", f"{a}_im"], parts),
    "parts first": wide(lambda a: [f"Re(S21) {a}°", f"Im(S21) {a}°"], parts),
    "levels": wide(lambda a: [f"angle_{a}_db", f"angle_{a}_phase_deg"], levels),
    "semicolons": wide(lambda a: [f"{a}_re", f"{a}_im"], parts, ";").replace(".", ","),
    "complex with commas": wide(lambda a: [f"{a}"], lambda h: [str(complex(h))], ";").replace(".", ","),
    "long": long("real", "imag", parts),
    "long in decibels": long("magnitude_db", "phase_deg", levels, order=RNG.permutation(12).tolist()),
    "long by angle": long("real", "imag", parts).replace("view,", "number,"),
}


@pytest.fixture
def file(tmp_path):
    return tmp_path / "sweeps.csv"


@pytest.mark.parametrize("table", TABLES)
def test_every_layout_is_read_equal(file, table):
    file.write_text(TABLES[table], encoding="utf-8")
    assert source_kind(file) == "responses"
    found = read_response_table(file)
    np.testing.assert_allclose(found.data["response"], H, rtol=1e-13)  # decibels and degrees are turned back
    assert found.data["start_hz"] == pytest.approx(34.5e9)
    assert found.data["step_hz"] == pytest.approx(15e6)
    assert found.angles_deg.tolist() == ANGLES


def test_a_table_becomes_a_channel(file, caplog):
    file.write_text(TABLES["complex"])
    channel = import_channel(import_settings(file, overrides=["geometry.radius_m=5"]))
    assert channel.response.shape == (3, 4)
    assert channel.provenance["importer"] == "responses"
    assert "names of columns are read as angles: 0° to 60.5°" in caplog.text


def test_views_may_be_numbers_and_positions(file):
    names = iter(["view_0", "view_1", "view_2"])
    file.write_text(wide(lambda _: [next(names)], lambda h: [str(complex(h))]))
    assert read_response_table(file).angles_deg is None
    text = "view,frequency_hz,real,imag,x_m,y_m\n" + "".join(
        f"{v},{f}e9,1,{f},{v},5\n" for v in (0, 1) for f in (1, 2, 3)
    )
    file.write_text(text)
    found = read_response_table(file)
    np.testing.assert_array_equal(found.positions_m, [[0, 5, 0], [1, 5, 0]])
    np.testing.assert_array_equal(found.data["response"], [[1 + 1j, 1 + 2j, 1 + 3j]] * 2)


def test_a_table_of_components_is_none_of_responses(file):
    file.write_text("view,delay_ns,power_db,frequency_hz\n0,1,1,36e9\n")
    assert source_kind(file) == "components"


LONG = "view,frequency_hz,real,imag\n0,1e9,1,1\n0,2e9,1,1\n1,1e9,1,1\n1,2e9,1,1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frequency,0\n1e9,1j\n2e9,1j\n", "line 1: has 0 of frequency_hz, frequency_khz, frequency_mhz, frequency_ghz"),
        ("frequency_hz\n1e9\n", "has no column of a view beside that of frequency"),
        ("frequency_hz,0\n", "has a header and no frequency responses"),
        ("frequency_hz,0\n1e9,1\n2e9,2\n", "column 0 is real; a frequency response is complex"),
        ("frequency_hz,0\n1e9,1j\n2e9,abc\n", "line 3, column 0: 'abc' is not a finite complex number"),
        ("frequency_hz,0\n1e9,1j\n2e9,nanj\n", "line 3, column 0: 'nanj' is not a finite complex number"),
        ("frequency_hz,0\n1e9,1j\n2e9,1_0j\n", "line 3, column 0: '1_0j' is not a finite complex number"),
        ("frequency_hz,0,0\n1e9,1j,1j\n", "two columns for 0"),
        ("frequency_hz,0_re\n1e9,1\n", "0 has real; needs re and im"),
        ("frequency_hz,0_re,0\n1e9,1,1j\n", "0 has real and a column without a part"),
        ("frequency_hz,0,view_1\n1e9,1j,1j\n", "some columns are named by angles and others by numbers"),
        ("frequency_hz,view_1\n1e9,1j\n", "views are numbered from 0"),
        ("frequency_hz,car\n1e9,1j\n", "line 1: column 'car' is none of a view"),
        ("frequency_hz,0\n1e9,1j\n2e9,1j\n4e9,1j\n", "frequency is not in even steps"),
        ("frequency_hz,0\n1e9,1j\n1e9,1j\n", "frequency must rise or fall strictly"),
        ("frequency_hz,0\n1e9,1j\n", "must be a list of at least 2 values"),
        ("frequency_hz,0\n-1e9,1j\n1e9,1j\n", "starts at -1000000000 Hz"),
        ("frequency_hz,0_db,0_phase\n1e9,1e9,1\n2e9,1,1\n", "a response is too large for a number"),
        (LONG.replace("view,", "number,"), "missing column 'view'; or give angle_deg"),
        (LONG.replace(",imag", ",im"), "missing column 'imag'; real needs it"),
        (LONG.replace("\n1,", "\n2,"), "column view: 2 where 1 is next"),
        (LONG.replace("1,2e9,1,1\n", ""), "view 1 has 1 frequencies, 0 has 2"),
        (LONG.replace("1,2e9", "1,3e9"), "view 1 has other frequencies than 0"),
        (LONG.replace("1,2e9", "x,2e9"), "line 5, column view: 'x' is not a number"),
    ],
)
def test_what_is_no_table_of_responses_is_refused(file, text, message):
    file.write_text(text)
    with pytest.raises(DataError) as caught:
        read_response_table(file)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


def survives(file, content):
    file.write_bytes(content)
    source_kind(file)
    with contextlib.suppress(DataError):
        found = read_response_table(file)
        assert np.isfinite(found.data["response"]).all()
        assert found.data["step_hz"] > 0


@settings(max_examples=150)
@given(
    st.sampled_from(["complex", "parts", "levels", "long"]),
    st.one_of(st.just(0), st.integers(0, 1 << 12)),
    st.lists(st.tuples(st.integers(0, 1 << 12), st.integers(0, 255)), max_size=4),
)
def test_a_damaged_table_never_crashes(tmp_path_factory, table, cut, changes):
    survives(tmp_path_factory.getbasetemp() / "damaged.csv", damaged(TABLES[table].encode(), cut, changes))


CELLS = [
    "0",
    "1",
    "1j",
    "nan",
    "1e999",
    '"',
    "\n",
    "\x00",
    "view",
    "real",
    "imag",
    "view_0",
    "30_re",
    "٣",
    "1_0",
    "9" * 99,
]


@settings(max_examples=150)
@given(st.lists(st.sampled_from(CELLS), min_size=1).map(lambda cells: ("frequency_hz," + ",".join(cells)).encode()))
def test_any_table_never_crashes(tmp_path_factory, content):
    survives(tmp_path_factory.getbasetemp() / "any.csv", content)
