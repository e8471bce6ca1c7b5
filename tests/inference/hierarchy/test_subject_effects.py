"""Draws of subject effects against their conditional law by dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from percept.inference.hierarchy.scales import Options
from percept.inference.hierarchy.statistics import from_trials
from tests.inference.hierarchy.linear_designs import made

REPEATS = {(0, 0): 2, (0, 1): 1, (1, 0): 3, (1, 1): 2, (2, 1): 2}  # Subject 2 missed the first


def density_of(parameters, options=None):
    rng = np.random.default_rng(3)
    cells = [cell for cell, count in REPEATS.items() for _ in range(count)]
    subject, environment = np.array(cells).T
    response = 0.3 * rng.normal(size=(3, len(parameters)))[subject]
    response = response + 0.2 * rng.normal(size=response.shape)
    statistics = from_trials(
        response,
        subject,
        environment,
        np.array([[-0.5, 0.5]] * len(parameters)),
        parameters=parameters,
        environments=("VE1", "VE2"),
        subjects=("A", "B", "C"),
    )
    return CollapsedDensity(statistics, options=options)


def covariance(named, sd, rho, j=None):
    values = named[sd][..., 0]
    values = values if j is None else values[:, j]
    correlation = np.eye(len(values))
    if len(values) == 2:
        correlation[0, 1] = correlation[1, 0] = named[rho][0]
    return values[:, None] * correlation * values


@pytest.mark.parametrize("parameters", [("k",), ("k", "b")])
def test_effects_have_the_conditional_mean_and_covariance(parameters):
    density = density_of(parameters)
    point = 0.3 * np.random.default_rng(1).standard_normal((1, density.dimension))
    draws = 40_000
    points = np.repeat(point, draws, axis=0)
    location = np.linspace(-0.2, 0.3, 2 * len(parameters))
    locations = np.repeat(location[None], draws, axis=0)
    found = density.draw_subject_effects(points, locations, np.random.default_rng(2))
    named = density.layout.scales(point.T).named
    shared = covariance(named, "sigma_u", "rho_u")
    size = len(parameters)
    for i in range(3):
        precision = np.linalg.inv(shared)
        pull = np.zeros(size)
        for j in range(2):
            count = REPEATS.get((i, j))
            if count is None:
                continue
            cell = covariance(named, "sigma", "rho_w", j)
            cell = cell + covariance(named, "sigma_e", "rho_e", j) / count
            residual = density.statistics.cell_means[i, :, j] - location.reshape(size, 2)[:, j]
            precision += np.linalg.inv(cell)
            pull += np.linalg.inv(cell) @ residual
        law = np.linalg.inv(precision)
        error = np.sqrt(np.diag(law) / draws)
        assert np.all(np.abs(found[:, i].mean(axis=0) - law @ pull) < 4.5 * error)
        scatter = np.atleast_2d(np.cov(found[:, i].T))
        bound = np.sqrt(2.0 * np.outer(np.diag(law), np.diag(law)) / draws)
        assert np.all(np.abs(scatter - law) < 4.5 * bound)


def test_a_model_without_them_has_none():
    density = density_of(("k",), Options(subject_effect=False))
    rng = np.random.default_rng(0)
    points = np.zeros((2, density.dimension))
    assert density.draw_subject_effects(points, np.zeros((2, 2)), rng) is None


@pytest.mark.parametrize("name", ["two levels, trials", "unequal trials", "subjects' trial SDs"])
def test_effects_of_a_linear_design_have_the_conditional_mean_and_covariance(name):
    built = made(name).model
    model = LinearPosterior(built.statistics, built.design, built.priors, scatter=built.scatter)
    point = 0.3 * np.random.default_rng(1).standard_normal((1, len(model.names)))
    size, cells = model.design.cells.x.shape
    location = np.linspace(-0.2, 0.3, size * cells)
    draws = 20_000
    points = np.repeat(point, draws, axis=0)
    locations = np.repeat(location[None], draws, axis=0)
    found = model.draw_subject_effects(points, locations, np.random.default_rng(2))
    laws = model.subject_laws(point)
    # Columns of what every subject adds to all quantities and cells, and to their averages.
    columns = laws.effects[..., 0].reshape(-1, size * cells).T
    averages = columns.reshape(size, cells, -1).mean(axis=1)
    for pattern, noise in zip(model.statistics.patterns, laws.noise, strict=True):
        count = len(pattern.environments)
        dense = np.zeros((size, count, size, count))
        for p, unit in enumerate(np.eye(size)):
            applied = noise[:, 0].inverse().apply(tuple(np.repeat(unit[:, None], count, axis=1)))
            for c in range(count):
                dense[:, c, p, c] = [part[c] for part in applied]
        precision = dense.reshape(size * count, -1)
        rows = np.arange(size * cells).reshape(size, cells)[:, pattern.environments].ravel()
        seen = columns[rows]
        law = np.linalg.inv(np.eye(columns.shape[1]) + seen.T @ precision @ seen)
        for i in pattern.members:
            means = model.statistics.cell_means[i].ravel()[rows]
            expected = averages @ law @ seen.T @ precision @ (means - location[rows])
            covariance = averages @ law @ averages.T
            error = np.sqrt(np.diag(covariance) / draws)
            assert np.all(np.abs(found[:, i].mean(axis=0) - expected) < 4.5 * error)
            scatter = np.atleast_2d(np.cov(found[:, i].T))
            bound = np.sqrt(2.0 * np.outer(np.diag(covariance), np.diag(covariance)) / draws)
            assert np.all(np.abs(scatter - covariance) < 4.5 * bound)


def test_effects_beside_covariates_are_not_drawn():
    built = made("covariates of trials").model
    model = LinearPosterior(
        built.statistics, built.design, built.priors, built.covariates, built.scatter
    )
    rng = np.random.default_rng(0)
    points = np.zeros((2, len(model.names)))
    assert model.draw_subject_effects(points, np.zeros((2, 12)), rng) is None
