"""Subjects of studies with factors left out, and prior draws, against dense covariances."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.checks.predictive import new_studies
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from tests.inference.hierarchy.linear_designs import dense, made

DESIGNS = [
    "two levels, trials",
    "two by two, spread",
    "three levels, missing cells",
    "two groups",
    "subjects' trial SDs",
    "one environment",
]


def opened(name):
    study = made(name)
    model = study.model
    given = (model.statistics, model.design, model.priors, model.covariates, model.scatter)
    density = LinearPosterior(*given)
    subjects = SubjectDensity(density, study.response, study.subject, study.cell)
    point = np.random.default_rng(3).normal(0.0, 0.5, (1, len(density.names)))
    return study, subjects, point


def means_of(study):
    """Matrix from trials, quantity by quantity, to the means of cells of one subject."""
    size = study.response.shape[1]
    for subject in np.unique(study.subject):
        cells = np.unique(study.cell[study.subject == subject])
        rows = []
        for p in range(size):
            for cell in cells:
                row = np.zeros((size, len(study.cell)))
                own = (study.subject == subject) & (study.cell == cell)
                row[p, own] = 1.0 / own.sum()
                rows.append(row.ravel())
        yield subject, np.array(rows)


@pytest.mark.parametrize("name", DESIGNS)
def test_a_subject_left_out_is_predicted_by_the_others_trials(name):
    """Density and distance by conditioning the covariance of all trials."""
    study, subjects, point = opened(name)
    named = study.model.linear_scales(point).named
    covariance, *_ = dense(study, named, 0)
    response = study.response.T.ravel()
    ((_, laws),) = subjects.batches(point)
    found = subjects.left_out(laws)
    size = study.response.shape[1]
    for subject, rows in means_of(study):
        own = np.tile(study.subject == subject, size)
        gain = np.linalg.solve(covariance[np.ix_(~own, ~own)], covariance[np.ix_(~own, own)]).T
        mean = gain @ response[~own]
        left = covariance[np.ix_(own, own)] - gain @ covariance[np.ix_(~own, own)]
        expected = stats.multivariate_normal(mean, left).logpdf(response[own])
        assert found.log_density[0, subject] == pytest.approx(expected, rel=1e-7)
        reduced = rows[:, own]
        apart = reduced @ (response[own] - mean)
        within = reduced @ left @ reduced.T
        distance = apart @ np.linalg.solve(within, apart)
        assert found.distance[0, subject] == pytest.approx(distance, rel=1e-7)
        standard = found.standard[0, subject]
        known = standard[np.isfinite(standard)]
        np.testing.assert_allclose(known, apart / np.sqrt(np.diag(within)), rtol=1e-7)


@pytest.mark.parametrize("name", ["three levels, missing cells", "subjects' trial SDs"])
def test_new_studies_scatter_as_the_model_says(name):
    """Means and variances of cell means over many studies from one set of scales."""
    _, subjects, point = opened(name)
    count = 4000
    studies = np.concatenate(
        list(new_studies(subjects, np.repeat(point, count, axis=0), np.random.default_rng(4)))
    )
    laws = subjects.density.subject_laws(point)
    patterns = subjects.density.statistics.patterns
    locations = np.einsum("rpcw,rpcw->pc", laws.columns, laws.columns)
    effects = np.einsum("qpcw,qpcw->pc", laws.effects, laws.effects)
    for pattern, noise in zip(patterns, laws.noise, strict=True):
        present = pattern.environments
        own = np.stack(noise.diagonal())[..., 0]
        variance = (locations + effects)[:, present] + own
        drawn = studies[:, pattern.members][..., present]
        off = (drawn.mean(axis=0) - laws.mean[:, present, 0]) / np.sqrt(variance / count)
        assert np.abs(off).max() < 4.5
        ratio = drawn.var(axis=0) / variance - 1.0
        assert np.abs(ratio).max() < 4.5 * np.sqrt(2.0 / count)
        assert np.isnan(studies[0, pattern.members[0], 0]).sum() == locations.shape[1] - len(
            present
        )


@pytest.mark.parametrize("name", ["two by two, spread", "subjects' trial SDs"])
def test_draws_before_any_data_have_the_priors(name):
    _, subjects, _ = opened(name)
    density = subjects.density
    count = 4000
    prior = density.draw_prior(count, np.random.default_rng(5))
    _, s = prior.scales["s"]
    scores = (np.log(s) - density.priors.log_s_mean) / density.priors.log_s_sd
    assert stats.kstest(scores.ravel(), "norm").pvalue > 1e-3
    _, psi = prior.scales["psi:hand"]
    assert stats.kstest(psi.ravel() / density.priors.psi_sd, "norm").pvalue > 1e-3
    if "omega_s" in prior.scales:
        # A subject's trial SD over the others' has a normal logarithm of SD omega_s.
        phi = prior.scales["phi"][1] / prior.scales["omega_s"][1][..., None]
        assert stats.kstest(phi[:, 0, 0], "norm").pvalue > 1e-3
    # Locations: the variance of the columns, given each draw's tau.
    design = density.design
    fixed = sum((term.columns**2).sum(axis=0) for term in design.fixed)
    own = np.zeros((count, *fixed.shape))
    for term in design.deviation:
        tau = prior.scales["tau" if term.name == "level" else f"tau:{term.name}"][1]
        own += tau[..., None] ** 2 * (term.columns**2).sum(axis=0)
    scores = prior.means.reshape(own.shape) / np.sqrt(fixed + own)
    assert stats.kstest(scores[:, 0, 0], "norm").pvalue > 1e-3
    assert stats.kstest(scores[:, -1, -1], "norm").pvalue > 1e-3
