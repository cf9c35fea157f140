"""The house: in which order data flows through the rooms of the package, and that nothing flows back.

A room is a module or package right below `torcharm`. A module imports only from its own room and from rooms before
it, and no modules import each other in a circle. Imports count wherever they stand, within functions too.
"""

import ast
import inspect
import io
import textwrap
import tokenize
from functools import cache
from pathlib import Path

import pytest

import torcharm
from torcharm.engine.compilation import SOURCES

ROOT = Path(torcharm.__file__).parent

ROOMS = (
    "inputs",
    "units",
    "extras",
    "files",
    "geometry",
    "shapes",
    "actuators",
    "characterise",
    "arm",
    "arm_series",
    "ready_arms",
    "load",
    "task",
    "statics",
    "engine",
    "wrench_sets",
    "equilibrium",
    "pressure",
    "attainability",
    "workspaces",
    "design",
    "study",
    "sweeps",
    "plot",
    "report",
    "page",
    "cli",
)

LONGEST_FILE = 400
LONGEST_ENTRY = 40
"""Lines of code, without signature, docstring and comments, in which a public function reads as its algorithm."""

NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


@cache
def modules(package="torcharm"):
    """Paths of all modules, by their dotted names."""
    found = {}
    for path in sorted((ROOT.parent / package).rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports_of(module):
    """The modules of its own package that a module imports, by their dotted names."""
    found, package = set(), module.split(".")[0]
    for node in ast.walk(ast.parse(modules(package)[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.split(".")[0] == package}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import in line {node.lineno}"
            if (node.module or "").split(".")[0] == package:
                for alias in node.names:
                    full = f"{node.module}.{alias.name}"
                    found.add(full if full in modules(package) else node.module)
    return found - {module}


def room_of(module):
    """The part right below torcharm, or "" for the package itself."""
    return [*module.split("."), ""][1]


def faults(module, imported):
    """What is wrong with one import, or nothing."""
    own, other = room_of(module), room_of(imported)
    if own == other:
        return []
    if not other:  # the package itself holds the version, and is otherwise for its users
        return [] if own in ("characterise", "sweeps", "cli") else [f"{module} imports the package itself"]
    return [] if ROOMS.index(other) < ROOMS.index(own) else [f"{module} imports {imported}, which comes later"]


def circles(graph):
    """Groups of modules that import each other, by Tarjan's algorithm."""
    index, low, stack, found = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            cut = stack.index(node)
            if len(stack) - cut > 1:
                found.append(sorted(stack[cut:]))
            del stack[cut:]

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def test_everything_at_the_root_is_a_room():
    entries = {
        f"{path.name}/" if path.is_dir() else path.name
        for path in ROOT.iterdir()
        if path.suffix == ".py" or (path / "__init__.py").is_file()
    }
    assert entries - {f"{room}{end}" for room in ROOMS for end in (".py", "/")} == {"__init__.py"}
    assert not [room for room in ROOMS if room.startswith("_")]


@pytest.mark.parametrize("room", [room for room in ROOMS if any(room_of(name) == room for name in modules())])
def test_a_room_imports_only_from_rooms_before_it(room):
    own = [module for module in modules() if room_of(module) == room]
    assert [fault for module in own for other in sorted(imports_of(module)) for fault in faults(module, other)] == []


def test_what_the_engine_imports_is_among_what_its_code_on_disk_is_told_apart_by():
    own = [module for module in modules() if room_of(module) == "engine"]
    assert {room_of(other) for module in own for other in imports_of(module)} <= set(SOURCES)


def test_no_modules_import_each_other_in_a_circle():
    names = {module for module in modules() if room_of(module)}
    assert circles({name: imports_of(name) & names for name in names}) == []


def test_no_experiments_import_each_other_in_a_circle():
    assert len(modules("experiments")) > 20
    assert circles({name: imports_of(name) for name in modules("experiments")}) == []


def test_the_test_sees_circles_and_arrows_back():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
    assert faults("torcharm.geometry.rod", "torcharm.task")
    assert faults("torcharm.statics.external_load", "torcharm.design.space")
    assert faults("torcharm.geometry.rod", "torcharm")
    assert not faults("torcharm.statics.external_load", "torcharm.geometry.rod")
    assert "torcharm.geometry.se2" in imports_of("torcharm.geometry.rod")


@pytest.mark.parametrize("room", [room for room in ROOMS if any(room_of(name) == room for name in modules())])
def test_no_file_is_too_long_to_be_read_at_once(room):
    own = [modules()[module] for module in modules() if room_of(module) == room]
    lengths = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in own}
    assert {name: length for name, length in lengths.items() if length > LONGEST_FILE} == {}


def code_lines(function):
    """Lines of code of a function's body."""
    source = textwrap.dedent(inspect.getsource(inspect.unwrap(function)))
    (node,) = ast.parse(source).body
    body = node.body[bool(ast.get_docstring(node)) :]
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    lines = {n for token in tokens if token.type not in NO_CODE for n in range(token.start[0], token.end[0] + 1)}
    return len(lines & set(range(body[0].lineno, node.end_lineno + 1)))


@pytest.mark.parametrize("name", [name for name in torcharm.__all__ if inspect.isfunction(getattr(torcharm, name))])
def test_a_public_function_is_short_enough_to_read_as_its_algorithm(name):
    assert 0 < code_lines(getattr(torcharm, name)) <= LONGEST_ENTRY
