"""Predictions against quadrature, exact laws of statistics, and simulated studies."""

import numpy as np
import pytest
from scipy import stats

from percept.inference.checks.predictive import predict_left_out, replicate, statistics_of
from percept.inference.checks.subjects import SubjectDensity
from percept.inference.hierarchy.density import CollapsedDensity
from tests.inference.checks import small
from tests.inference.checks.test_loo import RESPONSE
from tests.inference.checks.test_subjects import prepared
from tests.inference.hierarchy import designs


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
        found = predict_left_out(
            subjects, small.GRID[:, None], (weight / weight.sum())[:, None], np.array([i])
        )
        assert found.below[0, 0, 0] == pytest.approx(below, abs=1e-6)
        # One number: farther is both tails of the same law.
        tails = np.sum(mass[keep] * 2.0 * stats.norm.sf(np.abs(standard)))
        assert found.farther[0] == pytest.approx(tails, abs=1e-6)


def left_out(subjects, i):
    return subjects.left_out(subjects.density.layout.scales(small.GRID[None])).log_density[:, i]


def test_statistics_are_those_of_numpy_where_cells_are_missing():
    rng = np.random.default_rng(2)
    means = rng.normal(size=(7, 2, 3))
    means[2, :, 1] = np.nan
    means[1:, :, 2] = np.nan
    found = statistics_of(means)
    np.testing.assert_allclose(found[0], np.nanmean(means, axis=0), rtol=1e-13)
    np.testing.assert_allclose(found[1][:, :2], np.nanstd(means[..., :2], axis=0, ddof=1), rtol=1e-13)
    off = np.abs(means - np.nanmean(means, axis=0))[..., :2]
    np.testing.assert_allclose(found[2][:, :2], np.nanmax(off, axis=0) / found[1][:, :2], rtol=1e-13)
    assert np.isnan(found[1:][..., 2]).all()


def test_of_two_subjects_neither_is_the_farthest():
    """Both always lie half their distance from the mean: that says nothing of either."""
    found = statistics_of(np.array([1.0, 3.0]).reshape(2, 1, 1))[:, 0, 0]
    np.testing.assert_allclose(found[:2], [2.0, np.sqrt(2.0)], rtol=1e-15)
    assert np.isnan(found[2])


@pytest.mark.parametrize("name", ["balanced", "missing cells", "trials"])
def test_replicated_statistics_follow_their_exact_laws(name):
    rng = np.random.default_rng(3)
    study, density, _, subjects = prepared(name, rng)
    draws = 20_000
    point = 0.5 * rng.normal(size=density.dimension)
    drawn = replicate(subjects, np.tile(point, (draws, 1)), rng)
    scales = density.layout.scales(np.repeat(point[:, None], 2, axis=1))
    law = density.locations(scales)
    mean, error = np.stack(law.mean)[..., 0], np.stack(law.covariance.diagonal())[..., 0]
    spread = np.stack(density.population(scales).diagonal())[..., 0]
    if "sigma_e" in scales.named:
        spread = spread + scales.named["sigma_e"][..., 0] ** 2 / 3.0
    n = np.isfinite(study.statistics.cell_means).sum(axis=0)
    # Five standard errors over some 24 numbers.
    np.testing.assert_array_less(
        np.abs(drawn[:, 0].mean(axis=0) - mean), 5 * np.sqrt((error + spread / n) / draws)
    )
    ratio = drawn[:, 0].var(axis=0) / (error + spread / n)
    np.testing.assert_array_less(np.abs(ratio - 1.0), 5 * np.sqrt(2.0 / draws))
    square = drawn[:, 1] ** 2
    np.testing.assert_array_less(
        np.abs(square.mean(axis=0) / spread - 1.0), 5 * np.sqrt(2.0 / (n - 1) / draws)
    )
    # The farthest subject of a normal sample, whatever its mean and SD.
    plain = rng.normal(size=(draws, n[0, 0]))
    off = np.abs(plain - plain.mean(axis=1, keepdims=True)).max(axis=1) / plain.std(axis=1, ddof=1)
    assert stats.ks_2samp(off, drawn[:, 2, 0, 0]).pvalue > 1e-4


def test_an_outlier_that_was_planted_is_the_farthest_subject():
    rng = np.random.default_rng(4)
    study, *_ = prepared("balanced", rng)
    response = study.response.copy()
    response[(study.subject == 4) & (study.environment == 2)] += 25.0
    moved = designs.from_trials(
        response,
        study.subject,
        study.environment,
        study.x,
        parameters=study.statistics.parameters,
        environments=study.statistics.environments,
        subjects=study.statistics.subjects,
    )
    observed = statistics_of(moved.cell_means)[2]
    density = CollapsedDensity(moved)
    subjects = SubjectDensity(density, response, study.subject, study.environment)
    drawn = replicate(subjects, np.zeros((4000, density.dimension)), rng)[:, 2]
    above = (drawn > observed).mean(axis=0)
    assert (above[:, 2] < 0.005).all()
    assert (above[:, [0, 1, 3]] > 0.005).all()
