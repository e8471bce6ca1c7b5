"""Studies in which nothing was matched: their means are those that scipy gives."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study
from percept.cli import main
from percept.report.overview import decide
from percept.sessions import Sessions
from tests.documents import with_rows

VALUES = {"soft": [4.0, 5.0, 7.0, 6.5], "hard": [9.0, 11.0, 8.0, 12.5]}


@pytest.fixture
def ratings(tmp_path):
    lines = ["person,material,effort"]
    for material, values in VALUES.items():
        lines += [f"P{i},{material},{value}" for i, value in enumerate(values)]
    path = tmp_path / "ratings.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_values_without_references_give_the_means_that_scipy_gives(ratings, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[quantities.effort]\nunit = ""\nreference = "none"\n[inference]\nfamily = "normal"\n'
        '[model]\nscale = { effort = 7.5 }\n[columns]\nsubject = "person"\n'
        'environment = "material"\neffort_adj = "effort"\n'
    )
    out = tmp_path / "out"
    call = ["report", str(ratings), "--scene", str(scene), "--out", str(out)]
    assert main([*call, "--method", "classical"]) == 0
    document = with_rows((out / "report.json").read_text())
    rows = [
        row
        for row in document["intervals"]
        if (row["kind"], row["family"], row["joint"]) == ("mean", "normal", "marginal")
    ]
    limits = {row["environment"]: (row["lower"], row["upper"]) for row in rows}
    for material, values in VALUES.items():
        expected = stats.t.interval(0.99, 3, np.mean(values), stats.sem(values))
        assert limits[material] == pytest.approx(expected, rel=1e-12)
    page = (out / "report.html").read_text()
    text = " ".join(re.sub("<[^>]+>", "", page).split())
    assert re.search(r"gave effort in 2 (conditions|environments), once each", text)
    assert "Mean effort" in page or "Mean E" in page
    assert "Bias of" not in page
    assert "the reference" not in re.findall("<li>(.*?)</li>", page)[0]


@pytest.mark.parametrize("scale", [10.0, 0.001])
def test_means_far_apart_stay_where_the_data_have_them_or_are_the_first_thing_said(scale):
    rng = np.random.default_rng(3)
    left = rng.normal(-9.0, 3.0, 10)
    values = np.concatenate([left, rng.normal(43.0, 3.0, 10)])
    places = np.repeat(["left", "right"], 10)
    people = np.tile(np.arange(10), 2).astype(str)
    table = pd.DataFrame({"subject": people, "environment": places, "x_adj": values})
    scene = Scene(
        quantities={"x": {"unit": "mm", "label": "place", "reference": "none"}},
        inference={"family": "normal", "level": 0.95, "kinds": ["mean"], "tolerance": 0.1},
        model={"scale": {"x": scale}},
    )
    options = Scene(quantities=scene.quantities)
    study = Study(Sessions.from_frame(table, scene=options), scene)
    said = decide(study.results())[0]
    rows = study.intervals.query("method == 'bayesian'").set_index("environment")
    if scale >= 1.0:
        error = stats.sem(left)
        assert rows["estimate"]["left"] == pytest.approx(left.mean(), abs=error)
        assert "standard errors" not in said
    else:
        assert said.startswith("The Bayesian mean lies more than two standard errors from the")
        assert re.search(r"place of right \([^)]+ instead of 4\d\.\d+ mm\)", said)
