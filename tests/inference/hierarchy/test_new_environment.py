"""Users of an environment nobody was tested in: their laws by hand, and draws of them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.design import Cells, Factors, design_of
from percept.inference.hierarchy.interval_estimands import IntervalEstimands
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from percept.inference.hierarchy.linear_scales import effect_columns
from percept.inference.hierarchy.new_environment import NewEstimands, new_environment
from tests.inference.hierarchy import designs
from tests.inference.hierarchy.linear_designs import dense, made

PLACE = np.array([0.3, -0.4])


def model_and_points(width=5):
    model = CollapsedDensity(designs.study("balanced", np.random.default_rng(1)).statistics)
    return model, np.random.default_rng(2).normal(size=(width, len(model.names)))


def expected(model, points, repeats):
    found = new_environment(model, points, PLACE, repeats=repeats, rng=np.random.default_rng(0))[""]
    return found, {
        name: np.repeat(values, repeats, axis=0)
        for name, (_, values) in model.scales(points).items()
    }


def test_users_correlate_by_what_they_share_and_by_what_is_their_own() -> None:
    found, named = expected(*model_and_points(), repeats=3)
    shared = named["sigma_u"]
    own = np.sqrt(np.diagonal(found.population, axis1=1, axis2=2) - shared**2)
    wanted = named["rho_u"] * shared.prod(axis=1) + named["rho_w"] * own.prod(axis=1)
    np.testing.assert_allclose(found.population[:, 0, 1], wanted, rtol=1e-9)
    np.testing.assert_array_equal(found.population[:, 0, 1], found.population[:, 1, 0])


def test_repeats_of_a_draw_stand_together() -> None:
    model, points = model_and_points()
    once, thrice = (expected(model, points, repeats)[0] for repeats in (1, 3))
    np.testing.assert_array_equal(thrice.mean, np.repeat(once.mean, 3, axis=0))
    np.testing.assert_array_equal(thrice.covariance, np.repeat(once.covariance, 3, axis=0))


def test_spreads_of_stiffness_and_damping_leave_their_trends_independently() -> None:
    found, named = expected(*model_and_points(width=200), repeats=20)
    own = np.diagonal(found.population, axis1=1, axis2=2) - named["sigma_u"] ** 2
    off = (0.5 * np.log(own) - np.log(named["s"]) - named["kappa"] * PLACE) / named["omega"]
    # Where next to nothing leaves the trend the difference is rounding.
    off = off[(named["omega"] > 0.1).all(axis=1)]
    assert len(off) > 2000
    # A correlation of independent pairs scatters by one over the root of their number.
    assert abs(np.corrcoef(off.T)[0, 1]) < 4.0 / np.sqrt(len(off))


def test_estimands_average_the_pull_of_a_draw_over_its_spreads() -> None:
    model, points = model_and_points(width=300)
    asked = IntervalEstimands(model, kinds=("mean", "user"), level=0.9)
    new = NewEstimands(asked, PLACE, 3, seed=0, names=["new"])
    parts = list(new.estimates(new.components(points)))
    laws = new_environment(model, points, PLACE, repeats=3, rng=np.random.default_rng(0))[""].laws
    assert parts[0][0].names[0] == "lower mean limit of k in new"
    for kind, (found, influence) in zip(("mean", "user"), parts, strict=True):
        limits = asked.limits(kind, laws)
        np.testing.assert_array_equal(found.value, np.concatenate([limits.lower, limits.upper]))
        np.testing.assert_allclose(influence, limits.influence.reshape(300, 3, 4).mean(axis=1))
    assert (
        new.identity()
        != NewEstimands(asked, 2.0 * PLACE, 3, seed=0, names=["new"]).identity()
        != asked.identity()
    )


def posterior_of(name):
    """A design with factors, as a study uses it."""
    study = made(name)
    model = study.model
    given = (model.statistics, model.design, model.priors, model.covariates, model.scatter)
    return study, LinearPosterior(*given)


def with_new_cells(design, priors, x):
    """Columns of the same design with an environment more, which has every level."""
    cells = design.cells
    levels = {factor: np.asarray(level) for factor, level in design.factors.level.items()}
    grid = list(dict.fromkeys(zip(*levels.values(), strict=True)))
    added = np.array(grid).T
    names = [f"new {number}" for number in range(len(grid))]
    more = Cells(
        (*cells.names, *names),
        np.append(cells.environment, [cells.environment.max() + 1] * len(grid)),
        (*cells.environments, "new"),
        np.hstack([cells.x, np.tile(x[:, None], len(grid))]),
    )
    of_all = {
        factor: np.append(level, own)
        for (factor, level), own in zip(levels.items(), added, strict=True)
    }
    factors = Factors(
        levels=design.factors.levels,
        level=of_all,
        terms=design.factors.terms,
        between_subjects=design.factors.between_subjects,
        spread=design.factors.spread,
        slopes=design.factors.slopes,
    )
    return design_of(more, factors, priors)


@pytest.mark.parametrize(
    "name",
    [
        "two by two, two groups, covariate",
        "two by two, spread",
        "three levels, missing cells",
        "slopes over references",
    ],
)
def test_conditions_of_a_new_environment_by_dense_conditioning(name):
    """The covariance of all trials and of the new cells is written out and conditioned."""
    study, model = posterior_of(name)
    x = PLACE[: len(model.statistics.parameters)]
    point = np.random.default_rng(4).normal(0.0, 0.5, (1, len(model.names)))
    found = model.new_environment(point, x, 1, np.random.default_rng(5))
    named = dict(model.linear_scales(point).named)
    wider = with_new_cells(model.design, model.priors, x)
    old = len(model.design.cells.names)
    new = len(wider.cells.names) - old
    assert len(found) == new
    # The dense covariance takes users' own SDs of the new cells; they are found, and checked below.
    own = np.zeros((len(x), new, 1))
    named["sigma"] = np.concatenate([named["sigma"], own], axis=1)
    if "sigma_e" in named:
        named["sigma_e"] = np.concatenate([named["sigma_e"], own], axis=1)
    whole = SimpleNamespace(
        model=SimpleNamespace(design=wider, priors=model.priors),
        cell=study.cell,
        subject=study.subject,
        covariates=study.covariates,
    )
    covariance, prior, user = dense(whole, named, 0)
    count = old + new
    trials = np.concatenate([p * count + study.cell for p in range(len(x))])
    for number, laws in enumerate(found.values()):
        at = [p * count + old + number for p in range(len(x))]
        gain = np.linalg.solve(covariance, prior[np.ix_(trials, at)]).T
        mean = gain @ study.response.T.ravel()
        left = prior[np.ix_(at, at)] - gain @ prior[np.ix_(trials, at)]
        np.testing.assert_allclose(laws.mean[0], mean, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(laws.covariance[0], left, rtol=1e-6, atol=1e-10)
        # What is left is users' own: its SDs, and their correlation.
        rest = laws.population[0] - user[np.ix_(at, at)]
        sd = np.sqrt(np.diag(rest))
        np.testing.assert_allclose(rest[0, 1] / sd.prod(), named["rho_w"][0], rtol=1e-7)


def test_spreads_of_new_conditions_lie_about_the_columns_of_log_sigma():
    _, model = posterior_of("two by two, spread")
    point = np.random.default_rng(6).normal(0.0, 0.5, (1, len(model.names)))
    repeats = 4000
    found = model.new_environment(point, PLACE, repeats, np.random.default_rng(7))
    named = model.linear_scales(point).named
    wider = with_new_cells(model.design, model.priors, PLACE)
    effects = effect_columns(model.linear_scales(point).effects, wider)[..., 0]
    shared = np.einsum("qpc,qpc->pc", effects, effects)[:, -len(found) :]
    coefficients = [named[name][:, 0] for name in model.coordinates.between.coefficients]
    scaled = [
        column / model.coordinates.coefficient_sd(name)
        for name, column in _named_columns(model, wider)
    ]
    trend = np.einsum("kpc,kp->pc", np.stack(scaled), np.stack(coefficients))[:, -len(found) :]
    omega = named["omega"][:, 0]
    for number, laws in enumerate(found.values()):
        own = np.diagonal(laws.population, axis1=1, axis2=2) - shared[:, number]
        off = (0.5 * np.log(own) - model.priors.log_s_mean - trend[:, number]) / omega
        # Even draws of a standard normal.
        np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=0.01)
        np.testing.assert_allclose(off.std(axis=0), 1.0, atol=0.01)


def _named_columns(model, design):
    columns = np.concatenate([term.columns for term in design.sd_between])
    return zip(model.coordinates.between.coefficients, columns, strict=True)


def test_one_environment_with_factors_predicts_no_other():
    _, model = posterior_of("one environment")
    point = np.zeros((1, len(model.names)))
    with pytest.raises(RefusalError, match="one environment shows no trend"):
        model.new_environment(point, PLACE, 1, np.random.default_rng(0))
    with pytest.raises(RefusalError, match="one environment shows no trend"):
        model.trends(point)


def test_one_environment_without_factors_has_no_trend():
    study = designs.study("one environment", np.random.default_rng(1))
    model = CollapsedDensity(study.statistics)
    with pytest.raises(RefusalError, match="one environment shows no trend"):
        model.trends(np.zeros((1, len(model.names))))


@pytest.mark.parametrize(
    "name", ["balanced", "two by two, two groups, covariate", "slopes over references"]
)
def test_a_trend_is_a_new_environment_less_what_that_has_of_its_own(name):
    """New environments are checked against dense conditioning above."""
    if name == "balanced":
        model, points = model_and_points()
    else:
        _, model = posterior_of(name)
        points = np.random.default_rng(4).normal(0.0, 0.5, (5, len(model.names)))
    found = model.trends(points)
    new = model.new_environment(points, PLACE, 1, np.random.default_rng(0))
    named = model.scales(points)
    own = named["tau"][1] ** 2
    for scale, (_, values) in named.items():
        if scale.startswith("tau:"):
            # Columns of a factor of two levels are half a unit high, and of two by two a quarter.
            columns = 0.5 ** len(scale.split(":")[1:])
            own = own + (columns * values) ** 2
    assert list(found) == list(new)
    for condition, trend in found.items():
        weights = np.stack([np.ones(2), PLACE], axis=1)
        mean = np.einsum("wpa,pa->wp", trend.mean, weights)
        np.testing.assert_allclose(mean, new[condition].mean, rtol=1e-10)
        variance = np.einsum("wpab,pa,pb->wp", trend.covariance, weights, weights)
        expected = np.diagonal(new[condition].covariance, axis1=1, axis2=2) - own
        np.testing.assert_allclose(variance, expected, rtol=1e-9)


def test_a_pair_law_of_one_quantity_is_that_of_its_cells():
    _, model = posterior_of("one quantity, two levels")
    points = np.random.default_rng(4).normal(0.0, 0.5, (5, len(model.names)))
    pairs = model.pairs(points)
    laws = model.laws(points)
    np.testing.assert_allclose(pairs.mean[..., 0], laws.mean, rtol=1e-12)
    np.testing.assert_allclose(pairs.location[..., 0, 0], laws.sd**2, rtol=1e-10)
    np.testing.assert_allclose(pairs.users[..., 0, 0], laws.population_sd**2, rtol=1e-10)
