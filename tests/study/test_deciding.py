"""How many more subjects would decide: critical distances, and the promise in simulated studies."""

import numpy as np
import pytest

from percept.boundary.confidence import PARTS, SubjectPairs, confidence
from percept.boundary.feels_real import search_grid
from percept.boundary.users import Users
from percept.haptics import Device, Environment
from percept.haptics.records import Display
from percept.inference.classical.central_range import central_range_confidence
from percept.inference.classical.fiducial import fiducial_draws
from percept.inference.classical.moments import Moments
from percept.study.deciding import ASSURANCE, Critical, more_subjects
from tests import LONG

LEVEL, DECISION = 0.99, 0.95
WALL = Environment(stiffness=500.0, damping=2.0)
DISPLAY = Display(Device(mass=0.5, damping=5.0), WALL, 1e-3)
OMEGA = search_grid(0.1, 100.0, np.array([np.sqrt(500.0 / 0.5)]), np.array([0.05]))
SDS = np.array([0.15, 0.3])


def known_subjects(n=6, *, bias=1.6, seed=2):
    """Logarithms of what n users set, whose mean stiffness and damping lie `bias` SDs off."""
    rng = np.random.default_rng(seed)
    scores = rng.standard_normal((n, 2))
    scores = (scores - scores.mean(axis=0)) / scores.std(axis=0, ddof=1)
    return np.log([500.0, 2.0]) + SDS * (bias * np.array([1.0, -0.5]) + scores)


def truths_of(values, count, seed=1):
    draws = fiducial_draws(values, count, np.random.default_rng(seed))
    return Users.of(draws.mean, draws.covariance, log=True)


def predicted(values, truths, display=DISPLAY):
    return more_subjects(
        display,
        SubjectPairs(values, log=True),
        truths,
        OMEGA,
        level=LEVEL,
        decision=DECISION,
        rng=np.random.default_rng(3),
    )


def share_decided(values, more, studies):
    """Share of studies that so many real subjects more decide, of other truths than the plan's."""
    rng = np.random.default_rng(4)
    draws = fiducial_draws(values, studies, rng)
    decided = 0
    for mean, covariance in zip(draws.mean, draws.covariance, strict=True):
        new = rng.multivariate_normal(mean, covariance, more)
        pairs = SubjectPairs(np.concatenate([values, new]), log=True)
        found = confidence(DISPLAY, pairs, OMEGA, level=LEVEL, decision=DECISION, rng=rng)
        decided += found.verdict(DECISION) != "too little data"
    return decided / studies


@pytest.mark.parametrize("n", [2, 3, 7, 30, 400])
def test_critical_distances_are_where_the_confidence_crosses(n):
    critical = Critical(LEVEL, DECISION)
    users = Moments(0.0, 1.0, n)
    distances = critical.real(np.array(float(n))), critical.does_not(np.array(float(n)))
    for distance, expected in zip(distances, (DECISION, (1.0 - DECISION) / PARTS), strict=True):
        found = central_range_confidence(float(distance), users, level=LEVEL)
        assert found == pytest.approx(expected, rel=0.01)


@pytest.mark.evidence(reduced=True)
def test_the_predicted_number_decides_as_often_as_promised():
    values = known_subjects()
    plan = predicted(values, truths_of(values, 1_024))
    assert plan.subjects is not None
    assert plan.lower <= plan.subjects <= (plan.upper or plan.most)
    studies = 400 if LONG else 12
    share = share_decided(values, plan.subjects, studies)
    error = np.hypot(plan.error, np.sqrt(ASSURANCE * (1.0 - ASSURANCE) / studies))
    assert abs(share - plan.probability) <= 4.0 * error
    # A number that is far too small would not pass.
    if LONG:
        assert share_decided(values, max(1, plan.subjects // 8), studies) < ASSURANCE - 4.0 * error


def test_few_are_enough_where_users_are_near_and_known_well():
    near = known_subjects(bias=0.0)
    far = known_subjects()
    plans = [predicted(values, truths_of(values, 256)) for values in (near, far)]
    assert plans[0].subjects < plans[1].subjects


def test_a_display_at_the_edge_is_not_decided_by_a_thousand():
    values = known_subjects(bias=2.5758) + np.array([0.0, 0.5 * 2.5758 * SDS[1]])
    edge = np.log([500.0, 2.0])[:, None] + np.array([[2.5758 * SDS[0]], [0.0]])
    truths = Users(True, np.tile(edge, 64), np.tile(SDS[:, None], 64), np.zeros(64))
    plan = predicted(values, truths)
    assert plan.subjects is None
    assert plan.upper is None
    assert plan.probability < ASSURANCE


def test_no_user_of_a_wall_without_damping():
    values = known_subjects()
    undamped = Display(DISPLAY.device, Environment(500.0, 0.0), 1e-3)
    assert predicted(values, truths_of(values, 64), undamped).subjects == 1
