"""The reader's cost beside pandas', measured on a study it accepts."""

from __future__ import annotations

import json

from percept.bench import reader
from percept.sessions import read_sessions


def test_the_study_it_writes_is_one_the_reader_accepts(tmp_path):
    reader.write_study(tmp_path / "study.csv", 2000)
    sessions = read_sessions(tmp_path / "study.csv")
    assert len(sessions.table) == 2000
    assert len(sessions.environments) == 5
    assert sessions.notices == ()


def test_costs_are_printed_as_lines_of_json(capsys):
    assert reader.main(["--rows", "500", "--repeats", "1", "--tasks", "read_sessions"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["task"] for line in lines] == ["pandas", "read_sessions"]
    assert lines[0]["time_ratio"] == 1
    assert all(line["seconds"] > 0 and line["megabytes"] > 10 for line in lines)
