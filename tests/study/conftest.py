from __future__ import annotations

import pytest

from percept import Scene, Study, read_sessions
from tests import DATASETS
from tests.fits import SHARED
from tests.golden.studies import SEED, TOLERANCE


@pytest.fixture(scope="session")
def fitted() -> Study:
    """The published study of tests/golden, fitted once for all tests that only look at it."""
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=TOLERANCE, seed=SEED)
    study = Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene, store=SHARED)
    assert study.fit is not None
    assert study.fit.run.gate.passed
    return study
