"""Files that cannot be read say so by name, with what to do."""

import contextlib
import encodings.aliases
import io
import sys
import zipfile

import pandas as pd
import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions import read_sessions

HEAD = b"subject,environment,k_ref,k_adj\n"
ROWS = HEAD + b"S01,A,10,11\nS02,A,10,12\n"


def zipped(name, data):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr(name, data)
    return packed.getvalue()


def encrypted():
    """An archive whose member says that it is: the flag in its own and in the central header."""
    data = bytearray(zipped("a.csv", ROWS))
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + at] |= 1
    return bytes(data)


def damaged():
    data = bytearray(zipped("a.csv", ROWS))
    data[data.index(b"S01")] ^= 1
    return bytes(data)


def workbook(rows):
    pytest.importorskip("openpyxl")
    file = io.BytesIO()
    pd.DataFrame(rows).to_excel(file, index=False, header=False)
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("t.zip", zipped("note.md", b"x"), "t.zip: the archive holds no table (.csv, .tsv"),
        ("t.zip", encrypted(), "t.zip!a.csv: a broken archive: File 'a.csv' is encrypted"),
        ("t.zip", damaged(), "t.zip!a.csv"),
        ("t.parquet", b"PAR1 and no more", "t.parquet: a broken file:"),
        ("t.xlsx", zipped("xl/workbook.xml", b"<no/>"), "t.xlsx: a broken file:"),
    ],
    ids=["no table", "encrypted", "damaged", "parquet", "workbook"],
)
def test_what_cannot_be_read_is_named(tmp_path, name, data, said):
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    if name.endswith("xlsx"):
        pytest.importorskip("openpyxl")
    (tmp_path / name).write_bytes(data)
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path / name)
    assert said in str(caught.value)
    assert ".." not in str(caught.value).replace(str(tmp_path), "")


@pytest.mark.parametrize("sheet", ["*", "Sheet1"])
def test_a_workbook_that_breaks_off_is_refused(tmp_path, sheet):
    data = bytearray(workbook([["subject", "k_adj"], ["a", 1]]))
    data[data.index(b"worksheets/sheet1.xml") + 40] ^= 255
    (tmp_path / "t.xlsx").write_bytes(data)
    with pytest.raises(UsageError, match=r"t\.xlsx: a broken file: "):
        read_sessions(tmp_path / "t.xlsx", scene=Scene(sessions={"sheet": sheet}))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([], "the file has no header. Leave it out"),
        ([["subject", "k_adj"]], "there are no data below the"),
    ],
)
def test_sheets_without_data_are_named(tmp_path, rows, said):
    (tmp_path / "t.xlsx").write_bytes(workbook(rows))
    with pytest.raises(UsageError) as caught:
        read_sessions(tmp_path / "t.xlsx")
    assert said in str(caught.value)


@pytest.mark.skipif(
    sys.platform != "linux", reason="a file nobody can read from its start is Linux's"
)
def test_a_file_that_the_system_does_not_give(tmp_path):
    with pytest.raises(UsageError, match="/proc/self/mem: cannot be read: Input/output error"):
        read_sessions("/proc/self/mem")


def test_a_cell_without_end(tmp_path):
    file = tmp_path / "t.csv"
    file.write_bytes(ROWS + b"S03,A,10," + b"1" * (1 << 25) + b"\n")
    with pytest.raises(UsageError, match=r"t\.csv:4: a cell of more than 16,777,216 characters\."):
        read_sessions(file)


def test_utf_16_without_a_mark_asks_for_the_encoding(tmp_path):
    path = tmp_path / "t.csv"
    path.write_bytes(ROWS.decode().encode("utf-16-le"))
    with pytest.raises(UsageError, match="a NUL character") as caught:
        read_sessions(path)
    assert 'declare [sessions] encoding = "utf-16-le".' in caught.value.hint
    assert read_sessions(path, scene=Scene(sessions={"encoding": "utf-16-le"})).subjects


@pytest.mark.parametrize("name", sorted(set(encodings.aliases.aliases.values())))
def test_no_encoding_ends_in_a_traceback(tmp_path, name):
    path = tmp_path / "t.csv"
    path.write_bytes(ROWS + bytes(range(128, 256)))
    with contextlib.suppress(UsageError):
        read_sessions(path, scene=Scene(sessions={"encoding": name}))
