"""Importing: which reader a source is for, readers of other packages, and what settings say of files."""

from __future__ import annotations

import json
from typing import ClassVar

import numpy as np
import pytest
from channel_scenes import random_cir
from command_line import mvla
from kinds_of_channel import random_components, random_response

from mvla_sim.channel.importing import ImportSettings, import_channel, import_settings, resolve_files, source_kind
from mvla_sim.channel.overview import overview, view_line
from mvla_sim.channel.readers.source import READERS, Foreign, Reader
from mvla_sim.channel.readers.touchstone_files import write_touchstone
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import ConfigError, DataError

OWN = ["arrays", "components", "deepmimo", "insite", "responses", "touchstone"]


@pytest.fixture
def pulses():
    """A reader as another package would define it, for as long as a test runs."""

    class Pulses(Reader):
        """Text files of one number: how many views there are."""

        name: ClassVar = "pulses"
        block: ClassVar = "pulses"
        takes: ClassVar = "a .pulse file"
        points: int = 11

        @classmethod
        def recognises(cls, source):
            return source.suffix == ".pulse"

        def read(self, source, radio):
            count = int(source.read_text())
            data = {"response": np.eye(count, self.points) + 0j, "start_hz": radio.carrier_hz, "step_hz": 1e6}
            return Foreign(FrequencyResponse, data, count, angles_deg=10.0 * np.arange(count), facts={"by": "hand"})

    yield Pulses
    del READERS._classes["pulses"]


def test_this_packages_readers_are_found_by_name():
    assert [model.name for model in READERS.own()] == OWN
    for name in OWN:
        assert READERS.find(name).kinds is READERS


def test_sources_tell_their_reader(tmp_path):
    for name in ("sweeps", "scenario", "study", "empty"):
        (tmp_path / name).mkdir()
    for name in ("sweeps/a.s2p", "scenario/params.json", "scenario/a.s2p", "study/x.paths.t001_01.r002.p2m"):
        (tmp_path / name).write_text("x")
    for name in ("a.mat", "b.NPZ", "c.h5", "d.hdf5", "e.nc", "f.csv", "g.p2m", "h.s2p", "i.docx"):
        (tmp_path / name).write_text("x")
    kinds = {
        "sweeps": "touchstone", "empty": "touchstone", "scenario": "deepmimo", "study": "insite", "f.csv": "components",
        "g.p2m": "insite", **dict.fromkeys(("a.mat", "b.NPZ", "c.h5", "d.hdf5", "e.nc"), "arrays"),
    }  # fmt: skip
    assert {name: source_kind(tmp_path / name) for name in kinds} == kinds
    with pytest.raises(DataError, match=r"h\.s2p: is one sweep; give the folder"):
        source_kind(tmp_path / "h.s2p")
    with pytest.raises(DataError, match=r"i\.docx: unknown kind of source; allowed: .*a folder of \.s1p/\.s2p files"):
        source_kind(tmp_path / "i.docx")
    with pytest.raises(DataError, match="no such file or folder"):
        source_kind(tmp_path / "none")


def test_a_reader_from_elsewhere_is_used_with_its_settings(tmp_path, pulses):
    (tmp_path / "a.pulse").write_text("4")
    (tmp_path / "i.toml").write_text(
        'source = "a.pulse"\ncarrier_hz = 36e9\n[pulses]\npoints = 21\n[geometry]\nradius_m = 5.0\n'
    )
    channel = import_channel(import_settings(file=tmp_path / "i.toml"))
    assert channel.response.shape == (4, 21)
    assert (channel.provenance["importer"], channel.provenance["source.by"]) == ("pulses", "hand")
    assert channel.config["source"] == "a.pulse"
    assert channel.config["pulses"] == {"points": 21}
    other = import_channel(import_settings(file=tmp_path / "i.toml", overrides=["pulses.points=5"]))
    assert other.response.shape == (4, 5)
    named = ImportSettings(source=str(tmp_path / "a.pulse"), kind="pulses", carrier_hz=36e9, geometry={"radius_m": 5})
    assert import_channel(named).response.shape == (4, 11)
    with pytest.raises(ConfigError, match=r"pulses\.points = 'x'.*integer"):
        import_settings(file=tmp_path / "i.toml", overrides=["pulses.points=x"])
    with pytest.raises(ConfigError, match=r"pulses\.point: unknown key"):
        import_settings(file=tmp_path / "i.toml", overrides=["pulses.point=1"])


def test_what_is_no_reader_is_refused():
    with pytest.raises(ConfigError, match=r"kind = 'vna'.*'vna' is no reader; allowed: arrays, components, deepmimo"):
        import_settings("x", overrides=["kind=vna"])
    with pytest.raises(ConfigError, match="pulses: unknown key"):
        import_settings("x", overrides=["pulses.points=1"])


def test_files_that_settings_name_lie_beside_them_and_leave_no_folder_behind(tmp_path):
    table = {
        "source": "s", "geometry": {"positions": "p.csv"}, "antenna": {"kind": "file", "file": "a.csv"},
        "sweeps": {"angle_file": "f.csv", "background": {"file": "b.s2p"}, "reference": {"file": "r.s2p"}},
    }  # fmt: skip
    resolve_files(table, tmp_path)
    assert json.dumps(table).count(str(tmp_path)) == 6
    np.savez(tmp_path / "a.npz", response=random_response().response, frequency=34.5e9 + 7.5e6 * np.arange(33))
    rows = "".join(f"{k},5,0\n" for k in range(5))
    (tmp_path / "p.csv").write_text("x_m,y_m,z_m\n" + rows)
    settings = import_settings(tmp_path / "a.npz", overrides=[f"geometry.positions={tmp_path / 'p.csv'}"])
    channel = import_channel(settings)
    assert str(tmp_path) not in json.dumps(dict(channel.config))
    assert channel.config["geometry"]["positions"] == "p.csv"


@pytest.mark.parametrize(("first", "direction"), [(0, 1), (-180, 1), (360, -1)])
def test_a_view_that_closes_the_turn_is_left_out_with_a_note(tmp_path, caplog, first, direction):
    """The same from arrays and from a folder."""
    response = random_response(count=5).response
    angles = first + direction * 90.0 * np.arange(5)
    np.savez(tmp_path / "a.npz", response=response, frequency=34.5e9 + 7.5e6 * np.arange(33), angle=angles)
    (tmp_path / "sweeps").mkdir()
    for angle, sweep in zip(angles, response, strict=True):
        file = tmp_path / "sweeps" / f"car_{angle:g}deg.s1p"
        write_touchstone(file, 34.5e9 + 7.5e6 * np.arange(33), sweep[:, None, None])
    of_arrays = ["arrays.angles=angle", "geometry.radius_m=5"]
    of_files = ["sweeps.angle_pattern=car_{angle}deg", "sweeps.parameter=S11", "geometry.radius_m=5"]
    made = import_channel(import_settings(tmp_path / "a.npz", overrides=of_arrays))
    np.testing.assert_array_equal(made.response, response[:4])
    folder = import_channel(import_settings(tmp_path / "sweeps", overrides=of_files))
    assert {*folder.views.angles_deg.round(6)} == {*made.views.angles_deg.round(6)} == {0, 90, 180, 270}
    assert len(folder.response) == 4
    notes = [record.message for record in caplog.records]
    assert len(notes) == 2
    for note in notes:
        assert f"the views at {angles.min():g}° and {angles.max():g}° are one direction" in note
    assert made.provenance["source.left_out"] == "view 4, which closes the turn"


def test_a_turn_that_does_not_close_is_kept(tmp_path):
    angles = np.array([0.0, 120.0, 240.0, 359.99])
    np.savez(tmp_path / "a.npz", response=random_response(count=4).response, frequency=34.5e9 + 7.5e6 * np.arange(33),
             angle=angles)  # fmt: skip
    overrides = ["arrays.angles=angle", "geometry.radius_m=5"]
    assert import_channel(import_settings(tmp_path / "a.npz", overrides=overrides)).n_view == 4


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (["O1_28.params.mat", "O1_28.1.CIR.mat"], "of a DeepMIMO scenario of version 3; give one of version 4"),
        (["a/O1_28.params.mat", "x.txt"], "deepmimo.download('o1_28')"),
        (["m.setup", "m.txrx", "study/m.paths.t001_01.r002.p2m"], "Wireless InSite in study; give that: {}/study"),
        (["m.setup", "a/b/m.cir.t001_01.r002.P2M"], "holds paths of Wireless InSite in a/b; give that: {}/a/b"),
        (["e0/1.S1P", "e0/2.s1p", "e5/1.s1p", "e5/2.s1p"], "files in e0 and 1 more of its folders; give one of them"),
        (["scene_0/params.json", "scene_1/params.json"], "holds a DeepMIMO scenario in scene_0 and 1 more"),
        (["turn.mat", "README"], "to read a file in it, as turn.mat, give the file's name"),
        (["a/b/c/1.s1p", ".hidden/1.s1p", "e0/._1.s1p"], "the folder holds no file"),
        (["m.setup"], "the folder holds 1 files: m.setup"),
    ],
)
def test_folders_that_people_give_are_told_what_to_give_instead(tmp_path, names, says):
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    with pytest.raises(DataError) as caught:
        import_channel(import_settings(tmp_path))
    assert says.format(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_of_an_old_deepmimo_scenario_is_told(tmp_path):
    (tmp_path / "O1_28.params.mat").write_text("x")
    with pytest.raises(DataError, match="is of a DeepMIMO scenario of version 3; give the folder of one of version 4"):
        source_kind(tmp_path / "O1_28.params.mat")


def swept(tmp_path, response, step_hz=7.5e6):
    """Import four sweeps of one turn."""
    axis = 34.5e9 + step_hz * np.arange(response.shape[1])
    np.savez(tmp_path / "a.npz", response=response, frequency=axis, angle=90.0 * np.arange(len(response)))
    overrides = ["arrays.angles=angle", "geometry.radius_m=5"]
    return import_channel(import_settings(tmp_path / "a.npz", overrides=overrides))


def test_sweeps_that_hold_nothing_are_named_as_such(tmp_path, caplog):
    good = random_response(count=4).response
    with pytest.raises(DataError, match=r"a\.npz: every sweep is 0 at all frequencies; there is nothing in it"):
        swept(tmp_path, np.zeros_like(good))
    with pytest.raises(DataError, match=r"every sweep has one value at all frequencies, as 0\.5\+0j; it holds no ra"):
        swept(tmp_path, np.full_like(good, 0.5) * np.array([0, 1, 2, 3])[:, None] / [1])
    assert not caplog.records
    mixed = good.copy()
    mixed[1], mixed[3] = 0, 7
    swept(tmp_path, mixed)
    swept(tmp_path, np.repeat(good[:1], 4, axis=0))
    assert [record.message.partition(": ")[2].partition(": ")[2] for record in caplog.records] == [
        f"{tmp_path / 'a.npz'}: the sweeps of 1 views are 0 at all frequencies: 1 from 0",
        f"{tmp_path / 'a.npz'}: the sweeps of 1 views are one value at all frequencies: 3 from 0",
        f"{tmp_path / 'a.npz'}: all 4 views hold the same sweep",
    ]


def test_two_lines_let_a_person_notice_a_mistake(tmp_path):
    """An echo at 3 m of a target that turns a quarter between views, counter-clockwise."""
    frequency = 34.5e9 + 15e6 * np.arange(201)
    echo = np.exp(-2j * np.pi * frequency * (2 * 3.0 / 299_792_458.0))
    channel = swept(tmp_path, np.outer([1, 2, 3, 4], echo), 15e6)
    assert overview(channel) == (
        "band 34.5 GHz to 37.5 GHz in steps of 15 MHz, unambiguous to 9.993 m, resolution 0.0497 m; strongest echoes "
        "of the views at 3 to 3 m, median 3 m",
        "4 views from 0° to 90°: 270° in steps of 90°, seen from above sensor clockwise or target counter-clockwise, "
        "sensor 5 m from (0, 0)",
    )
    assert view_line(channel.views.select(np.array([0, 2, 1, 3]))).startswith("4 views from 0° to 90° in no one sense")
    for kind in (random_cir(), random_components()):
        echoes, views = overview(kind)
        assert "strongest echoes of the views at " in echoes
        assert views.startswith("5 views from ")


def test_the_command_prints_what_lets_a_person_notice_a_mistake(tmp_path):
    """An echo at 7 m, 24 views 15° apart: both stand in the two lines."""
    frequency = 34.5e9 + 6e6 * np.arange(501)
    echo = np.exp(-4j * np.pi * frequency * 7.0 / 299_792_458)
    np.savez(tmp_path / "r.npz", response=np.tile(echo, (24, 1)) * (1 + 0.01 * np.arange(24))[:, None],
             frequency=frequency, a=15.0 * np.arange(24))  # fmt: skip
    options = ["--set", "arrays.angles=a", "--set", "geometry.radius_m=10"]
    text = mvla("import", tmp_path / "r.npz", "-o", tmp_path / "c.nc", *options, notes=True)
    assert "34.5 GHz" in text
    assert "in steps of 6 MHz" in text
    assert "median 7 m" in text
    assert "345" in text
