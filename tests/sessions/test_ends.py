"""Adjustments at the ends of a control are left out, counted per environment and logged."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from percept.cli import main
from percept.errors import UsageError
from percept.scene import Scene
from percept.sessions import read_sessions
from percept.study import Study
from tests.documents import build_document, page_of, with_rows

HEAD = "subject,environment,trial,k_ref,k_adj,b_ref,b_adj"


def study(tmp_path, rows):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([HEAD, *rows]) + "\n")
    return path


def options(limits):
    return Scene(quantities={"k": {"limits": limits}, "b": {}})


ROWS = [
    "1,soft,1,50,0,1,1.1",
    "1,soft,2,50,55,1,1.2",
    "2,soft,1,50,100,1,0.9",
    "2,hard,1,90,100,3,",
]


def test_ends_are_blank_counted_and_logged(tmp_path):
    found = read_sessions(study(tmp_path, ROWS), scene=options([0.0, 100.0]))
    np.testing.assert_array_equal(found.table["k_adj"], [np.nan, 55.0, np.nan])
    assert found.table["b_adj"].tolist() == [1.1, 1.2, 0.9]
    assert found.environments == ("soft",)
    assert found.counts["left out: stiffness at a limit of its control"] == 3
    (notice,) = [notice.text for notice in found.notices if "limits of the control" in notice.text]
    assert notice == (
        "3 values of 4 at the limits of the control, 0 to 100 N/m, are left out: 2 of 3 in 'soft'"
        " (2 subjects), 1 of 1 in 'hard' (1 subject). Every interval describes the other values"
        " only"
    )
    rows = [(left.who, left.what, left.row) for left in found.exclusions]
    assert rows == [
        ("1", "k in environment soft", 2),
        ("2", "k in environment soft", 4),
        ("2", "k in environment hard", 5),
    ]
    # Places of what stays are those of its lines.
    assert [found.locate(index)[1] for index in found.table.index] == [2, 3, 4]


def test_one_end_may_be_open_and_values_beyond_are_at_it(tmp_path):
    found = read_sessions(study(tmp_path, ROWS), scene=options([-float("inf"), 90.0]))
    assert found.table["k_adj"].dropna().tolist() == [0.0, 55.0]


def test_limits_are_in_the_unit_of_the_quantity(tmp_path):
    path = study(tmp_path, ["1,a,1,0.05,0.055,1,1", "2,a,1,0.05,0.1,1,1"])
    columns = {name: {"name": name, "unit": "N/mm"} for name in ("k_ref", "k_adj")}
    quantities = {"k": {"limits": [0.0, 100.0]}, "b": {}}
    found = read_sessions(path, scene=Scene(quantities=quantities, columns=columns))
    assert found.table["k_adj"].dropna().tolist() == [55.0]


def test_limits_that_leave_nothing_or_are_none_say_so(tmp_path):
    path = study(tmp_path, ["1,a,1,50,100,1,", "2,a,1,50,100,1,"])
    with pytest.raises(UsageError, match=r"every adjustment lies at a limit of its control\."):
        read_sessions(path, scene=options([0.0, 100.0]))
    with pytest.raises(UsageError, match="the lower of the two limits comes first"):
        options([100.0, 0.0])


def test_intervals_say_what_they_leave_out(tmp_path, capsys):
    rows = [
        f"{s},{e},50,{45 + 3 * s + t},{s % 2}" for s in range(1, 6) for e in "ab" for t in (0, 1)
    ]
    rows += ["1,a,50,100,1", "2,a,50,100,0", "2,b,50,0,0"]
    head = "subject,environment,k_ref,k_adj,hand"
    path = tmp_path / "f.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    scene = tmp_path / "s.toml"
    scene.write_text(
        "[quantities.k]\nlimits = [0.0, 100.0]\n[quantities.b]\n"
        '[sessions]\ntrial = "order"\n[inference]\nmethod = "classical"\n'
    )
    assert main(["fit", str(path), "--scene", str(scene), "--out", str(tmp_path / "fit")]) == 0
    said = capsys.readouterr().err
    assert "are left out: 2 of 12 in 'a' (2 subjects), 1 of 11 in 'b' (1 subject)." in said
    assert "Every interval describes the other values only" in said
    document = with_rows((tmp_path / "fit" / "fit.json").read_text())
    counts = {row["environment"]: row["left_out"] for row in document["intervals"]}
    assert counts == {"a": 2, "b": 1}
    # At each level of a factor those stand that it leaves out.
    tables = {**tomllib.loads(scene.read_text()), "study": {"factor": "hand"}}
    study = Study(read_sessions(path, scene=Scene(**tables)), Scene(**tables))
    document = build_document(study, curves=False)
    counts = {row["environment"]: row["left_out"] for row in document["intervals"]}
    assert counts == {"a (1)": 1, "a (0)": 1, "b (1)": 0, "b (0)": 1}
    text = " ".join(re.sub("<[^>]*>", "", page_of(document)).split())
    assert (
        "Intervals of stiffness leave out adjustments at the limits of the control:"
        " 1 in a (1), 1 in a (0), 1 in b (0)."
    ) in text
    assert "left out" in text
