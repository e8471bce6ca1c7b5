"""Models that put densities together: batches, resolution, products and cells by themselves."""

import numpy as np
import pytest
from scipy import integrate, stats

from percept.errors import RefusalError
from percept.inference.hierarchy.density import CollapsedDensity
from percept.inference.hierarchy.model import Resolution
from percept.inference.hierarchy.models import Product, Unpooled
from percept.inference.hierarchy.statistics import from_summary
from tests.inference.hierarchy import dense_twin, designs
from tests.inference.hierarchy.test_statistics import reduce


@pytest.mark.parametrize("name", designs.NAMES)
def test_a_value_does_not_depend_on_its_batch(name):
    density = CollapsedDensity(designs.study(name, np.random.default_rng(2)).statistics)
    points = np.random.default_rng(3).normal(size=(1100, density.dimension))
    whole = density(points)
    for size in (2, 7, 256, 512, 1024):
        np.testing.assert_allclose(density(points[:size]), whole[:size], rtol=1e-13)
    np.testing.assert_array_equal(density(points[::-1]), whole[::-1])
    # numpy sums a single column in another order.
    np.testing.assert_allclose(density(points[:1]), whole[:1], rtol=1e-14)


def test_laws_do_not_depend_on_their_batch():
    model = CollapsedDensity(designs.study("unequal trials", np.random.default_rng(2)).statistics)
    points = np.random.default_rng(3).normal(size=(700, len(model.names)))
    whole = model.laws(points).pack()
    np.testing.assert_allclose(model.laws(points[100:130]).pack(), whole[100:130], rtol=1e-13)


def test_resolution_adds_its_variance():
    study = designs.study("trials", np.random.default_rng(5))
    rng = np.random.default_rng(6)
    between, trial = 0.1 * rng.random((2, 4)), 0.05 * rng.random((2, 4))
    density = CollapsedDensity(
        study.statistics, resolution=Resolution(between=between, trial=trial)
    )
    scales = density.layout.scales(rng.normal(size=(density.dimension, 5)))
    ours = density.log_likelihood(scales)
    for w in range(5):
        covariance = dense_twin.trial_covariance(
            study.subject, study.environment, study.x, scales, w, alpha_sd=1.0, gamma_sd=0.25
        )
        extra = np.zeros_like(covariance).reshape(len(study.subject), 2, len(study.subject), 2)
        same_cell = (study.subject[:, None] == study.subject) & (
            study.environment[:, None] == study.environment
        )
        for p in range(2):
            extra[:, p, :, p] += same_cell * between[p, study.environment]
            extra[:, p, :, p] += np.diag(trial[p, study.environment])
        total = covariance + extra.reshape(covariance.shape)
        wanted = stats.multivariate_normal(np.zeros(len(total)), total).logpdf(
            study.response.ravel()
        )
        assert abs(ours[w] - wanted) < 1e-9 * (1 + abs(wanted))


def test_identical_subjects_have_an_answer_with_a_resolution():
    study = designs.study("balanced", np.random.default_rng(5))
    response = study.response.copy()
    response[study.environment == 2] = 0.1
    still = designs.Study(response, study.subject, study.environment, study.x, study.statistics)
    density = CollapsedDensity(reduce(still), resolution=Resolution(between=np.full((2, 4), 1e-6)))
    points = np.random.default_rng(1).normal(size=(200, density.dimension))
    assert np.isfinite(density(points)).all()
    # The spread of that environment cannot run off to zero: the resolution bounds the density.
    far = np.zeros((2, density.dimension))
    far[1, density.names.index("sigma[k,VE3]")] = -30.0
    assert density(far)[1] < density(far)[0]


def summary(parameter, seed):
    rng = np.random.default_rng(seed)
    return CollapsedDensity(
        from_summary(
            0.1 * rng.normal(size=3),
            0.1 + 0.1 * rng.random(3),
            np.array([10, 8, 12]),
            np.array([-1.0, 0.2, 0.8]),
            parameter=parameter,
            environments=("VE1", "VE2", "VE3"),
        )
    )


def test_product_is_its_models_side_by_side():
    models = [summary("k", 1), summary("b", 2)]
    product = Product(models)
    assert product.names == models[0].names + models[1].names
    assert product.cells == models[0].cells + models[1].cells
    points = np.random.default_rng(0).normal(size=(6, len(product.names)))
    parts = np.split(points, 2, axis=1)
    np.testing.assert_allclose(
        product(points), models[0](parts[0]) + models[1](parts[1]), rtol=1e-14
    )
    laws = [model.laws(part) for model, part in zip(models, parts, strict=True)]
    joined = product.laws(points)
    for name in ("mean", "sd", "population_sd"):
        np.testing.assert_array_equal(
            getattr(joined, name), np.hstack([getattr(law, name) for law in laws])
        )
    scales = [model.scales(part) for model, part in zip(models, parts, strict=True)]
    for name, (dimensions, values) in product.scales(points).items():
        assert dimensions == scales[0][name][0]
        np.testing.assert_array_equal(values, np.concatenate([s[name][1] for s in scales], axis=1))
    means, users = product.draw(np.repeat(points[:1], 20_000, axis=0), np.random.default_rng(5))
    spread = np.hypot(joined.sd[0], joined.population_sd[0])
    assert np.all(
        np.abs(means.mean(axis=0) - joined.mean[0]) < 4.5 * joined.sd[0] / np.sqrt(20_000)
    )
    assert np.all(np.abs(users.std(axis=0) / spread - 1) < 4.5 / np.sqrt(40_000))


CELLS = (("k", "VE1"), ("k", "VE2"), ("b", "VE1"))


def test_unpooled_integrates_to_student_t():
    """Mixing beta | sigma over the posterior of sigma gives t with n - 1 degrees of freedom."""
    counts = np.array([2, 10, 25])
    model = Unpooled(CELLS, counts)
    for c, n in enumerate(counts):

        def law(u, c=c):
            point = np.zeros((1, 3))
            point[0, c] = u
            return model(point)[0] - model(np.zeros((1, 3)))[0], model.laws(point)

        def density(u, law=law):
            return np.exp(law(u)[0])

        mass = integrate.quad(density, -12, 60, limit=200, epsabs=1e-13)[0]
        for t in (0.0, 0.7, 2.5):

            def below(u, t=t, c=c, n=n, density=density, law=law):
                laws = law(u)[1]
                return density(u) * stats.norm.cdf(
                    (t / np.sqrt(n) - laws.mean[0, c]) / laws.sd[0, c]
                )

            found = integrate.quad(below, -12, 60, limit=200, epsabs=1e-13)[0] / mass
            assert abs(found - stats.t.cdf(t, n - 1)) < 1e-8, (n, t)


def test_unpooled_laws_and_draws():
    model = Unpooled(CELLS, np.array([3, 5, 9]))
    points = np.repeat(np.array([[0.3, -1.0, 0.5]]), 40_000, axis=0)
    laws = model.laws(points[:1])
    sigma = np.exp(points[0] / np.sqrt(2 * np.array([2.0, 4.0, 8.0])))
    np.testing.assert_allclose(laws.population_sd[0], sigma, rtol=1e-14)
    np.testing.assert_allclose(laws.sd[0], sigma / np.sqrt([3, 5, 9]), rtol=1e-14)
    np.testing.assert_allclose(model.scales(points[:1])["sigma_ratio"][1][0], sigma, rtol=1e-14)
    means, users = model.draw(points, np.random.default_rng(8))
    error = 4.5 / np.sqrt(2 * 40_000)
    assert np.all(np.abs(means.std(axis=0) / laws.sd[0] - 1) < error)
    assert np.all(
        np.abs(users.std(axis=0) / np.hypot(laws.sd[0], laws.population_sd[0]) - 1) < error
    )
    assert np.all(np.abs((users - means).std(axis=0) / laws.population_sd[0] - 1) < error)
    assert model.names == ["log sigma[k,VE1]", "log sigma[k,VE2]", "log sigma[b,VE1]"]


def test_unpooled_refuses_a_single_subject():
    with pytest.raises(RefusalError, match=r"k in VE2 has one subject.*needs two\..*partial"):
        Unpooled(CELLS, np.array([3, 1, 4]))


def test_pooled_scales_are_those_of_the_layout():
    model = CollapsedDensity(designs.study("trials", np.random.default_rng(1)).statistics)
    points = np.random.default_rng(3).normal(size=(5, len(model.names)))
    named = model.layout.scales(np.ascontiguousarray(points.T)).named
    scales = model.scales(points)
    assert set(scales) == set(named)
    assert scales["rho_u"][0] == ()
    assert scales["tau"][0] == ("parameter",)
    assert scales["sigma_e"][0] == ("parameter", "environment")
    for name, (_, values) in scales.items():
        np.testing.assert_array_equal(values[3], named[name][..., 3])
    laws = model.laws(points)
    total = np.hypot(named["sigma"], named["sigma_u"][:, None])
    np.testing.assert_allclose(laws.population_sd, total.reshape(-1, 5).T, rtol=1e-12)
