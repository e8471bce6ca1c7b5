"""Files as experiments leave them: trials without numbers, ids of several columns, masses,
order."""

from __future__ import annotations

import zipfile

import numpy as np
import pandas as pd
import pytest

from percept.errors import UsageError
from percept.haptics import Device, Environment, Loop, perceived_impedance
from percept.sessions import ReadOptions, Sessions, read_sessions
from percept.study import Study
from percept.study.regions import Region

HEAD = "subject,environment,k_ref,k_adj\n"


def read(tmp_path, text, name="f.csv", **tables):
    path = tmp_path / name
    path.write_text(text)
    return read_sessions(path, scene=ReadOptions.from_mapping(tables))


def refusal(tmp_path, text, **tables):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, text, **tables)
    return caught.value


def test_trials_are_numbered_by_their_order_where_the_scene_says_so(tmp_path):
    # The file's own numbers restart with every block, and are not read.
    rows = ["1,a,10,11,1", "1,b,20,21,2", "2,a,10,12,1", "1,a,10,13,1", "1,a,10,,2", "1,a,10,14,1"]
    text = HEAD.replace("\n", ",trial\n") + "\n".join(rows) + "\n"
    found = read(tmp_path, text, sessions={"trial": "order"})
    assert found.table["trial"].tolist() == [1, 1, 1, 2, 3]
    assert "columns not used: 'trial'" in [notice.text for notice in found.notices]


def test_the_order_of_rows_is_no_column_of_trials_for_events(tmp_path):
    error = refusal(tmp_path, HEAD + "1,a,10,11\n", sessions={"trial": "order", "keep": "last"})
    assert 'keep = "last" needs a column of trials' in str(error)


def test_people_whose_numbers_restart_are_told_apart(tmp_path):
    text = "experiment,participant,type,level,k_ref,k_adj\n" + "".join(
        f"{e},{p},{t},{v},{10 * v},{10 * v + p}\n"
        for e in (1, 2)
        for p in (1, 2)
        for t in "xy"
        for v in (1, 2)
    )
    columns = {"subject": ["experiment", "participant"], "environment": ["type", "level"]}
    found = read(tmp_path, text, columns=columns)
    assert found.subjects == ("1-1", "1-2", "2-1", "2-2")
    assert set(found.environments) == {"x-1", "x-2", "y-1", "y-2"}
    assert not any("not used" in notice.text for notice in found.notices)


def test_an_id_without_one_of_its_parts_is_missing(tmp_path):
    text = "experiment,participant,environment,k_ref,k_adj\n1,1,a,10,11\n,1,a,10,12\n"
    error = refusal(tmp_path, text, columns={"subject": ["experiment", "participant"]})
    assert (error.row, error.column) == (3, "experiment")
    assert "an adjustment has no subject." in str(error)


def test_ids_that_join_to_one_text_are_refused(tmp_path):
    text = "e,p,environment,k_ref,k_adj\na-b,c,x,10,11\na,b-c,x,10,12\n"
    error = refusal(tmp_path, text, columns={"subject": ["e", "p"]})
    assert "'a', 'b-c' and 'a-b', 'c' both join to 'a-b-c'." in str(error)
    assert "Take the hyphens out" in str(error)


def test_parts_of_ids_are_columns_that_are_there(tmp_path):
    error = refusal(tmp_path, HEAD + "1,a,10,11\n", columns={"subject": ["subject", "nobody"]})
    assert (error.row, error.column) == (1, "nobody")
    error = refusal(tmp_path, HEAD + "1,a,10,11\n", columns={"k_adj": ["k_adj", "k_ref"]})
    assert "only an id is made of several columns." in str(error)


def test_environments_stand_in_order_of_their_reference(tmp_path):
    rows = [
        f"{s},{e},{k},{k + s}"
        for s in (1, 2, 3)
        for e, k in (("hard", 900), ("soft", 80), ("mid", 300))
    ]
    text = HEAD + "\n".join(rows) + "\n"
    found = read(tmp_path, text)
    assert found.environments == ("soft", "mid", "hard")
    assert found.table["environment"].tolist()[:3] == ["hard", "soft", "mid"]


def test_environments_stand_as_the_scene_lists_them(tmp_path):
    text = "subject,environment,k_adj\n" + "".join(f"{s},{e},9{s}\n" for s in (1, 2) for e in "abc")
    listed = {"c": {"k_ref": 90.0}, "a": {"k_ref": 50.0}, "b": {"k_ref": 70.0}}
    assert read(tmp_path, text, environments=listed).environments == ("c", "a", "b")
    text = HEAD + "".join(
        f"{s},{e},{k},9{s}\n" for s in (1, 2) for e, k in (("a", 90), ("b", 50), ("c", 70))
    )
    assert read(tmp_path, text, environments={"c": {}}).environments == ("c", "b", "a")


def test_of_a_summary_they_stand_by_reference_too(tmp_path):
    text = "environment,parameter,reference,lower,upper,n,level\nhard,k,900,800,1000,9,0.95\n"
    assert read(tmp_path, text + "soft,k,80,70,90,9,0.95\n").environments == ("soft", "hard")


def test_a_mass_is_a_reference(tmp_path):
    head = "subject,environment,k_ref,b_ref,m_ref,k_adj,b_adj\n"
    rows = [
        f"{s},{e},{k},1,{m},{k + s},{1 + s / 10}"
        for s in (1, 2, 3)
        for e, k, m in (("a", 90, 200), ("b", 50, ""))
    ]
    found = read(
        tmp_path, head + "\n".join(rows) + "\n", columns={"m_ref": {"name": "m_ref", "unit": "g"}}
    )
    assert found.masses == {"b": 0.0, "a": 0.2}
    error = refusal(tmp_path, head + "1,a,90,1,0.2,91,1\n2,a,90,1,0.3,91,1\n")
    assert (error.row, error.column, error.value) == (3, "m_ref", 0.3)
    error = refusal(tmp_path, head, columns={"m_ref": {"name": "m_ref", "unit": "N/m"}})
    assert "not a unit of mass." in str(error)


def test_a_mass_from_the_scene_reaches_the_curves(tmp_path):
    from percept.scene import Scene

    head = "subject,environment,k_ref,b_ref,k_adj,b_adj\n"
    text = head + "".join(f"{s},a,900,2,{900 + s},{2 + s / 10}\n" for s in (1, 2, 3, 4))
    device = {"mass": 1.0, "damping": 5.0, "period": 0.001}
    found = read(tmp_path, text, environments={"a": {"m_ref": 0.3}})
    study = Study(found, Scene(device=device, inference={"method": "classical"}))
    assert study.setup.references["a"].mass == 0.3
    omega = np.array([2.0, 30.0])
    heavy = Environment(900.0, 2.0, 0.3)
    felt = np.abs(perceived_impedance(Loop(Device(mass=1.0, damping=5.0), 0.001), omega, heavy))
    # A box as small as a point feels as its environment does, mass and all.
    labels = {
        "kind": "mean",
        "method": "classical",
        "family": "normal",
        "joint": "marginal",
        "level": 0.99,
    }
    point = Region(environment="a", limits=((900.0, 900.0), (2.0, 2.0)), **labels)
    for shape in ("corner", "envelope"):
        for curve in study.setup.outline(point, shape, omega):
            np.testing.assert_allclose(curve, felt, rtol=1e-13)
    assert found.environments == ("a",)
    assert "m_ref" in found.table


def test_repeats_without_numbers_are_one_problem(tmp_path):
    text = HEAD + "".join(
        f"{s},{e},{k},{k + r}\n"
        for s in (1, 2)
        for e, k in (("a", 10), ("b", 20))
        for r in range(9)
    )
    error = refusal(tmp_path, text)
    assert error.total == 1
    assert (error.file, error.row) == (str(tmp_path / "f.csv"), 3)
    assert error.message.startswith(
        "32 of 36 rows (88.9%) repeat a subject, session and environment, and no column "
    )
    assert '[sessions] trial = "order"' in error.hint
    assert 'keep = "last" would need a column of trials' in error.hint
    assert 'conditions of one subject, name their column: [study] factor = "…".' in error.hint


def test_many_duplicates_are_one_problem_and_few_are_named(tmp_path):
    head = HEAD.replace("\n", ",trial\n")
    few = refusal(tmp_path, head + "1,a,10,11,1\n2,a,10,11,1\n2,a,10,11,1\n")
    assert [p.row for p in few.problems] == [4]
    assert "subject '2', session '1', environment 'a', trial 1 is already in" in few.message
    many = refusal(tmp_path, head + "1,a,10,11,1\n" * 8 + "2,a,10,11,1\n")
    assert many.total == 1
    assert many.message.startswith("7 of 9 rows (77.8%) repeat a subject, session and trial.")
    assert 'keep = "last" would keep 2 rows' in many.hint


def test_what_the_last_event_leaves_out_is_counted(tmp_path):
    text = HEAD + "".join(f"{s},a,10,{10 + r}\n" for s in (1, 2) for r in range(25))
    found = read(tmp_path, text, sessions={"keep": "last"})
    (said,) = [str(notice) for notice in found.notices if "keep" in notice.text]
    assert (
        said
        == f'{tmp_path / "f.csv"}: keep = "last" leaves out 48 of 50 rows (96.0%) as earlier events'
        " of a trial; no column numbers the trials, so one row stays per subject and environment"
    )


def test_an_offset_moves_a_scale_whose_zero_is_arbitrary(tmp_path):
    columns = {c: {"name": c, "offset": 5} for c in ("k_ref", "k_adj")}
    found = read(tmp_path, HEAD + "1,a,-4,-3.5\n2,a,-4,-3\n", columns=columns)
    assert found.table["k_ref"].tolist() == [1.0, 1.0]
    assert found.table["k_adj"].tolist() == [1.5, 2.0]
    columns["k_adj"]["name"] = "r.k"
    rows = '1,a,-4,"{""k"": -3.5}"\n2,a,-4,"{""k"": -3}"\n'
    picked = read(tmp_path, HEAD.replace("k_adj", "r") + rows, columns=columns)
    assert picked.table["k_adj"].tolist() == [1.5, 2.0]


def test_one_file_in_another_unit_is_refused(tmp_path):
    for s in range(1, 6):
        factor = 1e-3 if s == 3 else 1.0
        rows = [f"{s},{e},{k},{(k + s) * factor}" for e, k in (("a", 900), ("b", 4000))]
        (tmp_path / f"s{s}.csv").write_text(HEAD + "\n".join(rows) + "\n")
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path)
    error = caught.value
    assert (error.file, error.row, error.column) == (str(tmp_path / "s3.csv"), 2, "k_adj")
    assert error.value == 0.903
    assert (
        "k_adj is 0.001 times k_ref at the median of this file, and 1 times over all files"
        in error.message
    )
    assert "declare the units" in error.hint
    told = {c: {"name": c, "unit": "N/m"} for c in ("k_ref", "k_adj")}
    found = read_sessions(tmp_path, columns=told)
    assert any("differ by a thousand" in notice.text for notice in found.notices)


@pytest.mark.parametrize("response", [None, "ratio"])
def test_settings_a_thousand_apart_are_read_where_the_scene_says_the_unit(tmp_path, response):
    # Subjects whose settings differ by e³ are rare, and real for a pure number.
    settings = {"a": 0.0009, "b": 0.8, "c": 1.0, "d": 1.3}
    rows = [f"{s},{e},1,{value}" for s, value in settings.items() for e in ("x", "y")]
    text = "subject,environment,g_ref,g_adj\n" + "\n".join(rows) + "\n"
    unit = {"response": response} if response else {"unit": ""}
    quantities = {"g": {"unit": ""}}
    error = refusal(tmp_path, text, quantities=quantities)
    assert error.hint.endswith('If the numbers are right, declare unit = "" for both.')
    columns = {"g_ref": {"name": "g_ref", "unit": ""}, "g_adj": {"name": "g_adj", **unit}}
    found = read(tmp_path, text, quantities=quantities, columns=columns)
    assert len(found.table) == 8
    assert any("differ by a thousand" in notice.text for notice in found.notices)


def test_unnamed_columns_are_named_by_their_position(tmp_path):
    text = '"","subject","environment","k_ref","k_adj"\n' + "".join(
        f'"{row}","1","a",10,1{row}\n' for row in (1, 2, 3)
    )
    found = read(tmp_path, text, columns={"trial": "column 1"})
    assert found.table["trial"].tolist() == [1, 2, 3]
    frame = pd.read_csv(tmp_path / "f.csv", dtype=str).rename(columns={"Unnamed: 0": ""})
    assert Sessions.from_frame(
        frame, scene=ReadOptions(columns={"trial": "column 1"})
    ).table["trial"].tolist() == [1, 2, 3]  # fmt: skip
    error = refusal(tmp_path, text)
    assert "no column numbers their trials" in error.message


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
    (tmp_path / "raw.edf").write_text("")
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


def test_a_file_that_was_named_is_asked_for(tmp_path):
    (folder(tmp_path) / "tracker.csv").write_text("time,x,y\n0.1,2,3\n")
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path / "s1_trials.csv", tmp_path / "tracker.csv")
    assert (caught.value.file, caught.value.row) == (str(tmp_path / "tracker.csv"), 1)
    (tmp_path / "s4_trials.csv").write_text(HEAD)
    found = read_sessions(tmp_path / "s1_trials.csv", tmp_path / "s4_trials.csv")
    assert len(found.sources) == 1


def test_files_of_a_folder_are_chosen_by_patterns(tmp_path):
    (folder(tmp_path) / "practice.csv").write_text(HEAD + "9,a,10,19\n")
    tables = {"include": ["*_trials.csv"], "exclude": ["s2*"]}
    options = ReadOptions.from_mapping({"sessions": {"files": tables}})
    found = read_sessions(tmp_path, scene=options)
    assert found.subjects == ("1", "3")
    # A file that is named is read, whatever the patterns say.
    assert read_sessions(tmp_path / "practice.csv", scene=options).subjects == ("9",)
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        for name in ("practice.csv", "s1_trials.csv"):
            archive.write(tmp_path / name, name)
    assert read_sessions(tmp_path / "all.zip", scene=options).subjects == ("1",)
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path, scene=ReadOptions(sessions={"files": {"include": ["*.dat"]}}))
    assert "no file in the folders fits include and exclude." in str(caught.value)


def test_the_line_of_a_wrong_quote_is_that_of_the_delimiter_meant(tmp_path):
    rows = ['"1";"a";10;"11,5"', '"2";"a";10;"12,5"', '"3";"a"x;10;"13,5"', '"4";"a";10;"14,5"']
    error = refusal(tmp_path, "subject;environment;k_ref;k_adj\n" + "\n".join(rows) + "\n")
    assert (error.row, error.file) == (4, str(tmp_path / "f.csv"))
    assert "a quoted cell is not closed, or text follows its closing quote." in str(error)


@pytest.mark.parametrize(
    ("name", "data", "what"),
    [
        ("study.rds", b"A\n3\n262657\n", "an R data file in ASCII"),
        ("study.hdf", b"\x89HDF\r\n", "another program's binary file"),
        ("study.sav", b"$FL2@(#) SPSS DATA FILE", "another program's binary file"),
    ],
    ids=["rds", "hdf", "sav"],
)
def test_files_of_other_programs_are_named_for_what_they_are(tmp_path, name, data, what):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path / name)
    assert caught.value.message == f"this is {what}."
    assert caught.value.hint
