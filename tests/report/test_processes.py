"""A report written by two processes is that of one, byte for byte."""

from __future__ import annotations

import pytest

from percept import Study, read_sessions
from percept.report import write_report
from percept.sessions import Sessions

from .conftest import DATASETS, scene_of


@pytest.fixture(scope="module")
def sessions():
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    return Sessions.from_frame(table[table["environment"].isin(["VE2", "VE4"])])


def test_two_processes_write_the_files_of_one(sessions, tmp_path):
    written = []
    for processes in (1, 2):
        study = Study(sessions, scene_of(method="both", tolerance=0.1))
        out = tmp_path / str(processes)
        write_report(study, out, date="2026-01-01", processes=processes)
        written.append(
            {path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()}
        )
    assert len(written[0]) > 20
    assert written[0] == written[1]
