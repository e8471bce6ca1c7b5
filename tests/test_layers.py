"""Arrows point one way: the floors import no files, plots or command line, and not each other."""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

import percept

ROOT = Path(percept.__file__).parent
_ANALYSIS = {
    "study", "boundary", "results", "haptics", "inference", "sessions", "scene", "errors", "html",
}  # fmt: skip
#: Of percept's parts, those a part may import beside itself.
ALLOWED = {
    "errors": set(),
    "html": {"errors"},
    "files": {"errors"},
    "provenance": {"__version__"},
    "searches": set(),
    "haptics": {"searches", "html", "errors"},
    "inference": {"searches", "html", "errors"},
    "sessions": {"errors"},
    "results": {"inference", "haptics", "sessions", "html", "errors"},
    "boundary": {"results", "haptics", "inference", "searches", "html", "errors"},
    "scene": {"scene_device", "sessions", "inference", "html", "errors"},
    "scene_device": {"sessions", "errors"},
    "study": (_ANALYSIS - {"study"}) | {"scene_device", "report", "plots", "searches"},
    "cache": {"inference", "files", "errors"},
    "workers": {"cache", "errors"},
    "planning": {"inference", "html", "errors"},
    "simulate": {"inference", "errors"},
    "published": {"simulate", "sessions", "inference", "errors"},
    "judge": _ANALYSIS | {"simulate"},
    "calibration": _ANALYSIS | {"judge", "simulate", "checkpoint", "workers", "provenance"},
    "checkpoint": {"cache", "files", "workers", "errors"},
    "batch": {
        "study",
        "sessions",
        "scene",
        "checkpoint",
        "workers",
        "cache",
        "files",
        "errors",
    },
    "report": (_ANALYSIS - {"study"}) | {"files", "provenance", "__version__"},
    "plots": {"report", "results", "errors"},
}
#: The ends, which may import everything, and which nothing but an end imports.
ENDS = {"cli", "commands", "__main__", "__init__"}
#: Packages that are not Python's own, for the parts that have to stay light or pure.
OUTSIDE = {
    "errors": set(),
    "html": set(),
    "files": set(),
    "provenance": set(),
    "searches": {"numpy"},
    "haptics": {"numpy"},
    "inference": {"numpy", "scipy", "emcee", "arviz_stats"},
    "results": {"numpy", "pydantic"},
    "boundary": {"numpy", "scipy"},
    "study": {"numpy", "scipy", "pandas", "xarray", "h5py"},
    "planning": {"numpy", "scipy"},
}


def files(part):
    """Modules of a part, a folder or a file."""
    return sorted((ROOT / part).rglob("*.py")) or [ROOT / f"{part}.py"]


@cache
def imports(path):
    """Top-level packages a module imports, and percept's own parts; by a name in a call too."""
    outside, inside = set(), set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == "percept":
                names = [f"percept.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module":
            names = [word.value for word in node.args if isinstance(word, ast.Constant)]
        for name in names:
            first, *rest = name.split(".")
            if first == "percept" and rest:
                inside.add(rest[0])
            else:
                outside.add(first)
    return outside, inside


def test_every_part_is_listed():
    parts = {
        path.stem
        for path in ROOT.iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert parts == ALLOWED.keys() | ENDS


@pytest.mark.parametrize("part", ALLOWED)
def test_a_part_imports_only_what_lies_below(part):
    for path in files(part):
        assert imports(path)[1] <= ALLOWED[part] | {part}, path


@pytest.mark.parametrize("part", OUTSIDE)
def test_a_part_imports_only_the_packages_it_has_a_use_for(part):
    for path in files(part):
        assert imports(path)[0] - sys.stdlib_module_names - {"percept"} <= OUTSIDE[part], path


def test_percept_never_imports_what_convinces_of_it():
    for path in sorted(ROOT.rglob("*.py")):
        assert not imports(path)[0] & {"reports", "tests"}, path


def test_reports_import_no_tests():
    """Tests may import what stands there: the other way it would be a circle."""
    for path in sorted((ROOT.parent / "reports").rglob("*.py")):
        assert "tests" not in imports(path)[0], path


def test_reports_use_public_names_of_percept():
    for path in sorted((ROOT.parent / "reports").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("percept"):
                assert [a.name for a in node.names if a.name[:1] == "_"] == [], path


def test_public_names():
    assert sorted(percept.__all__) == [
        "PerceptError",
        "RefusalError",
        "Scene",
        "Sessions",
        "Study",
        "UsageError",
        "__version__",
        "read_sessions",
    ]
    for name in percept.__all__:
        assert getattr(percept, name) is not None
