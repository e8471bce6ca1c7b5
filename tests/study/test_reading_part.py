"""A scene's tables on data reach Python, or the study says that they did not."""

import pytest

from percept import Scene, Sessions, Study, UsageError, read_sessions
from percept.study.prediction import predict

ROWS = """participant,wall,k_ref,b_ref,stiffness,b_adj,side
Ann,VE1,500,2,0.56,2.4,left
Ben,VE1,500,2,0.61,1.9,left
Cem,VE1,500,2,0.53,2.6,left
Dee,VE1,500,2,0.64,2.2,left
Ann,VE2,900,3,0.96,3.4,left
Ben,VE2,900,3,1.01,2.9,left
Cem,VE2,900,3,0.93,3.6,left
Dee,VE2,900,3,1.04,3.2,left
"""
COLUMNS = {
    "subject": "participant",
    "environment": "wall",
    "k_adj": {"name": "stiffness", "unit": "N/mm"},
}
DEVICE = {"mass": 1.0, "damping": 5.0, "period": 0.001}
CLASSICAL = {"method": "classical"}


@pytest.fixture
def walls(tmp_path):
    path = tmp_path / "walls.csv"
    path.write_text(ROWS)
    return path


def scene(**tables):
    return Scene(columns=COLUMNS, device=DEVICE, inference=CLASSICAL, **tables)


def test_a_scene_says_how_its_files_are_read(walls):
    given = scene(
        sessions={"exclude": [{"column": "subject", "equals": "Dee"}]},
        environments={"VE2": {"m_ref": 0.25}},
    )
    study = Study(walls, given)
    assert study.sessions.subjects == ("Ann", "Ben", "Cem")
    assert study.sessions.table["k_adj"].max() == 1010.0
    assert study.data.environments == ("VE2", "VE1")
    assert study.setup.references["VE2"].mass == 0.25
    frame = study.sessions.table.rename(columns={"subject": "participant", "environment": "wall"})
    frame["stiffness"] = frame.pop("k_adj") / 1000.0
    again = Sessions.from_frame(frame, scene=scene(environments={"VE2": {"m_ref": 0.25}}))
    assert again.table["k_adj"].max() == pytest.approx(1010.0)


@pytest.mark.parametrize(
    ("tables", "named"),
    [
        ({"columns": COLUMNS}, "[columns]"),
        ({"sessions": {"exclude": [{"column": "subject", "equals": "Dee"}]}}, "[sessions]"),
        ({"sessions": {"groups": "side"}}, "[sessions]"),
        ({"environments": {"VE1": {"m_ref": 0.5}}}, "[environments]"),
        ({"quantities": {"duration": {"unit": "ms"}}}, "[quantities]"),
        (
            {"columns": COLUMNS, "environments": {"VE1": {"m_ref": 0.5}}},
            "[columns] and [environments]",
        ),
    ],
)
def test_a_part_that_was_not_applied_is_an_error(walls, tables, named):
    read_sessions(walls, scene=scene(sessions={"groups": "side"})).table.to_csv(walls, index=False)
    sessions = read_sessions(walls)
    with pytest.raises(UsageError) as caught:
        Study(sessions, Scene(inference=CLASSICAL, **tables))
    hint = "Read them with it: read_sessions(files, scene=scene)."
    assert str(caught.value) == f"the sessions were read without {named} of the scene. {hint}"


def test_a_factor_whose_column_was_not_kept_is_an_error(walls):
    given = scene(study={"factor": "side"})
    sessions = read_sessions(walls, scene=scene())
    with pytest.raises(UsageError, match=r"read_sessions\(files, scene=scene\)") as caught:
        Study(sessions, given)
    assert caught.value.column == "side"


def test_only_a_scene_says_how_files_are_read(walls):
    with pytest.raises(UsageError, match=r"a scene is needed, not dict\. Scene\.load reads"):
        read_sessions(walls, scene={"columns": COLUMNS})


SUMMARY = """environment,parameter,reference,lower,upper,n,level
VE1,k,500,450,650,10,0.99
VE1,b,2,1.5,3,10,0.99
VE2,k,900,850,1150,10,0.99
VE2,b,3,2.5,4,10,0.99
"""


@pytest.fixture
def published(tmp_path):
    path = tmp_path / "published.csv"
    path.write_text(SUMMARY)
    return path


def test_masses_reach_published_limits_and_predictions(published):
    walls = {"VE1": {"m_ref": 0.5}, "VE2": {"k_ref": 900.0, "m_ref": 0.5}}
    inference = {"tolerance": 0.2, "kinds": ["mean"], "method": "bayesian"}
    given = Scene(device=DEVICE, environments=walls, inference=inference)
    study = Study(published, given)
    assert study.sessions.masses == {"VE1": 0.5, "VE2": 0.5}
    assert study.setup.references["VE1"].mass == 0.5
    one = predict(study, stiffness=700.0, damping=2.5).boundaries
    other = predict(study, stiffness=700.0, damping=2.5, at={"m": 0.0}).boundaries
    assert one[0].reference != pytest.approx(other[0].reference)
    with pytest.raises(UsageError, match="mass must not be negative"):
        predict(study, stiffness=700.0, damping=2.5, at={"m": -1.0})


def test_masses_that_differ_leave_a_prediction_without_one(published):
    given = Scene(device=DEVICE, environments={"VE1": {"m_ref": 0.5}}, inference=CLASSICAL)
    study = Study(published, given)
    with pytest.raises(UsageError, match=r"tested ones have 0, 0\.5 kg") as caught:
        predict(study, stiffness=700.0, damping=2.5)
    assert "--at m=" in caught.value.hint


def test_references_of_a_published_table_are_held_to_the_scenes(published):
    given = Scene(environments={"VE2": {"k_ref": 950.0}})
    with pytest.raises(UsageError) as caught:
        read_sessions(published, scene=given)
    assert "[environments] gives 'VE2' the reference 950." in str(caught.value)
    assert (caught.value.row, caught.value.value) == (4, 900.0)
