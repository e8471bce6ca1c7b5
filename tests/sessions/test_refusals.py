"""What is refused: an input each, the place that is named, and the words."""

from __future__ import annotations

import pickle

import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions import ReadError, read_sessions
from tests.sessions.reading import BOTH, HEAD, read, refusal

CELLS = {
    "abc": "not a number",
    "١٢": "not a number",
    "inf": "not a finite number",
    "1e400": "not between 1e-100 and 1e+100 in size",
    "1e-400": "not between 1e-100 and 1e+100 in size",
    '"1,286"': "can be read as 1.286 or as 1286",
    '"1,286.5"': "separators of thousands are not read",
    "1.286.000": "separators of thousands are not read",
    "1\u202f286": "separators of thousands are not read",
    "01. Mai": "a date, not a number",
    '"[0.36, 0.55]"': "a list or a record",
    '\\"': "not a number.",
    "\u2212463.0": "a typographic minus sign, not a number. Replace it by a hyphen in the whole",
    "0.463 N/mm": 'such as [columns] k_adj = { name = "k_adj", unit = "N/mm" }.',
    "?": 'Leave the cell empty, or say so in the scene: [sessions] missing = ["?"].',
    "99%": "a percentage, not a number. Write it as a fraction",
    "=A1*2": "a formula without its result, not a number.",
}


@pytest.mark.parametrize("cell", CELLS)
def test_cells_that_are_no_numbers(tmp_path, cell):
    error = refusal(tmp_path, f"{HEAD}1,a,2000,{cell}\n")
    value = cell[1:-1] if cell.startswith('"') else cell
    assert CELLS[cell] in str(error)
    assert (error.row, error.column, error.value) == (2, "k_adj", value)
    assert error.hint


PSYCHOPY = "environment,k_ref,k_adj,note,participant,expName,psychopyVersion,"
#: The file's text, and what the message says.
NO_TABLES = {
    "pickle": (b"\x80\x04\x95abc", "a Python pickle"),
    "old office": (b"\xd0\xcf\x11\xe0\xa1\xb1", "old Office or E-Prime binary"),
    "e-prime log": ("*** Header Start ***\r\nSubject: 1\r\n".encode("utf-16"), "an E-Prime log in"),
    "staircase": (b"\xef\xbb\xbf\nreversalIntensities=\t0.4\n", "text summary of a staircase"),
    "summary": (
        b"ori\tn\tk_mean\tk_std\tk_raw\torder\n0\t3\t5.1\t0.2\t5.0\t1\n\nextraInfo\nparticipant\t01\n",
        "PsychoPy's summary of conditions",
    ),
    "json": (b'[["k_adj", 1], ["rt", 2]]', "this JSON is not a list of records"),
    "html": (b"<!DOCTYPE html><table>", "a web page or XML"),
    "empty": (b"", "the file is empty"),
    "blank header": (b",,,\n,,,\n", "the file has no header"),
    "one column": (b"k_adj\n1\n2\n", "no comma, semicolon, tab, bar or space"),
    "header only": (b"subject,k_adj\n", "no data below the header"),
    "nul": (b"subject,k_adj\n1,\x002\n", ":2: a NUL character"),
    "no text": (b"subject,k\x81_adj\n", "byte 0x81 is not text"),
    "two encodings": (
        "é,k_adj\nZoë,2\n".encode() + "Jürgen,3\n".encode("cp1252"),
        ":3: byte 0xfc is not text in utf-8. Other letters are UTF-8: two programs wrote this",
    ),
    "row names of R": (
        b'"subject","environment","k_ref","k_adj"\n"1","1","a",10,11\n"2","2","a",10,12\n',
        "R's write.table needs col.names = NA",
    ),
    "short line": (
        b'sep=,\nsubject,environment,k_ref,k_adj\n"0\n1",a,10,11\n\n2,a,10\n',
        ":6, value '2,a,10': 3 cells where the header has 4",
    ),
    "open quote": (HEAD.encode() + b'"1,a,10,11\n', "a quoted cell is not closed"),
    "text after a quote": (HEAD.encode() + b'"1"x,a,10,11\n', "text follows its closing quote"),
    "psychopy's quote": (
        f'{PSYCHOPY}\nA,10,11,"said "go", then",1,e,2024.2.4,\n'.encode(),
        "9 cells where the header has 8",
    ),
    "two dialects": (
        b"subject,x;environment,k_ref;k_adj,z\n1,2;3,4;5,6\n",
        "comma and semicolon can each split the lines",
    ),
}


@pytest.mark.parametrize("case", NO_TABLES)
def test_what_is_no_table_is_refused_with_its_name(tmp_path, case):
    data, message = NO_TABLES[case]
    error = refusal(tmp_path, data)
    assert message in str(error)
    assert str(error).startswith(str(tmp_path / "f.csv"))
    assert error.exit_code == 2


WIDE = {"k_adj": "{environment}", "subject": "ID"}
IN_CELLS = {"k_adj": {"name": "v", "path": "s.-1"}}
V = "subject,environment,k_ref,v\n"
VE = "environment,parameter,reference,lower,upper,n,level\n"
SD = "environment,parameter,reference,mean,sd,n,level\n"
SOFT = {"a": {"k_ref": 10, "b_ref": 1}}
#: Text, tables of the scene, row and column that are named, and what the message says.
REFUSED = {
    "ids that are blank": (f"{BOTH},a,10,1,1,11,1\n", {}, (2, "subject"), "has no subject."),
    "no trial": (f"{BOTH}1,b,10,1,,11,1\n", {}, (2, "trial"), "an adjustment has no trial."),
    "half a trial": (f"{BOTH}1,b,10,1,1.5,11,1\n", {}, (2, "trial"), "must be whole."),
    "two references": (
        f"{BOTH}1,a,10,1,1,11,1\n2,a,10.5,1,1,11,1\n",
        {},
        (3, "k_ref"),
        "environment 'a' has the reference 10.0 in an earlier row",
    ),
    "another reference": (
        f"{BOTH}1,a,11,1,1,11,1\n",
        {"environments": SOFT},
        (2, "k_ref"),
        "has the reference 10.0 in the scene",
    ),
    "no reference": (
        "subject,environment,k_adj\n1,soft,11\n1,hard,12\n",
        {"environments": {"other": {"k_ref": 1.0}}},
        (None, "k_ref"),
        '[environments]\n"soft" = { k_ref = "?" }\n"hard" = { k_ref = "?" }',
    ),
    "two names of a column": (
        "participant,subj,environment,k_ref,k_adj\n7,8,a,10,11\n",
        {},
        (1, "subject"),
        "'participant', 'subj' could each be subject",
    ),
    "no subject": (
        "who,environment,k_ref,k_adj\n7,a,10,11\n",
        {},
        (1, "subject"),
        "no column for subject; the columns are 'who', 'environment'",
    ),
    "no adjustment of b": (
        "subject,environment,k_ref,k_adj,b_ref\n7,a,10,11,1\n",
        {},
        (1, "b_adj"),
        "no column for b_adj",
    ),
    "a column twice": (
        "subject,environment,k_ref,k_adj,k_adj\n7,a,10,11,1\n",
        {},
        (1, "k_adj"),
        "two columns have the name 'k_adj'.",
    ),
    "a mistyped rule": (
        "subject,environment,k_ref,k_last\n7,a,1,2\n",
        {"columns": {"k_adj": "k_lst"}},
        (1, "k_lst"),
        "no column has that name. The columns are 'subject', 'environment', 'k_ref', 'k_last'. Did"
        " you mean k_last?",
    ),
    "no environment of two": (
        "subject,k_adj\n1,310\n",
        {"environments": {"wall": {"k_ref": 300.0}, "floor": {"k_ref": 900.0}}},
        (1, "environment"),
        "there is no column for environment",
    ),
    "a pattern": (
        "ID,age,firm\n1,33,11\n",
        {"columns": WIDE, "environments": SOFT},
        (1, "{environment}"),
        "no column fits the pattern",
    ),
    "a key twice": (
        f'{V}1,a,10,"{{""s"": 1, ""s"": 2}}"\n',
        {"columns": IN_CELLS},
        (2, "v"),
        "a key twice",
    ),
    "no such item": (
        f'{V}1,a,10,"{{""s"": []}}"\n',
        {"columns": IN_CELLS},
        (2, "v"),
        "there is no '-1' in it",
    ),
    "a truth": (
        f'{V}1,a,10,"{{""s"": [true]}}"\n',
        {"columns": IN_CELLS},
        (2, "v"),
        "a list or true/false",
    ),
    "a program": (f"{V}1,a,10,exit()\n", {"columns": IN_CELLS}, (2, "v"), "not a JSON record"),
    "deep JSON": (
        f'{V}1,a,10,"{"[" * 100_000}"\n',
        {"columns": IN_CELLS},
        (2, "v"),
        "not a JSON record or",
    ),
    "no such path": (
        f'{V}1,a,10,"{{""k"": 11}}"\n2,a,10,\n',
        {"columns": {"k_adj": {"name": "v", "path": "v.k"}}},
        (None, "v"),
        "columns.k_adj.path = 'v.k': no row has this path. Correct it: it begins inside a cell such"
        " as '{\"k\": 11}'.",
    ),
    "no row is left": (
        f'{V}1,a,10,"{{""s"": [1]}}"\n',
        {"columns": IN_CELLS, "sessions": {"only": {"subject": "2"}}},
        (None, None),
        "no row has an adjustment. Rows: 1 rows read, 1 subject is not 2",
    ),
    "a repeat": (
        f"{BOTH}1,a,10,1,1,11,1\n2,a,10,1,1,11,1\n2,a,10,1,1,11,1\n",
        {},
        (4, None),
        "subject '2', session '1', environment 'a', trial '1' is already in",
    ),
    "a rule on nothing": (
        f"{HEAD}1,a,10,11\n",
        {"sessions": {"exclude": [{"column": "subject", "equals": "S9"}]}},
        (None, "subject"),
        "sessions.exclude: no row has 'S9' in this column. Correct the text, or take the rule out.",
    ),
    "a limit of texts": (
        f"{HEAD}1,a,10,11\n",
        {"sessions": {"exclude": [{"column": "subject", "above": 3}]}},
        (None, None),
        "limits need a column of numbers",
    ),
    "no column of a rule": (
        f"{HEAD}1,a,10,11\n",
        {"sessions": {"exclude": [{"column": "session", "equals": "3"}]}},
        (1, "session"),
        "there is no column 'session'.",
    ),
    "no encoding": (
        f"{HEAD}1,a,10,11\n",
        {"sessions": {"encoding": "klingon"}},
        (None, None),
        "unknown encoding 'klingon'.",
    ),
    "no id in the name": (
        "environment,k_ref,k_adj\na,10,11\n",
        {"sessions": {"filename": "s{subject}"}},
        (None, None),
        "the name does not fit the pattern 's{subject}'.",
    ),
    "no parameter": (f"{VE}V,stiffness,10,11,19,9,0.9\n", {}, (2, "parameter"), 'be "k" or "b"'),
    "limits": (f"{VE}V,k,10,19,11,10,0.99\n", {}, (2, "upper"), "is below the lower limit"),
    "one subject": (f"{VE}V,k,10,11,19,1,0.9\n", {}, (2, "n"), "a whole number of at least 2"),
    "words for n": (f"{VE}V,k,10,11,19,ten,0.9\n", {}, (2, "n"), "not a number. Correct the cell."),
    "an empty cell": (f"{VE}V,k,10,,19,10,0.9\n", {}, (2, "lower"), "has no empty cells"),
    "a second row": (
        f"{VE}V,k,10,11,19,9,.9\nV,k,10,11,19,9,.9\n",
        {},
        (3, "environment"),
        "a second row",
    ),
    "another reference of a table": (
        f"{VE}a,k,11,10,19,9,.9\n",
        {"environments": SOFT},
        (2, "reference"),
        "the reference 10.",
    ),
    "a negative SD": (f"{SD}V,k,15,14.9,-1,10,0.99\n", {}, (2, "upper"), "the SD is negative."),
    "no level": (
        VE.replace(",level", "") + "V,k,15,11,19,10\n",
        {},
        (1, "level"),
        "needs the column level",
    ),
    "units of a table": (
        f"{SD}A,k,10,8,21,11,.9\n",
        {"columns": {"mean": {"name": "mean", "unit": "N/mm"}}},
        (None, None),
        "a published table is in N/m and N·s/m. Convert the table",
    ),
    "a table in another unit": (
        f"{VE}V,b,1,0.5,0.8,10,0.99\nV,k,5000,4.1,6.2,12,0.95\n",
        {},
        (3, "reference"),
        "limits of k are typically 0.00124 times the reference: their units seem to differ. Write"
        " references and limits in N/m.",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused_is_named_with_its_place(tmp_path, case):
    text, tables, (row, column), message = REFUSED[case]
    error = refusal(tmp_path, text, **tables)
    assert (error.row, error.column) == (row, column)
    assert message in str(error)


def test_problems_are_reported_together_by_kind(tmp_path):
    error = refusal(tmp_path, BOTH + "".join(f"{i},a,10,1,1,x{i},y\n" for i in range(8)))
    assert isinstance(error, ReadError)
    assert len(error.problems) == error.total == 16
    assert str(error).startswith("16 problems:")
    assert "column 'k_adj', rows 5 to 9: 5 more of this kind" in str(error)
    assert str(error).endswith("percept validate lists them by kind")
    error = refusal(tmp_path, BOTH + "".join(f"1,a,10,1,{t},x,1\n" for t in range(1499)))
    assert (len(error.problems), error.total) == (1000, 1499)
    assert "column 'k_adj', rows 5 to 1001: 997 more of this kind" in str(error)
    # As a worker's process sends it back.
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.row, again.total) == (str(error), error.row, 1499)


def test_many_repeats_are_one_problem(tmp_path):
    rows = "".join(f"{s},a,10,{11 + r}\n" for s in (1, 2) for r in range(9))
    error = refusal(tmp_path, HEAD + rows)
    assert (error.total, error.row) == (1, 3)
    assert error.message.startswith(
        "rows repeat a subject, session, environment and trial: 16 of 18 (88.9%). The first: "
    )
    assert error.hint == (
        "Remove it, or name the column of trial numbers in [columns]. Number the trials by the"
        ' order of their rows: [sessions] trial = "order". If rows are events of a trial,'
        ' [sessions] keep = "last" would keep 2 rows. If they are conditions of one subject, name'
        ' their column: [study] factor = "…".'
    )


@pytest.mark.parametrize(
    ("adjusted", "reference", "declared", "ratio", "hint"),
    [
        (1.2, 1000, {}, "0.0012", 'in [columns], such as k_adj = { name = "…", unit = "N/mm" }'),
        (1200, 1, {}, "1.2e+03", 'in [columns], such as k_ref = { name = "…", unit = "N/mm" }'),
        (1200, 1000, {"k_ref": "N/mm"}, "0.0012", "declare the units of both k_adj and k_ref"),
        (1.2, 1000, {"k_adj": "N/m"}, "0.0012", 'declare unit = "N/m" for both.'),
        (99, 1, {}, None, None),
        (1, 99, {}, None, None),
        (1200, 1, {"k_ref": "N/m", "k_adj": "N/m"}, None, "their units seem to differ"),
    ],
)
def test_a_slip_of_units_is_refused_unless_both_are_declared(
    tmp_path, adjusted, reference, declared, ratio, hint
):
    """Environments of reference zero have no ratio, and do not count."""
    rows = "".join(
        f"{s},{e},{scale * reference},{scale * adjusted * factor or 3}\n"
        for s, factor in ((1, 0.5), (2, 1), (3, 2))
        for e, scale in (("a", 1), ("b", 10), ("zero", 0))
    )
    columns = {column: {"name": column, "unit": unit} for column, unit in declared.items()}
    if ratio is None:
        found = read(tmp_path, HEAD + rows, columns=columns)
        assert len(found.table) == 9
        assert any("units seem to differ" in notice.text for notice in found.notices) == bool(hint)
        return
    error = refusal(tmp_path, HEAD + rows, columns=columns)
    assert f"k_adj is {ratio} times k_ref at the median: their units seem to differ." in str(error)
    assert error.column == "k_adj"
    assert hint in error.hint


def test_one_file_in_another_unit_is_refused(tmp_path):
    for s in range(1, 6):
        factor = 1e-3 if s == 3 else 1.0
        rows = [f"{s},{e},{k},{(k + s) * factor}" for e, k in (("a", 900), ("b", 4000))]
        (tmp_path / f"s{s}.csv").write_text(HEAD + "\n".join(rows) + "\n")
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path)
    error = caught.value
    assert (error.file, error.row, error.column) == (str(tmp_path / "s3.csv"), 2, "k_adj")
    assert "k_adj is 0.001 times k_ref at the median of this file, and 1 times over all files" in (
        error.message
    )
    told = {c: {"name": c, "unit": "N/m"} for c in ("k_ref", "k_adj")}
    found = read_sessions(tmp_path, scene=Scene(columns=told))
    assert any("differ by a thousand" in notice.text for notice in found.notices)


def test_settings_a_thousand_apart_are_read_where_the_scene_says_the_unit(tmp_path):
    # Subjects whose settings differ by e³ are rare, and real for a pure number.
    settings = {"a": 0.0009, "b": 0.8, "c": 1.0, "d": 1.3}
    rows = [f"{s},{e},1,{value}" for s, value in settings.items() for e in ("x", "y")]
    text = "subject,environment,g_ref,g_adj\n" + "\n".join(rows) + "\n"
    tables = {"quantities": {"g": {"unit": ""}}}
    error = refusal(tmp_path, text, **tables)
    assert error.hint.endswith('If the numbers are right, declare unit = "" for both.')
    for unit in ({"unit": ""}, {"response": "ratio"}):
        columns = {"g_ref": {"name": "g_ref", "unit": ""}, "g_adj": {"name": "g_adj", **unit}}
        assert len(read(tmp_path, text, **tables, columns=columns).table) == 8


def test_trials_and_summary_do_not_mix_and_identical_files_are_found(tmp_path):
    (tmp_path / "a.csv").write_text(HEAD + "1,a,10,11\n")
    (tmp_path / "b.csv").write_text(VE + "VE1,k,10,11,19,10,0.99\n")
    with pytest.raises(UsageError, match="trials and a published summary"):
        read_sessions(tmp_path)
    (tmp_path / "b.csv").write_text(HEAD + "1,a,10,11\n")
    with pytest.raises(UsageError, match=r"b\.csv: byte for byte the same file as .*a\.csv"):
        read_sessions(tmp_path)


def test_the_line_of_a_wrong_quote_is_that_of_the_delimiter_meant(tmp_path):
    head = HEAD.replace(",", ";").strip() + ";note\n"
    error = refusal(tmp_path, head + '1;a;10;11,5;"1,2"x\n2;a;10;12,5;y\n')
    assert (error.row, "follows its closing quote" in error.message) == (2, True)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            {"sessions": {"decimals": ","}},
            "sessions.decimals = ',': there is no such key; there are decimal,",
        ),
        ({"sessions": {"decimal": ";"}}, "sessions.decimal = ';': must be '.' or ','."),
        ({"sessions": {"delimiter": '"'}}, "sessions.delimiter = '\"': must be one character, not"),
        ({"sessions": {"filename": "x"}}, "sessions.filename = 'x': must name {subject}"),
        ({"sessions": {"groups": 1.5}}, "sessions.groups = 1.5: must be a text or a list of"),
        (
            {"sessions": {"exclude": [{"column": "x"}]}},
            "sessions.exclude.0: a rule has column, why, and either",
        ),
        (
            {"sessions": {"exclude": [{"column": "x", "above": "3"}]}},
            "sessions.exclude.0.above = '3': must be a number.",
        ),
        (
            {"sessions": {"trial": "order", "keep": "last"}},
            'sessions: keep = "last" needs a column of trials',
        ),
        ({"columns": {"k": "x"}}, "columns.k: there is no such key; there are subject, session,"),
        (
            {"columns": {"k_adj": {"nme": "x"}}},
            "columns.k_adj.nme = 'x': there is no such key; there are name, unit, path,"
            " scale, response. Did you mean name?",
        ),
        ({"columns": {"k_adj": 3}}, "columns.k_adj = 3: a column is a name, or a table of"),
        ({"columns": {"k_adj": "{trial}{trial}"}}, "columns.k_adj: names an id twice."),
        ({"columns": {"k_adj": ""}}, "columns.k_adj.name = '': must not be empty."),
        (
            {"columns": {"k_ref": {"name": "x", "response": "ratio"}}},
            "columns.k_ref.response: only an adjustment is a ratio",
        ),
        (
            {"columns": {"k_adj": {"name": "x", "response": "ratio", "unit": "N/m"}}},
            'columns.k_adj: numbers of response = "ratio" have no unit',
        ),
        ({"columns": {"k_adj": {"name": "x", "scale": 0.0}}}, "columns.k_adj: scale must not be"),
        (
            {"columns": {"b_ref": {"name": "b", "unit": "N/m"}}},
            "columns.b_ref.unit = 'N/m': not a unit of damping. Declare one that converts to",
        ),
        (
            {"columns": {"rt_adj": "rt"}},
            "columns.rt_adj: there is no quantity 'rt'. Declare it in the scene: [quantities.rt]",
        ),
        ({"environments": {"a": {"k_ref": "3"}}}, "environments.a.k_ref = '3': must be a number."),
        ({"environments": []}, "environments = []: must be a table."),
    ],
)
def test_options_are_checked(tables, message):
    with pytest.raises(UsageError) as caught:
        Scene(**tables)
    assert str(caught.value).startswith(message)


def test_paths_that_lead_nowhere(tmp_path):
    for path, message in (
        (tmp_path / "no.csv", "there is no such file"),
        (tmp_path, "the folder holds no table"),
        (tmp_path / "*.csv", "no file fits the pattern"),
        (7, r"a path is text, not int.*Sessions\.from_frame"),
    ):
        with pytest.raises(UsageError, match=message):
            read_sessions(path)
    with pytest.raises(UsageError, match="no file was given"):
        read_sessions()
