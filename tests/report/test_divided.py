"""A report written by two processes is that of one, byte for byte."""

from __future__ import annotations

import pytest

from percept import Study, read_sessions
from percept.inference.share import ALONE
from percept.report import write_report
from percept.report.divided import divided
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


def test_the_other_process_takes_a_part(sessions):
    study = Study(sessions, scene_of())
    alone = Study(sessions, scene_of()).boundaries
    with divided(study, 2) as beside:
        assert study.share is beside
        # An answer tells that the other process has imported what it was told to.
        beside.ask(abs, -1)()
        together = study.boundaries
        assert beside.answered == 2
    assert study.share is ALONE
    assert len(together) == len(alone) > 4
    for one, other in zip(together, alone, strict=True):
        assert (one.environment, one.kind, one.shape) == (other.environment, other.kind, other.shape)
        assert one.lower.tobytes() == other.lower.tobytes()
        assert one.upper.tobytes() == other.upper.tobytes()
