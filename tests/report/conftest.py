from __future__ import annotations

import pytest

from percept import Scene, Study, read_sessions
from percept.sessions import Sessions
from tests import DATASETS
from tests.documents import build_document
from tests.fits import SHARED


def scene_of(**inference):
    """The published scene with fewer frequencies."""
    tables = Scene.load(DATASETS / "hbfd.toml").to_dict()
    tables["frequency"]["points"] = 31
    tables["inference"] |= {"method": "classical", **inference}
    return Scene(**tables)


@pytest.fixture(scope="session")
def classical_study():
    return Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene_of())


@pytest.fixture(scope="session")
def classical(classical_study):
    """Document of the classical analysis of the published study."""
    return build_document(classical_study)


@pytest.fixture(scope="session")
def both_study():
    """Both methods on three of the environments, sampled to a loose accuracy."""
    sessions = read_sessions(DATASETS / "hbfd_sessions.csv")
    kept = sessions.table[sessions.table["environment"].isin(["VE1", "VE2", "VE4"])]
    return Study(Sessions.from_frame(kept), scene_of(method="both", tolerance=0.1), store=SHARED)


@pytest.fixture(scope="session")
def both(both_study):
    return build_document(both_study)


@pytest.fixture(scope="session")
def report(both_study, tmp_path_factory):
    """Folder of a written report."""
    out = tmp_path_factory.mktemp("report") / "out"
    both_study.report(out, date="2026-01-01")
    return out
