"""Files made to harm: nothing runs, nothing is written, nothing takes long."""

from __future__ import annotations

import gzip
import io
import struct
import time
import zipfile

import pytest

from percept.errors import UsageError
from percept.sessions import files, format_validation, read_sessions, validate

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


def test_formulas_are_neutralised_for_spreadsheets(tmp_path):
    file = tmp_path / "f.csv"
    ids = ["=1+1", "+1", "-1", "@SUM(A1)", "plain"]
    file.write_text(HEAD + "".join(f"{name},a,10,11\n" for name in ids))
    sessions = read_sessions(file)
    assert sessions.subjects == tuple(ids)
    sessions.to_csv(tmp_path / "out.csv", for_spreadsheets=True)
    cells = [line.split(",")[0] for line in (tmp_path / "out.csv").read_text().splitlines()[1:]]
    assert cells == ["'=1+1", "'+1", "'-1", "'@SUM(A1)", "plain"]
    sessions.to_csv(tmp_path / "own.csv")
    assert read_sessions(tmp_path / "own.csv").subjects == tuple(ids)


def test_a_line_of_a_million_columns(tmp_path):
    file = tmp_path / "f.csv"
    for count, message in (
        (10**5, "more than 20000 cells in a line"),
        (10**6, "a line of more than 262144 "),
    ):
        for name in ("a,", '"a",'):
            file.write_text(name * count + "\n1\n")
            with pytest.raises(UsageError, match=message):
                read_sessions(file)


def test_nul_bytes(tmp_path):
    file = tmp_path / "f.csv"
    file.write_bytes(HEAD.encode() + b"1,a,10,\x0011\n")
    with pytest.raises(UsageError, match=r"f\.csv:2: a NUL character"):
        read_sessions(file)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_before_a_nul_byte_are_counted_at_every_kind_of_end(tmp_path, end):
    file = tmp_path / "f.csv"
    file.write_bytes(end.join(["a,b", "1,2", "3,\0", ""]).encode())
    with pytest.raises(UsageError, match="a NUL character") as caught:
        read_sessions(file)
    assert caught.value.row == 3


def claiming(size: int) -> bytes:
    """A zip archive whose directory claims a member of `size` bytes."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("f.csv", HEAD)
    data = bytearray(out.getvalue())
    extra = struct.pack("<HHQ", 1, 8, size)
    directory = data.index(b"PK\x01\x02")
    data[directory + 24 : directory + 28] = b"\xff\xff\xff\xff"
    data[directory + 30 : directory + 32] = struct.pack("<H", len(extra))
    name_end = directory + 46 + len("f.csv")
    data[name_end:name_end] = extra
    end = data.index(b"PK\x05\x06")
    data[end + 12 : end + 16] = struct.pack("<I", end - directory)
    return bytes(data)


def test_a_member_that_claims_ten_gigabytes(tmp_path):
    file = tmp_path / "f.zip"
    file.write_bytes(claiming(10 * 10**9))
    with pytest.raises(UsageError, match="a member claims 10000000000 bytes"):
        read_sessions(file)


def test_bombs_are_cut_off(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "LIMIT", 10**6)
    bomb = tmp_path / "f.csv.gz"
    bomb.write_bytes(gzip.compress(b"0" * 10**7))
    with pytest.raises(UsageError, match="unpacks to more than 1000000 bytes"):
        read_sessions(bomb)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"PK\x03\x04rubbish", "a broken zip archive"),
        (b"\x1f\x8brubbish", "a broken gz file"),
        (gzip.compress(b"a,b\n1,2\n")[:-6], "a broken gz file"),
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
    """A pattern that backtracks takes minutes of the processor at this size; no count of ours sees it."""
    file = tmp_path / "f.csv"
    file.write_text(head + body, newline="")
    start = time.process_time()
    with pytest.raises(UsageError) as caught:
        read_sessions(file)
    assert str(caught.value).startswith(str(file))
    assert time.process_time() - start < 10
