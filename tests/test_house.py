"""The house stays small: budget, no cycles, nothing below Study takes one, docstrings by audience."""

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import percept

ROOT = Path(percept.__file__).parent
MODULES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(ROOT.rglob("*.py"))}
#: The most modules, lines and exported names.
BUDGET = {"modules": 190, "lines": 45_000, "names": 2_000}
#: Modules of one idea that is longer than 400 lines.
LONGER: set[str] = set()


def name_of(path):
    """Dotted name of a module."""
    parts = ("percept", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(path): path for path in MODULES}


def imported(path):
    """Modules of percept that a module imports anywhere, inside functions and for types too."""
    found = set()
    for node in ast.walk(MODULES[path]):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {member if member in NAMES else node.module for member in members}
    return {name for name in found if name in NAMES and name != name_of(path)}


def exported(path):
    """Names a module lists in `__all__`."""
    for node in MODULES[path].body:
        targets = node.targets if isinstance(node, ast.Assign) else ()
        if any(isinstance(target, ast.Name) and target.id == "__all__" for target in targets):
            return [
                element.value
                for element in ast.walk(node.value)
                if isinstance(element, ast.Constant)
            ]
    return []


def cycle(graph):
    """A cycle of a graph, or None."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return None


def test_the_budget_holds():
    lines = sum(path.read_text(encoding="utf-8").count("\n") for path in MODULES)
    names = sum(len(exported(path)) for path in MODULES)
    assert len(MODULES) <= BUDGET["modules"]
    assert lines <= BUDGET["lines"]
    assert names <= BUDGET["names"]


def test_no_module_is_longer_than_one_idea():
    long = {name_of(path) for path in MODULES if path.read_text(encoding="utf-8").count("\n") > 450}
    assert long <= LONGER


def test_a_cycle_is_found():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"a"}}) is not None
    assert cycle({"a": {"b", "c"}, "b": {"c"}}) is None


def test_imports_make_no_cycle():
    # A package's face imports its modules, and stands for none of them.
    graph = {name_of(path): imported(path) for path in MODULES if path.name != "__init__.py"}
    assert cycle(graph) is None


def below(name):
    """Modules a module imports, and theirs."""
    reached, waiting = set(), {name}
    while waiting:
        new = imported(NAMES[waiting.pop()]) - reached
        reached |= new
        waiting |= new
    return reached


def test_nothing_below_study_takes_a_study():
    takers = {
        name
        for name in below("percept.study.study")
        for node in ast.walk(MODULES[NAMES[name]])
        if isinstance(node, ast.arg) and node.annotation is not None
        if re.search(r"\bStudy\b", ast.unparse(node.annotation))
    }
    assert takers == set()


def documented():
    """Definitions with a block of parameters or returns, by module and outermost name."""
    for path, tree in MODULES.items():
        for node in tree.body:
            for inner in ast.walk(node):
                if isinstance(inner, (ast.FunctionDef, ast.ClassDef)):
                    text = ast.get_docstring(inner) or ""
                    if re.search(r"^(Parameters|Returns|Yields|Raises)\n-+$", text, re.MULTILINE):
                        yield path, node.name


def test_blocks_of_parameters_stand_on_exported_names_only():
    faces = {name for path in MODULES for name in exported(path)}
    assert (
        sorted({f"{name_of(path)}.{name}" for path, name in documented() if name not in faces})
        == []
    )
