"""Wireless InSite's path files: what stands in them arrives, and what is damaged is refused with file and line."""

from __future__ import annotations

import contextlib
import math
import time

import numpy as np
import pytest
from foreign_files import DIFFRACTION, DIFFUSE, REFRACTION, SPECULAR, Link, Ray, assert_holds, damaged, random_links
from foreign_files import write_p2m as write
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.readers.insite import InSite, read_p2m
from mvla_sim.channel.readers.pairs import PairPaths
from mvla_sim.constants import SPEED_OF_LIGHT
from mvla_sim.errors import ConfigError, DataError

TRANSMITTER = (50.0, 17.0, 5.0)

AS_PRINTED = """\
# three receivers
#   of which the second hears nothing
# and the third is the transmitter itself
     3
     1     2
 -71.25   0.15300E-06   0.50000E-08
    1   0   -71.5000   12.5   0.15237E-06    86.0000   357.0000    94.0000   177.0000
Tx-Rx\x20
 0.5000000E+02   0.1700000E+02   0.5000000E+01
 0.4500000E+01   0.1950000E+02   0.1800000E+01
    2   2   -74.2500   -90.0   0.15810E-06    90.0000   350.0000    95.0000   170.0000
Tx-R-DS-Rx
 0.5000000E+02   0.1700000E+02   0.5000000E+01
 0.1325000E+02   0.2150000E+02   0.2500000E+01
 0.1900000E+02   0.1250000E+02   0.3000000E+01
 0.4500000E+01   0.1950000E+02   0.1800000E+01
     2     0
     3     1
 -60 1e-7 0
    1   1   -60   180   1e-7    0 0 0 0
Tx-D-Rx
50 17 5
1 2 3
50 17 5
"""


@pytest.fixture
def printed(tmp_path):
    file = tmp_path / "model.paths.t001_01.r002.p2m"
    file.write_text(AS_PRINTED)
    return file


def refused(file, text):
    """The one line with which a text is refused."""
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DataError) as caught:
        read_p2m(file)
    message = str(caught.value)
    assert "\n" not in message
    assert str(file) in message
    return message


OTHERS = ("cir", "doa", "dod", "pl", "pg", "power", "spread", "dspower")


def test_a_study_folder_gives_its_paths_and_a_note_on_the_rest(tmp_path, printed, caplog):
    for name in OTHERS:
        (tmp_path / f"model.{name}.t001_01.r002.p2m").write_text(
            "# <number of receiver points>\n 2\n1 3\n1 10.5 1e-8 -65\n"
        )
    (tmp_path / "model.inputpower.t01.p2m").write_text("0 0.001\n")
    (tmp_path / "model.paths.t001_01.r003.P2M").write_text(AS_PRINTED)
    (tmp_path / "._model.paths.t001_01.r002.p2m").write_text("of another system")
    assert InSite().paths(tmp_path).n_pair == 2 * read_p2m(printed).n_pair
    [note] = [record.getMessage() for record in caplog.records]
    assert "left out: cir, doa, dod, dspower, inputpower, pg, pl, power, spread" in note


def test_outputs_without_points_are_told_which_is_needed(tmp_path):
    file = tmp_path / "my.model.cir.t001_01.r002.p2m"
    assert "is InSite's output 'cir'" in refused(file, "# <number of receiver points>\n 1\n1 0\n")
    assert "give my.model.paths.t001_01.r002.p2m" in refused(file, "x")
    with pytest.raises(DataError, match=r"InSite's output of cir and no propagation paths; request these"):
        InSite().paths(tmp_path)


def test_files_of_other_names_are_read_where_none_is_named_paths(tmp_path, printed):
    printed.rename(tmp_path / "run.1.p2m")
    (tmp_path / "model.pl.t001_01.r002.p2m").write_text("#Rx\n1 4 3 1 5 92.5\n")
    assert InSite().paths(tmp_path).n_pair == 2


def test_a_file_as_insite_prints_it(printed):
    paths = read_p2m(printed)
    np.testing.assert_array_equal(paths.row_size, [2, 1])
    np.testing.assert_array_equal(paths.transmitters_m, [TRANSMITTER] * 2)
    np.testing.assert_array_equal(paths.receivers_m, [[4.5, 19.5, 1.8], TRANSMITTER])
    np.testing.assert_array_equal(paths.interaction, [0, SPECULAR | DIFFUSE, DIFFRACTION])
    np.testing.assert_array_equal(paths.delay_s, [1.5237e-7, 1.5810e-7, 1e-7])
    np.testing.assert_allclose(20 * np.log10(np.abs(paths.gain)), [-71.5000, -74.2500, -60], rtol=1e-12)
    np.testing.assert_allclose(np.angle(paths.gain, deg=True), [12.5, -90, 180], rtol=1e-12)
    np.testing.assert_allclose(
        paths.first_point_m, np.array([[math.nan] * 3, [13.25, 21.5, 2.5], [1, 2, 3]], np.float32)
    )
    assert paths.carrier_hz is None
    assert paths.source == {
        "format": "Wireless InSite paths (.p2m)",
        "file": printed.name,
        "transmit_power_dbm": "0",
        "phase": "as in the file",
        "receivers_without_paths": "1",
    }
    # the direct path is as long as printed: half of the last digit is 1.5 mm
    assert paths.delay_s[0] * SPEED_OF_LIGHT == pytest.approx(math.dist([4.5, 19.5, 1.8], TRANSMITTER), abs=1.5e-3)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_what_is_written_is_read(tmp_path_factory, seed, n_receiver):
    links = random_links(seed, n_receiver)
    file = write(tmp_path_factory.mktemp("insite") / "a.paths.p2m", TRANSMITTER, links)
    paths = read_p2m(file)
    assert_holds(paths, TRANSMITTER, [link for link in links if link.rays])
    assert paths.source["receivers_without_paths"] == str(sum(not link.rays for link in links))


def test_received_power_is_relative_to_the_transmitted(tmp_path):
    links = random_links(1, 3)
    file = write(tmp_path / "a.p2m", TRANSMITTER, links, transmit_power_dbm=23.0)
    paths = read_p2m(file, transmit_power_dbm=23.0)
    assert_holds(paths, TRANSMITTER, links[1:])
    np.testing.assert_allclose(np.abs(read_p2m(file).gain / paths.gain) ** 2, 10**2.3)
    assert paths.source["transmit_power_dbm"] == "23"
    for power in (math.nan, math.inf):
        with pytest.raises(ConfigError, match="transmit_power_dbm"):
            InSite(transmit_power_dbm=power)


def test_older_files_have_no_phase(tmp_path):
    links = random_links(2, 3)
    paths = read_p2m(write(tmp_path / "a.p2m", TRANSMITTER, links, phases=False))
    flat = [
        Link(link.receiver, [Ray(r.power_db, 0.0, r.delay_s, r.kinds, r.points) for r in link.rays]) for link in links
    ]
    assert_holds(paths, TRANSMITTER, flat[1:])
    assert paths.source["phase"] == "not in the file, taken as 0"


@pytest.mark.parametrize(
    ("letter", "bits"),
    [
        ("R", SPECULAR), ("D", DIFFRACTION), ("d", DIFFRACTION), ("DS", DIFFUSE), ("T", REFRACTION), ("F", REFRACTION),
        ("X", REFRACTION),
    ],
)  # fmt: skip
def test_each_letter_has_its_bit(printed, letter, bits):
    printed.write_text(AS_PRINTED.replace("Tx-D-Rx", f"Tx-{letter}-Rx"))
    assert read_p2m(printed).interaction[-1] == bits


def test_a_file_without_any_path_gives_no_pair(printed):
    printed.write_text("2\n1 0\n2 0\n")
    paths = read_p2m(printed)
    assert (paths.n_pair, paths.gain.size, paths.source["receivers_without_paths"]) == (0, 0, "2")


@pytest.mark.parametrize("text", [AS_PRINTED.replace("\n", "\r\n"), AS_PRINTED.rstrip(), AS_PRINTED + "\n\n# end\n"])
def test_line_ends_and_comments_do_not_matter(printed, text):
    wanted = read_p2m(printed)
    printed.write_bytes(text.encode())
    np.testing.assert_array_equal(read_p2m(printed).gain, wanted.gain)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("     3\n", "     x\n", "line 4: 'x' is not a number of receivers"),
        ("     3\n", "   3 4\n", "line 4: has 2 columns where the number of receivers"),
        ("     3\n", "    -3\n", "line 4: '-3' is not a number of receivers"),
        ("     3\n", "   3.0\n", "line 4: '3.0' is not a number of receivers"),
        ("     3\n", "     2\n", "line 18: '3     1' follows after the last receiver"),
        ("     3\n", "     4\n", "ends after line 24 where a receiver should follow; is it truncated?"),
        ("     3\n", "1000000000000\n", "line 4: announces 1000000000000 as the number of receivers, too many"),
        ("     1     2\n", "  1 1000000000000\n", "line 5: announces 1000000000000 as the number of paths, too many"),
        ("     1     2\n", "  1 99999999999999999999\n", "line 5: '99999999999999999999' is not a number of paths"),
        ("     1     2\n", "  1 2 3\n", "line 5: has 3 columns; a receiver's number"),
        ("     1     2\n", "  1 1_0\n", "line 5: '1_0' is not a number of paths"),
        (" -71.25   0.15300E-06   0.50000E-08", "-93.44", "line 6: has 1 columns, 3 expected for a receiver's power"),
        ("    1   0   -71.5000", "    1   0", "line 11: has 9 columns, the paths before have 8"),
        ("    1   0   -71.5000   12.5", "    1   0", "line 7: has 7 columns, 8 or 9 expected for a path"),
        ("    1   0   -71", "    1   999999   -71", "line 7: announces 999999 as the number of interactions"),
        ("    1   0   -71", "    1   1   -71", "line 8: 'Tx-Rx' names 0 interactions, the line before 1"),
        ("-71.5000", "nan", "line 7: 'nan' in a path is not a finite number"),
        ("-71.5000", "-9_4.5", "line 7: '-9_4.5' in a path is not a finite number"),
        ("-71.5000", "1e300", "a gain is NaN or above 200 dB"),
        ("-71.5000", "********", "line 7: '********' in a path is not a finite number"),
        ("0.15237E-06", "-1e-9", "line 7: time of arrival -1e-09 s is negative"),
        ("0.15237E-06", "5", "delay 5 s"),
        ("86.0000", "up", "line 7: 'up' in a path is not a finite number"),
        ("Tx-Rx\x20\n", "Rx-Tx\n", "line 8: 'Rx-Tx' is not a list of interactions from Tx to Rx"),
        ("Tx-Rx\x20\n", "Tx\n", "line 8: 'Tx' is not a list of interactions from Tx to Rx"),
        ("Tx-R-DS-Rx", "Tx-R-Q-Rx", "line 12: unknown interaction 'Q'; allowed: R, D, d, DS, T, F, X"),
        ("Tx-R-DS-Rx", "Tx-R--Rx", "line 12: unknown interaction ''"),
        ("0.1900000E+02   0.1250000E+02", "0.1900000E+02", "line 15: has 2 columns, 3 expected for a point"),
        ("0.1900000E+02", "inf", "line 15: 'inf' in a point is not a finite number"),
        ("0.1325000E+02", "1e30", "first_point_m holds values beyond"),
        ("50 17 5\n1 2 3", "50 18 5\n1 2 3", "line 22: this path starts 1 m from where the first one does"),
        ("   0.1800000E+01\n     2", "   0.9800000E+01\n     2", "line 16: this path ends 8 m from where the first"),
    ],
)  # fmt: skip
def test_damage_is_named_with_its_line(printed, old, new, message):
    assert AS_PRINTED.count(old) >= 1
    assert message in refused(printed, AS_PRINTED.replace(old, new, 1))


def test_every_truncation_is_refused(printed):
    """Up to the last coordinate, whose digits may be cut without a trace."""
    for size in range(1, len(AS_PRINTED) - len(" 5\n")):
        refused(printed, AS_PRINTED[:size])


def test_a_line_without_an_end_is_refused_at_once(printed):
    assert "line 1: is longer than 4096 bytes" in refused(printed, b"1 " * 5_000_000)


def test_sizes_beyond_the_file_cost_no_time(printed):
    start = time.perf_counter()
    for _ in range(20):
        refused(printed, "999999999999999\n1 0\n")
        refused(printed, "1\n1 999999999999999\n0 0 0\n")
    assert time.perf_counter() - start < 2  # seconds, where 10^15 turns of a loop would take years


def test_no_file_and_no_content(tmp_path):
    with pytest.raises(DataError, match="no such InSite path file"):
        read_p2m(tmp_path / "a.p2m")
    with pytest.raises(DataError, match="is a folder"):
        read_p2m(tmp_path)
    (tmp_path / "empty.p2m").touch()
    with pytest.raises(DataError, match="is empty"):
        read_p2m(tmp_path / "empty.p2m")
    assert "ends after line 1 where the number of receivers" in refused(tmp_path / "a.p2m", "# nothing\n")
    assert "is not a number of receivers" in refused(tmp_path / "a.p2m", b"\x89HDF\r\n\x1a\n\xff\xfe")


def survives(file, content):
    """Read what may be anything: paths or one line on what is wrong, and nothing else."""
    file.write_bytes(content)
    with contextlib.suppress(DataError):
        assert isinstance(read_p2m(file), PairPaths)


CHANGES = st.lists(st.tuples(st.integers(0, 1 << 16), st.integers(0, 255)), max_size=4)


@settings(max_examples=300)
@given(st.integers(0, 1 << 16), CHANGES)
def test_a_damaged_file_never_crashes(tmp_path_factory, cut, changes):
    file = tmp_path_factory.getbasetemp() / "damaged.p2m"
    survives(file, damaged(AS_PRINTED.encode(), cut if cut % 2 else 0, changes))


WORDS = st.sampled_from(
    ["0", "1", "2", "-1", "1e-7", "nan", "1e400", "Tx-Rx", "Tx-R-Rx", "-", "#", "\n", "\x00", "9" * 15]
)


@settings(max_examples=300)
@given(st.one_of(st.binary(min_size=1, max_size=200), st.lists(WORDS, min_size=1).map(lambda w: " ".join(w).encode())))
def test_anything_at_all_never_crashes(tmp_path_factory, content):
    survives(tmp_path_factory.getbasetemp() / "anything.p2m", content)
