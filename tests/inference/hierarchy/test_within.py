"""The model of conditions within subjects against its covariance written out, trial by trial."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.statistics import from_trials
from percept.inference.hierarchy.within import WithinSubjects

REFERENCES = ("VE1", "VE2", "VE3")
LEVEL = np.array([False, True, False, True, False, True])
AT = np.array([0, 0, 1, 1, 2, 2])


def data(subjects=5, trials=2, *, seed=1, sd=(0.2, 0.3, 0.1, 0.05), contrast=0.2):
    """Trials of subjects in six cells: response, subject, cell."""
    rng = np.random.default_rng(seed)
    u, v, w, e = sd
    subject, cell, _ = (a.ravel() for a in np.indices((subjects, 6, trials)))
    c = np.where(LEVEL, 0.5, -0.5)
    mean = (
        rng.normal(0, u, subjects)[:, None]
        + c * (contrast + rng.normal(0, v, subjects)[:, None])
        + rng.normal(0, w, (subjects, 6))
    )
    return mean[subject, cell] + rng.normal(0, e, len(subject)), subject, cell


def model(response, subject, cell, **options):
    x = np.array([[-1.0, -1.0, 0.0, 0.0, 1.0, 1.0]])
    cells = tuple(
        f"{REFERENCES[j]}, {'right' if level else 'left'}"
        for j, level in zip(AT, LEVEL, strict=True)
    )
    names = tuple(f"S{i}" for i in range(subject.max() + 1))
    made = from_trials(
        response[:, None], subject, cell, x, parameters=("k",), environments=cells, subjects=names
    )
    return WithinSubjects(made, AT, LEVEL, names=REFERENCES, **options)


@pytest.mark.parametrize("lambda_sd", [1.0, 0.1])
def test_the_density_is_that_of_the_trials(lambda_sd):
    response, subject, cell = data(trials=2)
    # Missing cells and unequal counts: patterns of their own.
    kept = ~((subject == 2) & (cell == 3)) & ~(
        (subject == 4) & (np.arange(len(cell)) % 2 == 0) & (cell < 2)
    )
    response, subject, cell = response[kept], subject[kept], cell[kept]
    made = model(response, subject, cell, priors=Priors(lambda_sd=lambda_sd))
    points = np.random.default_rng(2).normal(0.0, 0.7, (4, len(made.names)))
    named, log_prior = made.named(points)
    laws = made.laws(points)
    c, x = np.where(LEVEL, 0.5, -0.5), np.array([-1.0, -1.0, 0.0, 0.0, 1.0, 1.0])
    same = AT[:, None] == AT
    for s in range(len(points)):
        own = {name: value[s] for name, value in named.items()}
        prior = 1.0 + 0.25**2 * np.outer(x, x) + lambda_sd**2 * np.outer(c, c)
        prior = prior + same * (own["tau"] ** 2 + own["tau_c"] ** 2 * np.outer(c, c))
        user = (
            own["sigma_u"] ** 2 + own["sigma_v"] ** 2 * np.outer(c, c) + np.diag(own["sigma"] ** 2)
        )
        together = subject[:, None] == subject
        noise = np.diag(own["sigma_e"][cell] ** 2)
        covariance = prior[np.ix_(cell, cell)] + together * user[np.ix_(cell, cell)] + noise
        expected = stats.multivariate_normal(cov=covariance).logpdf(response)
        np.testing.assert_allclose(made(points)[s] - log_prior[s], expected, rtol=1e-9)
        gain = np.linalg.solve(covariance, prior[cell]).T
        beta, left = gain @ response, prior - gain @ prior[cell]
        rows = np.array([[-1, 1, 0, 0, 0, 0], [0, 0, -1, 1, 0, 0], [0, 0, 0, 0, -1, 1]])
        rows = np.vstack([rows, rows.mean(axis=0)])
        np.testing.assert_allclose(laws.mean[s], rows @ beta, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(laws.sd[s], np.sqrt(np.diag(rows @ left @ rows.T)), rtol=1e-8)
        np.testing.assert_allclose(
            laws.population_sd[s], np.sqrt(np.diag(rows @ user @ rows.T)), rtol=1e-10
        )
        parts = [np.where(level == LEVEL, rows, 0) for level in (True, False)]
        ratio = np.sqrt(np.divide(*(np.diag(part @ user @ part.T) for part in parts)))
        np.testing.assert_allclose(made.spread_ratios(points)[s], ratio, rtol=1e-10)


@pytest.mark.parametrize("psi_sd", [0.5, 0.05])
def test_coordinates_have_the_prior_of_the_spreads(psi_sd):
    """Their density is that of standard normals times the Jacobian of the map, by finite differences."""
    spread = model(*data(), priors=Priors(psi_sd=psi_sd)).spreads["sigma"]
    rng, omega, step = np.random.default_rng(3), np.array([0.6]), 1e-6
    u = rng.normal(0.0, 0.5, (1, spread.count))
    (z,), found = spread.multiples(u, omega)
    ends = np.repeat(u, 2 * spread.count, axis=0) + step * np.vstack([np.eye(9), -np.eye(9)])
    moved, _ = spread.multiples(ends, np.repeat(omega, 18))
    jacobian = (moved[:9] - moved[9:]) / (2.0 * step)
    expected = stats.norm.logpdf(z).sum() + np.linalg.slogdet(jacobian)[1]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    x, c = np.array([-1.0, -1.0, 0.0, 0.0, 1.0, 1.0]), np.where(LEVEL, 0.5, -0.5)
    logs = np.log(0.2) + z[0] + 0.5 * z[1] * x + psi_sd * z[2] * c + 0.6 * z[3:]
    np.testing.assert_allclose(spread(u, omega)[0][0], logs, rtol=1e-12)
    # Without any scatter about their trend they follow it.
    assert np.isfinite(spread(u, np.array([1e-70]))[1]).all()


def test_without_contrasts_of_their_own_subjects_make_the_overall_limits_too_narrow():
    """Truths from the priors, at known scales: errors over their SD have variance 1, and more without v."""
    rng, studies = np.random.default_rng(5), 400
    one = np.ones(1)
    named = {
        "sigma_u": 0.3 * one,
        "tau": 0.1 * one,
        "tau_c": 0.1 * one,
        "sigma": np.full((1, 6), 0.1),
    }
    errors = {True: [], False: []}
    for seed in range(studies):
        contrast, zeta = rng.normal(), rng.normal(0.0, 0.1, 3)
        response, subject, cell = data(6, 1, seed=seed, sd=(0.3, 0.4, 0.1, 0.0), contrast=contrast)
        response = response + np.where(LEVEL, 0.5, -0.5)[cell] * zeta[AT[cell]]
        for varied, found in errors.items():
            sigma_v = {"sigma_v": 0.4 * one if varied else 0.0 * one}
            mean, sd, _ = model(response, subject, cell).contrasts(named | sigma_v)
            found.append((contrast + zeta.mean() - mean[0, -1]) / sd[0, -1])
    spread = np.sqrt(2.0 / studies)
    assert abs(np.var(errors[True]) - 1.0) < 5.0 * spread
    assert np.var(errors[False]) > 3.0
