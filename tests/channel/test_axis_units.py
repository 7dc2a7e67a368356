"""Units that files do not say: what no radar measures is refused with what it would be, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from mvla_sim.channel.readers.arrays import ArrayReader
from mvla_sim.channel.readers.axis_units import check_axis_unit, degrees_of, with_prefix
from mvla_sim.errors import DataError

BAND = np.linspace(34.5e9, 37.5e9, 201)  # 15 MHz apart, unambiguous to 9.993 m
DELAY = np.arange(201) / 3e9  # to 66.7 ns, which is 9.993 m


@pytest.mark.parametrize(("start", "stop", "points"), [
    (34.5e9, 37.5e9, 201), (34.5e9, 37.5e9, 6), (75e9, 110e9, 1001), (220e9, 330e9, 1601), (2e9, 18e9, 801),
    (0.0, 20e9, 2001), (9e3, 3e9, 1601), (2.412e9, 2.432e9, 64), (470e6, 790e6, 501),
])  # fmt: skip
def test_frequencies_that_radars_have(start, stop, points):
    """Whichever the unit, it passes in hertz and is refused with the right factor in any other."""
    axis = np.linspace(start, stop, points)
    check_axis_unit(axis, "frequency", None, "a.npz: axis 'f'")
    for unit, text, name in ((1e9, "1e9", "GHz"), (1e6, "1000000", "MHz"), (1e3, "1000", "kHz")):
        with pytest.raises(DataError, match=f"which is no radar's; .*in {name} it would be .*axis_unit = {text}"):
            check_axis_unit(axis / unit, "frequency", None, "a.npz: axis 'f'")
        check_axis_unit(axis / unit, "frequency", unit, "a.npz: axis 'f'")


def test_the_refusal_says_what_it_would_be():
    with pytest.raises(DataError) as caught:
        check_axis_unit(BAND / 1e9, "frequency", None, "a.npz: axis 'f'")
    assert str(caught.value) == (
        "a.npz: axis 'f' would be 34.5 Hz to 37.5 Hz in steps of 15 mHz, unambiguous to 9.993e+09 m, which is no "
        "radar's; in GHz it would be 34.5 GHz to 37.5 GHz in steps of 15 MHz, unambiguous to 9.993 m: set "
        "arrays.axis_unit = 1e9"
    )


@pytest.mark.parametrize(("unit", "text", "name"), [(1e-9, "1e-9", "ns"), (1e-6, "1e-6", "µs"), (1e-12, "1e-12", "ps")])
def test_delays_in_another_unit(unit, text, name):
    check_axis_unit(DELAY, "delay", None, "a.npz: axis 't'")
    check_axis_unit(DELAY / unit, "delay", unit, "a.npz: axis 't'")
    with pytest.raises(DataError, match=f"in {name} it would be .*66.6667 ns .*axis_unit = {text}"):
        check_axis_unit(DELAY / unit, "delay", None, "a.npz: axis 't'")


def test_ranges_instead_of_delays():
    with pytest.raises(DataError, match=r"in metres of one-way range it would be .*ranges to 10 m: .*= 6\.67128"):
        check_axis_unit(np.linspace(0, 10, 201), "delay", None, "a.npz: axis 'r'")


def test_delays_taken_for_frequencies_and_the_other_way_round():
    for unit in (1, 1e9):
        with pytest.raises(DataError, match=r"delays of 0 s to 66\.6667 ns.*arrays\.axis_kind = 'delay'"):
            check_axis_unit(DELAY * unit, "frequency", None, "a.npz: axis 't'")
    with pytest.raises(DataError, match=r"in Hz it would be 34\.5 GHz.*arrays\.axis_kind = 'frequency'"):
        check_axis_unit(BAND, "delay", None, "a.npz: axis 'f'")
    with pytest.raises(DataError, match=r"in GHz it would be 34\.5 GHz.*'frequency' and arrays\.axis_unit = 1e9"):
        check_axis_unit(BAND / 1e9, "delay", None, "a.npz: axis 'f'")


def test_what_is_unusual_is_taken_where_it_is_said_but_nothing_impossible():
    low = np.linspace(20e6, 90e6, 201)
    with pytest.raises(DataError, match=r"if it is right, say arrays\.axis_unit = 1$"):
        check_axis_unit(low, "frequency", None, "a.npz: axis 'f'")
    check_axis_unit(low, "frequency", 1.0, "a.npz: axis 'f'")
    for unit in (1.0, 1e6 / 1e12, 1e18):
        with pytest.raises(DataError, match=r"in GHz it would be"):
            check_axis_unit(BAND / 1e9, "frequency", unit, "a.npz: axis 'f'")
    with pytest.raises(DataError, match=r"neither as frequencies nor as delays does it fit any unit"):
        check_axis_unit(np.linspace(1, 1 + 1e-9, 3), "frequency", 1.0, "a.npz: axis 'f'")


@pytest.mark.parametrize("kind", ["frequency", "delay"])
def test_an_axis_below_zero(kind):
    with pytest.raises(DataError, match=f"axis 'x' begins at -1e\\+09; {kind}s are absolute"):
        check_axis_unit(np.linspace(-1e9, 1e9, 201), kind, None, "a.npz: axis 'x'")


def test_texts_of_values():
    assert [with_prefix(value, "Hz") for value in (34.5e9, 15e6, 0.0, 999.9, -2e3)] == [
        "34.5 GHz", "15 MHz", "0 Hz", "999.9 Hz", "-2 kHz",
    ]  # fmt: skip
    assert with_prefix(66.7e-9, "s") == "66.7 ns"


# ------------------------------------------------------------------------------------------------------------ angles


@pytest.mark.parametrize("angles", [
    np.deg2rad(np.arange(0, 360, 10)), np.deg2rad(np.arange(0, 361, 10)), np.deg2rad(np.arange(-180, 180, 1.0)),
    np.linspace(0, 2 * np.pi, 37, endpoint=False), np.linspace(0, 2 * np.pi, 360), np.deg2rad([-30.0, 0, 30]),
    np.deg2rad(np.arange(0, 360, 10)).astype(np.float32).astype(float), np.deg2rad(np.arange(0, 360, 10)).round(3),
    np.array([0, np.pi]), np.deg2rad(np.arange(350, -1, -10)),
])  # fmt: skip
def test_radians_are_not_taken_for_degrees(angles):
    with pytest.raises(DataError, match=r"in radians it would be .*set arrays\.angle_unit = 'radian', or 'degree'"):
        degrees_of(angles, None, "a.npz: variable 'phi'")
    np.testing.assert_array_equal(degrees_of(angles, "radian", "a.npz: variable 'phi'"), np.rad2deg(angles))
    np.testing.assert_array_equal(degrees_of(angles, "degree", "a.npz: variable 'phi'"), angles)


@pytest.mark.parametrize("angles", [
    np.arange(0, 360, 10.0), np.linspace(-3, 3, 61), np.linspace(-0.5, 0.5, 11), np.array([0.0]), np.array([3.14159]),
    np.array([5.0, 5.0]), np.array([0, 1, 2, 3.0]), np.arange(0, 5, 0.25), np.linspace(0, 360, 37),
    np.linspace(-3, 3, 61).astype(np.float32).astype(float),
])  # fmt: skip
def test_degrees_are_not_taken_for_radians(angles):
    assert degrees_of(angles, None, "a.npz: variable 'phi'") is angles


def test_degrees_are_not_taken_for_radians_that_are_said():
    with pytest.raises(DataError, match=r"spans 350, which in radians would be 20054°; set arrays\.angle_unit = 'deg"):
        degrees_of(np.arange(0, 360, 10.0), "radian", "a.npz: variable 'phi'")


def test_the_units_are_settings_of_the_reader():
    told = ArrayReader(axis_unit=1e9, angle_unit="radian")
    assert (told.axis_unit, told.angle_unit) == (1e9, "radian")
