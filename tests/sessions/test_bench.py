"""The commands that measure the reader do what they say."""

from __future__ import annotations

import json

from percept.bench import reader, session_fuzz
from percept.sessions import read_sessions


def test_the_study_it_writes_is_one_the_reader_accepts(tmp_path):
    reader.write_study(tmp_path / "study.csv", 2000)
    sessions = read_sessions(tmp_path / "study.csv")
    assert len(sessions.table) == 2000
    assert len(sessions.environments) == 5
    assert sessions.notices == ()


def test_costs_are_printed_as_lines_of_json(capsys):
    assert reader.main(["--rows", "500", "--repeats", "1", "--tasks", "reduce_sessions"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["task"] for line in lines] == ["pandas", "reduce_sessions"]
    assert lines[0]["time_ratio"] == 1
    assert all(line["seconds"] > 0 and line["megabytes"] > 10 for line in lines)


def test_the_fuzzer_reports_counts_and_failures(capsys):
    assert session_fuzz.main(["--files", "20", "--seed", "3"]) == 0
    assert capsys.readouterr().out.startswith("20 files, ")
    assert session_fuzz.main(["--files", "20", "--seed", "3", "--seconds", "0"]) == 1
    assert "FAILED seed 3 file 0: took" in capsys.readouterr().out
