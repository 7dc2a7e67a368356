"""Antenna patterns: their beamwidths, levels and gains, the angles they are given in, and files of measured ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.antenna import local_angles
from mvla_sim.scene.antennas.horn import Horn
from mvla_sim.scene.antennas.omni import Omni
from mvla_sim.scene.antennas.pattern_file import PatternFile
from mvla_sim.scene.radio import RadioSettings
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import Scene, SceneSettings
from mvla_sim.settings import parse

HALF_DB = -10 * np.log10(2)
shapes = st.sampled_from(["gaussian", "cosine"])


def horn(**values):
    return Horn(**values).pattern()


def level(antenna, azimuth, elevation=0.0):
    return float(antenna.level_db(np.array([float(azimuth)]), np.array([float(elevation)]))[0])


def from_file(tmp_path, text, **values):
    file = tmp_path / "pattern.csv"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return PatternFile(file=str(file), **values).pattern()


def test_omnidirectional_antennas_have_no_pattern():
    assert Omni().pattern() is None


@settings(max_examples=60)
@given(shapes, st.floats(1, 170), st.floats(1, 170), st.sampled_from([1, -1]))
def test_half_the_power_at_half_the_beamwidth(shape, azimuth, elevation, side):
    antenna = horn(shape=shape, azimuth_beamwidth_deg=azimuth, elevation_beamwidth_deg=elevation)
    for width, angles in ((azimuth, (side * azimuth / 2, 0)), (elevation, (0, side * elevation / 2))):
        # Linear between nodes h = 0.25° apart: h²/8 times the curvature, 24.1/β² dB/deg² of a Gaussian, and less of a
        # cosine but for the widest, whose logarithm bends most where it nears 90°.
        assert level(antenna, *angles) == pytest.approx(HALF_DB, abs=0.2 / width**2 + 1e-3)
    assert level(antenna, 0) == 0
    half = level(antenna, side * azimuth / 2, side * elevation / 2)
    assert half == pytest.approx(2 * HALF_DB, abs=0.2 / azimuth**2 + 0.2 / elevation**2 + 2e-3)  # cuts multiply


def test_vertical_beamwidth_is_as_the_horizontal_one_where_it_is_not_given():
    antenna, same = horn(azimuth_beamwidth_deg=20.0), horn(azimuth_beamwidth_deg=20.0, elevation_beamwidth_deg=20.0)
    assert level(antenna, 0, 10) == pytest.approx(HALF_DB)
    assert antenna.gain_dbi == same.gain_dbi


@pytest.mark.parametrize("shape", ["gaussian", "cosine"])
@pytest.mark.parametrize("beamwidth", [20.0, 120.0, 160.0, 175.0])
def test_floor_is_the_lowest_level_and_that_of_a_cosine_behind(shape, beamwidth):
    antenna = horn(shape=shape, azimuth_beamwidth_deg=beamwidth, floor_db=-35.0)
    azimuth, elevation = np.meshgrid(np.arange(-180.0, 181.0, 7.5), np.arange(-90.0, 91.0, 7.5))
    every = antenna.level_db(azimuth, elevation)
    assert every.shape == azimuth.shape
    assert every.min() >= -35
    assert every.max() == 0
    if shape == "cosine":
        assert (every[np.abs(azimuth) > 90] == -35).all()
        assert (every[np.abs(elevation) > 89.9] == -35).all()  # half of space, by either cut


@settings(max_examples=30)
@given(st.floats(3, 12), st.floats(3, 12))
def test_directivity_of_a_narrow_gaussian_beam(azimuth, elevation):
    """4π over ∫∫ exp(−4 ln2 (φ²/β_az² + ε²/β_el²)) = β_az·β_el·π/(4 ln2)."""
    antenna = horn(azimuth_beamwidth_deg=azimuth, elevation_beamwidth_deg=elevation, floor_db=-100.0)
    solid = np.deg2rad(azimuth) * np.deg2rad(elevation) * np.pi / (4 * np.log(2))
    # cos ε and the beam's own curvature: β²/(16 ln2), 0.4 % or 0.02 dB at 12°; interpolation between nodes 0.3 % at 3°.
    assert antenna.gain_dbi == pytest.approx(10 * np.log10(4 * np.pi / solid), abs=0.04)


@pytest.mark.parametrize(
    "values",
    [
        {"azimuth_beamwidth_deg": 30.0, "elevation_beamwidth_deg": 60.0},
        {"azimuth_beamwidth_deg": 40.0, "shape": "cosine"},
        {"azimuth_beamwidth_deg": 160.0, "shape": "cosine", "floor_db": -10.0},
        {"azimuth_beamwidth_deg": 20.0, "floor_db": -15.0},  # more than half of the power beside the lobe
        "file",
    ],
)
def test_gain_over_the_sphere_is_that_of_the_power_fed(values, tmp_path):
    """∫ G dΩ = 4π by Monte Carlo, over directions about a tilted boresight."""
    if values == "file":
        antenna = from_file(tmp_path, "angle_deg,azimuth_db,elevation_db\n-90,-9,-15\n-20,-6,-3\n0,0,0\n45,-2,-12\n")
    else:
        antenna = horn(**values)
    vectors = np.random.default_rng(1).standard_normal((300_000, 3))
    gain = antenna.amplitude(vectors, np.array([0.48, -0.64, 0.6])) ** 2
    error = gain.std() / np.sqrt(gain.size)
    assert error < 0.01  # or the next line could not fail
    assert gain.mean() == pytest.approx(1, abs=4 * error)


def test_stated_gain_is_that_of_the_peak_and_moves_the_whole_pattern():
    ahead = np.array([[1.0, 0, 0], [1.0, 0.1, 0], [-1.0, 0, 0]])
    own, stated = horn(), horn(gain_dbi=20.0)
    assert stated.amplitude(ahead, ahead[0])[0] ** 2 == pytest.approx(100)
    ratio = stated.amplitude(ahead, ahead[0]) / own.amplitude(ahead, ahead[0])
    np.testing.assert_allclose(ratio, 10 ** ((20 - own.gain_dbi) / 20))


@pytest.mark.parametrize(
    ("vector", "boresight", "azimuth", "elevation"),
    [
        ((2, 0, 0), (1, 0, 0), 0, 0),
        ((1, 1, 0), (1, 0, 0), 45, 0),  # left is positive
        ((1, -1, 0), (1, 0, 0), -45, 0),
        ((1, 0, 1), (1, 0, 0), 0, 45),  # up is positive
        ((-1, 0, 0), (1, 0, 0), 180, 0),
        ((1, 0, 0), (0, 1, 0), -90, 0),
        ((0, 1, 1), (0, 1, 0), 0, 45),
        ((0, 1, 1), (0, 0.6, 0.8), 0, 45 - np.degrees(np.arcsin(0.8))),  # tilted up: what is ahead is below
        ((-1, 0, 0), (0, 0.6, 0.8), 90, 0),  # the antenna's left stays horizontal
        ((0, -0.2, 1.4), (0, 0.6, 0.8), 0, 45),  # and its up tips back
        ((0, 0, -5), (0, 0, -1), 0, 0),
        ((0, 1, 0), (0, 0, 1), 90, 0),  # straight up: left is +y, as of a boresight that was raised from +x
        ((-1, 0, 1), (0, 0, 1), 0, 45),
    ],
)
def test_angles_off_the_boresight(vector, boresight, azimuth, elevation):
    found = local_angles(np.array([vector], float), np.array(boresight, float))
    np.testing.assert_allclose(np.ravel(found), [azimuth, elevation], atol=1e-12)


unit = st.floats(-1, 1)


@settings(max_examples=80)
@given(st.tuples(unit, unit, unit), st.floats(-180, 180), st.sampled_from([0.0, 40.0, -75.0, 89.9, -89.999999]))
def test_angles_lead_back_to_the_vector(vector, azimuth, up):
    """In the frame of boresight, left and up by cross products, at any steepness; and they turn with the antenna."""
    vector = np.array(vector)
    length = np.linalg.norm(vector)
    assume(length > 1e-3)
    turn, up = np.deg2rad(azimuth), np.deg2rad(up)
    ahead = np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    left = np.cross([0, 0, 1], ahead)
    left /= np.linalg.norm(left)
    above = np.cross(ahead, left)
    az, el = (np.deg2rad(angle[0]) for angle in local_angles(vector[None], ahead))
    back = length * (np.cos(el) * (np.cos(az) * ahead + np.sin(az) * left) + np.sin(el) * above)
    np.testing.assert_allclose(back, vector, atol=1e-9)  # at 1e-6° off the vertical, the azimuth keeps nine digits


def test_boresights_one_a_vector_or_one_for_all():
    rng = np.random.default_rng(2)
    vectors, boresights = rng.standard_normal((2, 20, 3))
    boresights /= np.linalg.norm(boresights, axis=1, keepdims=True)
    antenna = horn(azimuth_beamwidth_deg=40.0, elevation_beamwidth_deg=80.0)
    one_by_one = [antenna.amplitude(vectors[k : k + 1], boresights[k])[0] for k in range(20)]
    np.testing.assert_allclose(antenna.amplitude(vectors, boresights), one_by_one, rtol=1e-12)


# Measured patterns.


def test_pattern_file_is_relative_to_its_peak_and_may_be_in_any_order(tmp_path):
    antenna = from_file(tmp_path, "elevation_db,angle_deg,azimuth_db\n-1,30,-7\n2,-30,-4\n5,0,3\n5,10,1\n")
    assert level(antenna, 0) == 0
    assert level(antenna, 10) == pytest.approx(-2)
    assert level(antenna, -30) == pytest.approx(-7)
    assert level(antenna, 20) == pytest.approx(-6)  # halfway, linear in dB
    assert level(antenna, 0, -30) == pytest.approx(-3)
    assert level(antenna, 20, 20) == pytest.approx(-6 - 3)
    # What was not measured is as low as the lowest of its cut; their sum no lower than the lowest of all.
    assert level(antenna, 150) == level(antenna, -90) == pytest.approx(-10)
    assert level(antenna, 0, 80) == pytest.approx(-6)
    assert level(antenna, 150, 80) == pytest.approx(-10)
    assert antenna.floor_db == pytest.approx(-10)


def test_one_cut_serves_for_both_planes(tmp_path):
    antenna = from_file(tmp_path, "angle_deg,azimuth_db\n-40,-20\n0,0\n20,-6\n", gain_dbi=12.5)
    assert level(antenna, 0, 20) == level(antenna, 20, 0) == pytest.approx(-6)
    assert level(antenna, 0, -20) == pytest.approx(-10)
    assert antenna.gain_dbi == 12.5


def test_pattern_that_was_sampled_from_a_horn_is_that_horn(tmp_path):
    made = horn(azimuth_beamwidth_deg=25.0, elevation_beamwidth_deg=50.0, floor_db=-30.0)
    angles = np.arange(-180.0, 180.1, 0.25)
    rows = [f"{a},{level(made, a):.9f},{level(made, 0, np.clip(a, -90, 90)):.9f}" for a in angles]
    read = from_file(tmp_path, "\n".join(["angle_deg,azimuth_db,elevation_db", *rows]))
    np.testing.assert_allclose(read.azimuth_db, made.azimuth_db, atol=1e-8)  # dB, nine digits in the file
    np.testing.assert_allclose(read.elevation_db, made.elevation_db, atol=1e-8)
    assert read.gain_dbi == pytest.approx(made.gain_dbi, abs=1e-6)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "no such antenna pattern file"),
        ("", "is empty"),
        ("angle_deg,azimuth_db\n", "a header and no antenna pattern"),
        ("angle,azimuth_db\n0,0\n", "line 1: unknown column 'angle'; allowed: angle_deg, azimuth_db, elevation_db"),
        ("angle_deg,elevation_db\n0,0\n", "line 1: missing column 'azimuth_db'"),
        ("angle_deg,azimuth_db\n-5,-1\n0,0 dB\n", "line 3, column azimuth_db: '0 dB' is not a number"),
        ("angle_deg,azimuth_db\n-5,-inf\n5,0\n", "line 2, column azimuth_db: '-inf' is not a finite number"),
        ("angle_deg,azimuth_db\n-5,-1,0\n", "line 2: has 3 values"),
        ("angle_deg,azimuth_db\n0,0\n", "at least two different angles"),
        ("angle_deg,azimuth_db\n-5,-1\n5,0\n-5,-1\n", "at least two different angles, each once"),
        ("angle_deg,azimuth_db\n-5,-1\n185,0\n", "from -5 to 185; allowed: -180 to 180 degrees"),
        ("angle_deg,azimuth_db\n0,-1\n359,0\n", "from 0 to 359; allowed: -180 to 180"),
        ("angle_deg,azimuth_db\n10,-1\n20,0\n", "from 10 to 20; 0 must lie between"),
        (b"PK\x00\x00\xff", "not a CSV text file"),
    ],
)
def test_bad_pattern_files_are_refused_in_one_line_with_their_name(tmp_path, content, says):
    file = tmp_path / "pattern.csv"
    if content is not None:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DataError, match=says) as caught:
        PatternFile(file=str(file)).pattern()
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("antenna", "says"),
    [
        ({"kind": "horn", "azimuth_beamwidth_deg": 0.3}, r"antenna\.azimuth_beamwidth_deg"),  # below the nodes' spacing
        ({"kind": "horn", "azimuth_beamwidth_deg": 181.0}, r"antenna\.azimuth_beamwidth_deg"),
        ({"kind": "horn", "elevation_beamwidth_deg": -5.0}, r"antenna\.elevation_beamwidth_deg"),
        ({"kind": "horn", "floor_db": 0.0}, r"antenna\.floor_db"),
        ({"kind": "horn", "shape": "sinc"}, r"antenna\.shape"),
        ({"kind": "file"}, r"antenna\.file"),
        ({"kind": "dish"}, "dish"),
    ],
)
def test_settings_that_are_no_antenna_are_refused(antenna, says):
    with pytest.raises(ConfigError, match=says):
        parse(RadioSettings, {"antenna": antenna}, "test")


def scene_with(file):
    data = {
        "name": "test",
        "objects": [{"shape": "square", "side_m": 2.0}],
        "radio": {"antenna": {"kind": "file", "file": str(file)}},
    }
    return Scene(parse(SceneSettings, data, "test"))


def test_fingerprint_follows_a_patterns_content_and_not_its_place(tmp_path):
    one, moved, edited = (tmp_path / name for name in ("one.csv", "moved.csv", "edited.csv"))
    one.write_text("angle_deg,azimuth_db\n-30,-10\n0,0\n30,-10\n")
    moved.write_bytes(one.read_bytes())
    edited.write_text(one.read_text().replace("30,-10\n0", "30,-10.5\n0"))
    before = scene_with(one).fingerprint()
    assert scene_with(moved).fingerprint() == before
    assert scene_with(edited).fingerprint() != before
    one.write_bytes(edited.read_bytes())
    assert scene_with(one).fingerprint() == scene_with(edited).fingerprint()


def test_a_channel_file_does_without_its_pattern_file(tmp_path):
    """The cuts travel with the data: the sector is the same when the CSV file is gone, to the 0.001 dB they keep."""
    csv = tmp_path / "pattern.csv"
    csv.write_text("angle_deg,azimuth_db\n-90,-30\n-7.2,-3\n0,0\n8,-3.5\n90,-30\n")
    antenna = PatternFile(file=str(csv))
    before = antenna.pattern()
    angle = np.deg2rad([0.0, 90.0, 180.0])
    views = Views(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), np.rad2deg(angle), (0.0, 0.0))
    FrequencyResponse(np.ones((3, 4), complex), 36e9, 1e6, views=views, antenna=antenna).save(tmp_path / "r.nc")
    csv.unlink()
    after = (FrequencyResponse.load(tmp_path / "r.nc").antenna).pattern()
    np.testing.assert_allclose(after.azimuth_db, before.azimuth_db, atol=6e-4)
    np.testing.assert_allclose(after.elevation_db, before.elevation_db, atol=6e-4)
    assert after.gain_dbi == before.gain_dbi
