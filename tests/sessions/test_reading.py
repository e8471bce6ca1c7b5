"""What texts are read as: an input each, its rows, and what is said of it."""

from __future__ import annotations

from fractions import Fraction

import mpmath
import numpy as np
import pandas as pd
import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions import Sessions, read_sessions
from percept.sessions.inputs import ids_from_name
from percept.sessions.quantities import IMPEDANCE, factor
from tests import DATASETS
from tests.sessions.reading import BOTH, HEAD, cells, read, refusal, texts

WALLS = {"soft": {"k_ref": 10.0}, "hard": {"k_ref": 90.0}}
WIDE = {name: f"{name}_{{environment}}" for name in ("k_adj", "k_ref")}
IN_CELLS = {"k_adj": {"name": "v", "path": "s.-1"}}
MELTED = "wall,note,target,p1,p2,p3\nsoft,x,10,11,9,\nhard,x,20,21,19,22\n"
#: Text, tables of the scene, columns to look at and their rows, and one thing that is said.
READ = {
    "missing values": (
        f"{BOTH}1,a,10,1,1,11,NA\n2,a,10,1,1,None,1.5\n3,a,10,1,1, - ,2\n4,a,10,1,1,nan,null\n",
        {},
        ["subject", "k_adj", "b_adj"],
        [["1", 11.0, -1.0], ["2", -1.0, 1.5], ["3", -1.0, 2.0]],
        None,
    ),
    "words of a scene": (
        f"{HEAD}1,a,10,?\n2,a,10,Missing\n3,a,10,12\n",
        {"sessions": {"missing": ["?", "missing"]}},
        ["subject"],
        [["3"]],
        None,
    ),
    "names that are words": (f"{HEAD}NA,null,10,11\n", {}, ["subject", "environment"],
        [["NA", "null"]], None),
    "other names": (
        "Participant,Env,Stiffness Ref,k_final,color\n7,a,10,11,red\n",
        {},
        ["subject", "environment", "k_ref", "k_adj"],
        [["7", "a", 10.0, 11.0]],
        "column 'Participant' is taken as subject",
    ),
    "unused columns": (f"{HEAD[:-1]},x\n7,a,10,11,red\n", {}, [], [[]], "columns not used: 'x'"),
    "a wide table": (
        "subject,k_ref_A,k_adj_A,k_ref_B,k_adj_B\n1,10,11,20,21\n2,10,9,20,\n",
        {"columns": WIDE},
        ["environment", "k_ref", "k_adj"],
        [["A", 10.0, 11.0], ["B", 20.0, 21.0], ["A", 10.0, 9.0]],
        None,
    ),
    "subjects in columns": (
        MELTED,
        {
            "columns": {"environment": "wall", "k_ref": "target"},
            "sessions": {"layout": "subjects in columns", "groups": ["note"]},
        },
        ["subject", "environment", "k_ref", "k_adj", "note"],
        [
            ["p1", "soft", 10.0, 11.0, "x"],
            ["p2", "soft", 10.0, 9.0, "x"],
            ["p1", "hard", 20.0, 21.0, "x"],
            ["p2", "hard", 20.0, 19.0, "x"],
            ["p3", "hard", 20.0, 22.0, "x"],
        ],
        None,
    ),
    "subjects by a pattern": (
        MELTED.replace("wall", "who"),
        {"columns": {"k_ref": "target", "k_adj": "p{subject}"}},
        ["subject", "environment"],
        [["1", "10"], ["2", "10"], ["1", "20"], ["2", "20"], ["3", "20"]],
        "environments are named by the values of column 'target'",
    ),
    "environments of the scene": (
        "ID,age,soft,hard\n1,33,11,88\n2,44,9,91\n",
        {"columns": {"subject": "ID", "k_adj": "{environment}"}, "environments": WALLS},
        ["subject", "environment", "k_ref", "k_adj"],
        [
            ["1", "soft", 10.0, 11.0],
            ["1", "hard", 90.0, 88.0],
            ["2", "soft", 10.0, 9.0],
            ["2", "hard", 90.0, 91.0],
        ],
        "columns not used: 'age'",
    ),
    "a row per subject": (
        "soft,hard\n310,880\n290,\n",
        {
            "columns": {"k_adj": "{environment}"},
            "environments": {"soft": {"k_ref": 300.0}, "hard": {"k_ref": 900.0}},
            "sessions": {"subject": "row"},
        },
        ["subject", "k_adj"],
        [["f 2", 310.0], ["f 2", 880.0], ["f 3", 290.0]],
        None,
    ),
    "one environment": (
        "subject,k_adj\n1,310\n",
        {"environments": {"wall": {"k_ref": 300.0}}},
        ["environment", "k_ref"],
        [["wall", 300.0]],
        None,
    ),
    "nothing matched, and no environments": (
        "subject,x_adj\n1,11\n2,12\n",
        {"quantities": {"x": {"reference": "none"}}},
        ["environment", "x_ref"],
        [["all trials", 0.0], ["all trials", 0.0]],
        None,
    ),
    "an environment that no row has": (
        "subject,environment,k_adj\n1,soft,11\n",
        {"environments": WALLS},
        ["environment"],
        [["soft"]],
        "[environments] names it, but no row has it",
    ),
    "cells of JSON": (
        "subject,environment,k_ref,v\n"
        '1,a,10,"{""s"": [1, 1.25e1]}"\n2,a,10,"{""s"": [np.float64(9.5)]}"\n3,a,10,{}\n',
        {"columns": IN_CELLS},
        ["k_adj"],
        [[12.5], [9.5]],
        None,
    ),
    "a unit without a name": (
        f"{HEAD}1,a,300,31\n",
        {"columns": {"k_adj": {"name": "k_adj", "scale": 10.0}}},
        ["k_adj"],
        [[310.0]],
        None,
    ),
    "ratios": (
        "subject,environment,x\n1,a,1.5\n",
        {
            "columns": {"k_adj": {"name": "x", "response": "ratio"}},
            "environments": {"a": {"k_ref": 300.0}},
        },
        ["k_adj"],
        [[450.0]],
        None,
    ),
    "differences": (
        f"{HEAD}1,a,300,0.5\n",
        {"columns": {"k_adj": {"name": "k_adj", "response": "difference", "unit": "N/mm"}}},
        ["k_adj"],
        [[800.0]],
        None,
    ),
    "the order of rows": (
        f"{HEAD[:-1]},trial\n1,a,10,11,1\n1,b,20,21,2\n2,a,10,12,1\n1,a,10,13,1\n1,a,10,,2\n",
        {"sessions": {"trial": "order"}},
        ["subject", "environment", "trial"],
        [["1", "a", 1], ["1", "b", 1], ["2", "a", 1], ["1", "a", 2]],
        "columns not used: 'trial'",
    ),
    "a column without a name": (
        '"","subject","environment","k_ref","k_adj"\n"1","1","a",10,11\n"2","1","a",10,12\n',
        {"columns": {"trial": "column 1"}},
        ["trial"],
        [[1], [2]],
        None,
    ),
    "spaces": ("subject environment k_ref k_adj\n1 a 300 310.5\n", {}, ["k_adj"], [[310.5]], None),
    "names with spaces": (f"{HEAD}1,a b,300,310.5\n", {}, ["environment"], [["a b"]], None),
    "the last event": (
        f"{BOTH}1,a,10,1,1,5,\n1,a,10,1,1,9,2\n1,a,10,1,1,11,\n1,a,10,1,2,8,3\n",
        {"sessions": {"keep": "last"}},
        ["k_adj", "b_adj"],
        [[11.0, 2.0], [8.0, 3.0]],
        'keep = "last" leaves one row per subject, environment, trial',
    ),
    "the last event without numbers": (
        f"{HEAD}1,a,10,11\n1,a,10,12\n",
        {"sessions": {"keep": "last"}},
        ["k_adj"],
        [[12.0]],
        'keep = "last" leaves one row per subject, environment',
    ),
    "windows": (
        f"{HEAD}Jürgen,a,10,11\n".encode("cp1252"),
        {},
        ["subject"],
        [["Jürgen"]],
        "not UTF-8; read as Windows-1252",
    ),
    "a published table": (
        "environment,parameter,reference,lower,upper,n,level\nV,k,10,11,19,10,.9\nV,b,1,2,3,9,.9\n",
        {},
        ["environment", "parameter", "reference", "lower", "upper", "n", "level"],
        [["V", "k", 10.0, 11.0, 19.0, 10, 0.9], ["V", "b", 1.0, 2.0, 3.0, 9, 0.9]],
        None,
    ),
    "limits before means": (
        "environment,parameter,reference,mean,sd,lower,upper,n,level\nV,b,0.7,,,0.5,0.8,10,0.99\n",
        {},
        ["lower", "upper"],
        [[0.5, 0.8]],
        "columns not used: 'mean', 'sd'",
    ),
    "wide limits": (
        "environment,parameter,reference,lower,upper,n,level\nV,k,1,-50,450,2,0.99\n",
        {},
        ["upper"],
        [[450.0]],
        None,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", READ)
def test_what_is_read(tmp_path, case):
    text, tables, columns, rows, said = READ[case]
    found = read(tmp_path, text, **tables)
    table = found.table.fillna(-1.0)
    assert table[columns].to_numpy().tolist() == rows
    assert said is None or said in texts(found)


MARKS = {
    "0,435 2,301": [0.435, 2.301],
    "1.286 2.301 .5": [1.286, 2.301, 0.5],
    "0.435 1,286": ["1,286"],
    ".85 951.541 1,286 8.5": ["1,286"],
    "1,286 2,301 0.5": ["1,286", "2,301"],
    "12,5 0,435 1.286": ["1.286"],
    "1,286 2,301 1.250": ["1.250"],
    "1,286 1.250": ["1,286"],
    "1,286 1,301": ["1,286", "1,301"],
    "1.286 1.301": ["1.286", "1.301"],
}


@pytest.mark.parametrize("numbers", MARKS)
def test_a_file_has_one_decimal_mark_and_the_other_cells_are_blamed(tmp_path, numbers):
    """One number that is no thousand settles it; cells of one reading go before many of two."""
    lines = "".join(f"{i};a;2;{cell}\n" for i, cell in enumerate(numbers.split()))
    text = HEAD.replace(",", ";") + lines
    if isinstance(MARKS[numbers][0], float):
        assert read(tmp_path, text).table["k_adj"].tolist() == MARKS[numbers]
        return
    error = refusal(tmp_path, text)
    assert [problem.value for problem in error.problems] == MARKS[numbers]
    for problem in error.problems:
        plain = problem.value.replace(",", "").replace(".", "")
        point = problem.value.replace(",", ".")
        assert problem.message.startswith(f"can be read as {point} or as {plain}")


@pytest.mark.parametrize(("mark", "other"), [(",", "1.286"), (".", "1,286")])
def test_a_declared_decimal_mark_settles_it(tmp_path, mark, other):
    text = HEAD.replace(",", ";") + f"1;a;2;1{mark}301\n"
    error = refusal(tmp_path, text.replace(mark, "," if mark == "." else "."))
    word = {",": "point", ".": "comma"}[mark]
    assert f"If the {word} separates thousands, write them without it and declare" in error.hint
    assert read(tmp_path, text, sessions={"decimal": mark}).table["k_adj"].tolist() == [1.301]
    error = refusal(tmp_path, f"{text}2;a;2;{other}\n", sessions={"decimal": mark})
    assert f"as 1286; the file is read with the decimal mark {mark!r}" in error.message
    assert "thousands without a separator" in error.hint
    # Between commas a point is a decimal mark.
    assert len(read(tmp_path, HEAD + "1,a,2.000,1.286\n").table) == 1


@pytest.mark.parametrize("quote", ["", '"'])
def test_numbers_are_correctly_rounded(tmp_path, quote):
    values = -(10.0 ** np.random.default_rng(8).uniform(-99, 99, 500))
    numbers = [f"{value:.{n % 26}e}" for n, value in enumerate(values)]
    rows = [f"{quote}{n}{quote},a,10,{text}\n" for n, text in enumerate(numbers)]
    found = read(tmp_path, HEAD + "".join(rows))
    assert found.table["k_adj"].tolist() == [float(Fraction(text)) for text in numbers]


@pytest.mark.parametrize(
    ("unit", "parameter", "scale"),
    [("N/mm", "k", 1000.0), ("mN/m", "k", 0.001), ("N·s/mm", "b", 1000.0), ("Ns/cm", "b", 100.0)],
)
def test_units_convert(unit, parameter, scale):
    assert factor(unit, IMPEDANCE[parameter]) == scale


@pytest.mark.parametrize("unit", ["kg", "furlong", "10**10**10", "N/m; import os", ""])
def test_what_is_no_unit_is_refused(unit):
    with pytest.raises(UsageError, match="not a unit of stiffness"):
        factor(unit, IMPEDANCE["k"])


@pytest.mark.parametrize("rows", [3, 9000])
def test_two_carriage_returns_and_a_line_feed_end_a_line(tmp_path, rows):
    lines = [f"{row % 90},{row // 90},300,{300 + row / 8},{'x' * 40}" for row in range(rows)]
    found = read(tmp_path, "\r\r\n".join([f"{HEAD[:-1]},note", *lines, ""]))
    assert found.table["k_adj"].tolist() == [300 + row / 8 for row in range(rows)]
    assert "blank line" not in found.counts


ALIKE = "look alike and are kept apart: if they are one, write them alike in the files"


@pytest.mark.parametrize(
    ("names", "written"),
    [
        (("001", "1", "01"), ("'001'", "'1'", "'01'")),
        (("s1", "S1"), ("'s1'", "'S1'")),
        (("1", "1.0"), ("'1'", "'1.0'")),
        *(((other, "P1"), (repr(other), "'P1'")) for other in ("P01", "p1", "P_1", "P-1", "P 1")),
    ],
)
def test_names_that_look_alike_are_kept_apart_and_named(tmp_path, names, written):
    found = read(tmp_path, HEAD + "".join(f"{s},a,10,11\n" for s in (*names, "P10", "1-1")))
    assert found.subjects == (*names, "P10", "1-1")
    places = [f"{name} ({tmp_path}/f.csv:{row})" for row, name in enumerate(written, 2)]
    assert f"subjects {', '.join(places)} {ALIKE}" in texts(found)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("Zo\u00eb", "Zoe\u0308"),
        ("Ann", " Ann"),
        ("Ann B", "Ann\u00a0 B"),
        ("Ann", "An\u200bn"),
    ],
)
def test_spellings_of_one_name_are_one_subject(tmp_path, first, second):
    sessions = read(tmp_path, f"{HEAD}{first},a,10,11\n{second},b,10,12\nBen,a,10,13\n")
    assert sessions.subjects == (first, "Ben")
    (notice,) = (n.text for n in sessions.notices if "another spelling" in n.text)
    assert f"subject {first!r} is one name with another spelling in {tmp_path}/f.csv:3" in notice
    # Where a rule, the scene or another file spells it otherwise too.
    (tmp_path / "g.csv").write_text(f"{HEAD}{second},c,10,14\n")
    assert read_sessions(tmp_path).subjects == (first, "Ben")
    rule = {"exclude": [{"column": "subject", "equals": second}]}
    scene = Scene(sessions=rule, environments={"a\u200b": {"k_ref": 10.0}})
    left = read_sessions(tmp_path / "f.csv", scene=scene)
    assert (left.subjects, left.environments) == (("Ben",), ("a\u200b",))
    assert not any("no row has it" in text for text in texts(left))


def test_a_name_like_a_missing_value_is_announced(tmp_path):
    found = read(tmp_path, f"{HEAD}nan,a,10,11\n2,a,10,9\n")
    assert f"subject 'nan' ({tmp_path}/f.csv:2) is taken as a name: is it a missing value?" in (
        texts(found)
    )


def test_rules_leave_rows_out_log_and_count_them(tmp_path):
    """Limits judge the last event and are themselves kept; texts judge every event."""
    text = (
        "subject,environment,k_ref,trial,k_adj,phase,rt\n"
        "1,a,10,1,8,test,1\n2,a,10,1,9,test,70\n1,a,10,1,50,test,2\n2,a,10,1,40,test,60\n"
        "2,a,10,1,12,replay,4\n3,a,10,1,13,test,5\n3,a,10,1,,test,90\n4,b,20,1,19,test,61\n"
    )
    rules = [
        {"column": "phase", "equals": "replay", "why": "replayed"},
        {"column": "k_adj", "above": 40, "why": "slipped"},
        {"column": "rt", "above": 60},
    ]
    found = read(tmp_path, text, sessions={"keep": "last", "exclude": rules})
    assert cells(found, "subject", "k_adj") == [["2", 40.0], ["3", 13.0]]
    assert [(e.who, e.what, e.why, e.row) for e in found.exclusions] == [
        ("2", "environment a, trial 1", "replayed", 6),
        ("3", "environment a, trial 1", "no adjustment", 8),
        ("1", "environment a, trial 1", "slipped", 4),
        ("4", "environment b, trial 1", "rt is above 60", 9),
    ]
    assert found.counts["earlier event of a trial"] == 2
    assert found.counts["excluded: slipped"] == 1
    assert [found.locate(index)[1] for index in (0, 1)] == [5, 7]


def test_repeats_are_missing_where_there_are_some_and_cells_empty_where_there_are_none(tmp_path):
    """Twice each in V; in W one subject once, and the other never."""
    rows = [f"{s},V,10,1,{t},11,1\n" for s in "AB" for t in (1, 2)]
    found = read(tmp_path, BOTH + "".join([*rows, "A,W,20,2,1,21,2\n"]))
    assert found.counts["missing repeats"] == 1
    assert found.counts["empty cells (subject × environment)"] == 1


def test_published_means_become_the_limits_of_their_interval(tmp_path):
    head = "environment,parameter,reference,mean,sd,n,level\n"
    found = read(tmp_path, head + "VE1,k,15,14.914,3.9954,10,0.99\n")
    ((lower, upper),) = cells(found, "lower", "upper")

    def beyond(q):
        """P(|t| > q) for nine degrees of freedom: a regularised incomplete beta function."""
        return mpmath.betainc(4.5, 0.5, 0, 9 / (9 + q**2), regularized=True)

    with mpmath.workdps(30):
        t = mpmath.findroot(lambda q: beyond(q) - mpmath.mpf("0.01"), 3.25)
        half = float(t * mpmath.mpf("3.9954") / mpmath.sqrt(10))
    assert (lower, upper) == pytest.approx((14.914 - half, 14.914 + half), rel=1e-13)
    bare = read(tmp_path, head.replace(",level", "") + "VE1,k,15,14.914,3.9954,10\n")
    assert bare.table["level"].tolist() == [0.95]
    assert any("without a level are kept as their limits at 0.95" in text for text in texts(bare))


def test_environments_stand_as_the_scene_lists_them_and_by_their_reference(tmp_path):
    rows = "".join(f"1,{e},{k},{k}\n" for e, k in (("hard", 900), ("soft", 80), ("mid", 300)))
    assert read(tmp_path, HEAD + rows).environments == ("soft", "mid", "hard")
    listed = {"hard": {"k_ref": 900}, "mid": {}}
    assert read(tmp_path, HEAD + rows, environments=listed).environments == ("hard", "mid", "soft")
    table = "environment,parameter,reference,lower,upper,n,level\nhard,k,900,800,1000,9,0.95\n"
    found = read(tmp_path, table + "soft,k,80,70,90,9,0.95\n")
    assert found.environments == ("soft", "hard")


def test_a_mass_is_converted_and_zero_where_it_is_blank(tmp_path):
    head = "subject,environment,k_ref,b_ref,m_ref,k_adj,b_adj\n"
    rows = "".join(f"{s},a,900,2,300,{900 + s},{2 + s / 10}\n" for s in (1, 2, 3, 4))
    found = read(
        tmp_path, f"{head}{rows}1,b,50,1,,50,1\n", columns={"m_ref": {"name": "m_ref", "unit": "g"}}
    )
    assert found.masses == {"b": 0.0, "a": 0.3}


def test_files_merge_by_column_name(tmp_path):
    (tmp_path / "a.csv").write_text(f"{HEAD}1,a,10,11\n")
    (tmp_path / "b.csv").write_text("k_adj,environment,subject,k_ref,group\n12,a,2,10,left\n")
    found = read_sessions(tmp_path)
    assert cells(found, "k_adj", "group") == [[11.0, ""], [12.0, "left"]]
    assert found.parameters == ("k",)
    assert found.locate(1) == (str(tmp_path / "b.csv"), 2)


@pytest.mark.parametrize(
    ("pattern", "path", "ids"),
    [
        ("{subject}/*", "all/S10/contour_S10_1.csv", {"subject": "S10"}),
        ("*/{subject}/*/*", "walls/P01/S001/trial_results.csv", {"subject": "P01"}),
        ("walls_{subject}_*", "walls_ann_run_2.csv.gz", {"subject": "ann"}),
        ("s{subject}_v{session}", "x/s007_v02.csv", {"subject": "007", "session": "02"}),
    ],
)
def test_names_of_files_hold_ids(pattern, path, ids):
    assert ids_from_name(path, pattern, file=path) == ids


def test_ids_of_names_go_before_columns_and_are_told_apart(tmp_path):
    found = read(tmp_path, f"{HEAD}x,a,10,11\n", "s8.csv", sessions={"filename": "s{subject}"})
    assert found.subjects == ("8",)
    said = "subject is taken from the file's name; column 'subject' is not used"
    assert said in texts(found)
    text = "subject,k_ref,k_adj\n1,300,310\n"
    found = read(tmp_path, text, "soft.csv", sessions={"filename": "{environment}"})
    assert found.environments == ("soft",)
    pattern = {"filename": "{subject}_{session}"}
    error = refusal(tmp_path, f"{HEAD}x,a,10,11\n", "a_b_c.csv", sessions=pattern)
    assert "in more than one way" in str(error)


def folder(tmp_path):
    for s in (1, 2, 3):
        (tmp_path / f"s{s}_trials.csv").write_text(HEAD + f"{s},a,10,1{s}\n{s},b,20,2{s}\n")
    return tmp_path


def test_what_aborted_runs_and_trackers_leave_is_left_out_with_a_notice(tmp_path):
    for name in ("s4_trials.csv", "s5_trials.csv"):
        (folder(tmp_path) / name).write_text(HEAD)
    (tmp_path / "s6_trials.csv").write_text("")
    (tmp_path / "tracker.csv").write_text("time,x,y\n0.1,2,3\n")
    (tmp_path / "notes.docx").write_text("")
    found = read_sessions(tmp_path)
    assert (found.counts["observations"], len(found.sources)) == (6, 3)
    said = [str(notice).removeprefix(f"{tmp_path}/") for notice in found.notices]
    assert said == [
        "s4_trials.csv: left out: there are no data below the header. (and 1 more like this)",
        "s6_trials.csv: left out: the file is empty.",
        (
            "tracker.csv: left out: there is no column for subject and environment and k_adj (or"
            " b_adj); the columns are 'time', 'x', 'y'."
        ),
    ]
    # A rule of the scene is none of theirs; a file that is named is asked for.
    scene = Scene(columns={"subject": "subject", "environment": "environment"})
    assert len(read_sessions(tmp_path, scene=scene).sources) == 3
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path / "s1_trials.csv", tmp_path / "tracker.csv")
    assert (caught.value.file, caught.value.row) == (str(tmp_path / "tracker.csv"), 1)
    assert len(read_sessions(tmp_path / "s1_trials.csv", tmp_path / "s4_trials.csv").sources) == 1


def test_notices_of_many_files_are_one_with_their_number(tmp_path):
    for subject in range(1, 31):
        lines = [f"{subject},a,10,{10 + trial},{trial}" for trial in range(subject)]
        text = "\n".join([f"{HEAD[:-1]},x", *lines])
        (tmp_path / f"s{subject:02d}.csv").write_text(text)
    unused, kept = texts(read_sessions(tmp_path, scene=Scene(sessions={"keep": "last"})))
    assert unused == "columns not used: 'x' (and 29 more like this)"
    assert kept == ('keep = "last" leaves one row per subject, environment (and 29 more like this)')


def test_a_frame_passes_the_same_checks(tmp_path):
    rows = [["1", "a", 10.0, 11], ["", "", np.nan, np.nan], ["2", "a", 10.0, np.nan]]
    frame = pd.DataFrame([*rows, ["3", "a", 10.0, 9]], columns=HEAD.strip().split(","))
    found = Sessions.from_frame(frame)
    assert found.subjects == ("1", "3")
    assert [found.locate(index)[1] for index in (0, 1)] == [2, 5]
    assert found.exclusions[0].row == 4
    with pytest.raises(UsageError, match=r"<frame>:2, column 'k_adj', value 'x': not a number"):
        Sessions.from_frame(frame.assign(k_adj=["x", 1, 1, 1]))
    frame.to_csv(tmp_path / "f.csv", index=False)
    assert found.table.equals(read_sessions(tmp_path / "f.csv").table)
    with pytest.raises(UsageError, match=r"A DataFrame goes to Sessions\.from_frame\."):
        read_sessions(frame)


def test_simulated_sessions_say_so():
    assert read_sessions(DATASETS / "hbfd_sessions.csv").simulated
    assert not read_sessions(DATASETS / "hbfd_table1.csv").simulated
    frame = pd.DataFrame([["a", "V", 10.0, 9.0]], columns=HEAD.strip().split(","))
    assert not Sessions.from_frame(frame.assign(source="laboratory")).simulated
