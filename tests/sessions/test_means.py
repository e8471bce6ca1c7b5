"""Studies in which nothing was matched: a proposal leads to means in two calls."""

import json
import re

import numpy as np
import pytest
from scipy import stats

from percept.cli import main

VALUES = {"soft": [4.0, 5.0, 7.0, 6.5], "hard": [9.0, 11.0, 8.0, 12.5]}


@pytest.fixture
def ratings(tmp_path):
    lines = ["person,material,effort"]
    for material, values in VALUES.items():
        lines += [f"P{i},{material},{value}" for i, value in enumerate(values)]
    path = tmp_path / "ratings.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_uncommented_lines_of_a_proposal_give_the_means_that_scipy_gives(ratings, tmp_path):
    scene = tmp_path / "scene.toml"
    assert main(["new", str(scene), "--from", str(ratings)]) == 0
    proposed = scene.read_text()
    recipe = re.compile(
        r'^# (reference = "none"|\[inference\]|family = "normal"|\[model\]|scale = )', re.M
    )
    assert "# scale = { effort = 7.5 }" in proposed
    scene.write_text(recipe.sub(r"\1", proposed))
    out = tmp_path / "out"
    call = ["report", str(ratings), "--scene", str(scene), "--out", str(out)]
    assert main([*call, "--method", "classical"]) == 0
    document = json.loads((out / "report.json").read_text())
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
    assert re.search(r"gave values of effort in 2 (conditions|environments), once each", text)
    assert "Interval of the mean" in page
    assert "Interval of the bias" not in page
    assert "the reference" not in re.findall("<li>(.*?)</li>", page)[0]


def test_two_columns_of_a_row_per_subject_are_offered_as_before_and_after(tmp_path, capsys):
    path = tmp_path / "weights.csv"
    rows = ["80.7,80.2", "89.4,80.1", "91.8,86.4", "74.0,86.3", "78.1,76.1", "88.3,78.1"]
    path.write_text("\n".join(["Prewt,Postwt", *rows]) + "\n")
    main(["new", str(tmp_path / "scene.toml"), "--from", str(path)])
    proposed = (tmp_path / "scene.toml").read_text()
    assert '# To compare "Postwt" with "Prewt" of the same subject, in place of this:' in proposed
    assert '# response_ref = "Prewt"' in proposed
