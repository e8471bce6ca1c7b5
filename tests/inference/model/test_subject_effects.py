"""Draws of subjects' effects, and which cells they are of, against the twin."""

from __future__ import annotations

import numpy as np
import pytest

from percept.inference.model.predictions import draw_subject_effects
from tests.inference.model.designs import made

DRAWS = 5_000


def effects_given(twin, i, own, location):
    """Mean and covariance of a subject's effect, averaged over its own cells, given locations."""
    study = twin.study
    size, cells = study.x.shape
    users = twin.users[0].reshape(size, cells, size, cells).copy()
    for c in range(cells):
        sigma = twin.named["sigma"][:, :, c]
        users[:, c, :, c] -= twin._covariance(sigma, "rho_w")[0]
    effects = users.reshape(size * cells, -1)
    trials = study.subject == i
    at = (np.arange(size)[:, None] * cells + study.cell[trials]).ravel()
    rows = np.flatnonzero(np.tile(trials, size))
    of_locations = twin.loadings[rows] @ twin.locations[0] @ twin.loadings[rows].T
    total = twin.observed[0][np.ix_(rows, rows)] - of_locations
    averages = np.kron(np.eye(size), own / own.sum())
    gain = np.linalg.solve(total, effects[at] @ averages.T).T
    residual = study.response.T.ravel()[rows] - location[at]
    return gain @ residual, averages @ effects @ averages.T - gain @ effects[at] @ averages.T


@pytest.mark.parametrize(
    "name",
    ["plain, unequal trials", "plain, missing cells", "one quantity", "two levels, trials",
     "unequal trials", "subjects' trial SDs", "two groups"],
)  # fmt: skip
def test_effects_have_the_conditional_mean_and_covariance(name):
    """Of the cells of a subject's own group, where there are groups."""
    study = made(name)
    model = study.model
    point = study.points(1, spread=0.3)
    size, cells = study.study.x.shape
    location = np.linspace(-0.2, 0.3, size * cells)
    found = draw_subject_effects(
        model,
        np.repeat(point, DRAWS, axis=0),
        np.repeat(location[None], DRAWS, axis=0),
        np.random.default_rng(2),
    )
    twin = study.twin(point)
    for i in range(found.shape[1]):
        own = np.ones(cells, dtype=bool)
        for factor in study.study.between:
            _, level = study.study.levels[factor]
            own &= level == level[study.study.cell[study.study.subject == i][0]]
        mean, covariance = effects_given(twin, i, own, location)
        error = np.sqrt(np.diag(covariance) / DRAWS)
        assert np.all(np.abs(found[:, i].mean(axis=0) - mean) < 4.5 * error)
        scatter = np.atleast_2d(np.cov(found[:, i].T))
        bound = np.sqrt(2.0 * np.outer(np.diag(covariance), np.diag(covariance)) / DRAWS)
        assert np.all(np.abs(scatter - covariance) < 4.5 * bound)


@pytest.mark.parametrize("name", ["no subject effect", "one cell", "covariates of trials"])
def test_a_model_without_them_or_with_covariates_has_none(name):
    study = made(name)
    locations = np.zeros((2, len(study.model.cells)))
    rng = np.random.default_rng(0)
    assert draw_subject_effects(study.model, study.points(2), locations, rng) is None
