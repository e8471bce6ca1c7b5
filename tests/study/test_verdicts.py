"""Whether an environment feels real: what a study says of it, with much and with little data."""

from __future__ import annotations

import pytest

from percept import Scene, Study, read_sessions
from percept.boundary.feels_real import judge
from tests import DATASETS


def outcomes(study, *, coupled):
    return {row.environment: row.outcome for row in study.verdicts if row.coupled is coupled}


def test_the_published_wall_with_a_dip_is_not_said_to_feel_real(fitted: Study) -> None:
    """VE2 is inside the next user's boundary by the paper's rule."""
    assert outcomes(fitted, coupled=False)["VE2"] == "too little data"
    (verdict,) = [row for row in fitted.verdicts if row.environment == "VE2" and row.coupled]
    assert verdict.bayesian is not None
    assert verdict.probability == verdict.bayesian.probability
    # Some 0.49 of the draws hold stiffness and damping, and half of these the dip near 31.6 rad/s.
    assert verdict.bayesian.plane == pytest.approx(0.49, abs=0.07)
    assert verdict.bayesian.magnitude < 0.35
    assert outcomes(fitted, coupled=False)["VE3"] == "feels real"
    assert outcomes(fitted, coupled=True)["VE4"] == "does not"


def test_both_methods_follow_the_decision(fitted: Study) -> None:
    for row in fitted.verdicts:
        assert row.bayesian is not None
        assert row.classical is not None
        assert row.method == "bayesian"
        assert row.outcome == judge(row.probability, 0.95)
        parts = row.classical.stiffness, row.classical.damping, row.classical.magnitude
        assert row.classical.least == min(part for part in parts if part is not None)
        # The scene's coupling is unstable.
        assert row.stable_and_real == (0.0 if row.coupled else None)


@pytest.mark.parametrize(
    "method", [pytest.param("bayesian", marks=pytest.mark.evidence), "classical"]
)
def test_four_participants_are_too_few_to_say_that_a_wall_feels_real(method) -> None:
    columns = {
        "subject": "participant",
        "environment": "condition",
        "trial": "rep",
        **{
            f"{name}_{side}": {"name": f"{words} {column} ({unit})", "unit": unit}
            for name, words, unit in (("k", "stiffness", "N/mm"), ("b", "damping", "N·s/m"))
            for side, column in (("ref", "standard"), ("adj", "response"))
        },
    }
    scene = Scene(
        inference={"level": 0.95, "tolerance": 0.1, "method": method},
        device={"mass": 0.2, "damping": 2.0, "period": 0.001},
        coupling={"stiffness": 14e3, "damping": 1.0},
        columns=columns,
        sessions={"only": {"participant": ["P01", "P02", "P03", "P04"]}},
    )
    path = DATASETS.parent / "docs" / "tutorial" / "matching.csv"
    study = Study(read_sessions(path, scene=scene), scene)
    assert len(study.sessions.subjects) == 4
    assert "feels real" not in outcomes(study, coupled=True).values()


def test_published_limits_are_judged_part_by_part() -> None:
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    study = Study(read_sessions(DATASETS / "hbfd_table1.csv"), scene)
    for row in study.verdicts:
        assert row.classical is not None
        assert row.classical.magnitude is None
        assert row.method == "classical"
        assert row.probability == row.classical.least


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
    (typed,) = Study(read_sessions(path), scene).verdicts
    path.write_text(head + "\n".join([*rows[:3], rows[4]]))
    (without,) = Study(read_sessions(path), scene).verdicts
    assert without.leaning is None
    assert typed.leaning is not None
    (row,) = typed.leaning.rows
    assert (row.file, row.row) == ("walls.csv", 5)
    assert row.text == (
        "k = 6400 of subject 'Dee', where the other trials of 'soft' have a median of 572.5"
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
    (verdict,) = Study(read_sessions(path), scene).verdicts
    assert verdict.leaning is not None
    assert verdict.leaning.without is None
