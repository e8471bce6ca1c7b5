"""Commands that are killed; `make evidence` kills more often, reports and the cache too."""

import pytest

from percept.files import write_whole
from tests import LONG
from tests.survival.kill import JOBS, Survival, check_whole


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("job", JOBS if LONG else ("batch",))
def test_killed_commands_leave_whole_files_and_come_to_the_same_end(tmp_path, job):
    kills = 12 if LONG else 1
    survival = Survival(tmp_path, seed=5, sampled=LONG, workers=2 if LONG else 1)
    assert survival.run(job, kills) >= 1


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("fit.json", b'{"schema": "percept'),
        ("a.npz", b"PK\x03\x04 half"),
        ("posterior.nc", b"\x89HDF\r\n\x1a\n half"),
        ("report.html", b"<html><body>"),
        ("a.svg", b"<svg>"),
        (".percept", b"report.js"),
    ],
)
def test_the_check_tells_a_torn_file(tmp_path, name, data):
    write_whole(tmp_path / name, data)
    with pytest.raises(AssertionError, match="torn"):
        check_whole(tmp_path / name)
