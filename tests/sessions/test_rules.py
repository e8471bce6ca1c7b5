"""Each rule of the reader, with an input that trips it and the words it says."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions import ReadError, ReadOptions, Sessions, read_sessions
from percept.sessions.quantities import IMPEDANCE, convert, factor

HEAD = "subject,environment,k_ref,b_ref,trial,k_adj,b_adj\n"

IF_ONE = ": if they are one, write them alike in the files"


def read(tmp_path, text, tables=None, name="f.csv", **kwargs):
    file = tmp_path / name
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    options = None if tables is None else ReadOptions.from_mapping(tables)
    return read_sessions(file, scene=options, **kwargs)


def refusal(tmp_path, text, tables=None, **kwargs):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, text, tables, **kwargs)
    return caught.value


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("abc", "not a number"),
        ("1_000", "not a number"),
        ("0x10", "not a number"),
        ("١٢", "not a number"),
        ("−5", "not a number"),
        ("True", "not a number"),
        ("inf", "not a finite number"),
        ("1e400", "not between 1e-100 and 1e+100 in size"),
        ("1e-400", "not between 1e-100 and 1e+100 in size"),
        ("1e300", "not between 1e-100 and 1e+100 in size"),
        ("-1e-300", "not between 1e-100 and 1e+100 in size"),
        ('"1,286"', "can be read as 1.286 or as 1286"),
        ('"1,286.5"', "separators of thousands are not read"),
        ("1.286.000", "separators of thousands are not read"),
        ("1\u202f286", "separators of thousands are not read"),
        ("01. Mai", "a date, not a number"),
        ("2024-05-01", "a date, not a number"),
        ('"[0.36, 0.55]"', "a list or a record"),
    ],
)
def test_cells_that_are_no_numbers(tmp_path, cell, message):
    error = refusal(tmp_path, f"subject,environment,k_ref,k_adj\n1,a,2000,{cell}\n")
    assert message in str(error)
    assert (error.row, error.column, error.value) == (2, "k_adj", cell.strip('"'))
    assert error.hint


def test_a_blank_cell_hides_no_number_out_of_range(tmp_path):
    rows = [f"{row},a,10,1,1,11,1.5" for row in range(1, 80)]
    rows += ["80,a,10,1,1,11,", "81,a,10,1,1,1e-200,1.5"]
    error = refusal(tmp_path, HEAD + "\n".join(rows) + "\n")
    assert "not between 1e-100 and 1e+100 in size" in str(error)
    assert (error.row, error.column) == (82, "k_adj")


@pytest.mark.parametrize("cell", ["", "NaN", "nan", "NA", "null", "None", "-", " - "])
def test_missing_values_stay_missing_and_are_counted(tmp_path, cell):
    sessions = read(tmp_path, HEAD + f"1,a,10,1,1,11,{cell}\n2,a,10,1,1,{cell},1.5\n")
    assert sessions.table["b_adj"].isna().tolist() == [True, False]
    assert sessions.counts["rows without b"] == 1
    assert sessions.counts["rows without k"] == 1


def test_missing_words_are_names_in_id_columns(tmp_path):
    words = ["NA", "null", "None", "nan", "-", "NaN"]
    sessions = read(tmp_path, HEAD + "".join(f"{w},{w},10,1,1,11,1\n" for w in words))
    assert sessions.subjects == tuple(words)
    assert sessions.environments == tuple(words)


def test_one_decimal_mark_per_file(tmp_path):
    head = "subject;environment;k_ref;k_adj\n"
    # 0,435 has one reading, and it settles the file's mark for 1,286.
    sessions = read(tmp_path, head + "1;a;1,5;0,435\n2;a;1,5;1,286\n")
    assert sessions.table["k_adj"].tolist() == [0.435, 1.286]
    error = refusal(tmp_path, head + "1;a;1,5;0.435\n2;a;1,5;1,286\n")
    assert error.total == 1
    assert "a decimal point; the file is read with the decimal mark ','." in str(error)
    assert (error.row, error.column, error.value) == (2, "k_adj", "0.435")
    error = refusal(tmp_path, head + "1;a;2;1,286\n2;a;2;1,301\n")
    assert [p.row for p in error.problems] == [2, 3]
    assert 'decimal = ","' in str(error)
    sessions = read(tmp_path, head + "1;a;2;1,286\n", {"sessions": {"decimal": ","}})
    assert sessions.table["k_adj"].tolist() == [1.286]
    error = refusal(tmp_path, head + "1;a;2;1,286\n", {"sessions": {"decimal": "."}})
    assert (
        "can be read as 1.286 or as 1286; the file is read with the decimal mark '.'"
        in error.message
    )
    assert "thousands without a separator" in error.hint
    # A point with three digits behind it is not taken for a separator of thousands either.
    error = refusal(tmp_path, head + "1;a;2;951.541\n", {"sessions": {"decimal": ","}})
    assert "can be read as 951.541 or as 951541" in error.message


@pytest.mark.parametrize(
    ("cells", "blamed"),
    [
        # One cell among right ones, whose own readings are three-digit ones in part.
        ((".85", "951.541", "1,286", "8.5"), ["1,286"]),
        # Cells with one reading go before more numerous ones with two.
        (("1,286", "2,301", "0.5"), ["1,286", "2,301"]),
        (("12,5", "0,435", "1.286"), ["1.286"]),
        (("1,286", "2,301", "1.250"), ["1.250"]),
        (("1,286", "1.250"), ["1,286"]),
    ],
)
def test_cells_that_disagree_are_blamed_and_no_others(tmp_path, cells, blamed):
    rows = "".join(f"{i};a;2;{cell}\n" for i, cell in enumerate(cells))
    error = refusal(tmp_path, "subject;environment;k_ref;k_adj\n" + rows)
    assert [problem.value for problem in error.problems] == blamed
    for problem in error.problems:
        point, plain = (
            problem.value.replace(",", "."),
            problem.value.replace(",", "").replace(".", ""),
        )
        assert problem.message.startswith(f"can be read as {point} or as {plain}; the file is")


def test_points_between_semicolons_may_separate_thousands(tmp_path):
    head = "subject;environment;k_ref;k_adj\n"
    rows = "1;a;2.000;1.286\n2;a;2.000;1.301\n"
    error = refusal(tmp_path, head + rows)
    assert [(p.row, p.column) for p in error.problems] == [
        (row, column) for column in ("k_ref", "k_adj") for row in (2, 3)
    ]
    assert error.problems[2].message == "can be read as 1.286 or as 1286."
    assert error.hint == (
        'Declare [sessions] decimal = ".". If the point separates thousands, write them without it'
        ' and declare decimal = ",".'
    )
    declared = read(tmp_path, head + rows, {"sessions": {"decimal": "."}})
    assert declared.table["k_adj"].tolist() == [1.286, 1.301]
    # One number that is no thousand settles it, and so does a comma between cells.
    assert read(tmp_path, head + rows + "3;a;2;0.5\n").table["k_adj"].tolist()[0] == 1.286
    assert len(read(tmp_path, (head + rows).replace(";", ",")).table) == 2


@pytest.mark.parametrize("quote", ["", '"'])
def test_numbers_are_correctly_rounded(tmp_path, quote):
    """A file without quotes is read by another parser."""
    rng = np.random.default_rng(8)
    values = -(10.0 ** rng.uniform(-99, 99, 500))
    texts = [f"{value:.{n % 26}e}" for n, value in enumerate(values)]
    rows = [f"{quote}{n}{quote},a,10,{text}\n" for n, text in enumerate(texts)]
    sessions = read(tmp_path, "subject,environment,k_ref,k_adj\n" + "".join(rows))
    assert sessions.table["k_adj"].tolist() == [float(Fraction(text)) for text in texts]


def test_all_problems_of_a_file_are_reported_together(tmp_path):
    rows = "".join(f"{i},a,10,1,1,x{i},y\n" for i in range(8))
    error = refusal(tmp_path, HEAD + rows)
    assert isinstance(error, ReadError)
    assert len(error.problems) == error.total == 16
    assert str(error).startswith("16 problems:")
    assert "column 'k_adj', rows 5 to 9: 5 more of this kind" in str(error)
    assert str(error).endswith("percept validate lists them by kind")
    assert error.problems[0].row == 2


def test_ids_are_text_and_look_alikes_are_announced(tmp_path):
    sessions = read(
        tmp_path, HEAD + "".join(f"{s},a,10,1,1,11,1\n" for s in ("001", "1", "01", "s1", "S1"))
    )
    assert sessions.subjects == ("001", "1", "01", "s1", "S1")
    file = tmp_path / "f.csv"
    texts = [notice.text for notice in sessions.notices]
    assert (
        f"subjects '001' ({file}:2), '1' ({file}:3), '01' ({file}:4) look alike and are kept apart"
        + IF_ONE
        in texts
    )
    assert (
        f"subjects 's1' ({file}:5), 'S1' ({file}:6) look alike and are kept apart" + IF_ONE in texts
    )


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("Zo\u00eb", "Zoe\u0308"),
        ("Zoe\u0308", "Zo\u00eb"),
        ("Ann", " Ann"),
        ("Ann B", "Ann\u00a0 B"),
        ("Ann", "An\u200bn"),
        ("Ann", "Ann\u2060 "),
    ],
)
def test_spellings_of_one_name_are_one_subject(tmp_path, first, second):
    rows = [f"{first},a,10,1,1,11,1", f"{second},b,10,1,1,12,1", "Ben,a,10,1,1,13,1"]
    sessions = read(tmp_path, HEAD + "\n".join(rows) + "\n")
    assert sessions.subjects == (first, "Ben")
    (notice,) = (n for n in sessions.notices if "another spelling" in n.text)
    assert f"subject {first!r} is one name with another spelling in {tmp_path}/f.csv:3" in str(
        notice
    )
    # Where a rule or the scene spells it otherwise too.
    rule = {"exclude": [{"column": "subject", "equals": second}]}
    scene = Scene(sessions=rule, environments={"a\u200b": {"m_ref": 0.5}})
    left = read_sessions(tmp_path / "f.csv", scene=scene)
    assert left.subjects == ("Ben",)
    assert left.masses == {"a\u200b": 0.5}


def test_names_in_two_files_have_one_spelling(tmp_path):
    for name, subject, environment in (("1.csv", "Zo\u00eb", "a"), ("2.csv", "Zoe\u0308", "b")):
        (tmp_path / name).write_text(HEAD + f"{subject},{environment},10,1,1,11,1\n")
    assert read_sessions(tmp_path).subjects == ("Zo\u00eb",)


def test_numbers_and_letters_that_look_alike_are_said_with_their_rows(tmp_path):
    names = ("1", "1.0", "Sam", "S\u0430m", "nan")
    sessions = read(tmp_path, HEAD + "".join(f"{s},a,10,1,1,11,1\n" for s in names))
    assert sessions.subjects == names
    file = tmp_path / "f.csv"
    texts = [notice.text for notice in sessions.notices]
    assert (
        f"subjects '1' ({file}:2), '1.0' ({file}:3) look alike and are kept apart" + IF_ONE in texts
    )
    assert (
        f"subjects 'Sam' ({file}:4), 'S\\u0430m' ({file}:5) look alike and are kept apart" + IF_ONE
        in texts
    )
    assert f"subject 'nan' ({file}:6) is taken as a name: is it a missing value?" in texts


def test_problems_beyond_a_thousand_are_counted(tmp_path):
    error = refusal(tmp_path, HEAD + "".join(f"1,a,10,1,{t},x,1\n" for t in range(1499)))
    assert str(error).startswith("1499 problems:")
    assert (len(error.problems), error.total) == (1000, 1499)
    assert str(error).count("\n") == 5
    assert "column 'k_adj', rows 5 to 1001: 997 more of this kind" in str(error)


def test_identical_files_are_found(tmp_path):
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(HEAD + "1,a,10,1,1,11,1\n")
    with pytest.raises(UsageError, match=r"b\.csv: byte for byte the same file as .*a\.csv"):
        read_sessions(tmp_path)


def test_references_are_held_to_one_value(tmp_path):
    error = refusal(tmp_path, HEAD + "1,a,10,1,1,11,1\n2,a,10.5,1,1,11,1\n")
    assert "environment 'a' has the reference 10.0 in an earlier row" in str(error)
    assert (error.row, error.column, error.value) == (3, "k_ref", 10.5)
    scene = {"environments": {"a": {"k_ref": 10, "b_ref": 1}}}
    sessions = read(tmp_path, "subject,environment,k_adj,b_adj\n1,a,11,1\n", scene)
    assert sessions.table[["k_ref", "b_ref"]].to_numpy().tolist() == [[10.0, 1.0]]
    error = refusal(tmp_path, HEAD + "1,a,11,1,1,11,1\n", scene)
    assert "has the reference 10.0 in the scene" in str(error)
    error = refusal(tmp_path, "subject,environment,k_adj,b_adj\n1,z,11,1\n", scene)
    assert "environment 'z' has no reference" in str(error)


def test_units_are_declared_converted_and_checked(tmp_path):
    rows = "subject,environment,k_ref,k_adj\n1,a,1000,1.1\n2,a,1000,0.9\n"
    error = refusal(tmp_path, rows)
    assert "k_adj is 0.000995 times k_ref at the median" in str(error)
    assert "unit" in error.hint
    sessions = read(tmp_path, rows, {"columns": {"k_adj": {"name": "k_adj", "unit": "N/mm"}}})
    assert sessions.table["k_adj"].tolist() == [1100.0, 900.0]
    assert error.hint.endswith('If the numbers are right, declare unit = "N/m" for both.')
    both = {column: {"name": column, "unit": "N/m"} for column in ("k_adj", "k_ref")}
    sessions = read(tmp_path, rows, {"columns": both})
    assert any("their units seem to differ" in notice.text for notice in sessions.notices)
    with pytest.raises(UsageError) as caught:
        ReadOptions.from_mapping({"columns": {"b_ref": {"name": "b", "unit": "N/m"}}})
    assert str(caught.value).startswith("columns.b_ref.unit = 'N/m': not a unit of damping.")
    for unit in ("kg", "furlong", "10**10**10", "N/m; import os", ""):
        with pytest.raises(UsageError, match="not a unit of stiffness"):
            factor(unit, IMPEDANCE["k"])


@pytest.mark.parametrize(
    ("adjusted", "reference", "declared", "ratio", "hint"),
    [
        (1.2, 1000, {}, "0.0012", 'in [columns], such as k_adj = { name = "…", unit = "N/mm" }'),
        (1200, 1, {}, "1.2e+03", 'in [columns], such as k_ref = { name = "…", unit = "N/mm" }'),
        (1200, 1000, {"k_ref": "N/mm"}, "0.0012", "declare the units of both k_adj and k_ref"),
        (1200, 1000, {"k_adj": "N/mm"}, "1.2e+03", "declare the units of both k_adj and k_ref"),
        (1.2, 1000, {"k_adj": "N/m"}, "0.0012", "declare the units of both k_adj and k_ref"),
        (1200, 1, {"k_adj": "N/m"}, "1.2e+03", "declare the units of both k_adj and k_ref"),
        (99, 1, {}, None, None),
        (1, 99, {}, None, None),
        (30, 1, {"k_adj": "N/m"}, None, None),
    ],
)
def test_a_slip_of_units_is_refused_in_both_directions(
    tmp_path, adjusted, reference, declared, ratio, hint
):
    """Environments of reference zero have no ratio, and do not count."""
    rows = "subject,environment,k_ref,k_adj\n" + "".join(
        f"{s},{e},{scale * reference},{scale * adjusted * factor}\n"
        for s, factor in ((1, 0.5), (2, 1), (3, 2))
        for e, scale in (("a", 1), ("b", 10), ("zero", 0))
    ).replace("zero,0,0.0", "zero,0,3").replace("zero,0,0", "zero,0,3")
    tables = {
        "columns": {column: {"name": column, "unit": unit} for column, unit in declared.items()}
    }
    if ratio is None:
        assert len(read(tmp_path, rows, tables).table) == 9
        return
    error = refusal(tmp_path, rows, tables)
    assert f"k_adj is {ratio} times k_ref at the median: their units seem to differ." in str(error)
    assert (error.file, error.column) == (str(tmp_path / "f.csv"), "k_adj")
    assert hint in error.hint


def test_references_of_the_scene_have_their_unit(tmp_path):
    """One declared unit settles the column of adjustments; the file has no other to declare."""
    rows = "subject,environment,k_adj\n1,a,1.1\n2,a,0.9\n"
    scene = {"environments": {"a": {"k_ref": 1000.0}}}
    assert "k_adj is 0.000995 times k_ref" in str(refusal(tmp_path, rows, scene))
    sessions = read(
        tmp_path, rows, scene | {"columns": {"k_adj": {"name": "k_adj", "unit": "N/m"}}}
    )
    assert any("their units seem to differ" in notice.text for notice in sessions.notices)


@pytest.mark.parametrize(
    ("unit", "parameter", "scale"),
    [
        ("N/mm", "k", 1000),
        ("kN/m", "k", 1000),
        ("mN/mm", "k", 1),
        ("mN/m", "k", Fraction(1, 1000)),
        ("N·s/mm", "b", 1000),
        ("Ns/cm", "b", 100),
    ],
)
def test_conversions_round_once(unit, parameter, scale):
    values = np.random.default_rng(3).lognormal(size=200)
    want = [float(Fraction(v) * scale) for v in values.tolist()]
    assert convert(values, unit, IMPEDANCE[parameter]).tolist() == want


def test_trials_of_several_sessions_are_announced_as_repeats(tmp_path):
    header = "subject,session,environment,trial,k_ref,k_adj\n"
    rows = [
        "1,1,a,1,10,11",
        "1,2,a,1,10,12",
        "2,1,a,1,10,9",
        "2,1,a,2,10,9.5",
        "3,1,a,1,10,9",
        "3,2,b,1,20,9",
    ]
    announced = [
        n.text
        for n in read(tmp_path, header + "\n".join(rows) + "\n").notices
        if "sessions" in n.text
    ]
    (text,) = announced
    assert text.startswith(
        "1 of 4 cells (a subject in an environment) have trials of several sessions."
    )
    apart = read(tmp_path, header + "\n".join(rows[2:]) + "\n")
    assert not any("several sessions" in notice.text for notice in apart.notices)


def test_columns_are_found_announced_or_asked_for(tmp_path):
    sessions = read(tmp_path, "Participant,Env,Stiffness Ref,k_final,color\n7,a,10,11,red\n")
    texts = [notice.text for notice in sessions.notices]
    assert "column 'Participant' is taken as subject" in texts
    assert "columns not used: 'color'" in texts
    error = refusal(tmp_path, "participant,subj,environment,k_ref,k_adj\n7,8,a,10,11\n")
    assert "'participant', 'subj' could each be subject" in str(error)
    error = refusal(tmp_path, "who,environment,k_ref,k_adj\n7,a,10,11\n")
    assert "no column for subject; the columns are 'who', 'environment'" in str(error)
    error = refusal(tmp_path, "subject,environment,k_ref,k_adj,b_ref\n7,a,10,11,1\n")
    assert "no column for b_adj" in str(error)
    error = refusal(tmp_path, "subject,environment,k_ref,k_adj,k_adj\n7,a,10,11,1\n")
    assert "two columns have the name" in str(error)
    error = refusal(
        tmp_path, "subject,environment,k_ref,k_last\n7,a,1,2\n", columns={"k_adj": "k_lst"}
    )
    assert "no column has that name" in str(error)
    assert "Did you mean k_last?" in error.hint


def test_wide_tables_by_a_pattern_of_their_names(tmp_path):
    wide = {"columns": {c: c + "_{environment}" for c in ("k_adj", "k_ref")}}
    sessions = read(
        tmp_path, "subject,k_ref_A,k_adj_A,k_ref_B,k_adj_B\n1,10,11,20,21\n2,10,9,20,\n", wide
    )
    assert sessions.table[["environment", "k_ref", "k_adj"]].to_numpy().tolist() == [
        ["A", 10.0, 11.0],
        ["B", 20.0, 21.0],
        ["A", 10.0, 9.0],
    ]
    wide = {"columns": {c: c + "_{environment}_{trial}" for c in ("k_adj", "k_ref")}}
    assert "no column fits the pattern" in str(refusal(tmp_path, "subject,k_adj_A\n1,2\n", wide))


def test_subjects_in_columns_are_melted(tmp_path):
    text = "wall,note,target,p1,p2,p3\nsoft,x,10,11,9,\nhard,x,20,21,19,22\n"
    tables = {
        "columns": {"environment": "wall", "k_ref": "target"},
        "sessions": {"layout": "subjects in columns", "groups": ["note"]},
    }
    sessions = read(tmp_path, text, tables)
    columns = ["subject", "environment", "k_ref", "k_adj", "note"]
    assert sessions.table[columns].to_numpy().tolist() == [
        ["p1", "soft", 10.0, 11.0, "x"],
        ["p2", "soft", 10.0, 9.0, "x"],
        ["p1", "hard", 20.0, 21.0, "x"],
        ["p2", "hard", 20.0, 19.0, "x"],
        ["p3", "hard", 20.0, 22.0, "x"],
    ]
    # Without a column of environments the references name them; a pattern picks the subjects.
    columns = {"k_ref": "target", "k_adj": "p{subject}"}
    sessions = read(tmp_path, text.replace("wall", "who"), {"columns": columns})
    assert sessions.subjects == ("1", "2", "3")
    assert sessions.environments == ("10", "20")
    error = refusal(tmp_path, text, {"columns": {"k_ref": "target", "k_adj": "q{subject}"}})
    assert "no column fits the pattern in [columns]." in str(error)


def test_a_bare_environment_takes_the_environments_the_scene_names(tmp_path):
    tables = {
        "columns": {"subject": "ID", "k_adj": "{environment}"},
        "environments": {"soft": {"k_ref": 10.0}, "hard": {"k_ref": 90.0}},
    }
    sessions = read(tmp_path, "ID,age,soft,hard\n1,33,11,88\n2,44,9,91\n", tables)
    assert sessions.table[["subject", "environment", "k_adj"]].to_numpy().tolist() == [
        ["1", "soft", 11.0],
        ["1", "hard", 88.0],
        ["2", "soft", 9.0],
        ["2", "hard", 91.0],
    ]
    assert "columns not used: 'age'" in [notice.text for notice in sessions.notices]
    error = refusal(tmp_path, "ID,age,firm\n1,33,11\n", tables)
    assert "no column fits the pattern" in str(error)


def test_files_merge_by_column_name(tmp_path):
    (tmp_path / "a.csv").write_text("subject,environment,k_ref,k_adj\n1,a,10,11\n")
    (tmp_path / "b.csv").write_text("k_adj,environment,subject,k_ref,group\n12,a,2,10,left\n")
    sessions = read_sessions(tmp_path)
    assert sessions.table["k_adj"].tolist() == [11.0, 12.0]
    assert sessions.table["group"].tolist() == ["", "left"]
    assert sessions.parameters == ("k",)
    assert sessions.locate(1) == (str(tmp_path / "b.csv"), 2)


def test_ids_from_file_names(tmp_path):
    text = "environment,k_ref,k_adj\na,10,11\n"
    tables = {"sessions": {"filename": "s{subject}_v{session}"}}
    table = read(tmp_path, text, tables, name="s007_v02.csv").table
    assert table[["subject", "session"]].to_numpy().tolist() == [["007", "02"]]
    assert read(tmp_path, text, tables, name="s!7_v1.csv").subjects == ("!7",)
    both = read(tmp_path, "subject," + text.replace("a,", "x,a,"), tables, name="s8_v1.csv")
    assert both.subjects == ("8",)
    assert "subject is taken from the file's name; column 'subject' is not used" in [
        n.text for n in both.notices
    ]
    assert "does not fit the pattern" in str(refusal(tmp_path, text, tables, name="x007.csv"))
    error = refusal(
        tmp_path, text, {"sessions": {"filename": "{subject}_{session}"}}, name="a_b_c.csv"
    )
    assert "in more than one way" in str(error)


def test_paths_into_cells(tmp_path):
    head = "subject,environment,k_ref,value\n"
    path = {"columns": {"k_adj": {"name": "value", "path": "s.-1"}}}
    rows = '1,a,10,"{""s"": [1, 1.25e1]}"\n2,a,10,"{""s"": [np.float64(9.5)]}"\n'
    assert read(tmp_path, head + rows, path).table["k_adj"].tolist() == [12.5, 9.5]
    dotted = {"columns": {"k_adj": "value.s.0"}}
    assert read(tmp_path, head + '1,a,10,"{""s"": [8]}"\n', dotted).table["k_adj"].tolist() == [8.0]
    for cell, message in (
        ('"{""s"": 1, ""s"": 2}"', "has a key twice"),
        ('"{""s"": []}"', "there is no '-1' in it"),
        ('"{""s"": [true]}"', "leads to a record, a list or true/false"),
        ("__import__('os')", "not a JSON record or list"),
        ('"' + "[" * 100_000 + '"', "not a JSON record or list"),
    ):
        assert message in str(refusal(tmp_path, head + f"1,a,10,{cell}\n", path))


def test_no_row_is_left_of_which_a_value_is_picked(tmp_path):
    tables = {"columns": {"k_adj": "value.s"}, "sessions": {"only": {"subject": "2"}}}
    text = 'subject,environment,k_ref,value\n1,a,10,"{""s"": 1}"\n'
    assert "no row has an adjustment." in str(refusal(tmp_path, text, tables))


@pytest.mark.parametrize("row", ['2,a,10,\\"', '"2 \\"x",a,10,\\"', '2,a,10,1"1'])
def test_a_quote_outside_quotes_is_no_blank(tmp_path, row):
    error = refusal(tmp_path, f"subject,environment,k_ref,k_adj\n1,a,10,11\n{row}\n")
    assert (error.row, error.column, error.message) == (3, "k_adj", "not a number.")


def test_a_path_that_no_row_has_names_the_keys_there_are(tmp_path):
    head = "subject,environment,k_ref,b_ref,response\n"
    rows = '1,a,10,1,"{""k"": 11, ""b"": 2}"\n2,a,10,1,\n3,a,10,1,"{""k"": 9, ""rt"": null}"\n'
    tables = {
        "columns": {
            "k_adj": {"name": "response", "path": "response.k"},
            "b_adj": {"name": "response", "path": "b"},
        }
    }
    error = refusal(tmp_path, head + rows, tables)
    assert error.total == 1
    assert error.message == "no row has this path."
    assert 'it begins inside a cell such as \'{"k": 11, "b": 2}\'' in error.hint
    assert (error.column, error.key, error.value) == (
        "response",
        "columns.k_adj.path",
        "response.k",
    )
    assert error.file.endswith("f.csv")
    tables["columns"]["k_adj"]["path"] = "k"
    # Record 3 has no b, which record 1 has.
    sessions = read(tmp_path, head + rows, tables)
    assert sessions.table[["k_adj", "b_adj"]].fillna(-1).to_numpy().tolist() == [
        [11.0, 2.0],
        [9.0, -1.0],
    ]
    # A key whose every value is null is there.
    tables["columns"]["b_adj"]["path"] = "rt"
    only = {"sessions": {"only": {"subject": "3"}}}
    assert read(tmp_path, head + rows, tables | only).counts["rows without b"] == 1
    tables["columns"]["k_adj"]["path"] = "x.k"
    error = refusal(tmp_path, head + "1,a,10,1,{}\n", tables)
    assert [p.key for p in error.problems] == ["columns.k_adj.path", "columns.b_adj.path"]


def test_limits_judge_the_last_event_and_texts_every_event(tmp_path):
    text = (
        "subject,environment,k_ref,trial,k_adj,phase,rt\n"
        "1,a,10,1,8,test,1\n2,a,10,1,9,test,70\n1,a,10,1,50,test,2\n"
        "2,a,10,1,11,test,3\n2,a,10,1,12,replay,4\n3,a,10,1,13,test,5\n3,a,10,1,,test,90\n"
    )
    tables = {
        "sessions": {
            "keep": "last",
            "exclude": [
                {"column": "phase", "equals": "replay", "why": "replayed"},
                {"column": "k_adj", "above": 40, "why": "slipped"},
                {"column": "rt", "above": 60},
            ],
        }
    }
    sessions = read(tmp_path, text, tables)
    assert sessions.table[["subject", "k_adj"]].to_numpy().tolist() == [["2", 11.0], ["3", 13.0]]
    assert [(e.who, e.why, e.row) for e in sessions.exclusions] == [
        ("2", "replayed", 6),
        ("3", "no adjustment", 8),
        ("1", "slipped", 4),
    ]
    assert sessions.counts["earlier event of a trial"] == 2
    assert sessions.counts["excluded: slipped"] == 1


def test_events_reduce_only_when_declared(tmp_path):
    rows = "1,a,10,1,1,5,\n1,a,10,1,1,9,2\n1,a,10,1,1,11,\n1,a,10,1,2,8,3\n"
    assert "is already" in str(refusal(tmp_path, HEAD + rows))
    sessions = read(tmp_path, HEAD + rows, {"sessions": {"keep": "last"}})
    assert sessions.table[["k_adj", "b_adj"]].to_numpy().tolist() == [[11.0, 2.0], [8.0, 3.0]]
    assert sessions.counts["earlier event of a trial"] == 2
    assert [sessions.locate(i)[1] for i in (0, 1)] == [4, 5]


def test_exclusions_are_declared_logged_and_counted(tmp_path):
    text = (
        "subject,environment,k_ref,trial,k_adj,practice,rt\n"
        "1,a,10,0,11,yes,1\n1,a,10,1,12,no,2\n1,b,20,1,21,no,99\n2,a,10,1,1,no,3\n2,a,10,2,9,no,3\n3,a,10,1,,no,3\n"
        "3,b,20,1,19,no,3\n"
    )
    tables = {
        "sessions": {
            "exclude": [
                {"column": "practice", "equals": "yes", "why": "practice trials"},
                {"column": "rt", "above": 60},
                {"column": "k_adj", "below": 5, "why": "slipped"},
            ]
        }
    }
    sessions = read(tmp_path, text, tables)
    assert sessions.table["k_adj"].tolist() == [12.0, 9.0, 19.0]
    logged = [(e.who, e.what, e.why, e.row) for e in sessions.exclusions]
    assert logged == [
        ("1", "environment a, trial 0", "practice trials", 2),
        ("3", "environment a, trial 1", "no adjustment", 7),
        ("1", "environment b, trial 1", "rt is above 60", 4),
        ("2", "environment a, trial 1", "slipped", 5),
    ]
    assert sessions.counts["excluded: slipped"] == 1
    assert sessions.counts["empty cells (subject × environment)"] == 3
    total = sum(n for why, n in sessions.counts.items() if why.startswith("excluded"))
    assert sessions.counts["rows read"] == sessions.counts["observations"] + total


def test_limits_of_a_rule_are_themselves_kept(tmp_path):
    text = HEAD + "A,V,10,1,1,5,1\nB,V,10,1,1,20,1\nC,V,10,1,1,4.9,1\nD,V,10,1,1,20.1,1\n"
    rule = {"column": "k_adj", "below": 5, "above": 20, "why": "slipped"}
    sessions = read(tmp_path, text, {"sessions": {"exclude": [rule]}})
    assert sessions.subjects == ("A", "B")
    assert [entry.who for entry in sessions.exclusions] == ["C", "D"]


def test_exclusions_of_all_files_are_logged(tmp_path):
    for name in "AB":
        (tmp_path / f"{name}.csv").write_text(HEAD + f"{name},V,10,1,1,9,1\n{name},V,10,1,2,1,1\n")
    options = ReadOptions.from_mapping({"sessions": {"exclude": [{"column": "k_adj", "below": 5}]}})
    sessions = read_sessions(tmp_path / "A.csv", tmp_path / "B.csv", scene=options)
    assert [(entry.who, entry.row) for entry in sessions.exclusions] == [("A", 3), ("B", 3)]


def test_repeats_are_missing_where_there_are_some_and_cells_empty_where_there_are_none(tmp_path):
    """Twice each in V; in W one subject once, and the other never."""
    rows = [f"{s},V,10,1,{t},11,1\n" for s in "AB" for t in (1, 2)]
    sessions = read(tmp_path, HEAD + "".join([*rows, "A,W,20,2,1,21,2\n"]))
    assert sessions.counts["missing repeats"] == 1
    assert sessions.counts["empty cells (subject × environment)"] == 1


@pytest.mark.parametrize(
    ("sessions", "message"),
    [
        (
            {"exclude": [{"column": "session", "equals": "3"}]},
            "column 'session': there is no column 'session'.",
        ),
        (
            {"exclude": [{"column": "subject", "equals": "S9"}]},
            "column 'subject', sessions.exclude: no row has 'S9' in this column. Correct the text,"
            " or take the rule out.",
        ),
        ({"exclude": [{"column": "subject", "above": 3}]}, "limits need a column of numbers"),
        ({"exclude": [{"column": "rt", "above": 3}]}, "there is no column 'rt'."),
        ({"groups": "hand"}, "there is no column 'hand'."),
        ({"only": {"task": "match"}}, "there is no column 'task'."),
        (
            {"only": {"subject": "2"}},
            "no row has an adjustment. Rows: 1 rows read, 1 subject is not 2",
        ),
        ({"encoding": "klingon"}, "unknown encoding"),
        ({"encoding": "ascii"}, "is not text in ascii"),
    ],
)
def test_rules_that_do_not_fit_the_file(tmp_path, sessions, message):
    text = "subject,environment,k_ref,k_adj\n1,é,10,11\n"
    assert message in str(refusal(tmp_path, text, {"sessions": sessions}))


def test_rows_without_ids_are_problems(tmp_path):
    error = refusal(tmp_path, HEAD + ",a,10,1,1,11,1\n1, ,10,1,,11,1\n1,b,10,1,1.5,11,1\n")
    assert [(p.row, p.message) for p in error.problems] == [
        (2, "an adjustment has no subject."),
        (3, "an adjustment has no environment."),
        (3, "an adjustment has no trial."),
        (4, "a trial number must be whole."),
    ]


SUMMARY = "environment,parameter,reference,lower,upper,n,level\n"


def test_a_published_summary(tmp_path):
    sessions = read(tmp_path, SUMMARY + "VE1,k,10,11,19,10,0.99\nVE1,b,1,0.5,0.8,10,0.99\n")
    assert sessions.form == "summary"
    assert sessions.parameters == ("k", "b")
    assert sessions.subjects == ()
    assert sessions.table.to_numpy().tolist()[0] == ["VE1", "k", 10.0, 11.0, 19.0, 10, 0.99]


@pytest.mark.parametrize(
    ("row", "column", "message"),
    [
        ("VE1,stiffness,10,11,19,10,0.99", "parameter", 'must be "k" or "b"'),
        ("VE1,k,10,19,11,10,0.99", "upper", "is below the lower limit"),
        ("VE1,k,10,11,19,1,0.99", "n", "a whole number of at least 2"),
        ("VE1,k,10,11,19,2.5,0.99", "n", "a whole number of at least 2"),
        ("VE1,k,10,11,19,10,99", "level", "value 99.0: must lie between 0 and 1"),
        ("VE1,k,10,11,19,10,99%", "level", "a percentage, not a number. Write it as a fraction"),
        ("VE1,k,10,11,19,ten,0.99", "n", "not a number. Correct the cell."),
        ("VE1,k,10,,19,10,0.99", "lower", "has no empty cells"),
        (" ,k,10,11,19,10,0.99", "environment", "is empty"),
        ("VE1,k,10,11,19,10,0.99\nVE1,k,10,11,19,10,0.99", "environment", "a second row"),
    ],
)
def test_a_summary_that_cannot_be(tmp_path, row, column, message):
    error = refusal(tmp_path, SUMMARY + row + "\n")
    assert message in str(error)
    assert str(error).count("adjustment") == 0
    assert error.column == column


def test_published_means_become_the_limits_of_their_interval(tmp_path):
    import mpmath

    head = "environment,parameter,reference,mean,sd,n,level\n"
    table = read(
        tmp_path, head + "VE1,k,15,14.914,3.9954,10,0.99\nVE1,b,0.7,0.68455,0.63147,10,0.99\n"
    ).table
    with mpmath.workdps(30):
        # P(|t| > q) for nine degrees of freedom is a regularised incomplete beta function.
        beta = lambda q: mpmath.betainc(4.5, 0.5, 0, 9 / (9 + q**2), regularized=True)  # noqa: E731
        t = mpmath.findroot(lambda q: beta(q) - mpmath.mpf("0.01"), 3.25)
        for row, (mean, sd) in zip(
            table.to_dict("records"), (("14.914", "3.9954"), ("0.68455", "0.63147")), strict=True
        ):
            half = t * mpmath.mpf(sd) / mpmath.sqrt(10)
            assert row["lower"] == pytest.approx(float(mpmath.mpf(mean) - half), rel=1e-13)
            assert row["upper"] == pytest.approx(float(mpmath.mpf(mean) + half), rel=1e-13)
    bare = read(tmp_path, head.replace(",level", "") + "VE1,k,15,14.914,3.9954,10\n")
    (row,) = bare.table.to_dict("records")
    assert any("without a level are kept as their limits at 0.95" in n.text for n in bare.notices)
    # t(.975; 9) = 2.262157, from any table.
    assert row["level"] == 0.95
    assert row["upper"] - row["lower"] == pytest.approx(
        2 * 2.262157 * 3.9954 / math.sqrt(10), rel=2e-7
    )
    assert row["upper"] + row["lower"] == pytest.approx(2 * 14.914, rel=1e-13)
    error = refusal(tmp_path, head + "VE1,k,15,14.9,-1,10,0.99\n")
    assert (error.column, error.message) == ("sd", "a standard deviation is not negative.")


def test_limits_go_before_a_mean_and_sd(tmp_path):
    head = "environment,parameter,reference,mean,sd,lower,upper,n,level\n"
    found = read(
        tmp_path, head + "VE1,k,15,14.914,3.9954,10.8,19.0,10,0.99\nVE1,b,0.7,,,0.5,0.8,10,0.99\n"
    )
    assert found.table[["lower", "upper"]].to_numpy().tolist() == [[10.8, 19.0], [0.5, 0.8]]
    assert "mean and sd are not used: lower and upper are there" in [
        notice.text for notice in found.notices
    ]
    error = refusal(tmp_path, head.replace(",level", "") + "VE1,k,15,15,4,11,19,10\n")
    assert "a published table needs the column level" in error.message


def test_limits_far_from_every_reference_are_in_another_unit(tmp_path):
    rows = "VE1,b,1,0.5,0.8,10,0.99\nVE1,k,5000,4.1,6.2,12,0.95\n"
    error = refusal(tmp_path, SUMMARY + rows)
    assert "limits of k are typically 0.00124 times the reference" in error.message
    assert (error.total, error.row, error.column, error.value) == (1, 3, "reference", 5000.0)
    assert error.hint == "Write references and limits in N/m."
    error = refusal(tmp_path, SUMMARY + "VE1,b,0.01,6,9,12,0.95\n")
    assert "in N·s/m" in error.hint
    # Limits around the reference are no sign of a unit, however far their middle is from it.
    assert (
        len(read(tmp_path, SUMMARY + "VE1,b,1,-1,1.001,3,0.99\nVE1,k,1,-50,450,2,0.99\n").table)
        == 2
    )


def test_trials_and_summary_do_not_mix(tmp_path):
    (tmp_path / "a.csv").write_text(HEAD + "1,a,10,1,1,11,1\n")
    (tmp_path / "b.csv").write_text(SUMMARY + "VE1,k,10,11,19,10,0.99\n")
    with pytest.raises(UsageError, match="trials and a published summary"):
        read_sessions(tmp_path)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            {"sessions": {"decimals": ","}},
            "sessions.decimals = ',': there is no such key; there are decimal,",
        ),
        ({"sessions": {"decimal": ";"}}, "sessions.decimal = ';': must be '.' or ','."),
        (
            {"sessions": {"delimiter": '"'}},
            "sessions.delimiter = '\"': must be one character, not a quote.",
        ),
        ({"sessions": {"keep": "first"}}, "sessions.keep = 'first': must be 'last'."),
        (
            {"sessions": {"filename": "subject"}},
            "sessions.filename = 'subject': must name {subject}",
        ),
        (
            {"sessions": {"groups": 1.5}},
            "sessions.groups = 1.5: must be a text or a list of texts.",
        ),
        ({"sessions": {"groups": [True]}}, "sessions.groups.0 = True: must be text."),
        ({"sessions": {"only": "x"}}, "sessions.only = 'x': must be a table."),
        ({"sessions": {"sheet": 3}}, "sessions.sheet = 3: must be text."),
        ({"sessions": {"exclude": {}}}, "sessions.exclude: must be a list."),
        (
            {"sessions": {"exclude": [{"column": "x"}]}},
            "sessions.exclude.0: a rule has column, why, and either",
        ),
        (
            {"sessions": {"exclude": [{"column": "x", "above": "3"}]}},
            "sessions.exclude.0.above = '3': must be a number.",
        ),
        (
            {"columns": {"k": "x"}},
            "columns.k: there is no such key; there are subject, session, environment,",
        ),
        ({"columns": {"k_adj": {"unit": "N/m"}}}, "columns.k_adj.name: is missing."),
        (
            {"columns": {"k_adj": {"nme": "x"}}},
            (
                "columns.k_adj.nme = 'x': there is no such key; there are name, unit, path, also,"
                " offset, scale, response. Did you mean name?"
            ),
        ),
        (
            {"columns": {"k_ajd": "x"}},
            "columns.k_ajd: there is no such key; there are subject, session,",
        ),
        (
            {"columns": {"k_adj": 3}},
            (
                "columns.k_adj = 3: a column is a name, a list of names, or a table of name, unit"
                " and path."
            ),
        ),
        ({"columns": {"k_adj": "{trial}{trial}"}}, "columns.k_adj: names an id twice."),
        ({"columns": {"k_adj": ""}}, "columns.k_adj.name = '': must not be empty."),
        (
            {"environments": {"a": {"k_ref": "3"}}},
            "environments.a.k_ref = '3': must be a number.",
        ),
        (
            {"environments": {"a": {"k_ref": math.inf}}},
            "environments.a.k_ref = inf: must be a finite number",
        ),
        ({"environments": []}, "environments = []: must be a table."),
    ],
)
def test_options_are_checked(tables, message):
    with pytest.raises(UsageError) as caught:
        ReadOptions.from_mapping(tables)
    assert str(caught.value).startswith(message)


def test_options_given_as_keywords_are_checked_too():
    with pytest.raises(UsageError, match=r"sessions\.keep = 'first': must be 'last'"):
        ReadOptions(sessions={"keep": "first"})
    with pytest.raises(UsageError, match=r"columns\.k: there is no such key"):
        read_sessions("f.csv", columns={"k": "x"})


def test_a_frame_passes_the_same_checks():
    frame = pd.DataFrame(
        {"subject": [1, 2], "environment": ["a", "a"], "k_ref": [10.0, 10.0], "k_adj": [11, np.nan]}
    )
    sessions = Sessions.from_frame(frame)
    assert sessions.subjects == ("1",)
    assert sessions.exclusions[0].row == 3
    with pytest.raises(UsageError, match=r"<frame>:3, column 'k_adj', value 'x': not a number"):
        Sessions.from_frame(frame.assign(k_adj=[11, "x"]))


def test_rows_of_a_frame_are_known_by_their_place_though_blank_ones_are_left_out():
    frame = pd.DataFrame(
        {
            "subject": ["A", "", "B"],
            "environment": ["V", "", "V"],
            "k_ref": [10.0, np.nan, 10.0],
            "k_adj": [9.0, np.nan, 11.0],
        }
    )
    sessions = Sessions.from_frame(frame)
    assert [sessions.locate(i)[1] for i in (0, 1)] == [2, 4]


def test_paths_that_lead_nowhere(tmp_path):
    for path, message in (
        (tmp_path / "no.csv", "there is no such file"),
        (tmp_path, "the folder holds no table"),
        (tmp_path / "*.csv", "no file fits the pattern"),
    ):
        with pytest.raises(UsageError, match=message):
            read_sessions(path)
    with pytest.raises(UsageError, match="no file was given"):
        read_sessions()


def test_an_environment_that_no_row_names_is_noticed(tmp_path):
    (tmp_path / "t.csv").write_text("subject,environment,k_adj\nS01,A,11\nS02,A,12\n")
    options = ReadOptions.from_mapping(
        {"environments": {"A": {"k_ref": 10.0}, "B": {"k_ref": 20.0}}}
    )
    notices = [str(notice) for notice in read_sessions(tmp_path / "t.csv", scene=options).notices]
    assert "B: [environments] names it, but no row has it" in notices
    assert not any(notice.startswith("A:") for notice in notices)
