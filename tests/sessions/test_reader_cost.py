"""The reader's cost beside pandas', measured on a study the reader accepts."""

import json

from percept.sessions import read_sessions
from tests.sessions.reader_cost import main, write_study


def test_the_study_it_writes_is_one_the_reader_accepts(tmp_path):
    assert write_study(tmp_path / "study.csv", 2000) == 2000
    sessions = read_sessions(tmp_path / "study.csv")
    assert len(sessions.table) == 2000
    assert len(sessions.environments) == 5
    assert sessions.notices == ()


def test_both_ways_are_timed(capsys):
    main(["--rows", "500", "--repeats", "1"])
    pandas, ours = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (pandas["way"], ours["way"]) == ("pandas", "percept")
    assert pandas["time_ratio"] == pandas["memory_ratio"] == 1.0
    assert ours["cpu_ratio"] == ours["cpu_seconds"] / pandas["cpu_seconds"]
    assert all(
        cost["rows"] == 500 and cost["seconds"] > 0 and cost["megabytes"] > 10
        for cost in (pandas, ours)
    )
