"""Whether an environment feels real: what a study says of it, with much and with little data."""

from __future__ import annotations

import dataclasses

import pytest

from percept import Scene, Study, read_sessions
from percept.boundary.feels_real import judge
from percept.report.decisions import doubtful_verdicts
from tests import DATASETS


def outcomes(study, *, coupled):
    return {row.environment: row.outcome for row in study.verdict_rows if row.coupled is coupled}


def test_the_published_wall_with_a_dip_is_not_said_to_feel_real(fitted: Study) -> None:
    """VE2 is inside the next user's boundary by the paper's rule."""
    assert outcomes(fitted, coupled=False)["VE2"] == "too little data"
    (verdict,) = [row for row in fitted.verdict_rows if row.environment == "VE2" and row.coupled]
    assert verdict.bayesian is not None
    assert verdict.probability == verdict.bayesian.probability
    # Some 0.49 of the draws hold stiffness and damping, and half of these the dip near 31.6 rad/s.
    assert verdict.bayesian.plane == pytest.approx(0.49, abs=0.07)
    assert verdict.bayesian.magnitude < 0.35
    assert outcomes(fitted, coupled=False)["VE3"] == "feels real"
    assert outcomes(fitted, coupled=True)["VE4"] == "does not"


def test_the_table_has_both_methods_and_calls_nothing_real_that_cannot_be_rendered(
    fitted: Study,
) -> None:
    table = fitted.verdicts.set_index(["environment", "coupled", "method"])
    for row in fitted.verdict_rows:
        assert row.bayesian is not None
        assert row.classical is not None
        bayesian = table.loc[(row.environment, row.coupled, "bayesian")]
        classical = table.loc[(row.environment, row.coupled, "classical")]
        assert bayesian["probability"] == row.bayesian.probability
        assert classical["probability"] == row.classical.probability
        if row.environment in ("VE1", "VE2"):
            assert (bayesian["rendered"], bayesian["outcome"]) == ("can", row.bayesian.outcome)
        else:
            assert bayesian["rendered"] == "cannot"
            assert bayesian["outcome"] == classical["outcome"] == "cannot be rendered"


def test_both_methods_follow_the_decision(fitted: Study) -> None:
    for row in fitted.verdict_rows:
        assert row.bayesian is not None
        assert row.classical is not None
        assert row.method == "bayesian"
        assert row.outcome == judge(row.probability, 0.95)
        assert [other.central for other in row.bayesian.by_central] == [0.8, 0.9, 0.95, 0.99]
        shares = [other.probability for other in row.bayesian.by_central]
        assert shares == sorted(shares)
        assert shares[-1] == row.probability
        parts = row.classical.stiffness, row.classical.damping, row.classical.magnitude
        assert row.classical.probability == min(part for part in parts if part is not None)
        # Directly and through the coupling alike.
        renders = row.environment in ("VE1", "VE2")
        assert row.stable_and_real == (row.probability if renders else 0.0)


@pytest.mark.parametrize(
    ("data", "method"),
    [
        ("hbfd_sessions.csv", "classical"),
        pytest.param("hbfd_sessions.csv", "both", marks=pytest.mark.evidence),
        pytest.param("hbfd_table1.csv", "both", marks=pytest.mark.evidence),
        ("hbfd_table1.csv", "classical"),
    ],
)
def test_the_level_of_intervals_decides_no_verdict(data, method) -> None:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method=method, tolerance=0.1)
    said = []
    for level in (0.8, 0.999):
        study = Study(read_sessions(DATASETS / data), scene.with_inference(level=level))
        assert {row.central for row in study.verdict_rows} == {0.99}
        said.append({(row.environment, row.coupled): row.outcome for row in study.verdict_rows})
    assert said[0] == said[1]
    assert "feels real" in said[0].values()


def test_three_users_do_not_refute_a_wall_by_its_magnitude(tmp_path) -> None:
    head = "subject,environment,k_ref,b_ref,k_adj,b_adj\n"
    rows = ["Ann,light,1000,.01,800,.009", "Ben,light,1000,.01,1000,.01"]
    rows.append("Cem,light,1000,.01,1300,.0115")
    path = tmp_path / "walls.csv"
    path.write_text(head + "\n".join(rows))
    scene = Scene(
        inference={"method": "classical"},
        device={"mass": 1.0, "damping": 0.001, "period": 0.001},
    )
    results = Study(read_sessions(path), scene).results()
    (verdict,) = results.verdicts
    assert verdict.classical is not None
    assert verdict.classical.magnitude == verdict.probability <= 0.05 / 3.0
    assert min(verdict.classical.stiffness, verdict.classical.damping) > 0.05 / 3.0
    assert verdict.outcome == "too little data"
    assert doubtful_verdicts(dataclasses.replace(results, rendering=())) == [
        "With fewer than 6 subjects only k or b can show that light would not feel real."
    ]


def test_published_limits_are_judged_part_by_part() -> None:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    study = Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene)
    for row in study.verdict_rows:
        assert row.classical is not None
        assert row.classical.magnitude is None
        assert row.method == "classical"
        assert row.probability == row.classical.probability


@pytest.mark.parametrize("method", [pytest.param("both", marks=pytest.mark.evidence), "classical"])
def test_a_mistyped_row_is_named_with_the_verdict_without_it(tmp_path, method) -> None:
    head = "subject,environment,k_ref,b_ref,k_adj,b_adj\n"
    rows = ["Ann,soft,500,2,560,2.4", "Ben,soft,500,2,610,1.9", "Cem,soft,500,2,530,2.6"]
    rows += ["Dee,soft,500,2,6400,2.2", "Eli,soft,500,2,585,2.9"]
    path = tmp_path / "walls.csv"
    path.write_text(head + "\n".join(rows))
    scene = Scene(
        inference={"tolerance": 0.1, "method": method},
        device={"mass": 0.5, "damping": 5.0, "period": 0.001},
    )
    (typed,) = Study(read_sessions(path), scene).verdict_rows
    path.write_text(head + "\n".join([*rows[:3], rows[4]]))
    (without,) = Study(read_sessions(path), scene).verdict_rows
    assert without.leaning is None
    assert typed.leaning is not None
    (row,) = typed.leaning.rows
    assert (row.file, row.row) == ("walls.csv", 5)
    assert row.text == (
        "k = 6400 of subject 'Dee', where the other trials of 'soft' have a median of 572.5:"
        " mistyped?"
    )
    assert typed.leaning.without == without
    assert typed.probability != without.probability


def test_where_nothing_is_left_without_a_mistyped_row_no_verdict_is_given(tmp_path) -> None:
    path = tmp_path / "walls.csv"
    path.write_text(
        "subject,environment,k_ref,b_ref,k_adj,b_adj\n"
        "Ann,soft,500,2,560,2.4\nBen,soft,500,2,6100,1.9\n"
    )
    scene = Scene(
        inference={"method": "classical"}, device={"mass": 0.5, "damping": 5.0, "period": 0.001}
    )
    results = Study(read_sessions(path), scene).results()
    (verdict,) = results.verdicts
    assert verdict.leaning is not None
    assert verdict.leaning.without is None
