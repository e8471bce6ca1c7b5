"""Laws of cells, contrasts, pairs and untested environments against the twin."""

import dataclasses

import numpy as np
import pytest
from scipy import linalg

from percept.errors import RefusalError
from percept.inference.model.model import Product
from percept.inference.model.predictions import new_environment
from tests.inference.model.designs import DESIGNS, made
from tests.inference.twin import Twin


def random_rows(count, model):
    """Weights of cells and slopes; coefficients of fixed terms, which are last, have none."""
    rows = np.random.default_rng(3).normal(size=(count, model.locations))
    rows[:, model.locations - len(model.basis.fixed) :] = 0.0
    return rows


def weighed(twin, rows):
    """Mean, SD and users' SD of combinations (L, R), each (W, L)."""
    mean, covariance = twin.posterior()
    rows = rows[:, : mean.shape[1]]
    of_cells = rows[:, : twin.users.shape[1]]
    variance = np.einsum("lr,wrs,ls->wl", rows, covariance, rows)
    own = np.einsum("lr,wrs,ls->wl", of_cells, twin.users, of_cells)
    return mean @ rows.T, np.sqrt(variance), np.sqrt(own)


def check(laws, expected):
    mean, sd, population_sd = expected
    np.testing.assert_allclose(laws.mean, mean, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(laws.sd, sd, rtol=1e-7)
    np.testing.assert_allclose(laws.population_sd, population_sd, rtol=1e-10)


@pytest.mark.parametrize("name", DESIGNS)
def test_cells_and_contrasts_have_their_conditional_law(name):
    """Every cell, and combinations of cells and slopes."""
    study = made(name)
    points = study.points(3)
    twin = study.twin(points)
    model = study.model
    check(model.moments(points), weighed(twin, model.cell_rows))
    rows = random_rows(3, model)
    expected = weighed(twin, rows)
    check(model.moments(points, rows), expected)
    np.testing.assert_allclose(model.moments(points, rows).population_sd, expected[2], rtol=1e-10)


@pytest.mark.parametrize("name", ["plain, trials", "plain, missing cells", "unequal trials"])
def test_pairs_have_the_joint_law_of_their_quantities(name):
    study = made(name)
    points = study.points(3)
    twin = study.twin(points)
    pairs = study.model.joint(points, study.model.pair_rows)
    mean, covariance = twin.posterior()
    for c in range(twin.cells):
        at = np.array([c, twin.cells + c])
        np.testing.assert_allclose(pairs.mean[:, c], mean[:, at], rtol=1e-8, atol=1e-10)
        both = (slice(None), at[:, None], at)
        np.testing.assert_allclose(pairs.location[:, c], covariance[both], rtol=1e-7, atol=1e-12)
        np.testing.assert_allclose(pairs.users[:, c], twin.users[both], rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize(
    "name", ["plain, trials", "plain, missing cells", "two by two, spread", "covariates of trials"]
)
def test_draws_have_the_law_of_cells_and_users(name):
    study = made(name)
    point = study.points(1)
    count = 20_000
    rows = random_rows(4, study.model)
    rng = np.random.default_rng(4)
    location, user = study.model.draw(point, rng, rows, repeats=count)
    twin = study.twin(point)
    rows = rows[:, : len(twin.locations[0])]
    of_cells = rows[:, : twin.users.shape[1]]
    mean, covariance = twin.posterior()
    of_location = rows @ covariance[0] @ rows.T
    of_user = of_location + of_cells @ twin.users[0] @ of_cells.T
    for drawn, expected in ((location, of_location), (user, of_user)):
        variances = np.diag(expected)
        centre = (drawn.mean(axis=0) - rows @ mean[0]) / np.sqrt(variances / count)
        assert np.all(np.abs(centre) < 4.5)
        # An entry of an empirical covariance has this standard error.
        error = np.sqrt((np.outer(variances, variances) + expected**2) / count)
        assert np.all(np.abs(np.cov(drawn.T) - expected) < 4.5 * error)


def with_new_cells(study, x):
    """Add an untested environment with one cell for each combination of levels."""
    first = study.environment == 0
    count = int(first.sum())
    levels = {
        name: (number, np.concatenate([level, level[first]]))
        for name, (number, level) in study.levels.items()
    }
    added = np.full(count, study.environment.max() + 1)
    return dataclasses.replace(
        study,
        environment=np.concatenate([study.environment, added]),
        x=np.concatenate([study.x, np.repeat(x[:, None], count, axis=1)], axis=1),
        levels=levels,
    )


@pytest.mark.parametrize(
    "name",
    ["plain, trials", "plain, missing cells", "no subject effect", "two by two, spread",
     "slopes over references", "subjects' trial SDs", "covariates of trials"],
)  # fmt: skip
def test_an_untested_environment_has_the_law_of_a_cell_without_trials(name):
    study = made(name)
    model = study.model
    x = np.array([0.4, -0.2])
    points = study.points(3)
    scales = model.scales(points)
    wider = with_new_cells(study.study, x)
    tested = len(study.study.environment)
    added = len(wider.environment) - tested
    for sd in ("sigma", "sigma_e"):
        if sd in scales:
            dimensions, values = scales[sd]
            scales[sd] = (dimensions, np.pad(values, ((0, 0), (0, 0), (0, added))))
    twin = Twin(wider, model.priors, scales)
    mean, covariance = twin.posterior()
    new = new_environment(model, points, x, repeats=2, rng=np.random.default_rng(5))
    ahead = new_environment(model, points, x + 1.0, repeats=1, rng=np.random.default_rng(5))
    slopes = model.moments(points, model.slope_rows).mean
    assert len(new) == added
    for number, of_condition in enumerate(new.values()):
        at = np.array([tested + number, twin.cells + tested + number])
        both = (slice(None), at[:, None], at)
        np.testing.assert_allclose(of_condition.mean[::2, 0], mean[:, at], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(of_condition.location[1::2, 0], covariance[both], rtol=1e-6)
        shared = of_condition.users[:, 0] - np.repeat(twin.users[both], 2, axis=0)
        # What is left is the spread within the new environment: both SDs and their correlation.
        sd = np.sqrt(np.diagonal(shared, axis1=1, axis2=2))
        rho = shared[:, 0, 1] / sd.prod(axis=1)
        np.testing.assert_allclose(rho, np.repeat(scales["rho_w"][1], 2), rtol=1e-7)
    for condition, law in ahead.items():
        here = new[condition].mean[::2, 0]
        np.testing.assert_allclose(law.mean[:, 0] - here, slopes, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("name", ["one cell", "one environment"])
def test_one_environment_predicts_no_other(name):
    study = made(name)
    points = study.points(2)
    rng = np.random.default_rng(1)
    with pytest.raises(RefusalError, match="no trend to predict others from"):
        new_environment(study.model, points, np.zeros(2), repeats=1, rng=rng)


def test_models_side_by_side_have_the_law_of_all_their_locations():
    """A pair with covariates, and a quantity with a model of its own: contrasts over all three."""
    studies = [made("covariates of trials"), made("one quantity, two levels", seed=1)]
    models = [study.model for study in studies]
    product = Product(models)
    assert product.names == models[0].names + models[1].names
    assert product.cells == models[0].cells + models[1].cells
    points = np.random.default_rng(2).normal(0.0, 0.7, (2, len(product.names)))
    split = np.split(points, [len(models[0].names)], axis=1)
    values = sum(model(part) for model, part in zip(models, split, strict=True))
    np.testing.assert_allclose(product(points), values, rtol=1e-14)
    parts = [random_rows(4, model) for model in models]
    rows = np.hstack(parts)
    found = []
    for study, coordinates, own in zip(studies, split, parts, strict=True):
        found.append(weighed(study.twin(coordinates), own))
    means, sds, user_sds = zip(*found, strict=True)
    expected = (sum(means), np.hypot(*sds), np.hypot(*user_sds))
    check(product.moments(points, rows), expected)
    assert linalg.norm(expected[0]) > 0.0
    count = 20_000
    draws = product.draw(points[:1], np.random.default_rng(5), rows, repeats=count)
    sds = (expected[1][0], np.hypot(expected[1][0], expected[2][0]))
    for drawn, sd in zip(draws, sds, strict=True):
        assert np.all(np.abs(drawn.mean(axis=0) - expected[0][0]) < 4.5 * sd / np.sqrt(count))
        assert np.all(np.abs(drawn.std(axis=0) / sd - 1.0) < 4.5 / np.sqrt(2.0 * count))


def test_scales_side_by_side_stand_by_quantity():
    """A pair whose quantities correlate, and a quantity without repeats or correlations."""
    models = [made("plain, trials").model, made("one quantity", seed=1).model]
    product = Product(models)
    points = np.random.default_rng(2).normal(0.0, 0.7, (5, len(product.names)))
    named = product.scales(points)
    (pair, _), (alone, coordinates) = product.split(points)
    np.testing.assert_array_equal(named["sigma"][1][:, 2:], alone.scales(coordinates)["sigma"][1])
    np.testing.assert_array_equal(named["sigma_e"][1][:, 2], np.full((5, 3), np.nan))
    assert named["sigma_e"][0] == ("parameter", "environment")
    of_pair = pair.scales(points[:, : len(pair.names)])
    for name, (_, values) in of_pair.items():
        found = named[name][1]
        np.testing.assert_array_equal(found[:, :2] if found.ndim > 1 else found, values)
