"""The classical verdict: its parts, its thresholds, and how often it errs."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from percept.boundary.confidence import (
    Confidence,
    SubjectPairs,
    confidence,
    limits_confidence,
)
from percept.boundary.feels_real import search_grid
from percept.errors import RefusalError
from percept.haptics import Coupling, Device, Environment
from percept.haptics.records import Display
from percept.inference.classical.central_range import central_range_confidence
from percept.inference.classical.moments import Moments

LEVEL, DECISION = 0.99, 0.95
WALL = Environment(stiffness=500.0, damping=2.0)
DISPLAY = Display(Device(mass=0.5, damping=5.0), WALL, 1e-3)
OMEGA = search_grid(0.1, 100.0, np.array([np.sqrt(500.0 / 0.5)]), np.array([0.05]))
SDS = np.array([0.15, 0.3])


def subjects(n, *, bias=(0.0, 0.0), seed=1):
    """Logarithms of what n users set, `bias` SDs above the wall."""
    rng = np.random.default_rng(seed)
    return np.log([500.0, 2.0]) + SDS * (np.array(bias) + rng.standard_normal((n, 2)))


def judged(values, display=DISPLAY):
    rng = np.random.default_rng(1)
    return confidence(
        display, SubjectPairs(values, log=True), OMEGA, level=LEVEL, decision=DECISION, rng=rng
    )


def test_stiffness_and_damping_are_those_of_the_noncentral_t():
    values = subjects(8)
    found = judged(values)
    for part, column, displayed in ((found.stiffness, 0, 500.0), (found.damping, 1, 2.0)):
        users = Moments.from_values(values[:, column])
        assert part == central_range_confidence(np.log(displayed), users)


def test_a_coupling_is_judged_at_its_least_favourable_omega():
    values = subjects(8)
    coupled = dataclasses.replace(DISPLAY, coupling=Coupling(stiffness=2_000.0, damping=20.0))
    shown = Coupling(stiffness=2_000.0, damping=20.0)
    softest = 500.0 * shown.stiffness / (500.0 + shown.stiffness)
    users = Moments.from_values(values[:, 0])
    expected = central_range_confidence(np.log(softest), users)
    assert judged(values, coupled).stiffness == pytest.approx(expected, rel=1e-3)


def test_two_subjects_have_no_verdict_of_the_magnitude():
    found = judged(subjects(2))
    assert found.magnitude is None
    assert found.together is None
    assert found.parts == (found.stiffness, found.damping)


def test_published_limits_judge_stiffness_and_damping_alone():
    values = subjects(6)
    stiffness = Moments.from_values(values[:, 0])
    damping = Moments.from_values(values[:, 1])
    published = limits_confidence(DISPLAY, stiffness, damping, OMEGA, level=LEVEL, log=True)
    assert published.magnitude is None
    assert published.parts == judged(values).parts[:2]


def test_subjects_about_the_wall_decide_and_few_do_not():
    assert judged(subjects(60)).verdict(DECISION) == "feels real"
    assert judged(subjects(60, bias=(4.0, 0.0))).verdict(DECISION) == "does not"
    assert judged(subjects(3)).verdict(DECISION) == "too little data"


def test_no_lognormal_user_feels_an_undamped_wall():
    undamped = dataclasses.replace(DISPLAY, environment=Environment(500.0, 0.0))
    found = judged(subjects(20), undamped)
    assert found.damping == 0.0
    assert found.verdict(DECISION) == "does not"


def test_thresholds():
    sure = Confidence(0.96, 0.97, 0.95, 10.0, 0.9, 0.01)
    assert sure.verdict(DECISION) == "feels real"
    assert dataclasses.replace(sure, damping=0.94).verdict(DECISION) == "too little data"
    assert dataclasses.replace(sure, damping=0.016).verdict(DECISION) == "does not"
    assert dataclasses.replace(sure, damping=0.018).verdict(DECISION) == "too little data"


def test_equal_subjects_are_refused():
    with pytest.raises(RefusalError, match="All users set the same value"):
        judged(np.log(np.full((4, 2), 3.0)))


@pytest.mark.parametrize("n", [3, 10])
def test_error_rates_of_stiffness_and_damping(n):
    studies = 1_200
    edge = stats.norm.isf(0.5 * (1.0 - LEVEL))
    rng = np.random.default_rng(n)
    scores = rng.standard_normal((studies, n, 2))
    said_real = dict.fromkeys((0.0, edge), 0)
    said_not = dict.fromkeys((0.0, edge), 0)
    for bias in said_real:
        for values in np.log([500.0, 2.0]) + SDS * (np.array([bias, 0.0]) + scores):
            stiffness = Moments(values[:, 0].mean(), values[:, 0].std(ddof=1), n)
            damping = Moments(values[:, 1].mean(), values[:, 1].std(ddof=1), n)
            verdict = limits_confidence(
                DISPLAY, stiffness, damping, OMEGA[[0, -1]], level=LEVEL, log=True
            ).verdict(DECISION)
            said_real[bias] += verdict == "feels real"
            said_not[bias] += verdict == "does not"
    error = 4.0 * np.sqrt(DECISION * (1.0 - DECISION) / studies)
    assert said_real[edge] / studies <= 1.0 - DECISION + error
    assert said_not[0.0] / studies <= 1.0 - DECISION + error
    assert said_real[0.0] > said_real[edge]
