"""Every tool's own dialect reads to the same Sessions, to the last bit."""

from __future__ import annotations

import gzip
import zipfile

import pandas as pd
import pytest

from percept.errors import UsageError
from percept.sessions import ReadOptions, Sessions, read_sessions
from tests.sessions.dialects import WRITERS, delimited, example, frame

PSYCHOPY_HEADER = "environment,k_ref,k_adj,note,participant,expName,psychopyVersion,"


def written(folder, name, trials=None):
    writer = WRITERS[name]
    trials = example(writer.decimals) if trials is None else trials
    for file, data in writer.write(trials).items():
        (folder / file).write_bytes(data)
    return trials, writer.options


@pytest.mark.parametrize("name", WRITERS)
def test_a_dialect_reads_to_the_same_table(tmp_path, name):
    trials, options = written(tmp_path, name)
    sessions = read_sessions(tmp_path, scene=options)
    pd.testing.assert_frame_equal(
        sessions.table, Sessions.from_frame(frame(trials)).table, check_exact=True
    )
    assert sessions.subjects == ("001", "1", "NA")
    assert sessions.environments == ("VE1", "VE2", "Wände 3")
    assert sessions.counts["rows without b"] == 1


@pytest.mark.parametrize("name", ["plain", "psychopy appended", "gorilla", "excel csv", "wide"])
def test_rows_are_physical_lines(tmp_path, name):
    trials, options = written(tmp_path, name)
    sessions = read_sessions(tmp_path, scene=options)
    data = next(iter(WRITERS[name].write(trials).values()))
    lines = data.decode("cp1252" if name == "excel csv" else "utf-8").split("\n")
    for at, trial in enumerate(trials):
        line = lines[sessions.locate(at)[1] - 1].replace(",", ".")
        assert repr(trial.k_adj) in line


@pytest.mark.parametrize("pack", ["gz", "zip"])
def test_archives_are_read_in_memory(tmp_path, pack):
    data = WRITERS["plain"].write(example())["plain.csv"]
    file = tmp_path / f"a.csv.{pack}"
    if pack == "gz":
        file.write_bytes(gzip.compress(data))
    else:
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("../../escape.csv", data)
            archive.writestr("notes.docx", b"not a table")
    sessions = read_sessions(file)
    pd.testing.assert_frame_equal(sessions.table, Sessions.from_frame(frame(example())).table)
    assert [p.name for p in tmp_path.iterdir()] == [file.name]


@pytest.mark.parametrize("order", ["utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("declared", [None, "utf-16", "UTF16"])
def test_a_byte_order_mark_says_which_half_of_an_encoding_it_is(tmp_path, order, declared):
    file = tmp_path / "f.csv"
    file.write_bytes("\ufeffsubject,environment,k_ref,k_adj\nä,a,10,11\n".encode(order))
    options = ReadOptions(sessions={"encoding": declared} if declared else {})
    assert read_sessions(file, scene=options).subjects == ("ä",)


def test_folders_and_patterns_name_what_they_leave_out(tmp_path):
    _, options = written(tmp_path, "folder")
    (tmp_path / "run.log").write_text("x")
    (tmp_path / ".hidden.csv").write_text("x")
    folder = read_sessions(tmp_path, scene=options)
    pattern = read_sessions(tmp_path / "sub-*.csv", scene=options)
    twice = read_sessions(tmp_path, tmp_path / "sub-*.csv", scene=options)
    (tmp_path / "sub-folder.csv").mkdir()
    assert read_sessions(tmp_path / "sub-*.csv", scene=options).table.equals(pattern.table)
    assert folder.table.equals(pattern.table)
    assert folder.table.equals(twice.table)
    again = "a file that is named more than once is read once"
    assert [again in {n.text for n in one.notices} for one in (folder, twice)] == [False, True]


def test_results_in_a_folder_of_sessions_are_left_out(tmp_path):
    _, options = written(tmp_path, "folder")
    alone = read_sessions(tmp_path, scene=options)
    for name in ("report", "old/fit"):
        (tmp_path / name / "tables").mkdir(parents=True)
        (tmp_path / name / "tables" / "band.csv").write_text("environment,band\nVE1,2\n")
        (tmp_path / name / ".percept").write_text("")
    again = read_sessions(tmp_path, scene=options)
    assert again.table.equals(alone.table)
    (notice,) = [found for found in again.notices if "a folder of results" in found.text]
    assert notice.file == str(tmp_path / "old" / "fit")
    assert notice.text == "a folder of results is not read (and 1 more like this)"
    with pytest.raises(UsageError, match=r"band\.csv: the name does not fit the pattern"):
        read_sessions(tmp_path / "report", scene=options)


def test_excel_and_parquet(tmp_path):
    # openpyxl writes fifteen digits, so numbers of six decimals come back whole.
    trials = example(6)
    pytest.importorskip("openpyxl")
    pytest.importorskip("pyarrow")
    table = frame(trials).rename(columns={"k_adj": "k adj"})
    table.to_excel(tmp_path / "t.xlsx", index=False)
    table.to_parquet(tmp_path / "t.parquet")
    want = Sessions.from_frame(frame(trials)).table
    for name in ("t.xlsx", "t.parquet"):
        sessions = read_sessions(tmp_path / name)
        pd.testing.assert_frame_equal(sessions.table, want, check_exact=True)
        assert any("'k adj' is taken as k_adj" in notice.text for notice in sessions.notices)
    with pytest.raises(UsageError, match=r"the file holds no such table; there are 'Sheet1'"):
        read_sessions(tmp_path / "t.xlsx", scene=ReadOptions(sessions={"sheet": "Data"}))


REFUSED = {
    "pickle": (b"\x80\x04\x95abc", "a Python pickle"),
    "old office": (b"\xd0\xcf\x11\xe0\xa1\xb1", "old Office or E-Prime binary"),
    "e-prime log": (
        "*** Header Start ***\r\nSubject: 1\r\n*** Header End ***\r\n".encode("utf-16"),
        "an E-Prime log in frames",
    ),
    "staircase text": (
        b"\xef\xbb\xbf\nreversalIntensities=\t0.4\t0.2\nreversalIndices=\t3\t9\n",
        "PsychoPy's text summary of a staircase",
    ),
    "summary text": (
        b"ori\tn\tk_mean\tk_std\tk_raw\torder\n0\t3\t5.1\t0.2\t5.0\t1\n\nextraInfo\nparticipant\t01\n",
        "PsychoPy's summary of conditions",
    ),
    "json": (b'[["k_adj", 1], ["rt", 2]]', "this JSON is not a list of records"),
    "html": (b"<!DOCTYPE html><table>", "a web page or XML"),
    "empty": (b"", "the file is empty"),
    "one column": (b"k_adj\n1\n2\n", "no comma, semicolon, tab, bar or space"),
    "header only": (b"subject,k_adj\n", "no data below the header"),
    "nul": (b"subject,k_adj\n1,\x002\n", "a NUL character"),
    "no text at all": (b"subject,k\x81_adj\n", "byte 0x81 is not text"),
    "row names of R between commas": (
        b'"subject","environment","k_ref","k_adj"\n"1","1","a",10,11\n"2","2","a",10,12\n',
        "R's write.table needs col.names = NA",
    ),
    "row names of R that do not rise": (
        b"subject\tenvironment\tk_ref\tk_adj\n2\t1\ta\t10\t11\n1\t2\ta\t10\t12\n",
        "5 cells where the header has 4",
    ),
    "short line": (
        b"subject,environment,k_ref,k_adj\n1,a,10,11\n2,a,10\n",
        "3 cells where the header has 4",
    ),
    "open quote": (b'subject,environment,k_ref,k_adj\n"1,a,10,11\n', "a quoted cell is not closed"),
    "text after a quote": (
        b'subject,environment,k_ref,k_adj\n"1"x,a,10,11\n',
        "text follows its closing quote",
    ),
    "psychopy's unescaped quote": (
        f'{PSYCHOPY_HEADER}\nA,10,11,"said "go", then",1,e,2024.2.4,\n'.encode(),
        "9 cells where the header has 8",
    ),
    "two dialects": (
        b"subject,x;environment,k_ref;k_adj,z\n1,2;3,4;5,6\n",
        "comma and semicolon can each split the lines",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_table_is_refused_with_its_name(tmp_path, case):
    data, message = REFUSED[case]
    file = tmp_path / "f.csv"
    file.write_bytes(data)
    with pytest.raises(UsageError) as caught:
        read_sessions(file)
    assert message in str(caught.value)
    assert str(file) in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_short_line_is_named_by_its_physical_row(tmp_path):
    file = tmp_path / "f.csv"
    file.write_bytes(b'sep=,\nsubject,environment,k_ref,k_adj\n"0\n1",a,10,11\n\n2,a,10\n')
    with pytest.raises(UsageError) as caught:
        read_sessions(file)
    assert caught.value.row == 6


def test_a_windows_encoding_is_announced(tmp_path):
    file = tmp_path / "f.csv"
    rows = [["subject", "environment", "k_ref", "k_adj"], ["Jürgen", "VE1", "10", "11"]]
    file.write_bytes(delimited(rows, encoding="cp1252"))
    sessions = read_sessions(file)
    assert sessions.subjects == ("Jürgen",)
    assert "not UTF-8; read as Windows-1252" in [notice.text for notice in sessions.notices]


def test_text_in_two_encodings_is_refused(tmp_path):
    file = tmp_path / "f.csv"
    rows = "subject,environment,k_ref,k_adj\nZoë,VE1,10,11\n".encode()
    file.write_bytes(rows + "Jürgen,VE1,10,12\n".encode("cp1252"))
    with pytest.raises(UsageError, match="byte 0xfc is not text in utf-8") as caught:
        read_sessions(file)
    assert caught.value.row == 3
    assert 'or declare [sessions] encoding = "cp1252".' in caught.value.hint


def test_the_extras_are_named_when_missing(tmp_path, monkeypatch):
    (tmp_path / "t.parquet").write_bytes(b"PAR1xxxxPAR1")
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r"needs pyarrow\. Install it: pip install pyarrow\."):
        read_sessions(tmp_path / "t.parquet")
