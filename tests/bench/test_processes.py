"""The measurement runs, and tells a changed file."""

import pytest

from percept.bench import processes
from percept.bench.processes import process_gains


def test_two_processes_are_measured_beside_one():
    told = []
    found = process_gains([("fit", 0.1)], most=2, repeats=1, told=told.append)
    assert told == ["fit at 0.1: round 1"]
    assert [(one.task, one.tolerance, one.processes) for one in found] == [("fit", 0.1, 1), ("fit", 0.1, 2)]
    assert all(one.same for one in found)
    assert found[0].gain == 1.0
    assert found[1].gain == pytest.approx(found[0].wall_s / found[1].wall_s)


def test_other_files_show(monkeypatch):
    class Done:
        def __init__(self, command):
            self.stdout = f"digest of {command[-1]}\n"

    monkeypatch.setattr(processes.subprocess, "run", lambda command, **_: Done(command))
    found = process_gains([("report", 0.01)], most=2, repeats=2)
    assert [one.same for one in found] == [True, False]
