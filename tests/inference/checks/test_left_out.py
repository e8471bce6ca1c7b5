"""Leaving subjects out against quadrature and ratios of evidences."""

import numpy as np
import pytest
from scipy import special, stats

from percept.inference.predictive import (
    intervals_left_out,
    leave_one_out,
    predict_left_out,
    smoothed_subjects,
)
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


def reweighted(response):
    """Leave each subject out of small studies: its weights, and log p(y_i | others) by these."""
    subjects = small.subjects_of(response)
    left = subjects.left_out(small.even_draws(subjects.density, 4000))
    found = leave_one_out(subjects, left)
    return found, special.logsumexp(np.log(found.weights) + left.log_density, axis=0)


def test_pointwise_densities_are_ratios_of_evidences():
    found, density = reweighted(RESPONSE)
    exact = evidence_ratios(RESPONSE)
    # Even draws: what is left is the smoothing of the largest weights.
    np.testing.assert_allclose(density, exact, atol=5e-3)
    assert found.good_k == pytest.approx(0.7)
    assert (found.pareto_k < found.good_k).all()
    np.testing.assert_allclose(found.weights.sum(axis=0), 1.0)


@pytest.mark.parametrize(("draws", "good"), [(100, 0.5), (4000, 0.7)])
def test_few_draws_trust_smaller_tail_indices(draws, good):
    normal = stats.norm.ppf((np.arange(draws) + 0.5) / draws)[:, None]
    assert smoothed_subjects(normal).good_k == pytest.approx(good)


def test_weights_without_a_subject_far_off_are_not_trusted():
    response = np.append(RESPONSE, 1.2)
    found, density = reweighted(response)
    assert np.flatnonzero(~found.trusted).tolist() == [8]
    exact = evidence_ratios(response)[8]
    assert abs(density[8] - exact) > 0.1


def test_left_out_probabilities_equal_quadrature_over_the_posterior_of_the_others():
    subjects = small.subjects_of(RESPONSE)
    left = subjects.left_out(small.GRID[:, None])
    for i, own in enumerate(RESPONSE):
        others = small.density_of(np.delete(RESPONSE, i))
        mass, _ = small.weights(others)
        keep = mass > 1e-12
        law = others.moments(small.GRID[keep][:, None])
        standard = (own - law.mean[:, 0]) / np.hypot(law.sd, law.population_sd)[:, 0]
        below = np.sum(mass[keep] * stats.norm.cdf(standard))
        # Draws of the others' posterior, in the coordinates of all: here by weights on a grid.
        ours = subjects.density(small.GRID[:, None]) - left.log_density[:, i]
        weight = np.exp(ours - ours.max())
        weights = np.repeat((weight / weight.sum())[:, None], len(RESPONSE), axis=1)
        found = predict_left_out(subjects, left, weights)
        assert found.below[i, 0, 0] == pytest.approx(below, abs=1e-6)
        # One number: farther is both tails of the same law.
        tails = np.sum(mass[keep] * 2.0 * stats.norm.sf(np.abs(standard)))
        assert found.farther[i] == pytest.approx(tails, abs=1e-6)


def test_intervals_without_a_subject_equal_quadrature_over_the_posterior_of_the_others():
    subjects = small.subjects_of(RESPONSE)
    left = subjects.left_out(small.even_draws(subjects.density, 4000))
    weights = leave_one_out(subjects, left).weights
    lower, mean, upper = intervals_left_out(left, weights, [0], 0.95)
    for i in range(len(RESPONSE)):
        others = small.density_of(np.delete(RESPONSE, i))
        mass, _ = small.weights(others)
        keep = mass > 1e-12
        law = others.moments(small.GRID[keep][:, None])
        assert mean[i, 0] == pytest.approx(mass[keep] @ law.mean[:, 0], abs=2e-3)
        for end, probability in ((lower, 0.025), (upper, 0.975)):
            below = stats.norm.cdf((end[i, 0] - law.mean[:, 0]) / law.sd[:, 0])
            assert mass[keep] @ below == pytest.approx(probability, abs=2e-3)
