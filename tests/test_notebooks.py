"""The notebooks run as they stand, and what their sentences say comes out."""

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
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), name, "exec"), names)
    matplotlib.pyplot.close("all")
    return names


@pytest.mark.usefixtures("cache")
def test_own_data_are_read_fitted_and_summed_up(monkeypatch):
    monkeypatch.chdir(NOTEBOOKS)
    names = run("own_data.ipynb")
    assert names["sessions"].table["subject"].nunique() == 12
    assert set(names["average"]["method"]) == {"classical", "bayesian"}
    assert "the scene has no [device]" in [skipped.why for skipped in names["study"].skipped]


@pytest.mark.usefixtures("cache")
def test_foam_alone_can_be_rendered(monkeypatch):
    monkeypatch.chdir(NOTEBOOKS)
    names = run("coupling.ipynb")
    assert all(needed < names["DAMPING"] for needed in names["needed"].values())
    rendered = [row.environment for row in names["study"].rendering if row.verdict == "can"]
    assert rendered == ["foam"]
    outcomes = {row[0]: row[2] for row in names["rows"] if row[1]}
    assert outcomes["wood"] == "does not"
    assert outcomes["foam"] == "too little data"
