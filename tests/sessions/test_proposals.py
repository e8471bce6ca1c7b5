"""A scene for files with other names maps what names say, and asks for the rest."""

from __future__ import annotations

import tomllib

import pytest

from percept.errors import UsageError
from percept.scene import Scene
from percept.sessions import propose_scene, read_sessions
from tests.sessions.dialects import WRITERS, example

NUMBERS = ("k_ref", "b_ref", "k_adj", "b_adj")
IDS = ("subject", "session", "environment", "trial")
ALL = {name: name for name in (*IDS, *NUMBERS)}
#: What tools call otherwise, by the first word of their name.
OF_TOOLS = {
    "psychopy": {"subject": "participant", "trial": "trials.thisN"},
    "opensesame": {"subject": "subject_nr"},
    "uxf": {"subject": "ppid", "session": "session_num", "trial": "trial_num"},
    "gorilla": {
        "subject": "Participant Private ID",
        "session": "Session",
        "environment": "Environment",
        "trial": "Trial Number",
    },
    "e-prime": {name: name.capitalize() for name in IDS},
}


def roles(scene):
    """Columns that a scene maps, by percept's name."""
    columns = tomllib.loads(scene)["columns"]
    return {name: rule if isinstance(rule, str) else rule["name"] for name, rule in columns.items()}


def to_edit(scene):
    """Lines that a scene leaves to a person."""
    return scene.count(' = "?"')


@pytest.mark.parametrize("name", sorted(WRITERS.keys() - {"jspsych", "folder", "wide"}))
def test_the_columns_of_every_tool_are_found(tmp_path, name):
    for file, data in WRITERS[name].write(example(WRITERS[name].decimals)).items():
        (tmp_path / file).write_bytes(data)
    assert roles(propose_scene(tmp_path)) == ALL | OF_TOOLS.get(name.split(" ")[0], {})


#: Header, and the roles of its columns; what is asked for stands there as "?".
OF_NAMES = {
    "pid,cond,resp,true": "subject=pid environment=cond response_ref=true response_adj=resp",
    "NSub,trialnum,curDur,repDur,colAngle": (
        "subject=NSub environment=? trial=trialnum dur_ref=curDur dur_adj=repDur"
    ),
    "participant,percX,realX,percY,realY,rt": (
        "subject=participant environment=? x_ref=realX x_adj=percX y_ref=realY y_adj=percY"
    ),
    "ppid,session_num,trial_num,block_num,target_pos_x,response_pos_x_pivot,t_response_end": (
        "subject=ppid session=session_num environment=? trial=trial_num pos_x_ref=target_pos_x"
        " pos_x_adj=response_pos_x_pivot"
    ),
    "vp,cond,target,response,response_time,onset_time,date": (
        "subject=vp environment=cond response_ref=target response_adj=response"
    ),
    "observer,test_lum,match_lum,response_time,match_initial": (
        "subject=observer environment=? lum_ref=test_lum lum_adj=match_lum"
    ),
    "ID,Age,Beep,Button_Estimate_,Written_Estimate_": (
        "subject=? environment=? response_ref=? response_adj=?"
    ),
    "subj,participant,cond,target,resp,response": (
        "subject=? environment=cond response_ref=? response_adj=?"
    ),
    "Part_ID,wall_soft,wall_hard": (
        "subject=Part_ID environment=? response_ref=? response_adj=?"
    ),
    "subject,environment,k_ref,b_ref,stiff_adj,b_adj": (
        "subject=subject environment=environment b_ref=b_ref b_adj=b_adj"
    ),
    "c1,c2,c3": "subject=? environment=? response_ref=? response_adj=?",
}  # fmt: skip


def proposed(tmp_path, head, lines=()):
    """Propose columns for a file, of numbers unless its lines are given."""
    path = tmp_path / "s.csv"
    columns = range(len(head.split(",")))
    numbers = [",".join(str(row + 7 * column) for column in columns) for row in range(5)]
    path.write_text("\n".join([head, *(lines or numbers)]) + "\n")
    return path, propose_scene(path)


@pytest.mark.parametrize("head", OF_NAMES)
def test_roles_are_what_names_say(tmp_path, head):
    _, scene = proposed(tmp_path, head)
    assert roles(scene) == dict(pair.split("=") for pair in OF_NAMES[head].split(" "))


def test_answers_to_a_choice_are_no_adjustments(tmp_path):
    _, scene = proposed(tmp_path, "participant,target,response", ["1,5,0", "1,6,1", "2,5,1"])
    assert roles(scene)["response_adj"] == "?"


def test_a_condition_that_is_no_environment_is_refused_by_its_references(tmp_path):
    lines = [f"{s},{'ab'[s % 2]},{v},{v + s}" for s in (1, 2, 3, 4) for v in (10, 20)]
    path, scene = proposed(tmp_path, "subject,condition,target (mm),response (mm)", lines)
    assert to_edit(scene) == 0
    with pytest.raises(UsageError, match="environment 'b' has the reference 10"):
        read_sessions(path, scene=Scene(**tomllib.loads(scene)))


@pytest.mark.parametrize("units", ["brackets", "row"])
def test_a_scene_that_asks_nothing_reads_the_file(tmp_path, units):
    names = ["stiffness standard", "stiffness response"]
    lines = [
        f"{s},{wall},{t},{v / 9},{(v + s) / 9}"
        for s in range(5)
        for wall, v in (("soft", 10), ("hard", 20))
        for t in (1, 2)
    ]
    if units == "row":
        lines = [",,,N/mm,N/mm", *lines]
    else:
        names = [f"{name} (N/mm)" for name in names]
    path, scene = proposed(tmp_path, ",".join(["participant,condition,rep", *names]), lines)
    assert to_edit(scene) == 0
    options = Scene(**tomllib.loads(scene))
    table = read_sessions(path, scene=options).table
    assert table["k_ref"].unique().tolist() == pytest.approx([10000 / 9, 20000 / 9])
    assert len(table) == 20


def test_every_other_column_stands_in_a_comment_with_three_values(tmp_path):
    lines = [f"{s},{wall},1{s},10,0.{s},," for s in range(1, 5) for wall in ("soft", "hard")]
    _, scene = proposed(tmp_path, "pid,cond,resp,true,rt,note,", lines)
    assert '# "rt" (numbers: 0.1, 0.2, 0.3 …)' in scene
    assert '# "note" (empty: )' in scene
    assert 'environment = "cond"  # text: soft, hard' in scene


def test_a_scene_with_a_question_mark_left_is_refused_by_name(tmp_path):
    _, scene = proposed(tmp_path, "pid,cond,resp,true")
    assert to_edit(scene) == 1
    assert 'unit = "?"  # such as "ms"; "" for a pure number' in scene
    path = tmp_path / "scene.toml"
    path.write_text(scene)
    with pytest.raises(UsageError, match=r"quantities\.response\.unit = '\?': is not filled in"):
        Scene.load(path)
    path.write_text(scene.replace('unit = "?"', 'unit = "mm"'))
    assert Scene.load(path).quantities["response"].unit == "mm"


def test_what_is_not_filled_in_is_named():
    with pytest.raises(UsageError) as caught:
        Scene(environments={"a": {"k_ref": "?"}})
    assert str(caught.value) == (
        "environments.a.k_ref = '?': is not filled in. Write what is right in the place of each"
        ' "?"; a reference of zero is 0.0.'
    )


def test_the_kind_of_file_whose_names_say_most_counts(tmp_path):
    (tmp_path / "s.csv").write_text("subject,condition,estimate\n1,a,3\n2,a,4\n3,a,5\n")
    (tmp_path / "q.csv").write_text("item,answer\n" + "how,fine\n" * 40)
    scene = propose_scene(tmp_path)
    assert roles(scene)["environment"] == "condition"


def test_a_row_of_data_in_place_of_the_header_is_refused(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("P1,soft,1,10,10.7\nP1,hard,1,20,20.7\nP2,soft,1,10,10.7\n")
    for read in (propose_scene, read_sessions):
        with pytest.raises(UsageError) as caught:
            read(path)
        problem = caught.value
        assert (problem.file, problem.row) == (str(path), 1)
        assert problem.message == "the first row looks like data: 'P1', 'soft', '1', '10', '10.7'."
        assert "such as subject,environment,trial,k_ref,k_adj." in problem.hint


def test_hostile_names_stay_texts(tmp_path):
    path, scene = proposed(tmp_path, '"a""]\\","\u202enul",resp', ["1,2,3", "2,3,4"])
    assert tomllib.loads(scene)["columns"]["subject"] == "?"
    assert "\u202e" not in scene
    path.write_text("nothing")
    with pytest.raises(UsageError, match="this is not a table"):
        propose_scene(path)
