"""Where the coordinates of the spreads between subjects lie, and how long their unit is."""

import numpy as np
import pytest

from percept.inference.model.limits import Limits
from percept.inference.model.model import plain_model
from percept.inference.model.statistics import from_trials
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from reports.calibration.studies import KINDS, draw_study
from reports.studies import model_of


def model_of_rows(rows, environments=1):
    """Model of k for rows (subject, environment, response)."""
    subject, environment, response = (np.array(column) for column in zip(*rows, strict=True))
    statistics = from_trials(
        response[:, None].astype(float),
        subject,
        environment,
        np.linspace(0.0, 1.0, environments)[None],
        parameters=("k",),
        environments=tuple(f"VE{j + 1}" for j in range(environments)),
        subjects=tuple(f"S{i + 1}" for i in range(subject.max() + 1)),
    )
    return plain_model(statistics)


def test_subjects_that_differ_less_than_their_trials_are_sampled_soon():
    """Coordinates placed by all of the scatter need 630 steps here, with an autocorrelation time
    of 52."""
    rng = np.random.default_rng(1)
    subject, environment, _ = (axis.ravel() for axis in np.indices((40, 6, 10)))
    response = (0.02 * rng.normal(size=(40, 6)))[subject, environment] + 0.1 * rng.normal(
        size=subject.size
    )
    rows = list(zip(subject, environment, response, strict=True))
    model = model_of_rows(rows, environments=6)
    run = sample(
        model,
        Limits(model, kinds=("mean", "user")),
        Settings(tolerance=0.05, seed=1, most_steps=250),
    )
    assert run.gate.passed, run.gate.reasons
    assert run.gate.autocorrelation_time < 25


@pytest.fixture(scope="module")
def explained():
    """A study whose second cell repeats one trial, once, and has a covariate."""
    drawn = draw_study(KINDS["covariate, missing cells"], np.random.default_rng(224))
    model = model_of(drawn.observed)
    assert model.statistics.scatter.df.tolist() == [5, 1, 5, 4]
    return model


def test_trials_that_covariates_explain_say_nothing_of_their_spread(explained):
    """What is left of one difference and one covariate is rounding, near 1e-17."""
    squares = explained.statistics.trial_squares
    df = np.array([5.0, 0.0, 5.0, 4.0])
    assert not squares[:, 1].any()
    assert (explained.coordinates.trial.weight == 2.0 * df).all()
    sd = np.sqrt(squares[:, df > 0.0] / df[df > 0.0])
    assert ((sd > 0.02) & (sd < 0.5)).all()


@pytest.mark.evidence
def test_trials_that_covariates_explain_are_sampled_soon(explained):
    """Coordinates that followed the rounding took 20,000 steps and did not mix."""
    estimands = Limits(explained, kinds=("mean", "user"))
    run = sample(explained, estimands, Settings(tolerance=0.2, seed=1, most_steps=3000))
    assert run.gate.passed, run.gate.reasons
