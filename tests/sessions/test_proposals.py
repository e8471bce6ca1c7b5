"""A scene for files with other names maps what names say beyond doubt, and asks for the rest."""

from __future__ import annotations

import tomllib

import pytest

from percept.errors import UsageError
from percept.scene import Scene
from percept.sessions import ReadOptions, propose_columns, read_sessions
from tests.sessions.dialects import WRITERS, example

ALL = {name: name for name in ("subject", "session", "environment", "trial")}
ALL |= {name: name for name in ("k_ref", "b_ref", "k_adj", "b_adj")}

#: Right roles of every tool's file.
OF_TOOLS = {
    "plain": ALL,
    "psychopy": ALL | {"subject": "participant", "trial": "trials.thisN"},
    "jspsych": ALL | {"k_adj": "response.k", "b_adj": "response.b"},
    "opensesame": ALL | {"subject": "subject_nr"},
    "uxf": ALL | {"subject": "ppid", "session": "session_num", "trial": "trial_num"},
    "gorilla": ALL
    | {"subject": "Participant Private ID", "session": "Session", "environment": "Environment"}
    | {"trial": "Trial Number"},
    "e-prime export": ALL
    | {name: name.capitalize() for name in ("subject", "session", "environment", "trial")},
    "excel csv": ALL,
    "excel unicode text": ALL,
    "folder": {name: own for name, own in ALL.items() if name != "session"},
    "wide": {name: name for name in ("subject", "session")}
    | {name: f"{name}_{{environment}}_{{trial}}" for name in ALL if name[1] == "_"},
}
OF_TOOLS |= {
    name: OF_TOOLS[name.partition(" ")[0]]
    for name in ("psychopy tab", "psychopy semicolon", "psychopy european", "psychopy appended")
}
OF_TOOLS["uxf european"] = OF_TOOLS["uxf"]

SUBJECTS = range(1, 6)
WALLS = {"soft": 10, "hard": 20}


def in_cells(line, trials=1):
    """Lines of a file, from subject, wall, its value and the trial."""
    return [
        line(subject, wall, value, trial)
        for subject in SUBJECTS
        for wall, value in WALLS.items()
        for trial in range(1, trials + 1)
    ]


def counted_within(line, rows=14):
    """Lines of a file whose targets differ in every row, from subject, row and target."""
    return [
        line(subject, row, 3.5 + 7 * subject + 0.5 * row)
        for subject in SUBJECTS
        for row in range(1, rows + 1)
    ]


#: Header, lines, and the right roles; "" is a role that no column has.
OF_TABLES = {
    "short names": (
        "pid,cond,resp,true",
        in_cells(lambda s, w, v, t: f"{s},{w},{v + s / 10},{v}"),
        {
            "subject": "pid",
            "environment": "cond",
            "response_ref": "true",
            "response_adj": "resp",
        },
    ),
    "durations by stems": (
        "NSub,trialnum,curDur,repDur,colAngle",
        counted_within(lambda s, r, v: f"{s},{r},{v},{v + 0.3},{9 * r}"),
        {
            "subject": "NSub",
            "trial": "trialnum",
            "dur_ref": "curDur",
            "dur_adj": "repDur",
            "environment": "",
        },
    ),
    "percepts by stems": (
        "participant,percX,realX,percY,realY,rt",
        counted_within(lambda s, r, v: f"{s},{v + 0.2},{v},{v - 0.2},{v},{r / 7:.3f}"),
        {
            "subject": "participant",
            "x_ref": "realX",
            "x_adj": "percX",
            "y_ref": "realY",
            "y_adj": "percY",
            "environment": "",
        },
    ),
    "positions of UXF": (
        "ppid,session_num,trial_num,block_num,start_time,target_pos_x,response_pos_x_pivot,"
        "t_response_end",
        counted_within(lambda s, r, v: f"{s},1,{r},1,{9 * r}.5,{v},{v + 0.2},{9 * r + 3}.25"),
        {
            "subject": "ppid",
            "session": "session_num",
            "trial": "trial_num",
            "pos_x_ref": "target_pos_x",
            "pos_x_adj": "response_pos_x_pivot",
            "environment": "",
        },
    ),
    "a counter is a trial": (
        "observer,condition,stimulus_size,matched_size,n_row",
        [
            line
            for s in SUBJECTS
            for line in (
                f"{s},{w},{v},{v + s / 10 + r / 50},{4 * i + r}"
                for i, (w, v) in enumerate(WALLS.items())
                for r in range(4)
            )
        ],
        {
            "subject": "observer",
            "environment": "condition",
            "trial": "n_row",
            "size_ref": "stimulus_size",
            "size_adj": "matched_size",
        },
    ),
    "a counter is no environment": (
        "subj,condition,target,estimate",
        counted_within(lambda s, r, v: f"{s},{r},{v},{v + 0.4}", rows=40),
        {
            "subject": "subj",
            "response_ref": "target",
            "response_adj": "estimate",
            "environment": "",
        },
    ),
    "groups are no environments": (
        "subject,condition,reference_length [mm],reproduced_length [mm]",
        in_cells(lambda s, w, v, t: f"{s},{'ab'[s % 2]},{v},{v + s / 10}"),
        {
            "subject": "subject",
            "length_ref": "reference_length [mm]",
            "length_adj": "reproduced_length [mm]",
            "environment": "",
        },
    ),
    "stiffness in N/mm": (
        "participant,condition,rep,stiffness standard (N/mm),stiffness response (N/mm)",
        in_cells(lambda s, w, v, t: f"{s},{w},{t},{v / 9},{(v + s) / 9}", trials=2),
        {
            "subject": "participant",
            "environment": "condition",
            "trial": "rep",
            "k_ref": "stiffness standard (N/mm)",
            "k_adj": "stiffness response (N/mm)",
        },
    ),
    "clock times": (
        "vp,cond,target,response,response_time,onset_time,date",
        in_cells(lambda s, w, v, t: f"{s},{w},{v},{v + s / 10},0.{s},{s}.5,2026-03-0{s}"),
        {
            "subject": "vp",
            "environment": "cond",
            "response_ref": "target",
            "response_adj": "response",
        },
    ),
    "subjects in columns": (
        "target,p1,p2,p3,p4",
        [f"{v},{v + 1},{v + 2},{v - 1},{v + 0.5}" for v in (10, 20, 30)],
        {},
    ),
    "a row per subject": (
        "Part_ID,wall_soft,wall_hard",
        [f"{7 * s},{10 + s},{20 + s}" for s in SUBJECTS],
        {"subject": "Part_ID"},
    ),
    "forced choice": (
        "participant,target,response,key_resp.rt",
        in_cells(lambda s, w, v, t: f"{s},{v},{s % 2},0.{s}", trials=4),
        {"subject": "participant"},
    ),
    "two estimates of one reference": (
        "ID,Age,Beep,Button_Estimate_,Written_Estimate_",
        in_cells(lambda s, w, v, t: f"{s},{19 + s},{v},{v + s},{v - s / 10}"),
        {},
    ),
    "a response time is no response": (
        "observer,test_lum,match_lum,response_time,match_initial",
        in_cells(lambda s, w, v, t: f"{s},{v},{v + s / 7:.2f},0.{s},{v - s}"),
        {"subject": "observer", "lum_ref": "test_lum", "lum_adj": "match_lum"},
    ),
    "a condition between subjects": (
        "pno,condition,study,trialnum,congruency,acc,rt",
        in_cells(lambda s, w, v, t: f"{s},{'ab'[s % 2]},1,{t},{w},1,0.{s}", trials=3),
        {"trial": "trialnum", "environment": "congruency"},
    ),
    "two factors and a time": (
        "person,tint,target,time_seen",
        in_cells(lambda s, w, v, t: f"{s},{w},hicon,{v + s}"),
        {"subject": "person"},
    ),
    "other words": (
        "when,who,count,shown,set",
        counted_within(lambda s, r, v: f"{9 * r + 100 * s},{s},{r},{v},{v + 0.5}"),
        {},
    ),
    "lengths in words": (
        "subject_nr,stimulus_duration [ms],response_duration [ms],rt",
        in_cells(lambda s, w, v, t: f"{s},{v},{v + s / 7:.2f},0.{s}"),
        {
            "subject": "subject_nr",
            "duration_ref": "stimulus_duration [ms]",
            "duration_adj": "response_duration [ms]",
        },
    ),
    "made-up names": ("c1,c2,c3", [f"{s},{s * 3},{s / 7:.3f}" for s in SUBJECTS], {}),
    "two that could be": (
        "subj,participant,cond,target,resp,response",
        in_cells(lambda s, w, v, t: f"{s},{s},{w},{v},{v + s},{v - s}"),
        {"environment": "cond"},
    ),
}


def is_right(role, column, right):
    """Whether a role that is not asked for is the right one."""
    return right.get(role) == column


def judged(roles, right):
    """How many of the right roles were found; a wrong one fails."""
    for role, column in roles.items():
        assert column == "?" or is_right(role, column, right), (role, column)
    return sum(roles.get(role) == column for role, column in right.items() if column)


def test_no_role_of_a_tool_is_wrong_and_most_are_found(tmp_path):
    assert OF_TOOLS.keys() == WRITERS.keys()
    found = 0
    for name, right in OF_TOOLS.items():
        folder = tmp_path / name
        folder.mkdir()
        for file, data in WRITERS[name].write(example(WRITERS[name].decimals)).items():
            (folder / file).write_bytes(data)
        own = judged(propose_columns(folder).roles, right)
        assert own >= 2 / 3 * len(right), name
        found += own
    assert found >= 0.95 * sum(map(len, OF_TOOLS.values()))


def proposed(tmp_path, head, lines):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([head, *lines]) + "\n")
    return path, propose_columns(path)


@pytest.mark.parametrize("name", OF_TABLES)
def test_no_role_of_a_table_is_wrong(tmp_path, name):
    head, lines, right = OF_TABLES[name]
    _, proposal = proposed(tmp_path, head, lines)
    judged(proposal.roles, right)


def test_two_thirds_of_the_roles_of_tables_are_found(tmp_path):
    found = 0
    wanted = 0
    for head, lines, right in OF_TABLES.values():
        found += judged(proposed(tmp_path, head, lines)[1].roles, right)
        wanted += sum(map(bool, right.values()))
    assert found >= 2 / 3 * wanted


def test_a_scene_that_asks_nothing_reads_the_file(tmp_path):
    head, lines, _ = OF_TABLES["stiffness in N/mm"]
    path, proposal = proposed(tmp_path, head, lines)
    assert proposal.left == 0
    options = ReadOptions.from_mapping(tomllib.loads(proposal.text))
    table = read_sessions(path, scene=options).table
    assert table["k_ref"].unique().tolist() == pytest.approx([10000 / 9, 20000 / 9])
    assert len(table) == 20


def test_every_other_column_stands_in_a_comment_with_three_values(tmp_path):
    head = "pid,cond,resp,true,rt,note,n"
    lines = in_cells(lambda s, w, v, t: f"{s},{w},{v + s},{v},0.{s},,{s % 2}")
    _, proposal = proposed(tmp_path, head, lines)
    assert '# "rt" (numbers: 0.1, 0.2, 0.3 …)' in proposal.text
    assert '# "note" (empty: )' in proposal.text
    assert '# "n" (whole numbers: 1, 0)' in proposal.text
    assert 'environment = "cond"  # text: soft, hard' in proposal.text


def test_a_scene_with_a_question_mark_left_is_refused_by_name(tmp_path):
    _, proposal = proposed(tmp_path, *OF_TABLES["short names"][:2])
    assert proposal.left == 1
    assert 'unit = "?"  # such as "ms"; "" for a pure number' in proposal.text
    path = tmp_path / "scene.toml"
    path.write_text(proposal.text)
    with pytest.raises(UsageError, match=r"quantities\.response\.unit = '\?': is not filled in"):
        Scene.load(path)
    path.write_text(proposal.text.replace('unit = "?"', 'unit = "mm"'))
    assert Scene.load(path).quantities["response"].unit == "mm"


def test_all_that_is_not_filled_in_is_named():
    given = {"columns": {"subject": "?", "k_adj": {"name": "?"}}}
    given["environments"] = {"a": {"k_ref": "?"}}
    with pytest.raises(UsageError) as caught:
        ReadOptions.from_mapping(given)
    assert str(caught.value) == (
        "columns.subject = '?': is not filled in, and neither is columns.k_adj.name,"
        ' environments.a.k_ref. Write what is right in the place of each "?"; a reference of zero'
        " is 0.0."
    )
    given = {"environments": {"a": {"k_ref": 0.0}}}
    assert ReadOptions.from_mapping(given).environments["a"]["k_ref"] == 0.0


def test_what_is_not_known_is_asked_for(tmp_path):
    _, proposal = proposed(tmp_path, *OF_TABLES["made-up names"][:2])
    assert set(proposal.roles.values()) == {"?"}
    assert proposal.roles.keys() == {"subject", "environment", "response_ref", "response_adj"}
    # The unit is asked for, too.
    assert proposal.left == 5
    assert 'subject = "?"  # its column; or remove this line and write, below' in proposal.text


def test_repeats_without_a_number_are_asked_for(tmp_path):
    lines = in_cells(lambda s, w, v, t: f"{s},{w},{v},{v + t}", trials=2)
    _, proposal = proposed(tmp_path, "subject,condition,target,response", lines)
    assert proposal.roles["trial"] == "?"
    assert 'trial = "?"  # the column that numbers repeats; or remove this line' in proposal.text


def test_the_kind_of_file_whose_names_say_most_counts(tmp_path):
    for subject in SUBJECTS:
        lines = [f"{subject},{wall},{value}" for wall, value in WALLS.items()]
        text = "\n".join(["subject,condition,estimate", *lines])
        (tmp_path / f"s{subject}.csv").write_text(text)
    (tmp_path / "q.csv").write_text("item,answer\n" + "how,fine\n" * 40)
    proposal = propose_columns(tmp_path)
    assert proposal.roles["environment"] == "condition"
    assert "# Not of '" in proposal.text
    assert "with the columns 'item', 'answer'." in proposal.text


def test_a_row_of_data_in_place_of_the_header_is_refused(tmp_path):
    path = tmp_path / "s.csv"
    rows = [f"P{s},{w},1,{v},{v + 0.7}" for s in SUBJECTS for w, v in WALLS.items()]
    path.write_text("\n".join(rows) + "\n")
    for read in (propose_columns, read_sessions):
        with pytest.raises(UsageError) as caught:
            read(path)
        problem = caught.value
        assert (problem.file, problem.row) == (str(path), 1)
        assert problem.message == "the first row looks like data: 'P1', 'soft', '1', '10', '10.7'."
        assert "such as subject,environment,trial,k_ref,k_adj." in problem.hint


def test_hostile_names_stay_texts(tmp_path):
    head = '"a""]\\","\u202enul",resp'
    path, proposal = proposed(tmp_path, head, ["1,2,3", "2,3,4"])
    assert tomllib.loads(proposal.text)["columns"]["subject"] == "?"
    assert "\u202e" not in proposal.text
    path.write_text("nothing")
    with pytest.raises(UsageError, match="this is not a table"):
        propose_columns(path)
