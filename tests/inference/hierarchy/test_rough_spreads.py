"""Where the coordinates of the spreads between subjects lie, and how long their unit is."""

import math

import numpy as np
import pytest

from percept.inference.hierarchy import coordinates
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.models import IntervalEstimands, Pooled
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import from_summary, from_trials
from percept.inference.sampling.records import Settings
from percept.inference.sampling.run import sample

#: Deviations of each subject's trials about the subject's mean, in units of d.
SUBJECTS = ((0.1, (-1, 1)), (0.3, (-1, 1, -1, 1)), (0.5, (-1, 1)))


def layout_of(rows, environments=1):
    """Layout of the model of k for rows (subject, environment, response)."""
    subject, environment, response = (np.array(column) for column in zip(*rows, strict=True))
    statistics = from_trials(
        response[:, None].astype(float), subject, environment, np.linspace(0.0, 1.0, environments)[None],
        parameters=("k",), environments=tuple(f"VE{j + 1}" for j in range(environments)),
        subjects=tuple(f"S{i + 1}" for i in range(subject.max() + 1)),
    )  # fmt: skip
    return CollapsedDensity(statistics, Priors()).layout


def repeated(d, environment=0):
    return [
        (i, environment, mean + d * sign)
        for i, (mean, signs) in enumerate(SUBJECTS)
        for sign in signs
    ]  # fmt: skip


def weights(layout):
    """Weights of the rough likelihood, which shorten the unit of the coordinates."""
    units = (layout.limits / coordinates.LIMIT) ** 2
    found = dict(zip(layout.names, units - 1.0, strict=True))
    return [found[name] for name in layout.names if name.startswith("sigma[")]


# Between subjects s^2 = .04. Between trials s_e^2 = 8 d^2 / 5, and 1/r = (1/2 + 1/4 + 1/2)/3 = 5/12.
# So trials explain 2 d^2 / 3 of s^2 and leave the share 1 - d^2 / .06; 2 nu = 4.
@pytest.mark.parametrize(
    ("squared", "share"), [(0.01, 5 / 6), (0.03, 0.5), (0.0564, 0.06), (0.0576, 0.0), (0.09, 0.0)]
)
def test_scatter_between_trials_is_subtracted(squared, share):
    layout = layout_of(repeated(math.sqrt(squared)))
    weight = 4.0 * share**2
    assert weights(layout) == pytest.approx([weight], rel=1e-9, abs=1e-14)
    # At zero log sigma is the mean of its prior N(log .2, 1) and of the rough likelihood.
    middle = math.log(0.2)
    if share:
        middle = (middle + weight * 0.5 * math.log(0.04 * share)) / (1.0 + weight)
    found = layout.scales(np.zeros((layout.dimension, 1))).named["sigma"]
    assert found.ravel() == pytest.approx([math.exp(middle)], rel=1e-12)


def test_an_environment_without_repeats_takes_the_trials_of_the_others():
    once = [(i, 1, mean) for i, mean in enumerate((0.1, 0.5, 0.3))]
    layout = layout_of([*repeated(0.1), *once], environments=2)
    # s_e^2 = .016 of s^2 = .04 leaves 3/5 where r = 1.
    assert weights(layout) == pytest.approx([4 * (5 / 6) ** 2, 4 * (3 / 5) ** 2], rel=1e-12)


def test_a_missing_cell_counts_neither_its_subject_nor_its_trials():
    seen = [(i, 1, mean + 0.1 * sign) for i, mean in ((0, 0.1), (2, 0.5)) for sign in (-1, 1)]
    layout = layout_of([*repeated(0.1), *seen], environments=2)
    # Two subjects: s^2 = .08, s_e^2 = .04/2, r = 2, so trials leave 7/8 of s^2; 2 nu = 2.
    assert weights(layout) == pytest.approx([4 * (5 / 6) ** 2, 2 * (7 / 8) ** 2], rel=1e-12)


def test_without_repeats_all_scatter_is_between_subjects():
    once = [(i, 0, mean) for i, (mean, _) in enumerate(SUBJECTS)]
    assert weights(layout_of(once)) == pytest.approx([4.0])
    limits = from_summary(
        np.zeros(2), np.full(2, 0.2), np.array([10, 6]), np.zeros((1, 2)),
        parameter="k", environments=("VE1", "VE2"),
    )  # fmt: skip
    assert weights(CollapsedDensity(limits, Priors()).layout) == pytest.approx([18.0, 10.0])


def test_subjects_that_differ_less_than_their_trials_are_sampled_soon():
    """Coordinates placed by all of the scatter need 630 steps here, with an autocorrelation time of 52."""
    rng = np.random.default_rng(1)
    subject, environment, _ = (axis.ravel() for axis in np.indices((40, 6, 10)))
    response = (0.02 * rng.normal(size=(40, 6)))[subject, environment] + 0.1 * rng.normal(size=subject.size)
    rows = list(zip(subject, environment, response, strict=True))
    model = Pooled(CollapsedDensity(layout_of(rows, environments=6).statistics, Priors()))
    run = sample(
        model,
        IntervalEstimands(model, kinds=("mean", "user")),
        Settings(tolerance=0.05, seed=1, most_steps=250),
    )
    assert run.gate.passed, run.gate.reasons
    assert run.gate.autocorrelation_time < 25
