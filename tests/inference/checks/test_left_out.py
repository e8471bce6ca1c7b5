"""Leaving subjects out against quadrature and ratios of evidences."""

import numpy as np
import pytest
from scipy import stats

from percept.errors import UsageError
from percept.inference.checks.left_out import leave_one_out, predict_left_out
from tests.inference.checks import small

RESPONSE = np.array([0.12, -0.05, 0.2, 0.31, 0.02, -0.11, 0.17, 0.26])


def evidence_ratios(response):
    """log p(y_i | others) = log p(all) - log p(others), each evidence by quadrature."""
    whole = small.weights(small.density_of(response))[1]
    return np.array(
        [
            whole - small.weights(small.density_of(np.delete(response, i)))[1]
            for i in range(len(response))
        ]
    )


def test_pointwise_densities_are_ratios_of_evidences():
    subjects = small.subjects_of(RESPONSE)
    found = leave_one_out(subjects, small.even_draws(subjects.density, 4000), chains=4)
    exact = evidence_ratios(RESPONSE)
    # Even draws: what is left is the smoothing of the largest weights.
    np.testing.assert_allclose(found.pointwise, exact, atol=5e-3)
    assert found.elpd == pytest.approx(exact.sum(), abs=1e-2)
    assert found.se == pytest.approx(np.sqrt(8 * found.pointwise.var(ddof=1)))
    assert found.good_k == pytest.approx(0.7)
    assert not found.influential.any()
    np.testing.assert_allclose(found.weights.sum(axis=0), 1.0)


def test_an_influential_subject_is_rough():
    response = np.append(RESPONSE, 1.2)
    subjects = small.subjects_of(response)
    found = leave_one_out(subjects, small.even_draws(subjects.density, 4000), chains=4)
    assert np.flatnonzero(found.influential).tolist() == [8]
    exact = evidence_ratios(response)[8]
    assert abs(found.pointwise[8] - exact) > 0.1


def test_chains_must_divide_the_draws():
    subjects = small.subjects_of(RESPONSE)
    with pytest.raises(UsageError, match="10 draws do not make equal chains"):
        leave_one_out(subjects, np.zeros((10, 1)), chains=4)


def test_left_out_probabilities_equal_quadrature_over_the_posterior_of_the_others():
    subjects = small.subjects_of(RESPONSE)
    for i, own in enumerate(RESPONSE):
        others = small.density_of(np.delete(RESPONSE, i))
        mass, _ = small.weights(others)
        keep = mass > 1e-12
        scales = others.layout.scales(small.GRID[keep][None])
        law = others.locations(scales)
        sd = np.sqrt(law.covariance.diagonal()[0][0] + others.population(scales).diagonal()[0][0])
        standard = (own - law.mean[0][0]) / sd
        below = np.sum(mass[keep] * stats.norm.cdf(standard))
        # Draws of the others' posterior, in the coordinates of all: here by weights on a grid.
        ours = subjects.density(small.GRID[:, None]) - left_out(subjects, i)
        weight = np.exp(ours - ours.max())
        weights = np.repeat((weight / weight.sum())[:, None], len(RESPONSE), axis=1)
        found = predict_left_out(subjects, small.GRID[:, None], weights)
        assert found.below[i, 0, 0] == pytest.approx(below, abs=1e-6)
        # One number: farther is both tails of the same law.
        tails = np.sum(mass[keep] * 2.0 * stats.norm.sf(np.abs(standard)))
        assert found.farther[i] == pytest.approx(tails, abs=1e-6)


def left_out(subjects, i):
    return subjects.left_out(subjects.density.layout.scales(small.GRID[None])).log_density[:, i]
