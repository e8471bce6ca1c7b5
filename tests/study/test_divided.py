"""What two processes work out together is what one does, and the other takes a part of it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, read_sessions
from percept.inference.share import ALONE
from percept.study.divided import divided, for_sampling
from percept.study.left_out import leave_one_environment_out
from tests import DATASETS
from tests.study.checked import study_of, table_of


def together(study, asked):
    """What is asked of a study with another process beside it, and how many calls that one answered."""
    with divided(study, count=2) as beside:
        assert study.share is beside
        # An answer tells that the other process has imported what it was told to.
        beside.ask(abs, -1)()
        before = beside.answered
        found = asked(study)
        answered = beside.answered - before
    assert study.share is ALONE
    return found, answered


def test_boundaries():
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    kept = read_sessions(DATASETS / "hbfd_sessions.csv")
    ours, alone = (Study(kept, scene) for _ in range(2))
    found, answered = together(ours, lambda study: study.boundaries)
    assert answered >= 1
    assert len(found) == len(alone.boundaries) > 4
    for one, other in zip(found, alone.boundaries, strict=True):
        assert (one.environment, one.kind, one.shape) == (other.environment, other.kind, other.shape)
        assert one.lower.tobytes() == other.lower.tobytes()
        assert one.upper.tobytes() == other.upper.tobytes()


@pytest.fixture(scope="module")
def planted():
    """A subject far from the others, whom reweighting cannot leave out."""
    table = table_of(("k",), subjects=8, seed=3)
    table.loc[table["subject"] == "S04", "k_adj"] *= np.exp(1.5)
    return table


@pytest.mark.parametrize(
    ("asked", "runs"),
    [
        (lambda study: leave_one_environment_out(study).rows, 3),
        (lambda study: study.model_choice.table, 5),
    ],
)
def test_every_sampling_beside_the_fit(asked, runs):
    ours, alone = (study_of(table_of(), tolerance=0.3) for _ in range(2))
    found, answered = together(ours, asked)
    assert answered >= runs
    pd.testing.assert_frame_equal(found, asked(alone), check_exact=True)


def test_samplings_without_a_subject(planted):
    ours, alone = (study_of(planted, checks={"refit": True}, tolerance=0.3) for _ in range(2))
    assert ours.fit is not None
    found, answered = together(ours, lambda study: study.checks.loo.subjects)
    assert found["refitted"].any()
    assert answered >= found["refitted"].sum()
    pd.testing.assert_frame_equal(found, alone.checks.loo.subjects, check_exact=True)


def test_studies_over_other_sessions_share_alike():
    study = study_of(table_of())
    with divided(study, count=1) as beside:
        assert study.over(study.sessions).share is beside


def test_short_fits_stay_in_one_process():
    long, soon = (study_of(table_of(), tolerance=tolerance) for tolerance in (0.01, 0.02))
    classical = study_of(table_of(), tolerance=0.001, method="classical")
    assert for_sampling(long, soon) is None
    assert for_sampling(long, count=3) == 3
    assert for_sampling(soon, classical) == 1
