"""Arrows point one way: the floors import no files, plots or command line, and not each other."""

import ast
from pathlib import Path

import pytest

import percept

ROOT = Path(percept.__file__).parent
ALLOWED = {
    "haptics": {"haptics", "errors"},
    "inference": {"inference", "errors"},
    "boundary": {"boundary", "haptics", "inference", "errors"},
    "sessions": {"sessions", "cores", "errors"},
    "study": {"study", "boundary", "haptics", "inference", "sessions", "scene", "errors"},
    "workers": {"workers", "cache", "cores", "errors"},
}
FORBIDDEN = {
    "haptics": {"pandas", "matplotlib", "argparse", "scipy", "emcee"},
    "inference": {"pandas", "matplotlib", "argparse", "pydantic"},
    "boundary": {"matplotlib", "argparse", "pydantic", "jinja2"},
    "study": {"matplotlib", "argparse", "jinja2"},
}


def imports(path):
    """Top-level packages a module imports, and percept's own parts among them."""
    outside, inside = set(), set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == "percept":
                names = [f"percept.{alias.name}" for alias in node.names]
        for name in names:
            first, *rest = name.split(".")
            if first == "percept" and rest:
                inside.add(rest[0])
            else:
                outside.add(first)
    return outside, inside


@pytest.mark.parametrize("layer", ALLOWED)
def test_layer_imports_only_what_lies_below(layer):
    for path in sorted((ROOT / layer).rglob("*.py")):
        outside, inside = imports(path)
        assert inside <= ALLOWED[layer], path
        assert not outside & FORBIDDEN.get(layer, set()), path


def test_public_names():
    assert sorted(percept.__all__) == [
        "PerceptError",
        "RefusalError",
        "Scene",
        "Study",
        "UsageError",
        "__version__",
        "read_sessions",
    ]
    for name in percept.__all__:
        assert getattr(percept, name) is not None
