"""The notebooks run as they stand, and what their sentences say comes out."""

import ast
import json
from pathlib import Path

import matplotlib
import pytest

NOTEBOOKS = Path(__file__).resolve().parents[1] / "docs" / "notebooks"


@pytest.fixture
def cache(posteriors, monkeypatch):
    """One cache for all pages, so that none samples what another has sampled."""
    monkeypatch.setenv("PERCEPT_CACHE", posteriors)


def run(name):
    """Run the cells of a notebook in its folder, and return their names."""
    notebook = json.loads((NOTEBOOKS / name).read_text(encoding="utf-8"))
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), name, "exec"), names)
    matplotlib.pyplot.close("all")
    return names


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_what_cells_show_is_kept(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            last = ast.parse("".join(cell["source"])).body[-1]
            kinds = {output["output_type"] for output in cell["outputs"]}
            assert ("execute_result" in kinds) == isinstance(last, ast.Expr), "run make notebooks"
            assert "error" not in kinds


@pytest.mark.usefixtures("cache")
def test_own_data_are_read_fitted_and_summed_up(monkeypatch):
    monkeypatch.chdir(NOTEBOOKS)
    names = run("own_data.ipynb")
    assert names["sessions"].table["subject"].nunique() == 12
    assert set(names["average"]["method"]) == {"classical", "bayesian"}
    assert "the scene has no [device]" in set(names["study"].skipped["why"])


@pytest.mark.usefixtures("cache")
def test_foam_alone_can_be_rendered(monkeypatch):
    monkeypatch.chdir(NOTEBOOKS)
    names = run("coupling.ipynb")
    assert all(needed < names["DAMPING"] for needed in names["needed"].values())
    rendered = [row.environment for row in names["study"].rendering if row.verdict == "can"]
    assert rendered == ["foam"]
    table = names["study"].verdicts.query("coupled and method == 'bayesian'")
    outcomes = dict(zip(table["environment"], table["outcome"], strict=True))
    assert outcomes["wood"] == "cannot be rendered"
    assert outcomes["foam"] == "too little data"
