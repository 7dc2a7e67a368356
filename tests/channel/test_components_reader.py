"""Ready-made components in CSV: every column arrives in its place, and what is wrong is named with line and column."""

from __future__ import annotations

import contextlib
import time
from types import SimpleNamespace

import numpy as np
import pytest
from foreign_files import damaged
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.readers.component_tables import read_components
from mvla_sim.constants import SPEED_OF_LIGHT, range_to_delay
from mvla_sim.errors import DataError

PLAIN = "view,range_m,power\n0,2.5,0.5\n1,3,1\n0,1.5,0.25\n"
FULL = """\
view,delay_ns,power_db,angle_deg,x_m,y_m,z_m,rx_x_m,rx_y_m,rx_z_m
1,20,-60,90,0,2,1,0.5,2,1.5
0,12,-50.5,0,2,0,1,2,0.5,1.25

0,10,-40,0,2,0,1,2,0.5,1.25
"""


@pytest.fixture
def file(tmp_path):
    return tmp_path / "components.csv"


def parsed(file, text):
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    found = read_components(file)
    told = {name: getattr(found, name) for name in ("angles_deg", "positions_m", "receivers_m")}
    return SimpleNamespace(**found.data, **told)


def refused(file, text):
    """The one line with which a text is refused, after the file's name."""
    with pytest.raises(DataError) as caught:
        parsed(file, text)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{file}: ")
    return message.removeprefix(f"{file}: ")


def test_the_least_a_file_can_have(file):
    table = parsed(file, PLAIN)
    np.testing.assert_array_equal(table.range_m, [1.5, 2.5, 3])
    np.testing.assert_array_equal(table.power, [0.25, 0.5, 1])
    np.testing.assert_array_equal(table.row_size, [2, 1])
    assert (table.angles_deg, table.positions_m, table.receivers_m) == (None, None, None)
    assert (table.range_m.dtype, table.power.dtype, table.row_size.dtype) == (np.float64, np.float64, np.int64)


def test_all_a_file_can_have(file):
    table = parsed(file, FULL)
    # half of 10 ns at the speed of light is 1.5 m less 1 mm
    np.testing.assert_allclose(table.range_m, np.array([10, 12, 20]) * SPEED_OF_LIGHT / 2e9, rtol=1e-14)
    np.testing.assert_allclose(table.power, [1e-4, 10**-5.05, 1e-6], rtol=1e-14)  # a few roundings of float64
    np.testing.assert_array_equal(table.row_size, [2, 1])
    np.testing.assert_array_equal(table.angles_deg, [0, 90])
    np.testing.assert_array_equal(table.positions_m, [[2, 0, 1], [0, 2, 1]])
    np.testing.assert_array_equal(table.receivers_m, [[2, 0.5, 1.25], [0.5, 2, 1.5]])


def test_heights_that_are_not_given(file):
    table = parsed(file, "view,range_m,power,y_m,x_m\n0,1,1,3,2\n")
    np.testing.assert_array_equal(table.positions_m, [[2, 3, 0]])
    table = parsed(file, "view,range_m,power,x_m,y_m,z_m,rx_x_m,rx_y_m\n0,1,1,2,3,4,5,6\n")
    np.testing.assert_array_equal(table.receivers_m, [[5, 6, 4]])


ROWS = st.lists(st.tuples(st.integers(0, 5), st.floats(0, 1e6), st.floats(-299, 299)), min_size=1, max_size=30)


@settings(max_examples=60)
@given(ROWS, st.sampled_from(["delay_s", "delay_ns", "range_m"]), st.booleans(), st.randoms(use_true_random=False))
def test_order_and_units_of_a_file_do_not_matter(tmp_path_factory, rows, distance, decibel, random):
    file = tmp_path_factory.getbasetemp() / "order.csv"

    def text(rows):
        units = {"delay_s": range_to_delay, "delay_ns": lambda r: range_to_delay(r) * 1e9, "range_m": float}
        unit = units[distance]
        lines = [f"{v},{unit(r)!r},{(p if decibel else 10 ** (p / 10))!r}" for v, r, p in rows]
        return "\n".join([f"view,{distance},power{'_db' * decibel}", *lines])

    table = parsed(file, text(rows))
    sizes = np.bincount([v for v, _, _ in rows])
    np.testing.assert_array_equal(table.row_size, sizes)
    wanted = sorted((v, r) for v, r, _ in rows)
    np.testing.assert_allclose(table.range_m, [r for _, r in wanted], rtol=1e-13, atol=1e-300)  # to delay and back
    assert all((np.diff(part) >= 0).all() for part in np.split(table.range_m, np.cumsum(sizes)))
    np.testing.assert_allclose(np.sort(table.power), np.sort([10 ** (p / 10) for _, _, p in rows]), rtol=1e-13)
    shuffled = list(rows)
    random.shuffle(shuffled)
    again = parsed(file, text(shuffled))
    np.testing.assert_array_equal(again.range_m, table.range_m)
    np.testing.assert_array_equal(np.sort(again.power), np.sort(table.power))


def test_a_power_stays_with_its_range(file):
    rng = np.random.default_rng(3)
    view, range_m = rng.integers(0, 7, 200), rng.permutation(200) + 1.0
    lines = [f"{v},{r},{r * 2}" for v, r in zip(view, range_m, strict=True)]
    table = parsed(file, "\n".join(["view,range_m,power", *lines]))
    np.testing.assert_array_equal(table.power, table.range_m * 2)
    np.testing.assert_array_equal(np.repeat(np.arange(7), table.row_size), view[np.lexsort((range_m, view))])


def test_a_row_may_come_twice(file):
    table = parsed(file, PLAIN + "1,3,1\n")
    np.testing.assert_array_equal(table.row_size, [2, 2])


def test_a_view_may_have_no_component(file):
    np.testing.assert_array_equal(parsed(file, "view,range_m,power\n3,1,1\n").row_size, [0, 0, 0, 1])
    for column in ("angle_deg", "x_m,y_m"):
        numbers = ",0" * (column.count(",") + 1)
        message = refused(file, f"view,range_m,power,{column}\n0,1,1{numbers}\n2,1,1{numbers}\n")
        assert message == f"view 1 of 0 to 2 has no row, so its {column.split(',')[0]} is unknown"


@pytest.mark.parametrize(
    "text",
    [PLAIN.replace("\n", "\r\n"), "\ufeff" + PLAIN, PLAIN.rstrip(), PLAIN.replace(",", " , "), "\n".join([PLAIN, ""])],
)
def test_line_ends_blanks_and_marks_do_not_matter(file, text):
    np.testing.assert_array_equal(parsed(file, text).range_m, parsed(file, PLAIN).range_m)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("view,", "", "line 1: missing column 'view'"),
        ("view,", "angle,", "line 1: unknown column 'angle'; allowed: view, delay_s, delay_ns, range_m, power"),
        ("delay_ns", "power", "line 1: has none of delay_s, delay_ns, range_m; give exactly one"),
        ("angle_deg", "range_m", "line 1: has delay_ns and range_m of delay_s, delay_ns, range_m; give exactly one"),
        ("angle_deg", "power", "line 1: has power and power_db of power, power_db; give exactly one"),
        ("angle_deg", "x_m", "line 1: column 'x_m' appears 2 times"),
        ("x_m,y_m,z_m,", "x_m,z_m,angle_deg,", "line 1: column 'angle_deg' appears 2 times"),
        ("1,20,-60,90,", "1,20,-60,", "line 2: has 9 values; the header has 10 columns"),
        ("1,20,", "1.5,20,", "line 2, column view: 1.5 must be a whole number from 0 to 999999"),
        ("1,20,", "-1,20,", "line 2, column view: -1 must be a whole number from 0"),
        ("1,20,", "1e15,20,", "line 2, column view: 1e+15 must be a whole number from 0"),
        ("1,20,", "A,20,", "line 2, column view: 'A' is not a number"),
        ("0,10,", "0,-10,", "line 5, column delay_ns: -10 must be 0 to 1.499e+08 m of range"),
        ("0,10,", "0,1e10,", "line 5, column delay_ns: 1e+10 must be 0 to 1.499e+08 m of range"),
        ("0,10,", "0,nan,", "line 5, column delay_ns: 'nan' is not a finite number"),
        ("0,10,", "0,,", "line 5, column delay_ns: '' is not a number"),
        ("-40", "400", "line 5, column power_db: 400 must be above 0, 1e-30 to 1e+30 or ±300 dB"),
        ("-40", "-1e9", "line 5, column power_db: -1000000000 must be above 0"),
        ("-40,0", "-40,1", "line 5, column angle_deg: 1 differs from 0 in an earlier row of view 0"),
        ("-40,0,2", "-40,0,2.5", "line 5, column x_m: 2.5 differs from 2 in an earlier row of view 0"),
        ("-40,0,2,0,1,2,0.5,1.25", "-40,0,2,0,1,2,0.5,1", "line 5, column rx_z_m: 1 differs from 1.25"),
        ("90,0,2", "90,0,2e10", "line 2, column y_m: 2e+10 must be ±1e+09 m"),
        ("90,0,2", "inf,0,2", "line 2, column angle_deg: 'inf' is not a finite number"),
        ("1,20,", '"a\nb",20,', "line 3, column view: 'a b' is not a number"),
        ("1,20,", '"1,20,', "is not a CSV text file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_line_and_column(file, old, new, message):
    assert old in FULL
    assert message in refused(file, FULL.replace(old, new, 1))


TABLE = "view,angle_deg,delay_ns,power_db\n0,0.5,20.25,-60.5\n1,30.0,20.125,-61.5\n"


@pytest.mark.parametrize(
    "text",
    [
        TABLE.replace(",", ";"),
        TABLE.replace(",", ";").replace(".", ","),
        TABLE.replace(",", "\t"),
        TABLE.replace(",", "\t").replace(".", ","),
        TABLE.replace(",", " "),
        TABLE.replace(",", "   ").replace("\n", "\n  "),
        TABLE.replace(",", "|"),
        "sep=;\r\n" + TABLE.replace(",", ";").replace("\n", "\r\n"),
        '"sep=,"\n' + TABLE,
        "sep=\t\n" + TABLE.replace(",", "\t"),
        TABLE.replace("\n", ",,\n") + ",,,,,\n",
        TABLE.replace("\n", ",\n", 1),
        "# exported, by a peak finder\n\n" + TABLE,
        "% one\n! two\n" + TABLE.replace("\n1,", "\n# between\n1,"),
        "# " + TABLE,
        "peak finder 3.1\nThe view, the power_db\n\n" + TABLE,
        TABLE.replace("view,angle_deg,delay_ns,power_db", "View,ANGLE_deg,Delay (ns), Power [dB]"),
        TABLE.replace("\n", ",ok,7\n").replace("ok,7", "flag,snr", 1),
        TABLE.replace("\n", ",ok\n").replace("view", ",view").replace("\n0", "\n0,0").replace("\n1", "\n1,1"),
        TABLE.replace("-", "\u2212"),
        TABLE.replace("\n", "\r"),
        'view,angle_deg,delay_ns,power_db\n0,"0,5","20,25","-60,5"\n1,30,"20,125","-61,5"\n',
        '"view";"angle_deg";"delay_ns";"power_db"\n"0";"0,5";"20,25";"-60,5"\n"1";"30,0";"20,125";"-61,5"\n',
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-8-sig"])
def test_tables_as_spreadsheets_write_them(file, text, encoding):
    table = parsed(file, text.encode(encoding))
    wanted = parsed(file, TABLE)
    np.testing.assert_array_equal(table.range_m, wanted.range_m)
    np.testing.assert_array_equal(table.power, wanted.power)
    np.testing.assert_array_equal(table.angles_deg, [0.5, 30])


def test_columns_that_are_not_needed_are_noted(file, caplog):
    parsed(file, TABLE.replace("\n", ",7,x\n").replace("7,x", "snr,Flag", 1))
    [note] = [record.getMessage() for record in caplog.records]
    assert note.endswith("columns that are not read: 'snr', 'Flag'")


@pytest.mark.parametrize(
    "name", ["angel_deg", "angle", "Angle", "delay_us", "X", "z", "heading_deg", "azimuth_deg", "rxx_m"]
)
def test_a_column_that_may_be_meant_for_one_of_ours_is_not_passed_over(file, name):
    text = f"view,range_m,power,{name}\n0,1,1,1\n"
    assert f"line 1: unknown column '{name}'; allowed: view" in refused(file, text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("view;range_m;power\n0;1,5;2\n0;1.234,5;2\n", "line 2, column range_m: '1,5' is not a number: it has a comma"),
        ("view;range_m;power\n0;1.5;2\n0;1,234;2\n", "line 3, column range_m: '1,234' is not a number: it has a comma"),
        ("view,range_m,power\n0,1,5,2\n", "line 2: has 4 values, decimal commas included; the header has 3 columns"),
        ("view;range_m;power\n0;1_0;2\n", "line 2, column range_m: '1_0' is not a number"),
        ("view;range_m;power\n0;1.5 m;2\n", "line 2, column range_m: '1.5 m' is not a number"),
        ("# made by hand\n\nview;range_m\n0;1\n", "line 3: has none of power, power_db; give exactly one"),
    ],
)
def test_numbers_of_two_marks_and_other_text_are_refused(file, text, message):
    assert message in refused(file, text)


def test_a_comma_that_may_set_thousands_apart_is_noted(file, caplog):
    assert parsed(file, "view;range_m;power\n0;20,125;2\n1;3;2\n").range_m.tolist() == [20.125, 3]
    [note] = [record.getMessage() for record in caplog.records]
    assert note.endswith("'20,125' is read with a decimal comma, as 20.125")
    caplog.clear()
    parsed(file, "view;range_m;power\n0;20,125;2\n1;3,5;2\n")
    assert not caplog.records


@pytest.mark.parametrize("power", ["0", "-1", "1e31"])
def test_powers_are_above_0(file, power):
    assert f"line 3, column power: {float(power):g} must be above 0" in refused(
        file, PLAIN.replace("3,1\n", f"3,{power}\n")
    )


def test_positions_are_whole(file):
    needs = "missing column 'y_m'; positions need x_m and y_m"
    assert needs in refused(file, "view,range_m,power,x_m\n0,1,1,1\n")
    assert "missing column 'x_m'; positions" in refused(file, "view,range_m,power,z_m\n0,1,1,1\n")
    message = refused(file, "view,range_m,power,x_m,y_m,rx_z_m\n0,1,1,1,1,1\n")
    assert "missing column 'rx_x_m'; receivers need rx_x_m and rx_y_m" in message
    message = refused(file, "view,range_m,power,rx_x_m,rx_y_m\n0,1,1,1,1\n")
    assert "missing column 'x_m'; receivers need the positions of transmitters" in message


def test_no_file_and_no_content(tmp_path, file):
    with pytest.raises(DataError, match="no such components file"):
        read_components(file)
    with pytest.raises(DataError, match="is a folder"):
        read_components(tmp_path)
    file.touch()
    with pytest.raises(DataError, match="is empty"):
        read_components(file)
    assert "has a header and no components" in refused(file, "view,range_m,power\n\n")
    assert "is not a CSV text file: it holds zero bytes" in refused(file, b"PK\x03\x04\x00\x00" + PLAIN.encode())
    assert "unknown column" in refused(file, b"\xff\xfe" * 10)


def test_a_file_beyond_the_memory_is_refused_before_it_is_read(file, monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: type("Memory", (), {"available": 1000}))
    assert "its numbers need 0.0 GiB, 0.0 GiB are free; split the file" in refused(file, PLAIN)


def test_a_far_view_costs_no_time(file):
    start = time.perf_counter()
    assert parsed(file, "view,range_m,power\n999999,1,1\n").row_size.size == 10**6
    assert time.perf_counter() - start < 2  # seconds, for eight megabytes of zeros


# ------------------------------------------------------------------------------------------------------------ fuzzing


def survives(file, content):
    """Read what may be anything: components, or one line on what is wrong, and nothing else."""
    with contextlib.suppress(DataError):
        table = parsed(file, content)
        assert table.row_size.sum() == table.range_m.size == table.power.size
        assert np.isfinite(table.range_m).all()
        assert (table.power > 0).all()


CHANGES = st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 255)), max_size=4)
CELLS = st.sampled_from(
    ["0", "1", "-1", "1e-9", "1e308", "nan", "", '"', "\n", "\x00", "view", "range_m", "power", "٣", "1_0", "9" * 400]
)


@settings(max_examples=300)
@given(st.sampled_from([PLAIN, FULL]), st.one_of(st.just(0), st.integers(0, 1 << 16)), CHANGES)
def test_a_damaged_file_never_crashes(tmp_path_factory, text, cut, changes):
    survives(tmp_path_factory.getbasetemp() / "damaged.csv", damaged(text.encode(), cut, changes))


@settings(max_examples=300)
@given(
    st.one_of(
        st.binary(min_size=1, max_size=200),
        st.lists(CELLS, min_size=1).map(lambda cells: ",".join(cells).encode()),
        st.lists(CELLS, min_size=1).map(lambda cells: ("view,range_m,power\n" + ",".join(cells)).encode()),
    )
)
def test_anything_at_all_never_crashes(tmp_path_factory, content):
    survives(tmp_path_factory.getbasetemp() / "anything.csv", content)
