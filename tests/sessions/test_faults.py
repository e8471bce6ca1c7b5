"""Faults found in public files: each is named, with its place and the line that mends it."""

from __future__ import annotations

import tomllib

import openpyxl
import pytest

from percept import Scene
from percept.cli import main
from percept.errors import UsageError
from percept.sessions import read_sessions

HEAD = "subject,environment,trial,k_ref,k_adj"
WALLS = {"soft": 500, "hard": 2000}


def rows(subjects=6, trials=2):
    """Cells of a study without a fault."""
    return [
        [f"P{s}", wall, t, reference, round(reference * (0.8 + 0.05 * s + 0.013 * t), 1)]
        for s in range(1, subjects + 1)
        for wall, reference in WALLS.items()
        for t in range(1, trials + 1)
    ]


def lines(**changed):
    """Lines of CSV; `at_7="…"` replaces the physical line 7."""
    text = [HEAD, *(",".join(map(str, row)) for row in rows())]
    for line, cells in changed.items():
        text[int(line.removeprefix("at_")) - 1] = cells
    return text


def csv_file(tmp_path, text):
    path = tmp_path / "walls.csv"
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    return path


def workbook(tmp_path, **sheets):
    """A workbook; each sheet is a list of rows."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, cells in sheets.items():
        page = book.create_sheet(name)
        for row in cells:
            page.append(row)
    path = tmp_path / "walls.xlsx"
    book.save(path)
    return path


def refusal(path, **tables):
    with pytest.raises(UsageError) as caught:
        read_sessions(path, scene=Scene(**tables))
    assert caught.value.file.startswith(str(path))
    return caught.value


#: Lines, then row, column, value, message and remedy of the one problem.
IN_TEXT = {
    "a title above data": (
        ["Stiffness study", *lines()[1:]],
        (1, None, "Stiffness study"),
        "line 1 is a title, and line 2 below it has numbers: no header.",
        "Write the names of the columns in a line above the data.",
    ),
    "a comment of several cells": (
        [*lines()[:4], "# a pause, and coffee", *lines()[4:]],
        (5, None, "# a pause, and coffee"),
        "2 cells where the header has 5 and the lines above have 5.",
        "Fix this line or its quotes.",
    ),
    "a row of words": (
        [HEAD, ",,,shown,N/mm", *lines()[1:]],
        (2, "k_ref", "shown"),
        "line 2 is a second header, or a row of units that do not fit: 'shown', 'N/mm'.",
        'such as k_adj = { name = "…", unit = "N/mm" }.',
    ),
    "two headers": (
        [",soft,,hard,", "subject,ref,adj,ref,adj", "P1,500,510,2000,2100", "P2,500,490,2000,1900"],
        (1, None, "soft, hard"),
        "lines 1 and 2 are both headers.",
        "Write one line in their place: subject,ref_soft,adj_soft,ref_hard,adj_hard.",
    ),
    "no header": (
        lines()[1:],
        (1, None, None),
        "the first row looks like data: 'P1', 'soft', '1', '500',",
        "Write the names of the columns in a line above it, such as subject,environment,",
    ),
    "merged cells": (
        [HEAD, *(",".join(map(str, row if row[2] == 1 else ["", *row[1:]])) for row in rows())],
        (3, "subject", None),
        "12 of 24 rows have no subject: cells merged down?",
        "Write it in every row: unmerge the cells, and fill each down.",
    ),
    "a subject in another unit": (
        [HEAD]
        + [
            ",".join(map(str, [*row[:4], row[4] / 1000 if row[0] == "P3" else row[4]]))
            for row in rows()
        ],
        (10, "k_adj", 0.4815),
        "k_adj is 0.000969 times k_ref at the median of subject 'P3', and 0.969 times over"
        " all subjects: the units of the subject seem to differ by a thousand.",
        "Convert the file, or declare the units of both k_adj and k_ref in [columns]",
    ),
}


@pytest.mark.parametrize("name", IN_TEXT)
def test_a_fault_of_a_text_is_named_and_refused(tmp_path, name):
    text, (row, column, value), message, remedy = IN_TEXT[name]
    problem = refusal(csv_file(tmp_path, text))
    assert (problem.row, problem.column, problem.value) == (row, column, value)
    assert problem.message.startswith(message)
    assert remedy in problem.hint


TITLE = "the header is in line 3; what stands above it is skipped: 'Stiffness study'"
COMMENTS = "the header is in line 3; what stands above it is skipped: '# made by hand'"
UNITS = "line 2 is read as units: 'N/m' of 'k_ref', 'N/m' of 'k_adj'"
#: Lines, then what is said of them, with its line.
AROUND = {
    "a title": (["Stiffness study,,,,", "", *lines()], (1, TITLE)),
    "a title without commas": (["Stiffness study", "", *lines()], (1, TITLE)),
    "comments": (["# made by hand", "# two, of three", *lines()], (1, COMMENTS)),
    "a comment among the data": (
        [*lines()[:4], "# a pause", *lines()[4:], "% the end"],
        (5, "comments are skipped, here the first: '# a pause'"),
    ),
    "a row of units": ([HEAD, ",,,N/m,[N/m]", *lines()[1:]], (2, UNITS)),
}


def test_runs_of_spaces_separate_aligned_columns(tmp_path):
    whole = read_sessions(csv_file(tmp_path, lines()))
    aligned = ["".join(f" {cell:11}" for cell in line.split(",")) for line in lines()]
    assert read_sessions(csv_file(tmp_path, aligned)).table.equals(whole.table)
    aligned[2] = aligned[2].replace("soft", "    ")
    assert "4 cells where the header has 5" in refusal(csv_file(tmp_path, aligned)).message


@pytest.mark.parametrize("name", AROUND)
def test_what_stands_around_a_table_is_named(tmp_path, name):
    text, (row, said) = AROUND[name]
    whole = read_sessions(csv_file(tmp_path, lines()))
    found = read_sessions(csv_file(tmp_path, text))
    assert found.table.equals(whole.table)
    assert [(notice.row, notice.text) for notice in found.notices] == [(row, said)]


def test_a_title_stands_above_any_delimiter_and_decimal_mark(tmp_path):
    whole = read_sessions(csv_file(tmp_path, lines()))
    text = [line.replace(",", ";").replace(".", ",") for line in lines()]
    found = read_sessions(csv_file(tmp_path, ["Stiffness study", *text]))
    assert found.table.equals(whole.table)


def test_units_of_a_row_are_converted_and_held_to_the_scene(tmp_path):
    whole = read_sessions(csv_file(tmp_path, lines())).table
    cells = [[*row[:4], row[4] / 1000] for row in rows()]
    text = [HEAD, ",,,N/m,N/mm", *(",".join(map(str, row)) for row in cells)]
    path = csv_file(tmp_path, text)
    assert read_sessions(path).table["k_adj"].tolist() == pytest.approx(whole["k_adj"].tolist())
    columns = {"k_adj": {"name": "k_adj", "unit": "kN/m"}}
    assert len(read_sessions(path, scene=Scene(columns=columns)).table) == 24
    columns["k_adj"]["unit"] = "N/m"
    assert "units that do not fit" in refusal(path, columns=columns).message
    text[1] = ",,,N/m,"
    wide = [line.replace("k_ref,k_adj", "k_a,k_b") for line in text]
    both = {"k_adj": "k_{environment}"}
    assert "units that do not fit" in refusal(csv_file(tmp_path, wide), columns=both).message


def blanked(row):
    """A row whose subject stands in the first of merged cells alone."""
    return row if row[2] == 1 and row[1] == "soft" else [None, *row[1:]]


NAMES = HEAD.split(",")
TWO = [[None, "soft", None, "hard"], ["subject", "ref", "adj", "ref"], ["P1", 500, 510, 2000]]
MERGED = [NAMES, *map(blanked, rows())]
IN_WORKBOOKS = {
    "two headers": ({"data": TWO}, 1, "lines 1 and 2 are both headers."),
    "merged cells": (
        {"data": MERGED},
        3,
        "18 of 24 rows have no subject: cells merged down?",
    ),
}


@pytest.mark.parametrize("name", IN_WORKBOOKS)
def test_a_fault_of_a_workbook_is_named_and_refused(tmp_path, name):
    sheets, row, message = IN_WORKBOOKS[name]
    problem = refusal(workbook(tmp_path, **sheets))
    assert (problem.row, problem.message) == (row, message)


def test_a_title_and_units_of_a_workbook_are_named(tmp_path):
    whole = read_sessions(workbook(tmp_path, data=[NAMES, *rows()])).table
    units = [None, None, None, "N/m", "N/m"]
    cells = [["Stiffness study"], ["Date", 2024], NAMES, units, *rows()]
    cells[5] = [*cells[5], None, "a note"]
    found = read_sessions(workbook(tmp_path, data=cells))
    assert found.table.equals(whole)
    said = [(notice.row, notice.text) for notice in found.notices]
    assert said == [
        (1, TITLE),
        (4, UNITS.replace("line 2", "line 4")),
        (None, "columns not used: 'column 6', 'column 7'"),
    ]


def test_a_formula_that_nobody_worked_out_is_refused(tmp_path):
    cells = [NAMES, *rows()]
    cells[2][-1] = "=2*3"
    problem = refusal(workbook(tmp_path, data=cells))
    assert (problem.row, problem.value) == (3, "=2*3")
    assert problem.message == "a formula without its result, not a number."
    assert "save it there" in problem.hint


def test_sheets_of_subjects_are_read_together(tmp_path):
    whole = read_sessions(workbook(tmp_path, data=[NAMES, *rows()])).table
    sheets = {}
    for subject, *cells in rows():
        sheets.setdefault(subject, [NAMES[1:]]).append(cells)
    path = workbook(tmp_path, **sheets)
    scene = {"sessions": {"sheet": "*", "filename": "{subject}"}}
    sessions = read_sessions(path, scene=Scene(**scene))
    assert [source.name for source in sessions.sources] == [f"{path}::{name}" for name in sheets]
    assert sessions.table.equals(whole)


def test_a_sheet_of_several_is_named_behind_two_colons(tmp_path):
    path = workbook(tmp_path, trials=[NAMES, *rows()], notes=[["a", "b"], [1, 2]])
    problem = refusal(path)
    assert problem.message == "the file holds several tables; there are 'trials', 'notes'."
    assert problem.hint == (
        f"Name one behind two colons: {path}::trials. Or read all that are alike: [sessions] sheet"
        ' = "*".'
    )
    assert len(read_sessions(f"{path}::trials").table) == 24
    scene = Scene(sessions={"sheet": "trials"})
    assert len(read_sessions(path, scene=scene).table) == 24


def noticed(tmp_path, text, **tables):
    """Notices and warnings of a study, and the study read under the rule that one of them names."""
    path = csv_file(tmp_path, text)
    sessions = read_sessions(path, scene=Scene(**tables))
    return [*sessions.notices, *sessions.warnings]


def under_its_rule(tmp_path, notice):
    """The table that is read under the rule a notice gives."""
    rule = notice.text[notice.text.index("exclude = [") :].partition("]")[0] + "]"
    scene = Scene(sessions=tomllib.loads(rule))
    return read_sessions(tmp_path / "walls.csv", scene=scene).table


@pytest.mark.parametrize(("code", "rule"), [(-999, "below = -998.5"), (99999, "above = 99998.5")])
def test_a_code_for_a_missing_value_is_asked_about(tmp_path, code, rule):
    text = lines(at_7=f"P2,soft,2,500,{code}", at_9=f"P2,hard,2,2000,{code}")
    found = noticed(tmp_path, text)
    (notice,) = [own for own in found if "a code for a missing value?" in own.text]
    assert (notice.row, notice.column) == (7, "k_adj")
    assert f"2 values of k are {code}: " in notice.text
    assert rule in notice.text
    assert not any("zero or negative" in own.text for own in found)
    table = under_its_rule(tmp_path, notice)
    assert len(table) == 22
    assert table["k_adj"].between(300, 3000).all()


def test_a_number_of_nines_among_others_is_no_code(tmp_path):
    found = noticed(tmp_path, lines(at_7="P2,soft,2,500,999"))
    assert not any("code" in own.text for own in found)


def test_a_stray_negative_value_may_be_left_out(tmp_path):
    text = [HEAD, *(",".join(map(str, row)) for row in rows(subjects=12))]
    text[6] = "P2,soft,2,500,-463.0"
    (notice,) = [own for own in noticed(tmp_path, text) if "zero or negative" in own.text]
    assert (notice.row, notice.column) == (7, "k_adj")
    assert notice.text.startswith("1 value of k (2.1% of 48) is zero or negative, here the first: ")
    assert 'If people meant it, set family = "normal" in [inference]' in notice.text
    table = under_its_rule(tmp_path, notice)
    assert len(table) == 47
    assert (table["k_adj"] > 0).all()


def test_a_copied_subject_is_noticed(tmp_path):
    copy = [",".join(map(str, ["P9", *row[1:]])) for row in rows() if row[0] == "P2"]
    found = noticed(tmp_path, [*lines(), *copy])
    (notice,) = [own for own in found if "a copy?" in own.text]
    assert (notice.row, notice.column) == (26, "subject")
    assert notice.text.startswith("subjects 'P2' and 'P9' have the same 4 settings: a copy?")
    assert set(under_its_rule(tmp_path, notice)["subject"]) == {f"P{s}" for s in range(1, 7)}
    almost = [*copy[:-1], copy[-1] + "1"]
    assert not any("a copy?" in own.text for own in noticed(tmp_path, [*lines(), *almost]))


def test_unused_columns_may_stand_twice(tmp_path, capsys):
    text = ["subject,environment,k_ref,k_adj,note,note"]
    text += [f"{s},soft,500,{500 + 10 * s + t},," for s in (1, 2) for t in (1, 2)]
    path = csv_file(tmp_path, text)
    assert "rows repeat a subject, session, environment and trial" in refusal(path).message
    assert main(["validate", str(path)]) == 2
    assert "and trial: 2 of 4 (50.0%)." in capsys.readouterr().out
    scene = Scene(sessions={"trial": "order"})
    found = read_sessions(path, scene=scene)
    assert len(found.table) == 4
    assert "columns not used: 'note', 'note'" in [own.text for own in found.notices]
