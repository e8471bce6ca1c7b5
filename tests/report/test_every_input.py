"""Every shipped data set, and every form of input, becomes a page with figures by both methods.

The published study's trials are the fixture `report`, which other tests read.
"""

import re

import pytest

from percept import Scene, Study, read_sessions
from tests import DATASETS
from tests.documents import with_rows
from tests.fits import SHARED

#: Data sets by what is new about their form.
SHIPPED = {
    "published limits": "hbfd_table1",
    "a column an environment": "illusions",
    "a factor within subjects": "sleep",
    "a factor of four levels": "stools",
    "groups": "growth",
}


def scene_of(name):
    """A shipped scene, sampled to a loose accuracy; Table 1 has the published study's."""
    path = DATASETS / f"{name}.toml"
    tables = Scene.load(path if path.exists() else DATASETS / "hbfd.toml").to_dict()
    tables["inference"] |= {"tolerance": 0.2}
    if "device" in tables:
        tables["frequency"]["points"] = 21
    return tables


def written(name, scene, folder):
    """Page and document of a data set's report."""
    sessions = read_sessions(DATASETS / f"{name}.csv", scene=scene)
    page = Study(sessions, scene, store=SHARED).report(folder / "out", date="2026-01-01")
    document = with_rows((folder / "out" / "report.json").read_text("utf-8"))
    return page.read_text("utf-8"), document


def assert_both_methods(page, document):
    """Every cell has intervals of both methods, and each figure of the folder is on the page."""
    cells = {(row["environment"], row["parameter"]) for row in document["intervals"]}
    for method in ("classical", "bayesian"):
        found = [row for row in document["intervals"] if row["method"] == method]
        assert {(row["environment"], row["parameter"]) for row in found} == cells
        assert all(row["lower"] <= row["estimate"] <= row["upper"] for row in found)
    assert len(re.findall(r"<img\b", page)) >= 1


#: Others of their forms are read here too, and their classical numbers are golden.
EVIDENCE = ("stools", "growth")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.evidence if name in EVIDENCE else ())
        for name in SHIPPED.values()
    ],
    ids=SHIPPED,
)
def test_a_shipped_data_set_becomes_a_page(name, tmp_path):
    assert_both_methods(*written(name, Scene(**scene_of(name)), tmp_path))


def test_values_without_a_reference_become_a_page(tmp_path):
    tables = scene_of("stools")
    del tables["environments"]
    tables["quantities"]["effort"]["reference"] = "none"
    tables["model"] = {"scale": {"effort": 3.0}}
    tables["inference"]["kinds"] = ["user"]
    assert_both_methods(*written("stools", Scene(**tables), tmp_path))
