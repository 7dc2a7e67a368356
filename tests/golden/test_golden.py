"""Images of all methods are those that were stored, of a channel made here without the tracer."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import mvla_sim as mv

sys.path.append(str(Path(__file__).parent))
import check

RELATIVE = 1e-3
"""Of the brightest voxel. Processors differ in fused multiplications and the order of float32 sums, 10⁻⁶ of a sum;
steep methods (products over views, tens of iterations) make up to a hundred times that of it."""
FLIPPED = 0.005
"""Share of voxels, and of occupied ones, that may fall to the other side of a bound by that."""


@pytest.fixture(scope="module")
def stored():
    return json.loads(check.STORED.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def found():
    return dict(check.images())


def test_the_same_images_are_stored(stored, found):
    assert sorted(stored) == sorted(found)


@pytest.mark.parametrize("case", check.CASES)
def test_images_are_those_stored(case, stored, found):
    for method in check.OWN_METHODS:
        name = f"{case}: {method}"
        expected, image = stored[name], found[name]
        if expected is None:
            assert isinstance(image, mv.MvlaError), name
            continue
        figures = check.figures(image)
        most, voxels = abs(expected["max"]), image.score.size
        assert figures["max"] == pytest.approx(expected["max"], rel=RELATIVE), name
        assert figures["sum"] == pytest.approx(expected["sum"], abs=RELATIVE * most * voxels**0.5), name
        assert figures["sampled"] == pytest.approx(expected["sampled"], abs=RELATIVE * most), name
        assert figures["support"] == pytest.approx(expected["support"], abs=FLIPPED * voxels), name
        assert (figures["occupied"] is None) == (expected["occupied"] is None), name
        assert (figures["occupied"] or 0) == pytest.approx(expected["occupied"] or 0, rel=FLIPPED, abs=1), name


def test_a_changed_bit_or_verdict_is_found_and_a_time_is_not(tmp_path, monkeypatch, capsys):
    cir = check.made()
    image = mv.reconstruct(cir, mv.imaging_settings(check.GRID, method="bp"))
    monkeypatch.setattr(check, "images", lambda: iter([("one: bp", image)]))
    folder, file = tmp_path / "results", tmp_path / "hashes.json"
    (folder / "main").mkdir(parents=True)
    (folder / "main" / "table.csv").write_text("case,seconds,cd_db\n0,1.5,-20\n")
    (folder / "claims.csv").write_text("number,verdict\nC1,holds\n")

    def run(action):
        monkeypatch.setattr(sys, "argv", ["check.py", action, str(file), "--results", str(folder)])
        return check.main(), capsys.readouterr().out.splitlines()

    assert run("--write")[0] == 0
    (folder / "main" / "table.csv").write_text("case,seconds,cd_db\n0,2.5,-20\n")
    assert run("--compare") == (0, ["all 3 are the same"])
    (folder / "main" / "table.csv").write_text("case,seconds,cd_db\n0,2.5,-21\n")
    (folder / "claims.csv").write_text("number,verdict\nC1,does not hold\n")
    image.score.view("uint32")[0, 0, 0] ^= 1
    assert run("--compare") == (1, ["differ:", "one: bp", "claims.csv", "main/table.csv"])
