"""How kinds of things are found, and how plain data becomes settings."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from pydantic import Field

from mvla_sim import kinds as module
from mvla_sim.errors import ConfigError
from mvla_sim.kinds import Kind, Kinds, source_digest
from mvla_sim.scene.shape import SHAPES, Prism, Shape
from mvla_sim.scene.shapes.star import Star
from mvla_sim.scene.trajectories.circle import Circle
from mvla_sim.scene.trajectory import TRAJECTORIES, Trajectory
from mvla_sim.settings import Settings, apply_overrides, parse


class Holder(Settings):
    """Fields of kinds, alone and in a list."""

    shape: Annotated[Shape, SHAPES] = Star()
    more: tuple[Annotated[Shape, SHAPES], ...] = ()
    path: Annotated[Trajectory, TRAJECTORIES] = Circle()


def one_line(call, *arguments, **named):
    with pytest.raises(ConfigError) as caught:
        call(*arguments, **named)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_a_table_becomes_the_class_it_names_and_comes_back():
    data = {"shape": {"shape": "circle", "radius_m": 2}, "more": [{"shape": "star"}], "path": {"interval_deg": 5}}
    holder = parse(Holder, data, "test")
    assert (type(holder.shape).__name__, holder.shape.radius_m) == ("Cylinder", 2.0)
    assert holder.path == Circle(interval_deg=5)  # the kind that is meant where none is named
    assert holder.model_dump()["shape"]["facets"] == 360  # a field of the class that was found
    assert parse(Holder, holder.model_dump(mode="json"), "test") == holder


def test_objects_are_taken_as_they_are_beside_plain_data():
    star = Star(radius_m=3)
    holder = parse(Holder, {"shape": star, "more": [star, {"shape": "square", "side_m": np.float64(2)}]}, "test")
    assert holder.shape is star
    assert [shape.shape for shape in holder.more] == ["star", "square"]
    assert Holder(shape={"shape": "square"}).shape.side_m == 8.0


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ({"shape": {"shape": "sqare"}}, "test: shape.shape = 'sqare': 'sqare' is no shape (did you mean 'square'?); "
                                        "allowed: car, circle, "),
        ({"shape": {}}, "test: shape: missing key 'shape'; allowed: car, circle, "),
        ({"shape": {"shape": 3}}, "test: shape.shape = 3: must be a name"),
        ({"shape": 3}, "test: shape = 3: is no shape; allowed: Car, Cylinder, "),
        ({"shape": Circle()}, "test: shape: Circle is a trajectory and is no shape; allowed: Car, Cylinder, "),
        ({"more": [Star(), Circle()]}, "test: more[1]: Circle is a trajectory and is no shape"),
        ({"more": [{"shape": "star", "radius_m": -1}]}, "test: more[0].radius_m = -1: should be greater than 0"),
        ({"more": [{"shape": "star", "radius_m": "4"}]}, "test: more[0].radius_m = '4': should be a valid number"),
        ({"shape": {"shape": "star", "radus_m": 1}}, "test: shape.radus_m: unknown key (did you mean 'radius_m'?)"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_key(data, says):
    assert one_line(parse, Holder, data, "test").startswith(says)


def test_a_wrong_value_in_python_is_one_line_of_ours():
    assert one_line(Star, radius_m=-1) == "Star: radius_m = -1: should be greater than 0"
    with pytest.raises(ValueError, match="Star: radius_m"):
        Star(radius_m=-1)


@pytest.fixture
def animals():
    """A list of kinds with nothing in it, whose home has no modules."""

    class Animal(Kind):
        kinds: ClassVar[Kinds[Any]] = Kinds("animal", "no.such.group", "mvla_sim.scene.shapes", key="kind")

    return Animal


def test_a_class_is_found_once_it_is_defined(animals):
    class Cat(animals):
        kind: Literal["cat"] = "cat"
        lives: int = 9

    assert animals.kinds.find("cat") is Cat
    assert animals.kinds.names() == ("cat",)
    assert animals.kinds.model_of({"kind": "cat"}) is Cat
    assert animals.kinds.model_of({}) is None

    class Cat(animals):
        kind: Literal["cat"] = "cat"

    assert animals.kinds.find("cat") is Cat


def test_a_name_of_ours_cannot_be_taken():
    def take():
        class Other(Prism):
            shape: Literal["star"] = "star"

    assert "shape 'star' is one of mvla-sim's own; give" in one_line(take)
    assert SHAPES.find("star") is Star


TOOLS = Kinds("tool", "no.such.group", "mvla_sim.scene.shapes", key="kind", default="saw", short=True)


class Tool(Kind):
    """A kind whose name alone may stand for its defaults."""

    kinds: ClassVar[Kinds[Any]] = TOOLS


class Saw(Tool):
    """The default one."""

    kind: Literal["saw"] = "saw"
    teeth: int = 40


def test_a_name_may_stand_for_a_table_of_defaults():
    class Box(Settings):
        tool: Annotated[Tool, TOOLS] = Saw()

    assert parse(Box, {"tool": "saw"}, "test").tool == Saw()
    assert parse(Box, {"tool": {"teeth": 3}}, "test").tool.teeth == 3
    assert "'axe' is no tool" in one_line(parse, Box, {"tool": "axe"}, "test")


def test_a_class_that_only_changes_defaults_of_another_takes_no_name():
    class Tall(Star):
        height_m: float = 9.0

    assert SHAPES.find("star") is Star
    assert parse(Holder, {"shape": Tall()}, "test").shape.height_m == 9.0


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("no_such_module:Thing", "shape 'thing': no_such_module:Thing cannot be imported (ModuleNotFoundError"),
        ("mvla_sim.errors:DataError", "shape 'thing': mvla_sim.errors:DataError is no class of that kind"),
        ("mvla_sim.scene.trajectories.circle:Circle", "is no class of that kind"),
    ],
)
def test_entry_points_that_offer_no_such_class(monkeypatch, value, says):
    monkeypatch.setattr(module, "entry_points", lambda group: [EntryPoint("thing", value, group)])
    assert says in one_line(SHAPES.find, "thing")
    assert "thing" in SHAPES.names()


def test_the_digest_covers_a_class_and_what_it_is_derived_from():
    assert source_digest(Star) != source_digest(Circle)
    assert len(source_digest(Star)) == 64
    assert source_digest(type("Typed", (Star,), {"__module__": "nowhere"})) == ""  # typed into a prompt


class Inner(Settings):
    """A setting that may be absent, and one that may not."""

    level: float | None = 1.0
    text: str = ""


class Outer(Settings):
    """Every place where the text "none" may stand."""

    name: str = ""
    note: str | None = ""
    inner: Inner = Inner()
    maybe: Inner | None = Inner()
    several: tuple[Inner, ...] = ()
    heights: Annotated[tuple[float, ...], Field(min_length=1)] | None = None
    words: tuple[str, ...] = ()
    axes: dict[str, tuple[float | str | None, ...]] = Field(default_factory=dict)
    texts: dict[str, str] = Field(default_factory=dict)


def test_none_is_null_only_where_a_setting_may_be_absent():
    data = {
        "name": "none",
        "note": "none",
        "inner": {"level": "none", "text": "none"},
        "maybe": "none",
        "several": [{"level": "none"}, {"text": "none"}],
        "heights": "none",
        "words": ["none"],
        "axes": {"none": ["none", 1.0, "none at all"]},
        "texts": {"key": "none"},
    }
    found = parse(Outer, data, "test")
    assert (found.name, found.note, found.maybe, found.heights) == ("none", None, None, None)
    assert found.inner == Inner(level=None, text="none")
    assert found.several == (Inner(level=None), Inner(text="none"))
    assert (found.words, found.texts) == (("none",), {"key": "none"})
    assert found.axes == {"none": (None, 1.0, "none at all")}
    assert data["note"] == "none", "the data are the caller's"


def test_none_of_a_setting_that_must_be_there_is_told_as_it_was_written():
    class Strict(Settings):
        level: float = 1.0

    assert one_line(parse, Strict, {"level": "none"}, "test") == "test: level = 'none': should be a valid number"


def test_settings_show_what_is_not_the_default_on_one_short_line():
    assert repr(Star()) == "Star()"
    assert repr(Star(radius_m=3, name="tower")) == "Star(name='tower', radius_m=3.0)"
    assert str(Circle(interval_deg=5)) == "Circle(interval_deg=5.0)"
    assert len(repr(Circle(heights_m=tuple(range(1000))))) < 100


def test_overrides_reach_into_lists_and_make_tables():
    data = {"objects": [{"a": 1}]}
    assert apply_overrides(data, ["objects.0.b.c=[1, 2]", "name=none"]) == {
        "objects": [{"a": 1, "b": {"c": [1, 2]}}], "name": "none",
    }  # fmt: skip
    assert data == {"objects": [{"a": 1}]}
    assert "allowed: 0 to 0" in one_line(apply_overrides, data, ["objects.1.a=2"])
    assert "is a single value and has no keys" in one_line(apply_overrides, data, ["objects.0.a.b=2"])
    assert "write dotted.key=value" in one_line(apply_overrides, data, ["objects"])
