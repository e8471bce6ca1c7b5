"""The hierarchical model run forwards, against the moments its text implies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from percept.errors import RefusalError, UsageError
from percept.inference.model.priors import Priors
from percept.simulate import (
    Design,
    Hyperparameters,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    draw_responses,
    simulate,
)

REFERENCES = [[10.0, 0.1], [1000.0, 1.0], [10000.0, 10.0], [25000.0, 25.0], [50000.0, 50.0]]
DRAWS = 3000
# Fixed seeds: a right sampler passes each of these at odds of 10 000 to 1.
UNLIKELY = 1e-4


def hyperparameters(**changes: object) -> Hyperparameters:
    values: dict[str, object] = {
        "alpha": np.array([0.1, -0.2]),
        "gamma": np.array([0.05, 0.3]),
        "tau": np.array([0.2, 0.4]),
        "sigma_u": np.array([0.3, 0.5]),
        "rho_u": 0.6,
        "s": np.array([0.2, 0.4]),
        "kappa": np.array([-0.1, 0.2]),
        "omega": np.array([0.3, 0.1]),
        "rho_w": -0.4,
        "s_e": np.array([0.1, 0.2]),
        "kappa_e": np.array([0.1, -0.1]),
        "omega_e": np.array([0.2, 0.3]),
        "rho_e": 0.5,
        "sigma_trend": np.array([0.2, 0.1]),
        "rho_trend": -0.5,
    }
    return Hyperparameters(**(values | changes))  # type: ignore[arg-type]


def uniform(sample: object, distribution: object) -> float:
    """p of a Kolmogorov-Smirnov test of the sample against a frozen distribution."""
    return stats.kstest(np.ravel(sample), distribution.cdf).pvalue  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def prior_draws() -> list[Hyperparameters]:
    design = Design.balanced(REFERENCES, subjects=2, trials=2)
    rng = np.random.default_rng(20)
    return [draw_hyperparameters(design, Priors(), rng) for _ in range(DRAWS)]


@pytest.mark.parametrize(
    ("name", "distribution"),
    [
        ("alpha", stats.norm(0, 1)),
        ("gamma", stats.norm(0, 0.25)),
        ("tau", stats.halfnorm(0, 0.5)),
        ("sigma_u", stats.halfnorm(0, 0.5)),
        ("sigma_trend", stats.halfnorm(0, 0.25)),
        ("s", stats.lognorm(1, scale=0.2)),
        ("kappa", stats.norm(0, 0.5)),
        ("omega", stats.halfnorm(0, 1)),
        ("s_e", stats.lognorm(1, scale=0.1)),
        ("kappa_e", stats.norm(0, 0.5)),
        ("omega_e", stats.halfnorm(0, 1)),
        ("rho_u", stats.beta(2, 2, loc=-1, scale=2)),
        ("rho_trend", stats.beta(2, 2, loc=-1, scale=2)),
        ("rho_w", stats.beta(2, 2, loc=-1, scale=2)),
        ("rho_e", stats.beta(2, 2, loc=-1, scale=2)),
    ],
)
def test_default_priors(
    prior_draws: list[Hyperparameters], name: str, distribution: object
) -> None:
    sample = np.array([getattr(draw, name) for draw in prior_draws])
    assert uniform(sample, distribution) > UNLIKELY
    if sample.ndim == 2:
        assert abs(np.corrcoef(sample.T)[0, 1]) < 4 / math.sqrt(DRAWS)


def test_environments_depart_from_their_trends_each_by_itself() -> None:
    references = np.geomspace(1.0, 1e4, 1000)
    design = Design.balanced(np.stack([references, references]).T, subjects=2, trials=1)
    values = draw_environments(hyperparameters(), design, np.random.default_rng(12))
    hyper = values.hyper
    log_sigma = np.log(hyper.s) + hyper.kappa * design.decades
    log_sigma_e = np.log(hyper.s_e) + hyper.kappa_e * design.decades
    departures = [
        (values.beta - hyper.alpha - hyper.gamma * design.decades) / hyper.tau,
        (np.log(values.sigma) - log_sigma) / hyper.omega,
        (np.log(values.sigma_e) - log_sigma_e) / hyper.omega_e,
    ]
    for departure in departures:
        assert uniform(departure, stats.norm()) > UNLIKELY
    correlation = np.corrcoef(np.hstack(departures).T)
    assert np.abs(correlation - np.eye(6)).max() < 4.5 / math.sqrt(len(references))


def test_moments_of_the_responses() -> None:
    """Cell means have covariance Σ_u + x x'Σ_g + Σ_w + Σ_e/r, scatter Σ_e within, and Σ_u with the
    trends' part in common."""
    subjects, trials = 20000, 3
    design = Design.balanced(REFERENCES[:2], subjects=subjects, trials=trials)
    rng = np.random.default_rng(11)
    values = draw_environments(hyperparameters(), design, rng)
    y = draw_responses(values, design, rng).reshape(subjects, 2, trials, 2)
    means = y.mean(axis=2)
    within = (y - means[:, :, None])[:, :, :, :, None] * (y - means[:, :, None])[:, :, :, None, :]
    within = within.sum(axis=2) / (trials - 1)

    of_users = values.cov_users(design.decades)
    hyper = values.hyper
    cov_u = np.outer(hyper.sigma_u, hyper.sigma_u) * [[1.0, hyper.rho_u], [hyper.rho_u, 1.0]]
    of_trend = np.array([[0.2**2, -0.5 * 0.2 * 0.1], [-0.5 * 0.2 * 0.1, 0.1**2]])
    for j, x in enumerate(design.decades):
        own = np.outer(values.sigma[j], values.sigma[j]) * [[1.0, hyper.rho_w], [hyper.rho_w, 1.0]]
        assert_allclose(of_users[j], cov_u + own + np.outer(x, x) * of_trend)
        cov = of_users[j] + values.cov_e[j] / trials
        assert_covariance(means[:, j], means[:, j], cov, cov, cov)
        assert_allclose(
            means[:, j].mean(axis=0), values.beta[j], atol=4 * np.sqrt(np.max(cov) / subjects)
        )
        error = np.sqrt(_wishart_variance(values.cov_e[j]) / (subjects * (trials - 1)))
        assert np.all(np.abs(within[:, j].mean(axis=0) - values.cov_e[j]) < 4 * error)
    first, second = of_users + values.cov_e / trials
    shared = cov_u + np.outer(*design.decades) * of_trend
    assert_covariance(means[:, 0], means[:, 1], shared, first, second)


def _wishart_variance(cov: np.ndarray) -> np.ndarray:
    return cov**2 + np.outer(np.diag(cov), np.diag(cov))


def assert_covariance(
    a: np.ndarray, b: np.ndarray, expected: np.ndarray, cov_a: np.ndarray, cov_b: np.ndarray
) -> None:
    """Sample covariance of Gaussians within four of its standard errors."""
    n = len(a)
    sample = (a - a.mean(axis=0)).T @ (b - b.mean(axis=0)) / (n - 1)
    error = np.sqrt((np.outer(np.diag(cov_a), np.diag(cov_b)) + expected**2) / n)
    assert np.all(np.abs(sample - expected) < 4 * error)


@pytest.mark.parametrize("reference", [0.0, -1.0, math.nan])
def test_a_reference_that_no_response_is_a_ratio_to(reference: float) -> None:
    with pytest.raises(
        UsageError, match=rf"references = {reference}: every reference must be positive"
    ):
        Design.balanced([[10.0, reference], [1000.0, 1.0]], subjects=3)


UNEVEN = Design(
    np.array(REFERENCES[:3]),
    np.array([[1, 2, 0], [3, 1, 1]]),
    environments=("soft", "middle", "hard"),
)


@pytest.mark.parametrize("family", ["lognormal", "normal"])
def test_rows_are_the_responses_on_the_references(family: str) -> None:
    values = draw_environments(hyperparameters(), UNEVEN, np.random.default_rng(1))
    table = simulate(values, UNEVEN, np.random.default_rng(3), family=family)  # type: ignore[arg-type]
    responses = draw_responses(values, UNEVEN, np.random.default_rng(3))
    assert list(table.columns) == [
        *(
            "subject",
            "session",
            "environment",
            "k_ref",
            "b_ref",
            "trial",
            "k_adj",
            "b_adj",
            "source",
        )
    ]
    cells = list(zip(table["subject"], table["environment"], table["trial"], strict=True))
    assert cells == [
        ("S01", "soft", 1),
        ("S01", "middle", 1),
        ("S01", "middle", 2),
        ("S02", "soft", 1),
        ("S02", "soft", 2),
        ("S02", "soft", 3),
        ("S02", "middle", 1),
        ("S02", "hard", 1),
    ]
    for (_, row), y in zip(table.iterrows(), responses, strict=True):
        reference = dict(zip(UNEVEN.environments, UNEVEN.references, strict=True))[
            row["environment"]
        ]
        assert_array_equal((row["k_ref"], row["b_ref"]), reference)
        ratio = np.array([row["k_adj"], row["b_adj"]]) / reference
        assert_allclose(
            np.log(ratio) if family == "lognormal" else ratio - 1, y, rtol=1e-9, atol=1e-13
        )
    assert set(table["source"]) == {"simulated"}


@pytest.mark.parametrize("beta", [1e4, -1e4])
def test_values_no_double_can_hold(beta: float) -> None:
    cells = np.full((3, 2), beta)
    values = TrueValues(hyperparameters(), cells, np.ones((3, 2)), np.ones((3, 2)))
    with pytest.raises(RefusalError, match="leaves the range of doubles"):
        simulate(values, UNEVEN, np.random.default_rng(1))
