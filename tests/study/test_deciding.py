"""How many more subjects would decide: the formula, and what simulated studies say of it."""

import numpy as np
import pytest
from scipy import special

from percept.boundary.confidence import PARTS
from percept.inference.classical.fiducial import central_range_confidence
from percept.inference.classical.moments import Moments
from percept.study.verdicts import ASSURANCE, more_subjects

CENTRAL, DECISION = 0.99, 0.95
EDGE = float(special.ndtri(0.5 * (1.0 + CENTRAL)))


def share_decided(score, n, *, studies=5_000):
    """Share of studies of n normal users that decide on a value `score` SDs from their mean."""
    rng = np.random.default_rng(4)
    mean = rng.standard_normal(studies) / np.sqrt(n)
    sd = np.sqrt(rng.chisquare(n - 1.0, studies) / (n - 1.0))
    users = Moments(mean, sd, np.full(studies, n))
    found = central_range_confidence(score, users, central=CENTRAL)
    return np.mean((found >= DECISION) | (found <= (1.0 - DECISION) / PARTS))


@pytest.mark.parametrize("score", [1.7, 2.0, 3.0, 3.2])
def test_the_number_decides_a_known_distance_as_often_as_it_should(score):
    found = more_subjects(np.array([score]), 10, central=CENTRAL, decision=DECISION)
    assert found.assurance == ASSURANCE
    assert found.subjects is not None
    assert share_decided(score, 10 + found.subjects) == pytest.approx(ASSURANCE, abs=0.08)


def test_a_display_at_the_edge_is_not_decided_by_a_thousand():
    found = more_subjects(np.full(8, EDGE), 10, central=CENTRAL, decision=DECISION)
    assert found.subjects is None
    assert found.most == 1_000
