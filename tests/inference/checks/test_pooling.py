"""Shrinkage at scales where it is known, and correlations against dense covariances."""

import numpy as np
import pytest

from percept.inference.checks.pooling import correlation_draws, shrinkage
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.scales import Options
from tests.inference.hierarchy import designs


def points_at(density, **coordinates):
    """Two equal points, zero but where a name begins as said."""
    point = np.zeros(density.dimension)
    for start, value in coordinates.items():
        point[[name.startswith(start + "[") for name in density.names]] = value
    return np.stack([point, point])


def test_moved_is_the_weight_of_the_trend():
    """Without subject effects each centre is a weighted mean of its raw mean and the trend of the others."""
    rng = np.random.default_rng(41)
    study = designs.study("k only", rng)
    density = CollapsedDensity(study.statistics, options=Options(subject_effect=False))
    for tau in (-3.0, 0.0, 2.0):
        points = points_at(density, tau=tau)
        found = shrinkage(density, points)
        named = density.layout.scales(points.T).named
        noise = named["sigma"][0, :, 0] ** 2 / len(study.statistics.subjects)
        weight = noise / (noise + named["tau"][0, 0] ** 2)
        np.testing.assert_allclose(found.moved[0], weight, rtol=1e-8)
        np.testing.assert_allclose(found.raw, study.statistics.cell_means.mean(axis=0), rtol=1e-12)


@pytest.mark.parametrize(("tau", "expected"), [(-8.0, 1.0), (4.0, 0.0)])
def test_all_the_way_without_biases_of_their_own_and_nowhere_with_large_ones(tau, expected):
    rng = np.random.default_rng(42)
    study = designs.study("balanced", rng)
    density = CollapsedDensity(study.statistics)
    moved = shrinkage(density, points_at(density, tau=tau)).moved
    np.testing.assert_allclose(moved[np.isfinite(moved)], expected, atol=0.02)
    assert np.isfinite(moved).sum() >= 6


def test_nothing_to_move_through_is_no_number():
    rng = np.random.default_rng(43)
    study = designs.study("k only", rng)
    response = 0.3 + 0.0 * study.response + rng.permuted(np.tile([-0.1, 0.1], 12)).reshape(-1, 1)
    flat = response - np.array([[response[study.environment == j].mean() - 0.0] for j in study.environment])
    statistics = designs.from_trials(
        flat,
        study.subject,
        study.environment,
        study.x,
        parameters=("k",),
        environments=study.statistics.environments,
        subjects=study.statistics.subjects,
    )
    density = CollapsedDensity(statistics)
    assert np.isnan(shrinkage(density, points_at(density)).moved).all()


def test_one_environment_has_no_trend_and_one_parameter_no_correlation():
    rng = np.random.default_rng(44)
    alone = CollapsedDensity(designs.study("one environment", rng).statistics)
    assert shrinkage(alone, points_at(alone)) is None
    single = CollapsedDensity(designs.study("k only", rng).statistics)
    assert correlation_draws(single, points_at(single)) == {}


def test_correlations_are_those_of_the_dense_population():
    rng = np.random.default_rng(45)
    density = CollapsedDensity(designs.study("balanced", rng).statistics)
    points = rng.normal(size=(6, density.dimension))
    scales = density.layout.scales(points.T)
    found = correlation_draws(density, points)
    named = scales.named
    environments = len(density.statistics.environments)
    for j in range(environments):
        cross = named["rho_u"] * named["sigma_u"].prod(axis=0)
        cross = cross + named["rho_w"] * named["sigma"][:, j].prod(axis=0)
        k, b = named["sigma_u"] ** 2 + named["sigma"][:, j] ** 2
        expected = cross / np.sqrt(k * b)
        np.testing.assert_allclose(found["population"][:, j], expected, rtol=1e-10)
    np.testing.assert_array_equal(found["within"], scales.named["rho_w"])
    np.testing.assert_array_equal(found["shared"], scales.named["rho_u"])
    without = CollapsedDensity(density.statistics, options=Options(subject_effect=False))
    own = correlation_draws(without, rng.normal(size=(6, without.dimension)))
    np.testing.assert_allclose(own["population"], np.repeat(own["within"][:, None], environments, axis=1))
    assert "shared" not in own
