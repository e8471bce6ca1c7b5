"""Where the coordinates of the spreads between subjects lie, and how long their unit is."""

import math

import numpy as np
import pytest
from scipy import optimize

from percept.inference.model import priors as coordinates
from percept.inference.model.design import Options
from percept.inference.model.limits import Limits
from percept.inference.model.model import plain_model
from percept.inference.model.priors import Priors
from percept.inference.model.rough import likelihood_of_trials
from percept.inference.model.statistics import from_trials
from percept.inference.sampling.gate import Settings
from percept.inference.sampling.run import sample
from reports.calibration.studies import KINDS, draw_study
from reports.studies import model_of

APART = Options(subject_effect=False)
TIGHT = {"xatol": 1e-10, "fatol": 1e-15, "maxiter": 10_000}
#: Deviations of each subject's trials about the subject's mean, in units of d.
SUBJECTS = ((0.1, (-1, 1)), (0.3, (-1, 1, -1, 1)), (0.5, (-1, 1)))


def model_of_rows(rows, environments=1, options=None):
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
    return plain_model(statistics, Priors(), options)


def repeated(d, environment=0):
    return [
        (i, environment, mean + d * sign)
        for i, (mean, signs) in enumerate(SUBJECTS)
        for sign in signs
    ]  # fmt: skip


def weights(model):
    """Weights of the rough likelihood, which shorten the unit of the coordinates."""
    units = (model.coordinates.limits / coordinates.LIMIT) ** 2
    found = dict(zip(model.names, units - 1.0, strict=True))
    return [found[name] for name in model.names if name.startswith("sigma[")]


def at_zero(model):
    """SDs between subjects at coordinates of zero."""
    _, sigma = model.scales(np.zeros((1, len(model.names))))["sigma"]
    return sigma.ravel()


def mode(scatter, df, noise, prior):
    """Likeliest log sigma (J,) of chi-squared scatter about sigma^2 + noise, log sigma ~ N(log
    .2, prior)."""

    def short(log_sigma):
        total = np.exp(2.0 * log_sigma) + noise
        apart = log_sigma - math.log(0.2)
        return 0.5 * np.sum(df * (np.log(total) + scatter / total)) + 0.5 * apart @ np.linalg.solve(
            prior, apart
        )

    return optimize.minimize(short, np.full(len(df), -2.0), method="Nelder-Mead", options=TIGHT).x


def share_left(log_sigma, noise):
    return 1.0 / (1.0 + noise * np.exp(-2.0 * log_sigma))


# Between subjects s^2 = .04. Between trials s_e^2 = 8 d^2 / 5, and 1/r = (1/2 + 1/4 + 1/2)/3 =
# 5/12. So trials explain 2 d^2 / 3 of s^2; nu = 2.
@pytest.mark.parametrize("squared", [0.01, 0.03, 0.0564, 0.0576, 0.09])
def test_the_likelihood_is_taken_where_trials_leave_the_spread(squared):
    model = model_of_rows(repeated(math.sqrt(squared)))
    df, noise = np.array([2.0]), np.array([2.0 * squared / 3.0])
    (wanted,) = mode(np.array([0.04]), df, noise, np.eye(1))
    assert weights(model) == pytest.approx(2.0 * df * share_left(wanted, noise) ** 2, rel=1e-6)
    # At zero log sigma is the mean of its prior and of the rough likelihood, which is the mode.
    assert np.log(at_zero(model)) == pytest.approx([wanted], abs=1e-7)


def test_a_cell_that_trials_explain_is_left_to_the_prior():
    model = model_of_rows(repeated(3.0))
    assert weights(model) == [0.0]
    assert at_zero(model) == pytest.approx([0.2], rel=1e-12)


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
    rows = explained.statistics.trial_rows
    assert not rows[..., 1].any()
    mean, weight = likelihood_of_trials(explained.statistics)
    assert (weight == 2.0 * np.array([5.0, 0.0, 5.0, 4.0])).all()
    sd = np.exp(mean[:, [0, 2, 3]])
    assert ((sd > 0.02) & (sd < 0.5)).all()


@pytest.mark.evidence
def test_trials_that_covariates_explain_are_sampled_soon(explained):
    """Coordinates that followed the rounding took 20,000 steps and did not mix."""
    estimands = Limits(explained, kinds=("mean", "user"))
    run = sample(explained, estimands, Settings(tolerance=0.2, seed=1, most_steps=3000))
    assert run.gate.passed, run.gate.reasons
