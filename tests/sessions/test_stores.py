"""Tables in JSON, SQLite, MATLAB, R and workbooks of several sheets, against the same frame."""

from __future__ import annotations

import base64
import bz2
import gzip
import json
import lzma
import sqlite3
import struct
import zlib

import numpy as np
import pandas as pd
import pytest
import rdata
from scipy.io import savemat

from percept import Scene
from percept.errors import UsageError
from percept.sessions import Sessions, read_sessions

NAMES = ["subject", "environment", "k_ref", "k_adj"]
ROWS = [
    (subject, wall, reference, reference + shift + 0.25 * trial)
    for trial, (subject, shift) in enumerate([("P01", 1.5), ("P02", -3.0), ("Zoë", 0.125)])
    for wall, reference in (("soft", 300.0), ("hard", 900.0))
]
FRAME = pd.DataFrame(ROWS, columns=NAMES)


def same_as_frame(*paths, **tables):
    sessions = read_sessions(*paths, scene=Scene(**tables))
    expected = Sessions.from_frame(FRAME, scene=Scene(**tables))
    pd.testing.assert_frame_equal(sessions.table, expected.table, check_exact=True)
    return sessions


def refusal(path, **tables):
    with pytest.raises(UsageError) as caught:
        read_sessions(path, scene=Scene(**tables))
    return str(caught.value)


def records():
    return [dict(zip(NAMES, row, strict=True)) for row in ROWS]


JSON = {
    "list.json": lambda: json.dumps(records()),
    "nested.json": lambda: json.dumps([records()[:2], records()[2:]]),
    "keyed.json": lambda: json.dumps({"version": 3, "trials": records()}),
    "columns.json": lambda: json.dumps(FRAME.to_dict("list")),
    "lines.jsonl": lambda: "\n".join(json.dumps(record) for record in records()),
    "subjects.jsonl": lambda: "\r\n".join([json.dumps(records()[:2]), json.dumps(records()[2:])]),
    "marked.txt": lambda: "\ufeff" + json.dumps(records(), ensure_ascii=False, indent=1),
}


@pytest.mark.parametrize("name", JSON)
def test_json_is_read_however_it_is_laid_out(tmp_path, name):
    path = tmp_path / name
    path.write_text(JSON[name](), encoding="utf-8")
    same_as_frame(path)


def test_numbers_of_json_keep_their_digits_and_cells_their_records(tmp_path):
    response = '"response": {"k": 0.1000000000000000055}'
    text = f'[{{"subject": 1, "environment": "a", "k_ref": 10, {response}}}]'
    (tmp_path / "j.json").write_text(text)
    columns = {"k_adj": {"name": "response", "path": "k", "unit": "N/mm"}}
    found = read_sessions(tmp_path / "j.json", scene=Scene(columns=columns))
    assert found.table["k_adj"].tolist() == [100.0]


def test_json_that_holds_no_records_is_refused(tmp_path):
    path = tmp_path / "j.json"
    for text, message in (
        ('{"a": 1, "b": 2}', "there is no column for"),
        ('[{"k_adj": 1, "k_adj": 2}]', "the record has a key twice"),
        ('[{"a": 1}, 3]', "this JSON is not a list of records"),
        ('{"one": [{"a": 1}], "two": [{"a": 1}]}', "several tables; there are 'one', 'two'"),
        ("[[" * 100_000, "a broken file"),
        ('[{"a": 1', "a broken file"),
    ):
        path.write_text(text)
        assert message in refusal(path)
    path.write_text(json.dumps(records()))
    assert "more than 3 rows." in refusal(path, files={"rows": 3})


def database(path, **tables):
    connection = sqlite3.connect(path)
    for name, frame in tables.items():
        frame.to_sql(name, connection, index=False)
    connection.commit()
    connection.close()


def test_a_table_of_a_database_is_named_behind_colons(tmp_path):
    path = tmp_path / "study.db"
    database(path, trials=FRAME)
    same_as_frame(path)
    database(path, people=pd.DataFrame({"subject": ["P01"], "age": [30]}))
    message = refusal(path)
    assert "the file holds several tables; there are 'trials', 'people'." in message
    assert f"Name one behind two colons: {path}::trials." in message
    found = same_as_frame(f"{path}::trials")
    assert found.sources[0].name == f"{path}::trials"
    same_as_frame(path, sessions={"sheet": "trials"})
    assert "no such table" in refusal(f"{path}::nothing")
    assert "more than 2 rows." in refusal(f"{path}::trials", files={"rows": 2})


def test_views_of_a_database_are_not_run(tmp_path):
    path = tmp_path / "study.db"
    database(path, trials=FRAME)
    connection = sqlite3.connect(path)
    endless = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x FROM n"
    connection.execute(f"CREATE VIEW endless AS {endless}")
    connection.commit()
    connection.close()
    same_as_frame(path)
    assert "no such table" in refusal(f"{path}::endless")


def test_a_broken_database_says_so(tmp_path):
    path = tmp_path / "study.db"
    database(path, trials=FRAME)
    path.write_bytes(path.read_bytes()[:150])
    assert "a broken file: " in refusal(path)


def columns():
    # MATLAB knows char arrays and cells of them.
    cells = {name: FRAME[name].to_numpy(dtype=object) for name in ("subject", "environment")}
    return cells | {name: FRAME[name].to_numpy() for name in ("k_ref", "k_adj")}


STRUCT = [(name, object) for name in NAMES]
MATLAB = {
    "a struct of columns": lambda: {"trials": columns()},
    "an array of structs": lambda: {"trials": np.array(ROWS, dtype=STRUCT)},
    "vectors": lambda: {**columns(), "note": "first pilot"},
}


@pytest.mark.parametrize("layout", MATLAB)
def test_matlab_is_read_however_it_is_laid_out(tmp_path, layout):
    savemat(tmp_path / "m.mat", MATLAB[layout](), do_compression=layout == "vectors")
    same_as_frame(tmp_path / "m.mat")


@pytest.mark.parametrize("place", [324, 340])
def test_what_matlab_does_not_write_is_refused(tmp_path, place):
    # SciPy 1.17 ends with a segmentation fault on both.
    path = tmp_path / "m.mat"
    savemat(path, MATLAB["a struct of columns"]())
    broken = bytearray(path.read_bytes())
    broken[place : place + 4] = (place == 340).to_bytes(4, "little")
    path.write_bytes(broken)
    assert "a broken file: " in refusal(path)


#: A variable T of MATLAB that is a table, as MATLAB saves it.
TABLE = base64.b64decode(
    "TUFUTEFCIDUuMCBNQVQtZmlsZSwgUGxhdGZvcm06IEdMTlhBNjQgICAgICAgICAgICAgICAgICAgICAgICAgICAg"
    "ICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAgICAYAQAAAAAAAAABSU0OAAAA"
    "kAAAAAYAAAAIAAAAEQAAAAAAAAABAAAAAQAAAFQAAAAAAAAAAQAAAAQAAABNQ09TAAAAAAEAAAAFAAAAdGFibGUA"
    "AAAOAAAASAAAAAYAAAAIAAAADQAAAAAAAAAFAAAACAAAAAYAAAABAAAAAQAAAAAAAAAGAAAAGAAAAAAAAN0CAAAA"
    "AQAAAAEAAAABAAAAAQAAAA4AAAA4AAAABgAAAAgAAAAJAAAAAAAAAAUAAAAIAAAAAQAAAAgAAAABAAAAAAAAAAIA"
    "AAAIAAAAAAAAAAAAAAA="
)


@pytest.mark.parametrize("packed", [False, True])
def test_a_table_of_matlab_says_how_it_is_saved(tmp_path, packed):
    head, content = TABLE[:128], TABLE[128:]
    if packed:
        content = zlib.compress(content)
        content = struct.pack("<II", 15, len(content)) + content
    (tmp_path / "m.mat").write_bytes(head + content)
    said = refusal(tmp_path / "m.mat")
    assert "T is a table of MATLAB, an object that only MATLAB reads." in said
    assert "writetable(T, 'T.csv'), or S = table2struct(T, 'ToScalar', true);" in said


def test_what_a_file_of_matlab_unpacks_to_is_held_to_the_limits(tmp_path):
    path = tmp_path / "m.mat"
    savemat(path, {"s": {"a": np.zeros((25, 40)), "b": 1.0}}, do_compression=True)
    assert "more than 4,000 bytes." in refusal(path, files={"size": 4000})
    savemat(path, {"study": {"info": {"date": "2024-05-01"}, "trials": columns()}})
    assert "'study' hold no columns of one length, and no rows. Save the table" in refusal(path)
    # A thousand fields of a thousand structs that the file does not hold.
    savemat(path, {"s": np.empty((0, 1), dtype=[(f"f{i}", object) for i in range(1000)])})
    data = path.read_bytes()
    shape = struct.pack("<ii", 0, 1)
    assert data.count(shape) == 1
    path.write_bytes(data.replace(shape, struct.pack("<ii", 1000, 1)))
    assert "'s' hold no columns of one length, and no rows." in refusal(path)


def test_columns_of_a_matrix_have_numbers(tmp_path):
    matrix = np.array([[1, 1, 300, 310.5], [1, 2, 900, 890], [2, 1, 300, 305], [2, 2, 900, 1000]])
    savemat(tmp_path / "m.mat", {"data": matrix, "subjects": 2.0})
    names = {name: f"column {n}" for n, name in enumerate(NAMES, 1)}
    found = read_sessions(tmp_path / "m.mat", scene=Scene(columns=names))
    assert found.table["k_adj"].tolist() == matrix[:, 3].tolist()
    assert found.subjects == ("1", "2")


def test_matlab_files_that_are_not_read_say_why(tmp_path):
    path = tmp_path / "m.mat"
    savemat(path, {"data": np.zeros((40, 50))})
    assert "more than 100 cells." in refusal(path, files={"cells": 100})
    savemat(path, {"one": np.zeros((4, 5)), "two": np.zeros((4, 5))})
    assert "several tables; there are 'one', 'two'." in refusal(path)
    same = {"sessions": {"sheet": "two"}}
    assert "there is no column for" in refusal(path, **same)


def test_vectors_beside_a_shorter_struct_are_the_table(tmp_path):
    path = tmp_path / "m.mat"
    savemat(path, {**columns(), "info": {"date": "2024-05-01", "rate": 1000.0}})
    same_as_frame(path)
    # A struct that is named is read, and a longer one is the table.
    with pytest.raises(UsageError, match="there is no column for"):
        read_sessions(f"{path}::info")
    savemat(path, {"trials": columns(), "one": [1.0, 2.0], "two": [3.0, 4.0]})
    same_as_frame(path)


@pytest.mark.parametrize("head", [b"Octave-1-L\0\1", b"# Created by Octave 8.4.0\n"])
def test_octave_has_formats_of_its_own(tmp_path, head):
    path = tmp_path / "m.mat"
    path.write_bytes(head)
    assert "m.mat: this is a file of Octave's own. In Octave, save with -v7." in refusal(path)


def test_matlab_7_3_says_how_it_is_saved(tmp_path):
    (tmp_path / "m.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(600))
    said = refusal(tmp_path / "m.mat")
    assert "a MATLAB file of version 7.3, which percept does not read. Save it in MATLAB as" in said
    assert "save('T.mat', '-v7'), or by writetable(T, 'T.csv')." in said


def r_file(path, frame, name=None):
    plain = frame.astype(dict.fromkeys(("subject", "environment"), object))
    if name is None:
        rdata.write_rds(path, plain, compression=None)
    else:
        rdata.write_rda(path, {name: plain, "note": "pilot"}, compression=None)


@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress, lzma.compress])
def test_data_frames_of_r_are_read(tmp_path, pack):
    r_file(tmp_path / "plain.rds", FRAME)
    (tmp_path / "trials.rds").write_bytes(pack((tmp_path / "plain.rds").read_bytes()))
    same_as_frame(tmp_path / "trials.rds")
    r_file(tmp_path / "plain.rda", FRAME, "trials")
    (tmp_path / "trials.RData").write_bytes(pack((tmp_path / "plain.rda").read_bytes()))
    same_as_frame(tmp_path / "trials.RData")


def test_an_xz_file_unpacks_to_no_more_than_the_limit(tmp_path):
    path = tmp_path / "t.rds"
    path.write_bytes(lzma.compress(bytes(1 << 22)))
    assert "more than 1,000,000 bytes." in refusal(path, files={"size": 1_000_000})
    path.write_bytes(lzma.compress(b"X\n\0\0\0\3")[:40])
    assert "a broken archive: " in refusal(path)


def test_r_files_that_are_not_read_say_why(tmp_path):
    path = tmp_path / "t.rds"
    rdata.write_rds(path, [1.0, 2.0])
    assert "there is no data frame in this R file." in refusal(path)
    path.write_bytes(b"X\n\0\0\0\3\0\4")
    assert "a broken file: " in refusal(path)
    r_file(path, FRAME)
    assert "more than 2 rows." in refusal(path, files={"rows": 2})


def test_a_sequence_that_r_writes_as_its_length_is_held_to_the_limit(tmp_path):
    # 1:2e9 of R is a few bytes in a file: an ALTREP of class compact_intseq.
    pairlist = b"\0\0\0\2"
    symbol = b"\0\0\0\1\0\4\0\x09"
    state = b"\0\0\0\x0e\0\0\0\3" + np.array([2e9, 1, 1], dtype=">f8").tobytes()
    name = b"compact_intseq"
    info = pairlist + symbol + len(name).to_bytes(4, "big") + name
    info += pairlist + symbol + b"\0\0\0\4base" + pairlist + b"\0\0\0\x0d\0\0\0\1\0\0\0\x0d"
    info += b"\0\0\0\xfe"
    data = b"X\n\0\0\0\3\0\4\2\0\0\3\5\0\0\0\0\5UTF-8\0\0\0\xee" + info + state + b"\0\0\0\xfe"
    (tmp_path / "t.rds").write_bytes(data)
    assert "more than 2,000,000 rows" in refusal(tmp_path / "t.rds")


def test_files_of_all_formats_merge_in_a_folder(tmp_path):
    thirds = [FRAME[FRAME["subject"] == name] for name in FRAME["subject"].unique()]
    (tmp_path / "a.json").write_text(thirds[0].to_json(orient="records"))
    database(tmp_path / "b.sqlite", trials=thirds[1])
    r_file(tmp_path / "c.rds", thirds[2])
    (tmp_path / "settings.json").write_text('{"practice": 3, "volume": 0.5}')
    sessions = same_as_frame(tmp_path)
    assert any("settings.json" in str(notice) for notice in sessions.notices)
