"""Files made to harm: nothing runs, nothing is written, nothing takes long."""

from __future__ import annotations

import gzip
import os
import subprocess
import time
import zipfile

import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions import format_validation, read_sessions, validate

HEAD = "subject,environment,k_ref,k_adj\n"


def test_markup_is_escaped(tmp_path):
    file = tmp_path / "f.csv"
    script = "<script>alert(1)</script>"
    file.write_text(HEAD + f"{script},../../etc,10,11\n0{script},../../etc,10,11\n")
    html = read_sessions(file)._repr_html_()
    assert "<script>" not in html
    assert "&lt;script&gt;" in html
    assert [p.name for p in tmp_path.iterdir()] == ["f.csv"]


def test_terminal_escapes_are_shown_not_sent(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "\x1b[2J\u202e,a,10,11\n0\x1b[2J\u202e,a,10,x\n")
    text = format_validation(validate(file))
    assert "\x1b" not in text
    assert "\u202e" not in text


def test_a_line_of_a_million_columns(tmp_path):
    file = tmp_path / "f.csv"
    for count, message in (
        (10**5, "a header of 100001 cells"),
        (10**6, "a header of 1000001 cells"),
    ):
        for name in ("a,", '"a",'):
            file.write_text(name * count + "\n1\n")
            with pytest.raises(UsageError, match=message):
                read_sessions(file)


def test_bombs_are_cut_off(tmp_path):
    scene = Scene(files={"size": 10**6})
    (tmp_path / "f.csv.gz").write_bytes(gzip.compress(b"0" * 10**7))
    with zipfile.ZipFile(tmp_path / "f.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("f.csv", b"0" * 10**7)
    for bomb in ("f.csv.gz", "f.zip"):
        with pytest.raises(UsageError, match=r"more than 1,000,000 bytes\..*\[files\] size ="):
            read_sessions(tmp_path / bomb, scene=scene)


@pytest.mark.parametrize(
    ("limits", "message"),
    [({"rows": 3}, "3 rows"), ({"cells": 15}, "15 cells"), ({"size": 50}, "50 bytes")],
)
def test_plain_text_meets_the_limits_of_all_files(tmp_path, limits, message):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "".join(f"{s},a,10,1{s}\n" for s in range(4)))
    (limit,) = limits
    with pytest.raises(UsageError, match=rf"more than {message}\..*\[files\] {limit} ="):
        read_sessions(file, scene=Scene(files=limits))


def test_many_members_of_an_archive_count_together(tmp_path):
    with zipfile.ZipFile(tmp_path / "f.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(30):
            archive.writestr(f"{number}.csv", HEAD + f"{number},a,10,11\n" * 10)
    with pytest.raises(UsageError, match=r"f\.zip: more than 3,000 bytes"):
        read_sessions(tmp_path / "f.zip", scene=Scene(files={"size": 3000}))
    scene = Scene(files={"size": 10**4}, sessions={"trial": "order"})
    assert len(read_sessions(tmp_path / "f.zip", scene=scene).subjects) == 30


def test_a_stream_without_end_is_cut_off(tmp_path):
    fifo = tmp_path / "fifo.csv"
    os.mkfifo(fifo)
    scene = Scene(files={"size": 10**5})
    with (
        subprocess.Popen(["sh", "-c", f"cat /dev/zero > '{fifo}'"]),
        pytest.raises(UsageError, match="more than 100,000 bytes"),
    ):
        read_sessions(fifo, scene=scene)


def test_a_cell_in_the_far_corner_of_a_sheet(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (HEAD.strip().split(","), ["1", "a", 10, 11], ["2", "a", 10, 12]):
        book.active.append(row)
    book.active["XFD1048576"] = 1
    book.save(tmp_path / "t.xlsx")
    with pytest.raises(UsageError, match=r"more than 10,000,000 cells\..*\[files\] cells ="):
        read_sessions(tmp_path / "t.xlsx")


def test_a_small_parquet_file_of_many_rows(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    column = pa.DictionaryArray.from_arrays(pa.array([0] * 3_000_000, pa.int8()), ["a"])
    parquet.write_table(pa.table({"subject": column}), tmp_path / "t.parquet")
    assert (tmp_path / "t.parquet").stat().st_size < 10**5
    with pytest.raises(UsageError, match=r"more than 2,000,000 rows\..*\[files\] rows = 6000000"):
        read_sessions(tmp_path / "t.parquet")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"PK\x03\x04rubbish", "a broken archive"),
        (b"\x1f\x8brubbish", "a broken archive"),
        (gzip.compress(b"a,b\n1,2\n")[:-6], "a broken archive"),
        (gzip.compress(gzip.compress(b"a,b\n1,2\n")), "an archive inside an archive"),
    ],
    ids=["zip rubbish", "gzip rubbish", "cut off", "nested"],
)
def test_broken_archives(tmp_path, data, message):
    file = tmp_path / "f"
    file.write_bytes(data)
    with pytest.raises(UsageError, match=message):
        read_sessions(file)


@pytest.mark.parametrize(
    "body",
    [
        '"a,' * 30_000,
        '"' * 100_000,
        "a\\" * 50_000,
        '"\\' * 50_000,
        "1," * 9_000 + '"',
        "\r" * 100_000,
        "9" * 100_000,
        "_mean\t" * 15_000,
        "x_raw,y" * 14_000,
        "\ufeff" * 33_000,
        "[" * 100_000,
        ",,,\n" * 100_000,
    ],
)
@pytest.mark.parametrize("head", [HEAD, "subject,environment,k_ref,k_adj,expName\n", ""])
def test_time_is_linear_in_size(tmp_path, body, head):
    """A pattern that backtracks takes minutes of the processor at this size; no count of ours
    sees it."""
    file = tmp_path / "f.csv"
    file.write_text(head + body, newline="")
    start = time.process_time()
    with pytest.raises(UsageError) as caught:
        read_sessions(file)
    assert str(caught.value).startswith(str(file))
    assert time.process_time() - start < 10
