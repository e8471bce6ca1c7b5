from __future__ import annotations

import pytest

from percept import Scene, Study, read_sessions
from tests import DATASETS


@pytest.fixture(scope="session")
def fitted() -> Study:
    """The study like the published one, fitted once for all tests that only look at it."""
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=0.03, seed=3)
    study = Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene)
    assert study.parts.fit is not None
    assert study.parts.fit.run.gate.passed
    return study
