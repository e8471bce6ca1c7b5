"""The posterior of linear designs against its covariance written out, trial by trial."""

import numpy as np
import pytest
from scipy import linalg, stats

from percept.inference.hierarchy.cell_information import CellLaw
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.design import contrast_columns
from percept.inference.hierarchy.linear_posterior import LinearPosterior
from percept.inference.hierarchy.linear_product import LinearProduct
from percept.inference.hierarchy.log_linear import LogLinear
from percept.inference.hierarchy.one_pattern import absorb
from percept.inference.hierarchy.priors import Priors
from percept.inference.hierarchy.subject_spreads import SubjectSpreads
from percept.inference.hierarchy.trial_scatter import trial_scatter
from tests.inference.hierarchy.linear_designs import DESIGNS, dense, made


def points_of(model, count=4, spread=0.7):
    return np.random.default_rng(2).normal(0.0, spread, (count, len(model.names)))


def log_normal(covariance, response):
    lower = linalg.cholesky(covariance, lower=True)
    white = linalg.solve_triangular(lower, response, lower=True)
    constant = 0.5 * response.size * np.log(2.0 * np.pi)
    return -0.5 * white @ white - np.log(np.diag(lower)).sum() - constant


@pytest.mark.parametrize("name", DESIGNS)
def test_the_density_is_that_of_the_trials(name):
    """Log densities within 1e-9 of one multivariate normal over all trials."""
    study = made(name)
    points = points_of(study.model)
    scales = study.model.linear_scales(points)
    found = study.model(points) - scales.log_prior
    for s in range(len(points)):
        covariance, *_ = dense(study, scales.named, s)
        expected = log_normal(covariance, study.response.T.ravel())
        assert found[s] == pytest.approx(expected, abs=1e-9 * (1.0 + abs(expected)))


@pytest.mark.parametrize("name", DESIGNS)
def test_scales_of_one_dimension_have_one_length(name):
    model = made(name).model
    points = points_of(model, 3)
    lengths = {}
    for name_of_scale, (dimensions, values) in model.scales(points).items():
        assert len(values) == 3
        for dimension, length in zip(dimensions, values.shape[1:], strict=True):
            assert lengths.setdefault(dimension, length) == length, name_of_scale


def locations_given(study, named, s):
    """Mean, covariance and users' covariance of all locations, by the rule for normal variables."""
    model = study.model
    size, cells = model.design.cells.x.shape
    slopes = study.covariates.shape[1] * size
    variance = model.priors.covariate_sd**2
    at = np.concatenate([p * cells + study.cell for p in range(size)])
    quantity = np.repeat(np.arange(size), len(study.cell))
    covariance, prior, user = dense(study, named, s)
    towards = np.zeros((size * cells + slopes, len(at)))
    towards[: size * cells] = prior[:, at]
    for m, values in enumerate(study.covariates.T):
        for p in range(size):
            row = size * cells + m * size + p
            towards[row] = variance * np.tile(values, size) * (quantity == p)
    whole = linalg.block_diag(prior, variance * np.eye(slopes))
    gain = linalg.solve(covariance, towards.T, assume_a="pos").T
    users = linalg.block_diag(user, np.zeros((slopes, slopes)))
    return gain @ study.response.T.ravel(), whole - gain @ towards.T, users


def check_laws(laws, s, rows, given):
    mean, left, users = given
    np.testing.assert_allclose(laws.mean[s], rows @ mean, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(laws.sd[s] ** 2, np.diag(rows @ left @ rows.T), rtol=2e-7)
    own = np.diag(rows @ users @ rows.T)
    np.testing.assert_allclose(laws.population_sd[s] ** 2, own, rtol=2e-10)


@pytest.mark.parametrize("name", DESIGNS)
def test_locations_and_users_have_their_conditional_law(name):
    """Rows of cells and of slopes."""
    study = made(name)
    model = study.model
    points = points_of(model, 2)
    named = model.linear_scales(points).named
    count = len(model.cells) + study.covariates.shape[1] * model.design.parameters
    rows = np.random.default_rng(3).normal(size=(3, count))
    laws = model.laws_of(rows, points)
    for s in range(len(points)):
        check_laws(laws, s, rows, locations_given(study, named, s))


def test_three_quantities_have_the_law_of_their_models_side_by_side():
    """A pair with covariates, and a quantity with a model of its own: contrasts over all three."""
    studies = [made("covariates of trials"), made("one quantity, two levels", seed=1)]
    models = []
    for study in studies:
        own = study.model
        covariates = (own.covariates, own.scatter)
        models.append(LinearPosterior(own.statistics, own.design, own.priors, *covariates))
    product = LinearProduct(models)
    points = points_of(product, 2)
    split = np.split(points, [len(models[0].names)], axis=1)
    values = sum(model(part) for model, part in zip(models, split, strict=True))
    np.testing.assert_allclose(product(points), values, rtol=1e-14)
    count = sum(model.locations_count for model in models)
    rows = np.random.default_rng(3).normal(size=(4, count))
    laws = product.laws_of(rows, points)
    draws = 20_000
    for s in range(len(points)):
        parts = []
        for study, model, part in zip(studies, models, split, strict=True):
            parts.append(locations_given(study, model.linear_scales(part).named, s))
        means, left, users = zip(*parts, strict=True)
        given = (np.concatenate(means), linalg.block_diag(*left), linalg.block_diag(*users))
        check_laws(laws, s, rows, given)
        log_sds = product.log_user_sds(rows, points[s : s + 1])
        np.testing.assert_allclose(np.exp(log_sds[0]), laws.population_sd[s], rtol=1e-12)
        location, user = product.draw_of(
            rows, points[s : s + 1], np.random.default_rng(s), repeats=draws
        )
        of_location = rows @ given[1] @ rows.T
        for drawn, expected in (
            (location, of_location),
            (user, of_location + rows @ given[2] @ rows.T),
        ):
            variances = np.diag(expected)
            # An entry of an empirical covariance has this standard error.
            error = np.sqrt((np.outer(variances, variances) + expected**2) / draws)
            assert np.all(np.abs(np.cov(drawn.T) - expected) < 4.5 * error)


@pytest.mark.parametrize("name", ["three levels, missing cells", "two groups"])
def test_no_draw_that_has_lost_its_digits_is_weighed(name):
    """Of scales far out the density is right, as far as the dense one can tell, or zero."""
    study = made(name)
    points = np.random.default_rng(5).normal(0.0, 5.0, (60, len(study.model.names)))
    with np.errstate(all="ignore"):
        scales = study.model.linear_scales(points)
        lost = ~CellLaw(study.model.problem, scales.cells).sound
    found = study.model(points) - scales.log_prior
    assert lost.any()
    assert np.isneginf(found[lost]).all()
    compared = 0
    for s in np.flatnonzero(np.isfinite(found)):
        covariance, *_ = dense(study, scales.named, s)
        condition = np.linalg.cond(covariance)
        if condition < 1e12:
            expected = log_normal(covariance, study.response.T.ravel())
            error = 1e-9 + 1e-15 * condition
            assert found[s] == pytest.approx(expected, abs=error * (1.0 + abs(expected)))
            compared += 1
    assert compared > 10


@pytest.mark.parametrize("name", ["no factor", "two by two, spread", "one environment"])
@pytest.mark.parametrize("spread", [5.0, 12.0])
def test_every_draw_of_one_pattern_that_is_weighed_has_laws(name, spread):
    """At extreme scales the orthogonal form still gives a density where no law has digits left."""
    model = made(name).model
    points = np.random.default_rng(5).normal(0.0, spread, (200, len(model.names)))
    weighed = points[np.isfinite(model(points))]
    assert len(weighed) > 20
    laws = model.laws(weighed)
    assert np.isfinite(laws.mean).all()
    assert (laws.sd > 0.0).all()


def test_laws_keep_their_digits_where_only_the_orthogonal_form_gives_a_density():
    study = made("one quantity, two levels")
    model = study.model
    points = np.random.default_rng(5).normal(0.0, 9.0, (400, len(model.names)))
    scales = model.linear_scales(points)
    law = CellLaw(model.problem, scales.cells)
    weighed = np.isfinite(model(points))
    assert law.laws_sound[weighed].all()
    laws = model.laws(points)
    compared = 0
    for s in np.flatnonzero(weighed & ~law.sound):
        covariance, *_ = dense(study, scales.named, s)
        if np.linalg.cond(covariance) < 1e11:
            mean, left, _ = locations_given(study, scales.named, s)
            sd = np.sqrt(np.diag(left))
            # The dense law of doubles has itself lost up to eleven of sixteen digits.
            np.testing.assert_allclose(laws.mean[s] / sd, mean / sd, rtol=1e-4, atol=1e-4)
            np.testing.assert_allclose(laws.sd[s], sd, rtol=1e-4)
            compared += 1
    assert compared > 5


def test_trial_sds_of_subjects_who_share_a_pattern_are_refused():
    model = made("no factor").model
    own = made("subjects' trial SDs").model.scatter
    with pytest.raises(ValueError, match="need a pattern each: pattern 0 has 5 subjects"):
        LinearPosterior(model.statistics, model.design, scatter=own)


def test_both_forms_of_the_density_agree():
    """Blocks by environment, and the information of all patterns."""
    model = made("two by two, spread").model
    scales = model.linear_scales(points_of(model)).cells
    by_blocks = model.one_pattern.log_density(scales)
    law = CellLaw(model.problem, scales)
    assert law.sound.all()
    np.testing.assert_allclose(law.log_density, by_blocks, rtol=1e-11)


def test_without_factors_it_is_the_model_of_environments():
    """Equal scales give equal densities, up to what the coordinates are."""
    study = made("no factor")
    model = study.model
    pooled = CollapsedDensity(model.statistics)
    points = points_of(model)
    scales = model.linear_scales(points)
    named = scales.named
    likelihood = model(points) - scales.log_prior
    for s in range(len(points)):
        value = {name: array[..., s : s + 1] for name, array in named.items()}
        same = pooled.layout.scales(np.zeros((pooled.dimension, 1)))
        from percept.inference.hierarchy.blocks import block
        from percept.inference.hierarchy.scales import Scales

        def pair(sd, rho):
            return block(tuple(sd), rho, 1.0 - np.abs(rho))

        own = Scales(
            between=pair(value["sigma"], value["rho_w"]),
            shared=pair(value["sigma_u"], value["rho_u"]),
            trial=None,
            tau=tuple(value["tau"]),
            named=same.named,
            log_prior=same.log_prior,
        )
        assert pooled.log_likelihood(own)[0] == pytest.approx(likelihood[s], rel=1e-9)


@pytest.mark.parametrize("psi_sd", [0.5, 0.05])
def test_coordinates_have_the_prior_of_the_spreads(psi_sd):
    """Their density is that of standard normals times the Jacobian of the map, by differences."""
    rng = np.random.default_rng(3)
    columns = np.stack([np.ones(6), np.linspace(-1, 1, 6), psi_sd * np.tile([-0.5, 0.5], 3)])
    weight = np.array([0.0, 3.0, 10.0, 50.0, 5.0, 0.0])
    spread = LogLinear(np.log(0.2), columns, rng.normal(-1.5, 0.5, 6), weight)
    omega = np.array([0.6])
    step = 1e-6

    def standard(coords, omega):
        made = spread(coords[:3], coords[3:], omega)
        middle = columns.T @ made.multiples
        own = (made.log_sigma - np.log(0.2) - middle) / omega
        return np.concatenate([made.multiples, own]), made

    u = rng.normal(0.0, 0.5, (9, 1))
    z, found = standard(u, omega)
    ends = u + step * np.hstack([np.eye(9), -np.eye(9)])
    moved, _ = standard(ends, np.repeat(omega, 18))
    jacobian = (moved[:, :9] - moved[:, 9:]) / (2.0 * step)
    expected = stats.norm.logpdf(z).sum() + np.linalg.slogdet(jacobian)[1]
    np.testing.assert_allclose(found.log_density, expected, rtol=1e-6)
    # Without any scatter about their trend they follow it.
    assert np.isfinite(spread(u[:3], u[3:], np.array([1e-70])).log_density).all()


def test_coordinates_have_the_prior_of_subjects_trial_sds():
    """Their density is that of standard normals times the Jacobian of the map, by differences."""
    rng = np.random.default_rng(6)
    subject = np.repeat(np.arange(5), 12)
    cell = np.tile(np.repeat(np.arange(3), 4), 5)
    size = np.exp(rng.normal(0.0, 0.5, 5))[subject]
    response = size[:, None] * rng.normal(size=(60, 2))
    # A subject who repeats no trial, and one whose settings are all alike.
    kept = (subject != 1) | (np.arange(60) % 4 == 0)
    response[subject == 3] = 1.0
    nothing = np.zeros((kept.sum(), 0))
    scatter = trial_scatter(response[kept], subject[kept], cell[kept], nothing, by_subject=True)
    spreads = SubjectSpreads(scatter, 5, 3, 0.6)
    omega = np.array([[0.4], [0.7]])
    step = 1e-6

    def multiples(coordinates):
        width = coordinates.shape[1]
        scales = np.repeat(omega, width, axis=1)
        phi, log_density = spreads(coordinates.reshape(2, 5, width), scales)
        return (phi / omega[:, None]).reshape(10, width), log_density

    here = rng.normal(size=(10, 1))
    ends, _ = multiples(here + step * np.hstack([np.eye(10), -np.eye(10)]))
    jacobian = (ends[:, :10] - ends[:, 10:]) / (2.0 * step)
    standard, found = multiples(here)
    expected = stats.norm.logpdf(standard).sum() + np.linalg.slogdet(jacobian)[1]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_subjects_trial_sds_stand_at_their_rough_likelihood():
    """With a wide prior and many trials, ratios of subjects' SDs are those of their scatter."""
    rng = np.random.default_rng(7)
    true = np.array([-0.6, 0.0, 0.2, 0.5])
    subject = np.repeat(np.arange(4), 4000)
    cell = np.tile(np.arange(2), 8000)
    response = np.exp(true[subject] + 0.3 * cell)[:, None] * rng.normal(size=(16000, 1))
    nothing = np.zeros((16000, 0))
    scatter = trial_scatter(response, subject, cell, nothing, by_subject=True)
    spreads = SubjectSpreads(scatter, 4, 2, 0.0)
    phi, _ = spreads(np.zeros((1, 4, 1)), np.array([[10.0]]))
    ratios = phi[0, :, 0] - phi[0, :, 0].mean()
    # A log SD from 4,000 trials has a standard error of 1/sqrt(8,000).
    np.testing.assert_allclose(ratios, true - true.mean(), atol=4.0 / np.sqrt(8000.0))
    cells = spreads.cells_given(phi)[0, :, 0]
    np.testing.assert_allclose(cells[1] - cells[0], 0.0, atol=1e-2)


@pytest.mark.parametrize("levels", [2, 3, 5])
def test_every_difference_of_levels_has_the_prior_of_two(levels):
    columns = contrast_columns(levels)
    np.testing.assert_allclose(columns.sum(axis=0), 0.0, atol=1e-12)
    for first in range(levels):
        for second in range(first):
            apart = columns[first] - columns[second]
            assert apart @ apart == pytest.approx(1.0)
    np.testing.assert_allclose(contrast_columns(2)[:, 0], [-0.5, 0.5])


def test_an_interaction_has_the_prior_of_a_difference():
    """Differences of differences have prior SD one, and so has each main effect."""
    model = made("two by two, spread").model
    terms = {term.name: term.columns for term in model.design.fixed}
    corners = np.array([1.0, -1.0, -1.0, 1.0])
    assert terms["hand:load"][:, 0, :4] @ corners == pytest.approx(1.0)
    assert terms["hand"][:, 0, :4] @ [-0.5, -0.5, 0.5, 0.5] == pytest.approx(1.0)


def test_absorbed_columns_are_integrated_out():
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(5, 7, 2))
    rest, log_determinant = absorb(columns, 2)
    for w in range(2):
        first = columns[:2, :, w].T
        covariance = np.eye(7) + first @ first.T
        assert log_determinant[w] == pytest.approx(np.linalg.slogdet(covariance)[1])
        others = columns[2:, :, w]
        expected = others @ np.linalg.solve(covariance, others.T)
        np.testing.assert_allclose(rest[..., w] @ rest[..., w].T, expected, rtol=1e-10)


def test_densities_of_extreme_scales_are_numbers_or_nothing():
    for name in ("two by two, spread", "unequal trials", "covariates of trials"):
        model = made(name).model
        points = np.random.default_rng(5).normal(0.0, 12.0, (200, len(model.names)))
        value = model(points)
        assert not np.isnan(value).any()
        assert np.isneginf(model(np.full((1, len(model.names)), 1e4))).all()


def test_wrong_priors_change_the_density():
    """The prior SD of a contrast is felt, so that the comparisons above can fail."""
    wide = made("two levels, trials").model
    narrow = made("two levels, trials", priors=Priors(lambda_sd=0.01)).model
    points = points_of(wide)
    assert (np.abs(wide(points) - narrow(points)) > 1e-3).all()
