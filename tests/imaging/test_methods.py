"""Methods by name, and methods from elsewhere."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from cases import ring, scatterers

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.imaging.imaging_settings import METHOD_NAMES, imaging_settings
from mvla_sim.imaging.methods import registry
from mvla_sim.imaging.methods.registry import find_method, title_of
from mvla_sim.imaging.pipeline import reconstruct

MINE = """
import numpy as np

def image(seen):
    return sum(np.interp(seen.range_m(m), seen.pdp.range_m, seen.pdp.power[m]) for m in range(seen.n_view))

def both(seen):
    return image(seen), np.full(seen.grid.shape, 90.0)
"""


def options(**values):
    return imaging_settings(**({"grid.size_m": [4.0, 4.0, 0.0], "grid.spacing_m": 0.1} | values))


def small_cir():
    return scatterers([[1.0, 0.5, 0.0], [-0.8, -0.4, 0.0]], ring(12))


def write(folder, text=MINE, name="mine.py"):
    file = folder / name
    file.write_text(text)
    return str(file)


@pytest.mark.parametrize("name", METHOD_NAMES)
def test_every_method_has_a_module_a_title_and_an_equation(name):
    method = find_method(name)
    assert method.title
    assert title_of(name) == method.title
    assert "``" in (sys.modules[type(method).__module__].__doc__ or "") + (type(method).__doc__ or "")


def test_a_function_of_a_file_is_a_method(tmp_path):
    """Written with the ranges of the observation, backprojection is the projector's."""
    cir = small_cir()
    mine = reconstruct(cir, options(method=write(tmp_path), snr_db=None))
    bp = reconstruct(cir, options(method="bp", snr_db=None))
    np.testing.assert_allclose(mine.score / mine.score.max(), bp.score / bp.score.max(), atol=2e-4)
    assert mine.support_deg is None
    assert title_of(write(tmp_path)) == write(tmp_path)


def test_it_may_return_angular_support_and_lie_under_another_name(tmp_path):
    image = reconstruct(small_cir(), options(method=f"{write(tmp_path)}:both"))
    assert (image.support_deg == 90).all()


def test_a_changed_file_is_another_method(tmp_path):
    first = find_method(write(tmp_path)).digest
    assert find_method(write(tmp_path, MINE + "\n# changed\n")).digest != first


def test_an_entry_point_is_a_method(tmp_path, monkeypatch):
    write(tmp_path, name="their_package.py")
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [EntryPoint("theirs", "their_package:image", registry.METHOD_GROUP)]
    for module in ("mvla_sim.imaging.methods.registry", "mvla_sim.imaging.imaging_settings"):
        monkeypatch.setattr(f"{module}.entry_points", lambda group: [p for p in points if p.group == group])
    cir = small_cir()
    theirs = reconstruct(cir, options(method="theirs"))
    mine = reconstruct(cir, options(method=write(tmp_path)))
    assert np.array_equal(theirs.score, mine.score)
    assert find_method("theirs").digest


@pytest.mark.parametrize(
    ("text", "function", "message"),
    [
        ("def image(seen): return 1 / 0", "", r"ZeroDivisionError: division by zero \(mine.py, line 1\)"),
        ("def image(seen): return seen.peaks.range_m[:3]", "", r"score has shape \(3,\), must be \(1, "),
        ("def image(seen): return seen.range_m(0) * float('nan')", "", "values of its score are not finite"),
        ("def image(seen): return 'black'", "", "its score is str, not an array"),
        ("def image(seen): return None", "", "score"),
        ("import sys\ndef image(seen): sys.exit(0)", "", r"SystemExit: 0 \(mine.py, line 2\)"),
        ("def image(seen): return seen.range_m(0), -seen.range_m(0)", "", "angular support has a value of -"),
    ],
)
def test_what_a_function_does_wrong_is_one_line(tmp_path, text, function, message):
    with pytest.raises(DataError, match=message) as caught:
        reconstruct(small_cir(), options(method=write(tmp_path, text)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mvla", "'mvla' is none; allowed: mvla-gr, mvla-hard, bp"),
        ("mine.txt:image", "is none; allowed"),
        ("mine.py:not a name", "is none; allowed"),
        ("nowhere.py", "nowhere.py cannot be read"),
        ("{broken}", "broken.py cannot be imported .ModuleNotFoundError: No module named 'nothing_here'"),
        ("{syntax}", "syntax.py cannot be imported .SyntaxError"),
        ("{good}:missing", "the file has no function 'missing'"),
        ("{good}:np", "the file has no function 'np'"),
    ],
)
def test_no_such_method_is_one_line(tmp_path, name, message):
    files = {
        "broken": write(tmp_path, "import nothing_here", "broken.py"),
        "syntax": write(tmp_path, "def image(:", "syntax.py"),
        "good": write(tmp_path),
    }
    with pytest.raises(ConfigError, match=message) as caught:
        find_method(options(method=name.format(**files)).method)
    assert "\n" not in str(caught.value)
