"""The house stays readable: how much there is to understand, how dense it is, and no circles."""

import ast
import io
import re
import tokenize
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import percept

ROOT = Path(percept.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))

#: Code tokens in all: what is new is paid for by what it makes dead. Packing does not help.
MOST_TOKENS = 212_000
#: The same of what makes the pages of `reports`.
MOST_TOKENS_OF_REPORTS = 38_000
#: The same of the tests.
MOST_TOKENS_OF_TESTS = 206_500
#: Tokens on a code line, and in a statement; well-read libraries have 6 to 9, and 10 to 12.
MOST_TOKENS_PER_LINE = 8.7
MOST_TOKENS_PER_LINE_OF_A_FOLDER = 9.5
MOST_TOKENS_PER_STATEMENT = 12.0
#: Assignments of several names at once, per 1,000 code lines.
MOST_PAIRED_ASSIGNMENTS = 5.0
MOST_UNPACKED_GENERATORS = 0.5
#: Annotations that hide what a mapping holds.
MOST_UNTYPED_MAPPINGS = 30
MOST_LINES_OF_A_MODULE = 450
MOST_MODULES = 150
MOST_FUNCTIONS = 1_800
MOST_CLASSES = 340

NOT_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
WITH_DOCSTRING = (ast.Module, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


@dataclass
class Measure:
    """Counts of one module, or of several together."""

    tokens: int = 0
    lines: int = 0
    statements: int = 0
    paired_assignments: int = 0
    unpacked_generators: int = 0
    untyped_mappings: int = 0
    functions: int = 0
    classes: int = 0

    def __add__(self, other):
        counts = {name: value + getattr(other, name) for name, value in vars(self).items()}
        return Measure(**counts)

    def per_thousand_lines(self, count):
        return 1000.0 * count / self.lines


@cache
def tree_of(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def docstrings(tree):
    """Docstring statements of a module, its classes and functions."""
    for node in ast.walk(tree):
        if isinstance(node, WITH_DOCSTRING) and ast.get_docstring(node, clean=False) is not None:
            yield node.body[0]


def measure(text):
    """Count code tokens, code lines and statements of a module's text, its docstrings left out."""
    tree = ast.parse(text)
    said = list(docstrings(tree))
    docstring_lines = {line for node in said for line in range(node.lineno, node.end_lineno + 1)}
    counts = Measure(untyped_mappings=len(re.findall(r"(?:dict|Mapping)\[str, Any\]", text)))
    code_lines = set()
    open_f_strings = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        kind = tokenize.tok_name[token.type]
        if token.type not in NOT_CODE and token.start[0] not in docstring_lines:
            # Since Python 3.12 an f-string is cut into its parts. It counts as one, as before.
            counts.tokens += open_f_strings == 0
            code_lines |= set(range(token.start[0], token.end[0] + 1))
        open_f_strings += (kind == "FSTRING_START") - (kind == "FSTRING_END")
    counts.lines = len(code_lines)
    for node in ast.walk(tree):
        counts.statements += isinstance(node, ast.stmt) and node not in said
        counts.functions += isinstance(node, ast.FunctionDef)
        counts.classes += isinstance(node, ast.ClassDef)
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
            counts.paired_assignments += isinstance(node.value, ast.Tuple)
            counts.unpacked_generators += isinstance(node.value, ast.GeneratorExp)
    return counts


@cache
def measured(path):
    return measure(path.read_text(encoding="utf-8"))


def total(paths):
    return sum((measured(path) for path in paths), Measure())


def folders():
    """Modules by folder; modules beside the folders are one more."""
    found = {}
    for path in MODULES:
        found.setdefault(path.parent.relative_to(ROOT).as_posix(), []).append(path)
    return found


def name_of(path):
    """Dotted name of a module."""
    parts = ("percept", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(path): path for path in MODULES}


@cache
def imported(path):
    """Modules of percept that a module imports anywhere: in functions, for types, and by name."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {member if member in NAMES else node.module for member in members}
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module":
            found |= {argument.value for argument in node.args if hasattr(argument, "value")}
    return {name for name in found if name in NAMES and name != name_of(path)}


def exported(path):
    """Names a module lists in `__all__`; without one those of no underscore."""
    for node in tree_of(path).body:
        targets = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        if any(isinstance(target, ast.Name) and target.id == "__all__" for target in targets):
            return [
                element.value
                for element in ast.walk(node.value)
                if isinstance(element, ast.Constant)
            ]
    names = [getattr(node, "name", "_") for node in tree_of(path).body]
    return [name for name in names if not name.startswith("_")]


def cycle(graph):
    """A cycle of a graph, or None."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return None


def test_counting():
    counts = measure(
        '"""Doc."""\n\na, b = 1, 2  # why\nc, d = (x for x in (a, b))\nif a:\n    c = a\n'
    )
    assert counts == Measure(
        tokens=28, lines=4, statements=4, paired_assignments=1, unpacked_generators=1
    )


def test_how_much_there_is():
    counts = total(MODULES)
    assert counts.tokens <= MOST_TOKENS
    assert counts.functions <= MOST_FUNCTIONS
    assert counts.classes <= MOST_CLASSES
    assert len(MODULES) <= MOST_MODULES


def test_how_much_makes_the_reports():
    modules = sorted((ROOT.parent / "reports").rglob("*.py"))
    assert total(modules).tokens <= MOST_TOKENS_OF_REPORTS


def test_how_much_tests_it():
    modules = sorted((ROOT.parent / "tests").rglob("*.py"))
    assert total(modules).tokens <= MOST_TOKENS_OF_TESTS


def test_how_dense_it_is():
    counts = total(MODULES)
    assert counts.tokens / counts.lines <= MOST_TOKENS_PER_LINE
    assert counts.tokens / counts.statements <= MOST_TOKENS_PER_STATEMENT
    assert counts.per_thousand_lines(counts.paired_assignments) <= MOST_PAIRED_ASSIGNMENTS
    assert counts.per_thousand_lines(counts.unpacked_generators) <= MOST_UNPACKED_GENERATORS
    assert counts.untyped_mappings <= MOST_UNTYPED_MAPPINGS


@pytest.mark.parametrize("folder", sorted(folders()))
def test_how_dense_a_folder_is(folder):
    counts = total(folders()[folder])
    assert counts.tokens / counts.lines <= MOST_TOKENS_PER_LINE_OF_A_FOLDER


def test_no_module_is_longer_than_one_idea():
    lengths = {name_of(path): len(path.read_text("utf-8").splitlines()) for path in MODULES}
    assert {name for name, lines in lengths.items() if lines > MOST_LINES_OF_A_MODULE} == set()


def test_a_cycle_is_found():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"a"}}) is not None
    assert cycle({"a": {"b", "c"}, "b": {"c"}}) is None


def test_imports_make_no_cycle():
    # A package's face imports its modules, and stands for none of them.
    graph = {name_of(path): imported(path) for path in MODULES if path.name != "__init__.py"}
    assert cycle(graph) is None


def test_only_faces_import_by_a_computed_name():
    callers = {
        name_of(path)
        for path in MODULES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module"
        if not isinstance(node.args[0], ast.Constant)
    }
    # They load a public name, or a command, when it is first asked for.
    assert callers <= {"percept", "percept.cli"}


def below(name):
    """Modules a module imports, and theirs."""
    reached, waiting = set(), {name}
    while waiting:
        new = imported(NAMES[waiting.pop()]) - reached
        reached |= new
        waiting |= new
    return reached


def takers_of_a_study(names):
    """Modules that take a Study as an argument."""
    return {
        name
        for name in names
        for node in ast.walk(tree_of(NAMES[name]))
        if isinstance(node, ast.arg) and node.annotation is not None
        if re.search(r"\bStudy\b", ast.unparse(node.annotation))
    }


def test_nothing_below_study_takes_a_study():
    assert takers_of_a_study(below("percept.study.study")) == set()


def test_report_and_plots_never_see_a_study():
    names = [name for name in NAMES if name.startswith(("percept.report", "percept.plots"))]
    assert takers_of_a_study(names) == set()
    assert not any(
        below_name.startswith("percept.study") for name in names for below_name in below(name)
    )


def documented():
    """Definitions with a block of parameters or returns, by module and outermost name."""
    for path in MODULES:
        for node in tree_of(path).body:
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
