"""Methods by name, and methods from elsewhere."""

from __future__ import annotations

import functools
import pickle
import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from cases import ring, scatterers

from mvla_sim.errors import ConfigError, DataError
from mvla_sim.imaging.imaging_settings import imaging_settings
from mvla_sim.imaging.method import METHODS, title_of
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


@pytest.mark.parametrize("name", METHODS.names())
def test_every_method_has_a_module_a_title_and_an_equation(name):
    method = METHODS.find(name)
    assert method.title
    assert title_of(name) == method.title
    assert "``" in (sys.modules[method.__module__].__doc__ or "") + (method.__doc__ or "")


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
    first = METHODS.find(write(tmp_path)).digest()
    assert METHODS.find(write(tmp_path, MINE + "\n# changed\n")).digest() != first


def test_an_entry_point_is_a_method(tmp_path, monkeypatch):
    write(tmp_path, name="their_package.py")
    monkeypatch.syspath_prepend(str(tmp_path))
    points = [EntryPoint("theirs", "their_package:image", METHODS.group)]
    monkeypatch.setattr("mvla_sim.kinds.entry_points", lambda group: [p for p in points if p.group == group])
    cir = small_cir()
    theirs = reconstruct(cir, options(method="theirs"))
    mine = reconstruct(cir, options(method=write(tmp_path)))
    assert np.array_equal(theirs.score, mine.score)
    assert METHODS.find("theirs").digest()


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
        ("mvla", "'mvla' is no method .did you mean 'mvla-gr'.*; allowed: bp, bp-coherence"),
        ("mine.txt:image", "is no method.*; allowed"),
        ("mine.py:not a name", "is no method.*; allowed"),
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
        METHODS.find(options(method=name.format(**files)).method)
    assert "\n" not in str(caught.value)


SHARPER = """
import numpy as np

def sharper(seen, power: float = 2.0, *, floor=0.0):
    total = sum(np.interp(seen.range_m(m), seen.pdp.range_m, seen.pdp.power[m]) for m in range(seen.n_view))
    return np.maximum(total / total.max(), floor) ** power
"""


def test_parameters_of_a_function_are_settings(tmp_path):
    """Under [imaging.NAME], with their types and defaults, in settings, --set and every dump."""
    name = f"{write(tmp_path, SHARPER)}:sharper"
    plain, bent = (
        reconstruct(small_cir(), options(method=name, snr_db=None, **more)) for more in ({}, {"sharper.power": 4.0})
    )
    np.testing.assert_allclose(bent.score, plain.score**2, rtol=1e-5, atol=1e-7)
    assert bent.config["imaging"]["sharper"] == {"power": 4.0, "floor": 0.0}
    assert imaging_settings(["sharper.floor=0.5"], method=name).chosen.floor == 0.5
    for key, value, message in (
        ("sharper.pwoer", 1.0, r"sharper\.pwoer: unknown key \(did you mean 'power'\?\); allowed: floor, power"),
        ("sharper.power", "x", r"sharper\.power = 'x': should be a valid number"),
        ("carvin.kernel", 1.0, r"carvin: unknown key \(did you mean 'carving'\?\)"),
    ):
        with pytest.raises(ConfigError, match=message):
            options(method=name, **{key: value})


def test_settings_of_a_function_of_a_file_can_be_pickled(tmp_path):
    chosen = options(method=f"{write(tmp_path, SHARPER)}:sharper", **{"sharper.power": 3.0})
    assert pickle.loads(pickle.dumps(chosen)) == chosen


def test_a_function_itself_is_a_method():
    def doubled(seen, *, times: int = 2):
        return times * METHODS.find("bp")().image(seen).score

    cir = small_cir()
    bp = reconstruct(cir, options(method="bp", snr_db=None)).score
    assert np.array_equal(reconstruct(cir, options(method=doubled, snr_db=None)).score, 2 * bp)
    own = functools.partial(doubled, times=3)
    assert np.array_equal(reconstruct(cir, options(method=own, snr_db=None)).score, 3 * bp)
    with pytest.raises(ConfigError, match="a function without a name"):
        options(method=lambda seen: seen.range_m(0))
    with pytest.raises(ConfigError, match=r"doubled\.times = 0\.5"):
        options(method=doubled, doubled={"times": 0.5})


def test_settings_of_methods_are_refused_one_by_one():
    for key, message in (
        ("carving.kernl", r"carving\.kernl: unknown key \(did you mean 'kernel'\?\); allowed: kernel, margin, share"),
        ("em.iterations", r"em\.iterations = 0: should be greater than or equal to 1"),
    ):
        with pytest.raises(ConfigError, match=message):
            options(method="bp", **{key: 0})
