"""The rules of the code's structure: one direction of imports, honest ``__all__``, modules that fit a head."""

from __future__ import annotations

import ast
import functools
import importlib
import re
import subprocess
import sys
from collections import Counter, defaultdict
from graphlib import TopologicalSorter
from pathlib import Path

import mvla_sim

ROOT = Path(mvla_sim.__file__).parent
FLOW = (
    "constants", "errors", "interrupt", "progress", "memory", "streams", "files", "text_files", "spreadsheet", "netcdf",
    "ragged", "shipped", "settings", "kinds", "distributions", "dsp", "grid", "engine", "cluster", "scene", "channel",
    "imaging", "evaluation", "sweep", "dataset", "plot", "pictures", "measured", "listing", "bench", "paper", "cli",
)  # fmt: skip
"""Every part of the package, each of which may import those before it: what all use, the stages, their users."""
MODULES = sorted(ROOT.rglob("*.py"))
NAMES = [str(path.relative_to(ROOT)) for path in MODULES]

ENGINE_USERS = ("channel/raytrace.py", "engine/")
"""The only places that may import Sionna RT and Mitsuba."""
ENGINE_AT_IMPORT = ("imaging/kernels.py",)
"""The only module that may import Dr.Jit when it is imported itself, for it activates the backend first."""


def for_each(things):
    """One test of a rule for many modules; it names all that break it."""

    def fold(rule):
        def test():
            broken = {}
            for thing in things:
                try:
                    rule(thing)
                except AssertionError as error:
                    broken[str(thing)] = str(error)
            assert broken == {}

        test.__doc__ = rule.__doc__
        return test

    return fold


def imports(tree):
    """Full names of everything a module imports, wherever in it, but for what only annotations need."""
    skipped = [
        node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    unseen = {inner for node in skipped for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if node in unseen:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@functools.cache
def parse(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def dotted(path):
    """Name under which a module is imported."""
    return ".".join(("mvla_sim", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")


def target(imported, modules):
    """The module that an import is of: of a name in it, or of itself; None where it is not of this package."""
    return next((name for name in (imported, imported.rpartition(".")[0]) if name in modules), None)


def part_of(name):
    """The package's part a dotted name belongs to: "imaging" of mvla_sim.imaging.pdp."""
    return name.split(".")[1]


@for_each(MODULES)
def test_a_stage_imports_nothing_of_a_later_one(path):
    own = path.relative_to(ROOT).parts[0].removesuffix(".py")
    used = {part_of(name) for name in imports(parse(path)) if name.startswith("mvla_sim.")}
    allowed = set(FLOW) if own == "__init__" else {*FLOW[: FLOW.index(own) + 1]}
    allowed |= {"__version__"} if own == "cli" else set()  # the package's front names every stage, and imports on use
    assert used <= allowed


def test_the_package_itself_is_imported_at_once():
    """``mvla --help`` and ``import mvla_sim`` must not wait for the libraries that compute."""
    heavy = "{'drjit', 'matplotlib', 'mitsuba', 'numpy', 'scipy', 'sionna', 'trimesh', 'xarray'}"
    for name in ("mvla_sim", "mvla_sim.cli"):
        program = f"import {name}, sys; sys.exit(' '.join({heavy} & set(sys.modules)) or 0)"
        child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert child.returncode == 0, child.stderr


def test_every_part_is_known():
    parts = {path.relative_to(ROOT).parts[0].removesuffix(".py") for path in MODULES}
    assert parts == {*FLOW, "__init__"}


@for_each(MODULES)
def test_only_the_tracer_knows_the_engine(path):
    name = str(path.relative_to(ROOT))
    used = {imported.split(".")[0] for imported in imports(parse(path))}
    if not name.startswith(ENGINE_USERS):
        assert not used & {"sionna", "mitsuba"}


@for_each(MODULES)
def test_nothing_loads_the_engine_before_the_backend_is_chosen(path):
    """Dr.Jit opens libLLVM when it is imported, so it is imported inside functions, after ``activate()``."""
    if str(path.relative_to(ROOT)) in ENGINE_AT_IMPORT:
        return
    top = [node for node in parse(path).body if isinstance(node, ast.Import | ast.ImportFrom)]
    used = {imported.split(".")[0] for node in top for imported in imports(node)}
    assert not used & {"drjit", "mitsuba", "sionna"}


def test_no_module_imports_itself_by_way_of_others():
    """Layers inside a part as well; imports inside functions count, and those of the package's front do not."""
    modules = {dotted(path): path for path in MODULES if path != ROOT / "__init__.py"}
    graph = {name: {target(used, modules) for used in imports(parse(path))} for name, path in modules.items()}
    tuple(TopologicalSorter({name: used - {None, name} for name, used in graph.items()}).static_order())


@for_each(MODULES)
def test_public_names_exist_and_are_sorted(path):
    """Constants, then classes, then functions, each by the alphabet."""
    module = importlib.import_module(dotted(path))
    public = list(getattr(module, "__all__", []))
    assert [name for name in public if not hasattr(module, name)] == []
    assert public == sorted(set(public), key=lambda name: (not name.isupper(), name[0].islower(), name))
    if path.name != "__init__.py":
        assert public, "every module says what is public in it"


def test_no_two_modules_share_a_name():
    """Nor a module and a package: who reads ``thresholds.py`` in a traceback knows which."""
    names = [path.parent.name if path.name == "__init__.py" else path.stem for path in MODULES]
    assert [name for name, count in Counter(names).items() if count > 1] == []


def test_no_two_public_types_share_a_name():
    homes = defaultdict(set)
    for path in MODULES:
        module = importlib.import_module(dotted(path))
        public = {name: getattr(module, name) for name in getattr(module, "__all__", ())}
        for name, value in public.items():
            if isinstance(value, type):
                homes[name].add(f"{value.__module__}.{value.__qualname__}")
    assert {name: found for name, found in homes.items() if len(found) > 1} == {}


@for_each(MODULES)
def test_modules_fit_a_head(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 450


def test_nothing_imports_the_command_line():
    users = [name for path, name in zip(MODULES, NAMES, strict=True) if not name.startswith("cli/")
             for used in imports(parse(path)) if used.startswith("mvla_sim.cli")]  # fmt: skip
    assert users == []


COMPUTING = ("numpy", "scipy", "pandas", "matplotlib", "shapely", "xarray", "drjit", "mvla_sim.plot")


@for_each([name for name in NAMES if name.startswith("cli/")])
def test_the_command_line_computes_and_draws_nothing(name):
    """It has what it prints from other rooms: pandas' name is there for annotations alone."""
    body = parse(ROOT / name).body
    for_types = [node for node in body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    tree = ast.Module([node for node in body if node not in for_types], [])
    assert [used for used in imports(tree) if used.startswith(COMPUTING)] == []


@for_each([name for name in NAMES if name.startswith("plot/")])
def test_figures_compute_nothing(name):
    """They know kinds of data, other figures, and names of methods; no function that makes data."""
    used = {full for full in imports(parse(ROOT / name)) if full.startswith("mvla_sim.")}
    functions = {full for full in used if full.rpartition(".")[2][0].islower()}
    allowed = {"title_of", "score_label_of", "exposed_faces", "as_path", "atomic_output", "check_argument"}
    assert {full for full in functions if not full.startswith("mvla_sim.plot.")
            and full.rpartition(".")[2] not in allowed} == set()  # fmt: skip


FRONT_END = ("settings.py", "channel/readers/")
"""Rooms whose messages still name options, ``settings`` for those that ``--set`` itself gives."""


@for_each([name for name in NAMES if not name.startswith(("cli/", *FRONT_END))])
def test_messages_name_settings_and_no_options(name):
    """The command line adds its own hints; who calls a function from a notebook has no options."""
    for node in ast.walk(parse(ROOT / name)):
        if isinstance(node, ast.Raise) and node.exc is not None:
            texts = [part.value for part in ast.walk(node.exc) if isinstance(part, ast.Constant)]
            options = [text for text in texts if isinstance(text, str) and re.search(r"(^|\s)--?[a-z]", text)]
            assert options == []
