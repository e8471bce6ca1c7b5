"""Commands where only what percept always needs is installed: no extra's package can be
imported."""

import csv
import os
import subprocess
import sys
from importlib import metadata

import pytest
from packaging.requirements import Requirement

from tests import DATASETS
from tests.batch.conftest import study_text

SESSIONS = str(DATASETS / "hbfd_sessions.csv")
HIDING = """
import sys
for name in {names!r}:
    sys.modules[name] = None
"""


def of_extras_only():
    """Names that the packages of extras are imported by."""
    requirements = [Requirement(line) for line in metadata.requires("percept-haptics")]
    needed = {r.name for r in requirements if not r.marker}
    extras = {r.name for r in requirements if r.marker} - needed
    assert {"dask", "pyarrow", "openpyxl"} <= extras
    return sorted({name.replace("-", "_") for name in extras} | {"distributed"})


@pytest.fixture
def percept(tmp_path):
    """Run percept in a process that finds no extra, nor do the processes it starts."""
    (tmp_path / "hiding").mkdir()
    hiding = HIDING.format(names=of_extras_only())
    (tmp_path / "hiding" / "sitecustomize.py").write_text(hiding)
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "hiding")}

    def run(*words):
        return subprocess.run(
            [sys.executable, "-m", "percept", *words],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_a_batch_on_two_processes(percept, tmp_path):
    for i in range(2):
        (tmp_path / f"s{i}.csv").write_text(study_text(i))
    studies = [str(tmp_path / f"s{i}.csv") for i in range(2)]
    words = ["--method", "classical", "--workers", "2", "--out", str(tmp_path / "out")]
    ran = percept("batch", *studies, *words)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.startswith("2 studies (2 done): 0 finished before, 2 now\n")
    with (tmp_path / "out" / "batch.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(dict.fromkeys(row["study"] for row in rows)) == studies


@pytest.mark.evidence
def test_calibration_as_it_is_recommended(percept, tmp_path):
    """On as many processes as there are cores, one of which may be this one."""
    words = ["--from", "prior", "--method", "classical", "--studies", "2", "--quiet"]
    ran = percept("calibrate", SESSIONS, *words, "--out", str(tmp_path / "out"))
    assert (ran.returncode, ran.stderr) == (0, "")
    assert (tmp_path / "out" / "coverage.md").exists()
