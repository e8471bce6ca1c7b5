"""What a hostile file, name or formula would do: hang, fill the memory, run, or raise."""

import gzip
import json
import sqlite3
import time

import numpy as np
import pandas as pd
import pytest
import rdata

from percept import Scene, Sessions, Study, read_sessions
from percept.batch import encode
from percept.cli import main
from percept.errors import RefusalError, UsageError
from percept.report import rewrite_report
from percept.report.overview import findings
from percept.sessions.options import terms_of

FILES = {"size": 100_000}


def trials(environment="hard"):
    """A row per subject and environment, as records."""
    rng = np.random.default_rng(4)
    rows = []
    for subject in ("P1", "P2", "P3"):
        for name, reference in ((environment, 900.0), ("soft", 300.0)):
            adjusted = reference * rng.lognormal(0.0, 0.2)
            rows.append({"subject": subject, "environment": name, "k_ref": reference})
            rows[-1]["k_adj"] = round(adjusted, 3)
    return rows


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("*".join(f"c{i}" for i in range(40)), "has more than 200 terms"),
        ("+".join(["a"] * 20_000 + ["b:c"]), "has an interaction without b"),
        ("(" * 900 + "a" + ")" * 900, "is not a formula"),
    ],
)
def test_a_formula_that_grows_without_end_is_refused(formula, message):
    start = time.monotonic()
    with pytest.raises(UsageError, match=message):
        terms_of(formula, key="model.bias")
    assert time.monotonic() - start < 2.0


def test_a_column_named_many_times_is_one_term():
    assert terms_of("*".join(["a"] * 60), key="model.bias") == (("a",),)


def test_generated_columns_of_a_database_are_held_to_the_bytes(tmp_path):
    path = tmp_path / "s.db"
    connection = sqlite3.connect(path)
    connection.execute(
        "CREATE TABLE t (subject, environment, k_ref, k_adj,"
        " note AS (replace(hex(zeroblob(5000)), '00', 'ab')))"
    )
    rows = [tuple(row.values()) for row in trials()]
    connection.executemany("INSERT INTO t VALUES (?, ?, ?, ?)", 4 * rows)
    connection.commit()
    connection.close()
    with pytest.raises(UsageError, match="more than 100,000 bytes"):
        read_sessions(path, scene=Scene(files=FILES))


def test_a_text_many_times_and_a_frame_are_held_to_the_bytes(tmp_path):
    frame = pd.DataFrame(trials()).assign(note="x" * 20_000)
    with pytest.raises(UsageError, match="more than 100,000 bytes"):
        Sessions.from_frame(frame, scene=Scene(files=FILES))
    with pytest.raises(UsageError, match="more than 4 rows"):
        Sessions.from_frame(frame, scene=Scene(files={"rows": 4}))


def test_sequences_of_r_count_together(tmp_path):
    """Each of three is within the limit of cells."""
    three = rdata.parser.DEFAULT_ALTREP_MAP
    assert b"compact_intseq" in three
    symbol = b"compact_intseq"
    info = b"\0\0\0\2\0\0\0\1\0\4\0\x09" + len(symbol).to_bytes(4, "big") + symbol
    info += b"\0\0\0\2\0\0\0\1\0\4\0\x09\0\0\0\4base"
    info += b"\0\0\0\2\0\0\0\x0d\0\0\0\1\0\0\0\x0d\0\0\0\xfe"
    state = b"\0\0\0\x0e\0\0\0\3" + np.array([900.0, 1, 1], dtype=">f8").tobytes()
    sequence = b"\0\0\0\xee" + info + state + b"\0\0\0\xfe"
    data = b"X\n\0\0\0\3\0\4\2\0\0\3\5\0\0\0\0\5UTF-8"
    data += b"\0\0\0\x13\0\0\0\3" + 3 * sequence
    (tmp_path / "t.rds").write_bytes(data)
    with pytest.raises(UsageError, match="more than 2,000 cells"):
        read_sessions(tmp_path / "t.rds", scene=Scene(files={"cells": 2000}))


def test_draws_of_a_device_are_held_to_the_bytes(tmp_path):
    (tmp_path / "draws.csv.gz").write_bytes(gzip.compress(b"damping\n" + b"16.0\n" * 100_000))
    device = {"mass": 1.0, "damping": 16.0, "period": 1e-3}
    posterior = {"parameters": ["damping"], "draws": str(tmp_path / "draws.csv.gz")}
    tables = {"device": {**device, "posterior": posterior}, "files": FILES}
    scene = Scene(coupling={"stiffness": 1e4, "damping": 50.0}, **tables)
    sessions = Sessions.from_frame(pd.DataFrame(trials()))
    with pytest.raises(UsageError, match="more than 100,000 bytes"):
        Study(sessions, scene.with_inference(method="classical")).coupling  # noqa: B018


def test_half_of_a_character_and_an_empty_frame_are_refused(tmp_path):
    rows = trials("wall \ud800")
    (tmp_path / "s.json").write_text(json.dumps(rows))
    for read in (
        lambda: read_sessions(tmp_path / "s.json"),
        lambda: Sessions.from_frame(pd.DataFrame(rows, dtype=object)),
    ):
        with pytest.raises(UsageError, match="half of a character"):
            read()
    with pytest.raises(UsageError, match="the file has no header"):
        Sessions.from_frame(pd.DataFrame())


def test_a_name_that_looks_like_a_part_of_the_page_breaks_nothing(tmp_path, capsys):
    name = '"><p class="caption" id="table-1" data-file="x"><script>alert(1)</script>'
    (tmp_path / "s.json").write_text(json.dumps(trials(name)))
    words = ["report", str(tmp_path / "s.json"), "--method", "classical", "--quiet"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    assert "<script>alert" not in (tmp_path / "out" / "report.html").read_text()
    names = {path.stem for path in (tmp_path / "out" / "tables").glob("*.tex")}
    assert "x" not in names
    assert "overview" in names


def test_a_name_of_its_own_in_every_row_is_no_environment():
    rows = [
        {"subject": f"P{subject}", "environment": f"E{wall}", "k_ref": 300.0 + wall, "k_adj": 310.0}
        for subject in range(2)
        for wall in range(2_000)
    ]
    start = time.process_time()
    with pytest.raises(RefusalError, match="2,000 environments are more than the 1,000"):
        Study(Sessions.from_frame(pd.DataFrame(rows)))
    assert time.process_time() - start < 5.0  # one on a quiet machine


def test_a_study_without_a_coupling_says_so():
    classical = {"inference": {"method": "classical"}}
    study = Study(Sessions.from_frame(pd.DataFrame(trials())), Scene(**classical))
    with pytest.raises(RefusalError, match=r"there is no coupling\. Give the scene a \[device\]"):
        study.coupling.eq10  # noqa: B018
    with_device = Scene(device={"mass": 1.0, "damping": 5.0, "period": 1e-3}, **classical)
    with pytest.raises(RefusalError, match=r"there is no coupling"):
        Study(study.sessions, with_device).coupling.eq10  # noqa: B018


def test_a_path_that_is_a_formula_is_text_in_a_batch():
    text = encode("=1+1.csv", "k", "refused", "-2 is wrong").rows
    assert text.startswith("'=1+1.csv,k,refused,'-2 is wrong,")


def test_a_report_of_parts_that_do_not_fit_is_refused(tmp_path):
    frame = pd.DataFrame(trials())
    scene = Scene(
        inference={"method": "classical"},
        device={"mass": 1, "damping": 5, "period": 1e-3},
        frequency={"points": 11},
    )
    frame = frame.assign(b_ref=5.0, b_adj=frame["k_adj"] / 100)
    results = Study(Sessions.from_frame(frame, scene=scene), scene).results()
    harmed = json.loads(results.to_json(findings(results)))
    curves = harmed["boundaries"]["lower"]
    curves[0] = curves[0][:-3]
    (tmp_path / "harmed.json").write_text(json.dumps(harmed))
    with pytest.raises(UsageError, match=r"harmed\.json: its parts do not fit each other"):
        rewrite_report(tmp_path / "harmed.json", tmp_path / "again")
