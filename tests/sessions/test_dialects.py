"""Every tool's own dialect reads to the same Sessions, to the last bit."""

from __future__ import annotations

import gzip
import zipfile

import pandas as pd
import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions import Sessions, read_sessions
from tests.sessions.dialects import WRITERS, example, frame


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
    options = Scene(sessions={"encoding": declared} if declared else {})
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
        read_sessions(tmp_path / "t.xlsx", scene=Scene(sessions={"sheet": "Data"}))


def test_the_extras_are_named_when_missing(tmp_path, monkeypatch):
    (tmp_path / "t.parquet").write_bytes(b"PAR1xxxxPAR1")
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r"needs pyarrow\. Install it: pip install pyarrow\."):
        read_sessions(tmp_path / "t.parquet")
