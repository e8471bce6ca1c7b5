"""Small studies get their curves; `make evidence` takes 180 subsets of the published one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from percept import Scene, Study, read_sessions
from percept.sessions import Sessions
from tests import DATASETS, LONG

#: Coarse, so that a fit takes about a second.
TOLERANCE = 0.3
SUBJECTS = [f"S{number:02d}" for number in range(1, 11)]
SUBSETS = [("S01", "S02", "S03")]
if LONG:
    SUBSETS = [*itertools.combinations(SUBJECTS, 3)]
    SUBSETS += [*itertools.combinations(SUBJECTS, 4)][::4]


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("subjects", SUBSETS, ids="-".join)
def test_curves_of_few_subjects_are_drawn_or_said_to_be_missing(subjects: tuple[str, ...]) -> None:
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    chosen = table["subject"].isin(subjects)
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=TOLERANCE)
    if not LONG:
        chosen &= table["environment"] == "VE1"
        scene = scene.with_tables(frequency={"points": 41})
    study = Study(Sessions.from_frame(table[chosen]), scene)
    boundaries = study.boundaries
    assert {boundary.environment for boundary in boundaries} == set(study.data.environments)
    for boundary in boundaries:
        limits = np.concatenate([boundary.lower, boundary.upper])
        assert np.isfinite(limits).all(), boundary
        assert boundary.error is None or boundary.error <= 10.0 * TOLERANCE
    refused = [part.what for part in study.skipped_rows if " curves of " in part.what]
    shapes = [b for b in boundaries if b.shape in ("pointwise", "simultaneous")]
    # Every curve of a law is either drawn or said to be missing.
    assert len(shapes) + len(refused) >= 2 * len(study.curve_laws)
